"""A press as a typed record of a row, from the log to the report, and the only parser of its cells.

`LoggedPress` is a row of the raw log, `PosedPress` one of the pose table that stage 10 writes. Lengths are mm, angles
degrees, forces N, moments N m. In every file and message, a row's number is its line in the log, as in an editor.
"""

import math
import re
from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from gelforge.errors import BadInput, printable
from gelforge.flow.layout import command_for

if TYPE_CHECKING:  # commands that only read logs need no arrays: importing numpy would double their start-up time
    import numpy as np

POSE = ("x0_mm", "y0_mm", "z0_mm", "dx_mm", "dy_mm", "dz_mm", "rot_deg")
TILT = ("tilt_x_deg", "tilt_y_deg")  # an empty cell: the tilt of [poses], which is 0 where none is set
MOST_NAMED = 5  # most images named in one message, and most presses named for an image
FORCE = ("fx_n", "fy_n", "fz_n")
MOMENT = ("mx_nm", "my_nm", "mz_nm")
FORCES = (*FORCE, *MOMENT)
N_M = 1e-3  # N m in a N mm: columns named as the log's hold N m, arrays and Python's attributes N mm
COLUMNS = ("sample_id", "time_utc", "sensor_id", "gel_id", "indenter", *POSE, *FORCES, "image")
OPTIONAL = ("press_id", "mounting", *TILT)
KNOWN = (*COLUMNS, *OPTIONAL)
# Files with the tables of the sensors and indenters that rows name.
SENSOR_TABLES = "workflow/sensors.toml or the dataset's own sensors.toml"
INDENTER_TABLES = (
    "workflow/indenters.toml (or the catalogue that dataset.toml names) or the dataset's own indenters.toml"
)

ID_RULE = "1 to 100 characters, each a letter, a digit or one of . - _, beginning with a letter or digit"
LARGEST = {
    **dict.fromkeys(POSE, 1000.0),
    "rot_deg": 3600.0,
    **dict.fromkeys(TILT, 30.0),
    **dict.fromkeys(FORCE, 500.0),
    **dict.fromkeys(MOMENT, 20.0),
}
# A drifted force sensor may read a light press as a small pull; a larger pull means that the sign is reversed.
LARGEST_PULL_N = 0.5
SHALLOW, BORNE = 0.01, 1.0  # mm and N: no gel bears such a force at so small a depth, so depths are in metres
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.\-]{0,99}", re.ASCII)

# Faults of a row that leave its cells unreliable: column that the rejection names, reason, hint.
ROW_FAULTS = {
    "more_cells": (
        "sample_id",
        "the row has more cells than the header has columns",
        "quote cells that hold a comma, write decimals with a point, and end rows as the header ends",
    ),
    "fewer_cells": (
        "sample_id",
        "the row has fewer cells than the header has columns",
        "complete it, or remove it if its writing was cut off: a number that was cut is another number; leave a cell empty by"
        " its comma",
    ),
    "second_header": (
        "sample_id",
        "the row is a header again",
        "remove it, as where two logs were put one behind the other; both must have the same columns in the same order",
    ),
}
ABSENT = "the column is missing in the header"


@dataclass(frozen=True)
class Press:
    """Pose and path of one press in the gel frame, mm and degrees.

    The tip touches the plane z = z0 at (x0, y0), turned by `rot_deg` about z; then it moves down
    to dz (negative), then sideways by (dx, dy) at that depth. A tilted indenter is then also turned about its tip, by
    `tilt_x_deg` about the gel's x and after that by `tilt_y_deg` about the gel's y, both right-handed.
    """

    x0: float
    y0: float
    z0: float
    dx: float
    dy: float
    dz: float
    rot_deg: float = 0.0
    tilt_x_deg: float = 0.0
    tilt_y_deg: float = 0.0

    def pose(self, press: float, shear: float) -> "tuple[np.ndarray, np.ndarray]":
        """Rotation (3, 3) and translation (3,) mm of the indenter frame at fractions of the way down and sideways."""
        import numpy as np

        angle = np.deg2rad(self.rot_deg)
        c, s = np.cos(angle), np.sin(angle)
        rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        if self.tilted:
            (cx, cy), (sx, sy) = (of(np.deg2rad([self.tilt_x_deg, self.tilt_y_deg])) for of in (np.cos, np.sin))
            about_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
            about_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
            rotation = about_y @ about_x @ rotation
        travel = np.array([shear * self.dx, shear * self.dy, press * self.dz])
        return rotation, np.array([self.x0, self.y0, self.z0]) + travel

    @property
    def tilted(self) -> bool:
        """Whether the indenter's axis differs from the gel's z axis."""
        return bool(self.tilt_x_deg or self.tilt_y_deg)

    @property
    def end(self) -> float:
        """Path parameter of the end: 2 where the press goes sideways, else 1."""
        return 2.0 if self.dx or self.dy else 1.0

    @property
    def straight_there(self) -> "Press":
        """The press straight down that ends in the same pose."""
        return replace(self, x0=self.x0 + self.dx, y0=self.y0 + self.dy, dx=0.0, dy=0.0)


@dataclass(frozen=True, kw_only=True)
class PressRecord:
    """What the log says of one press; a force that was not measured is None, a pose that was not logged NaN.

    press_id: shared by the frames of one press (`records.frames`); empty where the row is the only one. mounting: name
    of the mounting of the sensor and its gel, between two re-seatings; rows without one are of one mounting.
    tilt_x_deg, tilt_y_deg: None where the row has none.
    """

    row: int
    sample_id: str
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
    press_id: str = ""
    mounting: str = ""
    tilt_x_deg: float | None = None
    tilt_y_deg: float | None = None

    @property
    def press(self) -> Press:
        """Pose and path."""
        x, y = self.tilt
        return Press(self.x0_mm, self.y0_mm, self.z0_mm, self.dx_mm, self.dy_mm, self.dz_mm, self.rot_deg, x, y)

    @property
    def tilt(self) -> tuple[float, float]:
        """Tilt about gel x and y, degrees; 0 where the record has none."""
        return self.tilt_x_deg or 0.0, self.tilt_y_deg or 0.0

    @property
    def posed(self) -> bool:
        """Whether the log has the whole pose: images that were imported with their labels may have none."""
        return all(math.isfinite(getattr(self, name)) for name in POSE)

    @property
    def force(self) -> "np.ndarray":
        """Force on the gel along its axes, (3,) N; NaN where it was not measured."""
        import numpy as np

        return np.array([self.fx_n, self.fy_n, self.fz_n], dtype=float)

    @property
    def wrench(self) -> "np.ndarray":
        """Force and moment on the gel along its axes, (6,) N and N m; NaN where they were not measured."""
        import numpy as np

        return np.array([getattr(self, name) for name in FORCES], dtype=float)

    def cells(self) -> dict[str, str]:
        """The record as text; numbers in the shortest form that reads back to the same float."""
        return {name: _cell(value) for name, value in vars(self).items() if name != "row"}


@dataclass(frozen=True, kw_only=True)
class LoggedPress(PressRecord):
    """One row of the raw log."""

    time_utc: str = ""


@dataclass(frozen=True, kw_only=True)
class PosedPress(PressRecord):
    """One row of the pose table: the path of the tip relative to the gel; stl names the posed surface."""

    stl: str = ""


@dataclass(frozen=True)
class RawRow:
    """One row of a log as text: cells by known column, stripped; `fault` names one of ROW_FAULTS."""

    row: int
    cells: dict[str, str]
    fault: str = ""

    @property
    def press_id(self) -> str:
        """Identifier that rows of one press share; empty where the row is the only one."""
        return self.cells.get("press_id", "")


@dataclass(frozen=True)
class Rejection:
    """Why a row is rejected for one cell, and what to do; text of the log is shown as `printable`."""

    file: str
    row: int
    sample_id: str
    column: str
    value: str
    reason: str
    hint: str

    def __str__(self) -> str:
        return f"rejected: {self.text}"

    @property
    def text(self) -> str:
        """What is wrong where, and what to do."""
        where = f"{self.file}, row {self.row}, {self.sample_id or 'no sample_id'}"
        return printable(f"{where}: {self.column} = {self.value!r}: {self.reason}; {self.hint}")


def with_tilt(
    press: LoggedPress, tilt_deg: Sequence[float], by_mounting: Mapping[str, Sequence[float]] = MappingProxyType({})
) -> LoggedPress:
    """A press with a tilt about gel x and y, degrees, where its record has none.

    by_mounting: the tilt of each mounting that has its own; tilt_deg: of all others.
    """
    usual = by_mounting.get(press.mounting, tilt_deg)
    stated: dict[str, Any] = {
        name: tilt for name, tilt in zip(TILT, usual, strict=True) if tilt and getattr(press, name) is None
    }
    return replace(press, **stated) if stated else press


MOST_ROWS = 5  # of one reason that are listed by number


def summarised(rejections: Iterable[Rejection], verdict: str = "rejected") -> list[str]:
    """One line per column, reason and hint: the first rejection, the number of further rows and the first of these.

    A log that lacks a column gives the same reason for every row. verdict: what becomes of the rows.
    """
    alike: dict[tuple[str, str, str], list[Rejection]] = {}
    for one in rejections:
        alike.setdefault((one.column, one.reason, one.hint), []).append(one)
    return [f"{verdict}: {first.text}{_more(others)}" for first, *others in alike.values()]


def _more(others: list[Rejection]) -> str:
    if not others:
        return ""
    rows = ", ".join(str(one.row) for one in others[:MOST_ROWS])
    rest = ", …" if len(others) > MOST_ROWS else ""
    return f"; the same reason against {len(others)} more row{'s' if len(others) > 1 else ''}: {rows}{rest}"


def reject(press: PressRecord, file: str, column: str, reason: str, hint: str) -> Rejection:
    """A rejection for one cell of a press whose row was parsed."""
    return Rejection(
        file, press.row, press.sample_id, column, printable(_cell(getattr(press, column)))[:200], reason, hint
    )


def parse_number(text: str) -> float | None:
    """The finite float that plain decimal text stands for, else None."""
    text = text.replace("\u2212", "-")  # typographic minus sign
    value = float(text) if _NUMBER.fullmatch(text) else math.nan
    return value if math.isfinite(value) else None


def names_files(name: str) -> bool:
    """Whether a name may be used for our files and folders (ID_RULE)."""
    return _ID.fullmatch(name) is not None


def check_id(name: str, what: str = "sample_id") -> str:
    """The name, if it may be used for files; any other raises BadInput. what: what is named, for the message."""
    if not names_files(name):
        raise BadInput(f"{what} {name[:100]!r} is not usable as a file name; use {ID_RULE}")
    return name


def parse(raw: RawRow, file: str, needed: Collection[str] = COLUMNS) -> tuple[LoggedPress | None, list[Rejection]]:
    """One raw row as a typed press, or None and every reason against it.

    Columns that are not `needed` may be missing or, but for OPTIONAL ones, hold anything: unreadable cells stay
    empty.
    """
    absent = [name for name in COLUMNS if name in needed and name not in raw.cells]
    if raw.fault == "more_cells" and absent:  # for example, the header lacks a column's name
        return None, [
            _rejection(raw, file, name, ABSENT, f"write {name} there again, at its place") for name in absent
        ]
    if raw.fault:
        column, *why = ROW_FAULTS[raw.fault]
        return None, [_rejection(raw, file, column, *why)]
    wrong: list[Rejection] = []
    values: dict[str, Any] = {}
    for name in KNOWN:
        values[name], fault = judge_cell(name, raw.cells.get(name))
        if fault and (name in needed or name in OPTIONAL):
            wrong.append(_rejection(raw, file, name, *fault))
    if not wrong and values["dz_mm"] > -SHALLOW and abs(values["fz_n"] or 0.0) > BORNE:
        reason = f"less than {SHALLOW:g} mm beside a force of {values['fz_n']:g} N"
        wrong.append(_rejection(raw, file, "dz_mm", reason, "check the units: mm and N"))
    return (None, wrong) if wrong else (LoggedPress(row=raw.row, **values), [])


def parse_posed(raw: RawRow, file: str) -> PosedPress:
    """One row of a pose table; a cell that stage 10 cannot have written raises BadInput."""
    press, wrong = parse(raw, file, ("sample_id", "sensor_id", "indenter", *POSE))
    if press is None:
        hint = f"delete it and run {command_for('poses', file)}"
        raise BadInput(f"{file}: row {raw.row}: {wrong[0].column}: {wrong[0].reason}; {hint}")
    cells = {name: value for name, value in vars(press).items() if name != "time_utc"}
    return PosedPress(**cells, stl=raw.cells.get("stl", ""))


def _rejection(raw: RawRow, file: str, column: str, reason: str, hint: str) -> Rejection:
    sample_id, value = (
        printable(raw.cells.get(name, ""))[:most] for name, most in (("sample_id", 100), (column, 200))
    )
    return Rejection(file, raw.row, sample_id, column, value, reason, hint)


def _cell(value: str | float | None) -> str:
    if value is None or isinstance(value, str):
        return value or ""
    return repr(float(value)) if math.isfinite(value) else ""


def judge_cell(name: str, text: str | None) -> tuple[str | float | None, tuple[str, str] | None]:
    """Value of a cell and None, or the empty value of its column and what is wrong: (reason, hint)."""
    if text is None:
        measured = f"rename the column that holds it to {name}; where it was not measured, "
        hint = f"{measured if name in FORCES else ''}add a column {name} to the log{' with empty cells' if name in FORCES else ''}"
        if name == "image":
            hint = "add a column image to the log, or set [params.poses] images = false in the dataset's dataset.toml"
        return _nothing(name), None if name in OPTIONAL else (ABSENT, hint)
    if name in POSE or name in FORCES or name in TILT:
        value, fault = _number_cell(name, text)
        return (_nothing(name) if value is None else value), fault
    fault = _word_fault(name, text)
    return (_nothing(name) if fault else text), fault


def _nothing(name: str) -> str | float | None:
    return math.nan if name in POSE else None if name in FORCES or name in TILT else ""


def _number_cell(name: str, text: str) -> tuple[float | None, tuple[str, str] | None]:
    if not text:
        every = "every press needs its full pose and path; write 0 where nothing moves"
        return None, None if name in FORCES or name in TILT else ("the cell is empty", every)
    value = parse_number(text)
    if value is None:
        empty = ", or leave the cell empty" if name in FORCES or name in TILT else ""
        return None, ("not a finite number", f"write plain decimals with a point, like -1.25{empty}")
    if fault := size_fault(name, value):
        return None, fault
    if name == "dz_mm" and value >= 0.0:
        why = "the indenter does not move towards the gel", "give the press depth as a negative number"
        return None, why
    return value, None


def size_fault(name: str, value: float) -> tuple[str, str] | None:
    """Reason and hint for a number in a column of POSE, TILT or FORCES that is too large for our units, else None."""
    return (
        (f"larger than {LARGEST[name]:g}", "check the unit: mm, degrees, N and N m")
        if abs(value) > LARGEST[name]
        else None
    )


def pull_fault(fz_n: float) -> tuple[str, str] | None:
    """Reason and hint for a normal force that pulls on the gel, else None."""
    if fz_n <= LARGEST_PULL_N:
        return None
    hint = (
        "tare the sensor if it reads a force without contact; forces are those on the gel: multiply the force columns by -1 if the"
        " sensor states those on the indenter"
    )
    return "the force reading pulls while the indenter presses", hint


def _word_fault(name: str, text: str) -> tuple[str, str] | None:
    if name == "sample_id" and not _ID.fullmatch(text):
        return "not usable as a file name", f"use {ID_RULE}"
    if name in ("press_id", "mounting") and text and not _ID.fullmatch(text):
        return "not a name", f"use {ID_RULE}, or leave it empty"
    if name == "sensor_id" and not text:
        return "the cell is empty", f"write a name of {SENSOR_TABLES}"
    if name == "indenter" and not text:
        return "the cell is empty", f"write a name of {INDENTER_TABLES}"
    if name == "time_utc" and text:
        try:
            datetime.fromisoformat(text)
        except ValueError:
            return "not a time", "write ISO 8601 like 2025-04-08T12:25:19Z, or leave the cell empty"
    return None


def repeats(records: Sequence[PressRecord | RawRow], pictures: Sequence[Hashable]) -> list[list[int]]:
    """For each image that several presses show, the numbers of the records that show it.

    pictures: key of the content of each record's image, None where it has no image. Frames of one press may share an
    image, for example where a log runs faster than its camera.
    """
    found: dict[Hashable, list[int]] = {}
    for at, picture in enumerate(pictures):
        if picture is not None:
            found.setdefault(picture, []).append(at)
    several = (members for members in found.values() if len(members) > 1)
    return [members for members in several if len({records[at].press_id or at for at in members}) > 1]


def describe_repeats(where: str, records: Sequence[PressRecord], found: Sequence[Sequence[int]]) -> str:
    """One sentence about `repeats`; where: the file of the presses."""
    each = []
    for members in found[:MOST_NAMED]:
        names = [f"{records[at].sample_id} ({records[at].image})" for at in members]
        more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
        each.append(", ".join(names[:MOST_NAMED]) + more)
    more = f"; {len(found) - MOST_NAMED} more such pictures" if len(found) > MOST_NAMED else ""
    count = sum(map(len, found))
    return (
        f"{where}: {count} presses share {len(found)} picture{'s' if len(found) > 1 else ''} of the same content:"
        f" {'; '.join(each)}{more}"
    )
