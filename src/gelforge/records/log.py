"""The raw log: one row per press, judged cell by cell; what is wrong comes back as data."""

import math
import re
import struct
import zlib
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.files import read_csv, write_csv

POSE = ("x0_mm", "y0_mm", "z0_mm", "dx_mm", "dy_mm", "dz_mm", "rot_deg")
FORCES = ("fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm")
COLUMNS = ("sample_id", "time_utc", "sensor_id", "gel_id", "indenter", *POSE, *FORCES, "image")
REJECTION_COLUMNS = ("file", "row", "sample_id", "column", "value", "reason", "remedy")

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.\-]{0,99}", re.ASCII)
_PNG = b"\x89PNG\r\n\x1a\n"
LARGEST = {**dict.fromkeys(POSE, 1000.0), "rot_deg": 3600.0, **dict.fromkeys(FORCES, 1e5)}
MOST_PIXELS = 4096 * 4096


@dataclass(frozen=True)
class Sample:
    """One press as logged: mm, degrees, N, N m; a force that was not measured is None."""

    row: int
    sample_id: str
    time_utc: str
    sensor_id: str
    gel_id: str
    indenter: str
    x0_mm: float
    y0_mm: float
    z0_mm: float
    dx_mm: float
    dy_mm: float
    dz_mm: float
    rot_deg: float
    fx_n: float | None
    fy_n: float | None
    fz_n: float | None
    mx_nm: float | None
    my_nm: float | None
    mz_nm: float | None
    image: str

    def press(self):
        """The pose and path as `mechanics.scene.Press`."""
        from gelforge.mechanics.scene import Press

        return Press(self.x0_mm, self.y0_mm, self.z0_mm, self.dx_mm, self.dy_mm, self.dz_mm, self.rot_deg)

    def cells(self) -> dict[str, str]:
        """The row as text; numbers in the shortest form that reads back to the same float."""
        return {name: _cell(value) for name, value in asdict(self).items() if name != "row"}


@dataclass(frozen=True)
class Rejection:
    """Why one cell keeps its row out, and what to do."""

    file: str
    row: int
    sample_id: str
    column: str
    value: str
    reason: str
    remedy: str

    def __str__(self) -> str:
        where = f"{self.file}, row {self.row}, {self.sample_id or 'no sample_id'}"
        return f"rejected: {where}: {self.column} = {self.value!r}: {self.reason}; {self.remedy}"


def read_log(path) -> list[dict]:
    """Rows of a log as dicts of text with their line number as `row`; an empty log is BadInput."""
    try:
        rows = read_csv(path)
    except FileNotFoundError:
        raise BadInput(f"{path}: not found; a dataset needs its raw log there") from None
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: not UTF-8 text ({error}); save it as CSV in UTF-8") from None
    if not rows:
        raise BadInput(f"{path}: holds no presses; log at least one row under {', '.join(COLUMNS)}")
    return [row if "row" in row else {"row": str(line), **row} for line, row in enumerate(rows, 2)]


def write_log(path, samples: Iterable[Sample]) -> None:
    """Write samples as a raw log that `read_log` and `parse` read back to the last digit."""
    write_csv(path, COLUMNS, [sample.cells() for sample in samples])


def parse_number(text: str) -> float | None:
    """The finite float that plain decimal text stands for, else None."""
    value = float(text) if _NUMBER.fullmatch(text) else math.nan
    return value if math.isfinite(value) else None


def parse(row: dict, file: str) -> tuple[Sample | None, list[Rejection]]:
    """One raw row as a typed sample, or None and every reason against it."""
    cells = {name: _text(row.get(name)) for name in COLUMNS}
    number = int(row["row"]) if _text(row.get("row")).isdigit() else 0
    wrong = []

    def reject(column, reason, remedy):
        wrong.append(Rejection(file, number, cells["sample_id"][:100], column, cells[column][:200], reason, remedy))

    absent = [name for name in COLUMNS if row.get(name) is None]
    for name in absent:
        reject(name, "the column is missing", f"add a column {name} to the log (the force columns may be empty)")
    if row.get(None) or _text(row.get("extra_columns")):
        reject(
            "image",
            "the row has more cells than the header has columns",
            "quote cells that hold a comma, and write decimals with a point",
        )
    values = {}
    for name in POSE + FORCES:
        if name not in absent:
            values[name] = _number_cell(name, cells[name], reject)
    for name in ("sample_id", "time_utc", "sensor_id", "indenter"):
        if name not in absent:
            _word_cell(name, cells[name], reject)
    if values.get("dz_mm") is not None and values["dz_mm"] >= 0.0:
        reject("dz_mm", "the indenter does not move towards the gel", "give the press depth as a negative number")
    if wrong:
        return None, wrong
    return Sample(row=number, **{**cells, **values}), []


def _cell(value) -> str:
    if value is None or isinstance(value, str):
        return value or ""
    return repr(float(value))


def _text(value) -> str:
    return value.strip() if isinstance(value, str) else ""


def _number_cell(name, text, reject) -> float | None:
    if name in FORCES and not text:
        return None
    value = parse_number(text)
    if value is None and not text:
        reject(name, "the cell is empty", "every press needs its full pose and path; write 0 where nothing moves")
    elif value is None:
        empty = ", or leave the cell empty" if name in FORCES else ""
        reject(name, "not a finite number", f"write plain decimals with a point, like -1.25{empty}")
    elif abs(value) > LARGEST[name]:
        reject(name, f"larger than {LARGEST[name]:g}", "check the unit: mm, degrees, N and N m")
        return None
    return value


def _word_cell(name, text, reject) -> None:
    if name == "sample_id" and not _ID.fullmatch(text):
        reject(
            name,
            "not usable as a file name",
            "use 1 to 100 letters, digits, dots, dashes or underscores, beginning with a letter or digit",
        )
    if name in ("sensor_id", "indenter") and not text:
        reject(name, "the cell is empty", "name it as in its catalogue")
    if name == "time_utc" and text:
        try:
            datetime.fromisoformat(text)
        except ValueError:
            reject(name, "not a time", "write ISO 8601 like 2025-04-08T12:25:19Z, or leave the cell empty")


def reject(sample: Sample, file: str, column: str, reason: str, remedy: str) -> Rejection:
    """A rejection of one cell of a sample that could be read."""
    value = getattr(sample, column)
    text = "" if value is None else str(value)[:200]
    return Rejection(file, sample.row, sample.sample_id, column, text, reason, remedy)


def without_duplicates(samples: list[Sample], file: str) -> tuple[list[Sample], list[Rejection]]:
    """The first sample of every id, and a rejection of each later one."""
    first, good, wrong = {}, [], []
    for sample in samples:
        if sample.sample_id in first:
            remedy = f"row {first[sample.sample_id]} has it and was kept; give every press its own"
            wrong.append(reject(sample, file, "sample_id", "an earlier row has the same sample_id", remedy))
            continue
        first[sample.sample_id] = sample.row
        good.append(sample)
    return good, wrong


def unknown_names(sample: Sample, file: str, sensors, indenters) -> list[Rejection]:
    """Rejections of a sensor or an indenter that its catalogue does not have."""
    wrong = []
    if sample.sensor_id not in sensors:
        wrong.append(
            reject(
                sample,
                file,
                "sensor_id",
                "no such sensor in workflow/sensors.toml",
                f"add it there or use one of {', '.join(sensors)}",
            )
        )
    if sample.indenter not in indenters:
        wrong.append(
            reject(
                sample,
                file,
                "indenter",
                "no such indenter in the dataset's catalogue",
                f"add it there or use one of {', '.join(indenters)}",
            )
        )
    return wrong


def bad_image(sample: Sample, file: str, folder, size: tuple[int, int]) -> Rejection | None:
    """Why a sample's image cannot be used; `folder` is the dataset's, `size` the sensor's width and height."""

    def no(reason, remedy):
        return reject(sample, file, "image", reason, remedy)

    if not sample.image:
        return no("no image is named", "name its PNG, or set images = false under [params.poses] in dataset.toml")
    if "\x00" in sample.image or "\\" in sample.image:
        return no("the path holds a character that is not allowed", "write it with forward slashes: images/0001.png")
    folder = Path(folder).resolve()
    if Path(sample.image).is_absolute() or not (folder / sample.image).resolve().is_relative_to(folder):
        return no("the path leaves the dataset's folder", "copy the image below data/DATASET and name it from there")
    try:
        data = (folder / sample.image).read_bytes()
    except OSError as error:
        return no(f"cannot be read ({error.strerror})", "copy the image there, or remove the row")
    fault, seen = png_fault(data)
    if fault:
        return no(fault, "copy the file again from the source, as PNG")
    if seen != tuple(size):
        return no(
            f"is {seen[0]} x {seen[1]} pixels, the sensor has {size[0]} x {size[1]}",
            f"record at that size, or correct `image` of {sample.sensor_id} in workflow/sensors.toml",
        )
    return None


def png_fault(data: bytes) -> tuple[str | None, tuple[int, int]]:
    """What is wrong with PNG bytes (None where nothing is), and width and height.

    Chunks and checksums are walked first, because decoders show half a truncated file without complaint (PNG
    specification, 5.3).
    """
    if not data.startswith(_PNG):
        return "is not a PNG file", (0, 0)
    at, size, kind = len(_PNG), (0, 0), b""
    while kind != b"IEND":
        if at + 12 > len(data):
            return "is truncated", size
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        body = data[at + 4 : at + 8 + length]
        at += 12 + length
        if at > len(data):
            return "is truncated", size
        if zlib.crc32(body) != struct.unpack(">I", data[at - 4 : at])[0]:
            return "is damaged: a checksum is wrong", size
        if kind == b"IHDR" and length >= 8:
            size = struct.unpack(">II", body[4:12])
    if not 0 < size[0] * size[1] <= MOST_PIXELS:
        return f"has a size of {size[0]} x {size[1]} pixels", size
    return _decode_fault(data), size


def _decode_fault(data: bytes) -> str | None:
    import cv2
    import numpy as np

    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        return "cannot be decoded"
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] not in (3, 4):
        return "is not an 8-bit colour image"
    return None


def write_rejections(path, rejections: Iterable[Rejection]) -> None:
    """Write rejections as CSV, whole or not at all."""
    write_csv(path, REJECTION_COLUMNS, [asdict(r) for r in rejections])
