"""Read the files of a bench: gauge log, path log, and a film or a folder of images.

Times are in a column `time_s`, `time_ms`, `time_us`, `time_ns` or `time_utc` (ISO 8601). A gauge log is a CSV with
`fz_UNIT` and optionally `fx_UNIT` and `fy_UNIT`. A path log holds measured positions of the tip, in one of two forms.
Either it is a CSV of a time, `x_UNIT`, `y_UNIT`, `z_UNIT`, optionally `rot_deg`, and no other column. Or it has lines
`TIME <STATE|WPos:x,y,z|…>`, reports of GRBL or grblHAL after their time, in s or ISO 8601; axes after the third must
stand still. With `MPos`, at least one report states `WCO`, which must not change. A folder of images has a `times.csv` with the columns `image` and a time.
"""

import os
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput, printable
from gelforge.formats.align import Recording
from gelforge.records.film import Film, open_source
from gelforge.records.image import read_image
from gelforge.records.nocontactimage import STILL
from gelforge.records.press import FORCE, parse_number
from gelforge.records.regular import read_text
from gelforge.records.table import TableRows, cure

NEWTONS = {"n": 1.0, "mn": 1e-3, "kn": 1e3, "gf": 9.80665e-3, "kgf": 9.80665, "lbf": 4.4482216, "ozf": 0.27801385}
MILLIMETRES = {"mm": 1.0, "um": 1e-3, "m": 1e3, "in": 25.4}
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
HINT = "the head of src/gelforge/formats/benchfiles.py says which columns are read"
AXES = "xyz"
SMALL = (64, 48)  # px at which the change of an image is measured
FASTEST_MM_S = 500.0  # largest speed of a tip
SLOWEST_S, SLOWEST_GAUGE_S = 0.25, 5.0  # largest sampling intervals of a path and of a gauge
MOST_HEAD = 100  # lines in which a misplaced header is searched
NUMBER = r"-?\d+\.\d{1,3}"
PLACE = rf"({NUMBER}(?:,{NUMBER}){{2,7}})"  # x, y, z, and further axes
STAMP = r"(\d+(?:\.\d+)?|\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d(?:\.\d+)?(?:Z|[+-]\d\d:?\d\d)?)"  # seconds, or ISO 8601
# States of GRBL and grblHAL in which the tip is where it reports, with their substates.
REPORT = re.compile(rf"{STAMP} <(?:Idle|Run|Jog|Hold|Tool)(?::\d+)?\|([MW])Pos:{PLACE}(?:\|([^<>]*))?>", re.ASCII)
OFFSET = re.compile(rf"(?:^|\|)WCO:{PLACE}(?:\||$)")
M114 = (
    r"(\d+(\.\d+)?\s+)?X:\s*-?\d",
    "M114 reports the commanded position: log the measured one, as time_s,x_mm,y_mm,z_mm",
)
# What is wrong with a line that is no report of a path, by a pattern that it matches.
STRANGE = (
    (
        r"[\d.:TZ+ -]+ <(Alarm|Home|Check|Door|Sleep)",
        "in this state the machine resets its zero or does not move: remove the line",
    ),
    (
        r"(\d{1,2}:)?\d{1,2}:\d\d(\.\d+)?\s.*<",
        "a time of day: write seconds, or date and time as 2026-09-01T12:00:00.000",
    ),
    (
        r"<\w+(:\d+)?,[MW]Pos",
        "a report of GRBL 0.9: this is not a report of GRBL 1.1 `TIME <STATE|WPos:x,y,z|...>`; update the controller",
    ),
    (
        r".*(\bok\b|error:|ALARM:|\[MSG:|\$\d+=)",
        "an answer of the controller's console: only reports are read: remove other lines, or begin them with #",
    ),
    (r"<.*[MW]Pos:-?\d+\.\d{4}", "four decimals mean inches ($13=1): set $13=0 and log again"),
    (r"<.*[MW]Pos", "this is not a report `TIME <STATE|WPos:x,y,z|...>` with its time in s first"),
    M114,
    (
        r"(?i)(\d[\d.]*\s+)?(\$J=|N\d+|[GM]\d)",
        "G-code states commanded positions, not measured ones: log the controller's reports",
    ),
)


def read_gauge(path: Path, sign: int) -> tuple[Recording, tuple[str, ...]]:
    """Read a gauge log: compression and k forces along the gel's axes (n, 1 + k) N, and the names of their columns.

    sign: -1 where the gauge counts pressing as positive.
    """
    table, times = _timed(path, "readings", "fz_n")
    forces = [table.quantity(f"f{name}", NEWTONS, needed=name == "z")[1] for name in AXES]
    found = {name: sign * np.array(values) for name, values in zip(FORCE, forces, strict=True) if values}
    gauge = Recording(str(path), times, np.column_stack([-found["fz_n"], *found.values()]))
    if gauge.interval > SLOWEST_GAUGE_S:
        raise BadInput(
            f"{path}: one reading every {gauge.interval:.3g} s, too few to follow a press: is the column of times in another unit?"
        )
    return gauge, tuple(found)


def read_path(path: Path, origin: Sequence[float]) -> Recording:
    """Read a path log: depth below the apex and the tip's x, y, z in mm, and its rotation in degrees (n, 5).

    origin (3,): the apex in the path's coordinates, mm.
    """
    text = read_text(path, HINT)
    reports = any("Pos:" in line or re.match(STRANGE[-1][0], line) for line in text.splitlines())
    times, places, lines = _reports(path, text) if reports else _samples(path)
    places[:, :3] -= np.asarray(origin, float)
    found = Recording(str(path), times, np.column_stack([-places[:, 2], places]))
    if found.interval > 1.1 * SLOWEST_S:  # reports at 4 a second have jitter
        raise BadInput(
            f"{path}: one sample every {found.interval:.3g} s, as if each line were a whole move: log the position of the tip {1 / SLOWEST_S:.0f} times a"
            " second or more"
        )
    jump = np.linalg.norm(np.diff(places[:, :3], axis=0), axis=1)
    fast = np.flatnonzero(jump > FASTEST_MM_S * np.maximum(np.diff(times), SLOWEST_S / 10))
    if len(fast):
        raise BadInput(
            f"{path} line {lines[fast[0] + 1]}: the tip jumps by {jump[fast[0]]:.3g} mm; does the log mix work and machine coordinates, two units, or two"
            " recordings?"
        )
    return found


def _samples(path: Path) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """Times (n,) s, positions x, y, z and rotation (n, 4) in mm and degrees, and line numbers of a CSV of samples."""
    table, times = _timed(path, "positions", "x_mm,y_mm,z_mm")
    places, known = np.zeros((len(times), 4)), {"rot_deg"}
    for axis, name in enumerate(AXES):
        column, places[:, axis] = table.quantity(name, MILLIMETRES, needed=True)
        known.add(column)
    if "rot_deg" in table.rows[0]:
        # without jumps from 360 to 0, between which other angles would be interpolated
        places[:, 3] = np.unwrap(table.numbers("rot_deg"), period=360.0)
    other = [name for name in table.rows[0] if name not in known and not name.startswith("time_")]
    if other:
        raise BadInput(
            f"{path}: column {printable(other[0])[:60]!r} is not known; a path has a time, x_UNIT, y_UNIT, z_UNIT and perhaps rot_deg, and"
            " no column that could mark rows of several kinds: remove it"
        )
    return times, places, table.lines


def _reports(path: Path, text: str) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """The same of GRBL's real-time status reports, in one coordinate frame (github.com/gnea/grbl, interface.md)."""
    found: list[list[float]] = []
    lines: list[int] = []
    frame, offset = "", None
    further: list[float] = []  # positions of axes after the third
    for number, line in enumerate(text.splitlines(), 1):
        line = line.strip()
        if not line or line.startswith("#"):
            continue
        report = REPORT.fullmatch(line)
        if report is None:
            why = next(
                (why for like, why in STRANGE if re.match(like, line) or ("<" in like and re.search(like, line))), ""
            )
            why = (
                why or "only reports `TIME <STATE|WPos:x,y,z|...>` are read: remove other lines, or begin them with #"
            )
            raise BadInput(f"{path} line {number}: {printable(line)[:60]!r}: {why}")
        time, of, place, rest = report.groups()
        axes = [float(value) for value in place.split(",")]
        if lines and (axes[3:] != further):
            raise BadInput(
                f"{path} line {number}: {len(axes)} axes with {axes[3:]} beyond x, y, z, and {further} before: what another axis turns or moves is unknown;"
                " keep it still, or log time_s,x_mm,y_mm,z_mm,rot_deg"
            )
        further = axes[3:]
        if frame and of != frame:
            raise BadInput(
                f"{path} line {number}: {of}Pos, and {frame}Pos before it: log one frame of coordinates ($10)"
            )
        frame = of
        for seen in OFFSET.findall(rest or ""):
            if offset not in (None, seen):
                raise BadInput(
                    f"{path} line {number}: WCO:{seen}, and WCO:{offset} before it: the origin of the work coordinates was"
                    " moved; remove the lines before or after this one"
                )
            offset = seen
        found.append([_time(path, number, "time_utc" if "-" in time else "time_s", time), *axes[:3], 0.0])
        lines.append(number)
    table = np.array(found, float).reshape(-1, 5)
    if frame == "M":
        if offset is None:
            raise BadInput(
                f"{path}: MPos without any WCO: log WPos ($10=0, of grblHAL $10=510), or include a report with WCO"
            )
        table[:, 1:4] -= np.array(offset.split(",")[:3], float)
    return table[:, 0], table[:, 1:], lines


@dataclass(frozen=True)
class Images:
    """A film or a folder of images: names (n,), times (n,) s and small copies (n, rows, cols, 3) of its images."""

    path: Path
    names: list[str]
    times: np.ndarray
    small: np.ndarray

    @classmethod
    def of(cls, path: Path) -> "Images":
        """Read names, times and small copies; BadInput where there are none."""
        if path.is_dir():
            table, times = _timed(path / "times.csv", "images", "image", ("image",))
            names = [os.path.normpath(row["image"]) for row in table.rows]
            (twice, count), *_ = Counter(names).most_common(1)
            if count > 1:
                raise BadInput(f"{path}/times.csv: names {twice} more than once; give each image its own row")
            return cls(path, names, times, np.array([_small(read_image(path / name)) for name in names], np.float32))
        with open_source(path, None) as (source, announced):
            film = Film(source, announced, str(path), None, camera=False)
            seen, small = zip(*((frame.time_s, _small(frame.image)) for frame in film), strict=True)
        names = [f"{path.stem}-{number:06d}" for number in range(len(seen))]
        return cls(path, names, np.array(seen), np.array(small, np.float32))

    def __iter__(self) -> Iterator[np.ndarray]:
        """Images (h, w, 3) uint8 RGB in the order of `times`."""
        if self.path.is_dir():
            for name in self.names:
                yield read_image(self.path / name)
            return
        with open_source(self.path, None) as (source, announced):
            for frame in Film(source, announced, str(self.path), None, camera=False):
                yield np.ascontiguousarray(frame.image[:, :, ::-1])

    def change(self) -> Recording:
        """Mean absolute change in levels (n, 1) from the mean of the first STILL images, which show no contact."""
        change = np.abs(self.small - self.small[:STILL].mean(axis=0)).mean(axis=(1, 2, 3))
        return Recording(str(self.path), self.times, change[:, None].astype(float))


def _small(image: np.ndarray) -> np.ndarray:
    """An image (h, w, 3) at the size at which its change is measured."""
    import cv2

    return cv2.resize(image, SMALL, interpolation=cv2.INTER_AREA)


def _timed(path: Path, what: str, example: str, needed: tuple[str, ...] = ()) -> tuple[TableRows, np.ndarray]:
    """A table, and its times (n,) s; example: columns beside the time, for messages."""
    _check_head(path, example)
    table = TableRows.read(path, HINT, needed, what)
    names = [name for name in table.rows[0] if name in {"time_utc", *(f"time_{unit}" for unit in SECONDS)}]
    if len(names) != 1:
        raise BadInput(
            f"{path}: {len(names)} time columns; give exactly one of time_s, time_ms, time_us, time_ns, time_utc"
        )
    cells = [row[names[0]] for row in table.rows]
    times = [_time(path, at, names[0], cell) for at, cell in zip(table.lines, cells, strict=True)]
    if names[0] == "time_s":
        _check_digits(path, cells, times)
    return table, np.array(times)


def _check_head(path: Path, example: str) -> None:
    """BadInput where a table has no header, has it below other lines, or consists of replies to M114."""
    lines = [(number, line.strip()) for number, line in enumerate(read_text(path, HINT).splitlines(), 1)]
    lines = [(number, line) for number, line in lines if line and not line.startswith("#")]
    for number, line in lines[:1]:
        cells = [cell.strip() for cell in line.split(",")]
        if re.match(M114[0], line):
            raise BadInput(f"{path} line {number}: {printable(line)[:60]!r}: {M114[1]}")
        if all(parse_number(cell) is not None for cell in cells):
            raise BadInput(
                f"{path}: has no header, it begins with {printable(line)[:60]!r}; write time_s,{example} above it"
            )
        if "time_" not in line:
            below = next((at for at, text in lines[1:MOST_HEAD] if re.match(r"(.*,)?\s*time_\w+\s*(,|$)", text)), 0)
            if below:
                raise BadInput(
                    f"{path}: its header is in line {below}; remove the lines above it, or begin them with #"
                )


def _time(path: Path, number: int, column: str, cell: str) -> float:
    """A cell as a time in s; BadInput where it is none."""
    try:
        if column == "time_utc":
            return _date(cell)
        unit = column.removeprefix("time_")
        # nanoseconds since 1970 have more digits than a float holds, so read them as int
        seconds = int(cell) / 1e9 if unit == "ns" else float(cell) * SECONDS[unit]
    except ValueError as error:
        raise BadInput(f"{path} line {number}: {cell!r} is not a valid {column}; {cure(cell) or HINT}") from error
    if not np.isfinite(seconds):
        raise BadInput(f"{path} line {number}: {column} is {cell}; {HINT}")
    return seconds


def _check_digits(path: Path, texts: list[str], times: list[float]) -> None:
    """BadInput where times are seconds and nanoseconds with a point between, without the zeros that belong there."""
    cells = [text.partition(".")[::2] for text in texts]
    if len({len(rest) for _, rest in cells}) < 2 or not all(
        whole.isdigit() and rest.isdigit() for whole, rest in cells
    ):
        return
    joined = [int(whole) + 1e-9 * int(rest) for whole, rest in cells]
    if (np.diff(times) <= 0).any() and (np.diff(joined) > 0).all():
        raise BadInput(
            f"{path}: times are seconds and nanoseconds without leading zeros ({texts[0]}): write nine digits after the point"
        )


def _date(cell: str) -> float:
    """Seconds since 1970 of a time in ISO 8601; without a time zone it is UTC."""
    when = datetime.fromisoformat(cell)
    return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()
