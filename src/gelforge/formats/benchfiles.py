"""Files of a bench, read and brought to one log: gauge log, path log, a film or a folder of images.

Times stand in a column `time_s`, `time_ms`, `time_us`, `time_ns` or `time_utc` (ISO 8601). A gauge log is a CSV with `fz_UNIT` and perhaps
`fx_UNIT` and `fy_UNIT`. A path log is a CSV with `x_UNIT`, `y_UNIT`, `z_UNIT` and perhaps `rot_deg`, or lines of G-code (or GRBL's
status reports), each behind its time in s. A folder of images has a `times.csv` with the columns `image` and a time.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import write_text
from gelforge.formats.align import MatchedClock, Recording, match_clock, presses_of
from gelforge.formats.feats_folder import NO_PRESS, new_folder
from gelforge.records.film import Film, open_source
from gelforge.records.image import read_image, write_png
from gelforge.records.log import write_log
from gelforge.records.nocontactimage import STILL
from gelforge.records.press import FORCE, POSE, LoggedPress
from gelforge.records.regular import read_text
from gelforge.records.table import filled_rows

NEWTONS = {"n": 1.0, "mn": 1e-3, "kn": 1e3, "gf": 9.80665e-3, "kgf": 9.80665, "lbf": 4.4482216, "ozf": 0.27801385}
MILLIMETRES = {"mm": 1.0, "um": 1e-3, "m": 1e3, "in": 25.4}
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
HINT = "the head of src/gelforge/formats/benchfiles.py says which columns are read"
AXES = "xyz"
SMALL = (64, 48)  # px at which the change of an image is measured
HELD_MM = 0.01  # above its lowest height the tip goes back up
WORD = re.compile(r"([XYZ])\s*([+-]?\d*\.?\d+)", re.IGNORECASE)
REPORT = re.compile(r"[MW]Pos:([-+\d.]+),([-+\d.]+),([-+\d.]+)")
DATASET_TOML = '# Aligned from the recordings of a bench by `gelforge align`.\nsensor = "{sensor}"\ngel = "{gel}"\n'


def read_gauge(path: Path, sign: int) -> Recording:
    """The force that presses, N, and forces along gel x, y, z (n, 4) of a gauge log; sign: -1 where pressing is positive."""
    rows, times = _timed_rows(path, "readings")
    forces = np.zeros((len(rows), 3))
    for axis, name in enumerate(AXES):
        column, unit = _column(path, rows[0], f"f{name}", NEWTONS, needed=name == "z")
        if column:
            forces[:, axis] = sign * unit * _numbers(path, rows, column)
    return Recording(str(path), times, np.column_stack([-forces[:, 2], forces]))


def read_path(path: Path, origin: Sequence[float]) -> Recording:
    """Depth below the apex in mm, the tip's x, y, z in mm and its turn in degrees (n, 5) of a path log; origin (3,): the apex there."""
    if path.suffix.lower() == ".csv":
        rows, times = _timed_rows(path, "positions")
        places = np.zeros((len(rows), 4))
        for axis, name in enumerate(AXES):
            column, unit = _column(path, rows[0], name, MILLIMETRES, needed=True)
            places[:, axis] = unit * _numbers(path, rows, column)
        if "rot_deg" in rows[0]:
            places[:, 3] = _numbers(path, rows, "rot_deg")
    else:
        times, places = _timed_code(path)
    places[:, :3] -= np.asarray(origin, float)
    return Recording(str(path), times, np.column_stack([-places[:, 2], places]))


def _timed_code(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) s and positions x, y, z, turn (n, 4) of lines `TIME G-code` or `TIME <Idle|MPos:x,y,z|…>`; words are modal."""
    times: list[float] = []
    places: list[list[float]] = []
    now, unit = [np.nan] * 3, 1.0
    for number, line in enumerate(read_text(path, HINT).splitlines(), 1):
        head, _, code = line.strip().partition(" ")
        if not head or head.startswith((";", "(", "#")):
            continue
        code = re.sub(r"\(.*?\)|;.*", "", code)
        unit = 25.4 if re.search(r"\bG20\b", code) else 1.0 if re.search(r"\bG21\b", code) else unit
        report = REPORT.search(code)
        words = zip("XYZ", report.groups(), strict=True) if report else WORD.findall(code)
        before = list(now)
        for axis, value in words:
            now["XYZ".index(axis.upper())] = unit * float(value)
        if re.search(r"\bG91\b", code):
            raise BadInput(
                f"{path} line {number}: G91, relative positions; log absolute ones (G90, or the controller's reports)"
            )
        if np.isfinite(now).all() and (report or now != before):
            times.append(_time(path, number, "time_s", head))
            places.append([*now, 0.0])
    return np.array(times), np.array(places, float).reshape(-1, 4)


@dataclass(frozen=True)
class Images:
    """A film, or a folder of images with their times: names (n,), times (n,) s, small copies (n, rows, cols, 3), and where they are."""

    path: Path
    names: list[str]
    times: np.ndarray
    small: np.ndarray

    @classmethod
    def of(cls, path: Path) -> "Images":
        """Read names, times and small copies; BadInput where there are none."""
        if path.is_dir():
            rows, times = _timed_rows(path / "times.csv", "images", ("image",))
            names = [row["image"] for row in rows]
            return cls(path, names, times, np.array([_small(read_image(path / name)) for name in names], np.float32))
        with open_source(path, None) as (source, announced):
            film = Film(source, announced, str(path), None, camera=False)
            seen, small = zip(*((frame.time_s, _small(frame.image)) for frame in film), strict=True)
        names = [f"{path.stem}-{number:06d}" for number in range(len(seen))]
        return cls(path, names, np.array(seen), np.array(small, np.float32))

    def __iter__(self) -> Iterator[np.ndarray]:
        """Images (h, w, 3) uint8 RGB in the order of time."""
        if self.path.is_dir():
            for name in self.names:
                yield read_image(self.path / name)
            return
        with open_source(self.path, None) as (source, announced):
            for frame in Film(source, announced, str(self.path), None, camera=False):
                yield np.ascontiguousarray(frame.image[:, :, ::-1])

    def change(self) -> Recording:
        """Mean change in levels (n, 1) since the first STILL images, which show no contact."""
        change = np.abs(self.small - self.small[:STILL].mean(axis=0)).mean(axis=(1, 2, 3))
        return Recording(str(self.path), self.times, change[:, None].astype(float))


def _small(image: np.ndarray) -> np.ndarray:
    """An image (h, w, 3) at the size at which its change is measured."""
    import cv2

    return cv2.resize(image, SMALL, interpolation=cv2.INTER_AREA)


@dataclass(frozen=True)
class Setup:
    """What is known of a bench beside its recordings: sensor (labelling.sensor.Sensor), indenter and piece of gel by name."""

    sensor: object
    indenter: str
    gel_id: str


def align(
    gauge: Recording, path: Recording, images: Images, bench, data: Path, touch: float, every: int
) -> list[str]:
    """Write the dataset folder `data`, which must not exist, and return what is to be said of the recordings.

    A row is an image on the way down or sideways, with the path's place and the gauge's force at its time. Rows of one press
    share a press_id. touch: N from which on the gel is pressed. every: of so many images of a press one is taken.
    """
    change = images.change()
    clocks = {"path": match_clock(gauge, path, touch), "images": match_clock(gauge, change, touch)}
    notes = [*_told(gauge, path, change), *(_clock_told(name, clock) for name, clock in clocks.items())]
    at = clocks["images"].to_gauge(images.times)
    felt, places = gauge.at(at), path.at(clocks["path"].from_gauge(at))
    known = np.isfinite(felt[:, 0]) & np.isfinite(places[:, 0])
    rows: list[LoggedPress] = []
    chosen: dict[int, str] = {}
    for number, press in enumerate(presses_of(gauge.values[:, 0], touch), 1):
        began, ended = gauge.times[press.start], gauge.times[press.stop - 1]
        begin = path.at(clocks["path"].from_gauge(np.array([began])))[0]
        during = np.flatnonzero(known & (at >= began) & (at <= ended))
        if not np.isfinite(begin).all() or not len(during):
            notes.append(
                f"press {number} at {began:.2f} s of the gauge: path or images were dropped there, it is left out"
            )
            continue
        held = during[places[during, 0] >= places[during, 0].max() - HELD_MM]
        for image in during[during <= held[-1]][::every].tolist():
            name = f"p{number:04d}-{image:06d}"
            chosen[image] = name
            x, y, z, turn = places[image, 1:]
            pose = (begin[1], begin[2], 0.0, x - begin[1], y - begin[2], z, turn)
            known_of_it = {
                **NO_PRESS,
                **dict(zip(POSE, map(float, pose), strict=True)),
                **dict(zip(FORCE, felt[image, 1:].tolist(), strict=True)),
                "sample_id": name,
                "sensor_id": bench.sensor.name,
                "gel_id": bench.gel_id,
                "indenter": bench.indenter,
                "image": f"images/{name}.png",
                "press_id": f"p{number:04d}",
            }
            rows.append(LoggedPress(row=0, **known_of_it))
    if not rows:
        raise BadInput(f"{images.path}: no image lies within a press of both gauge and path; " + "; ".join(notes))
    _check_height(path, rows)
    _write(images, chosen, rows, bench, data)
    return [
        *notes,
        f"{data}: {len(rows)} images of {len({row.press_id for row in rows})} presses; {int((~known).sum())} of {len(at)} images have no force or no place",
    ]


def _write(images: Images, chosen: dict[int, str], rows: list[LoggedPress], bench, data: Path) -> None:
    size = tuple(bench.sensor.image)
    with new_folder(data) as part:
        first = []
        for number, image in enumerate(images):
            if (image.shape[1], image.shape[0]) != size:
                raise BadInput(
                    f"{images.path}: images are {image.shape[1]} x {image.shape[0]}, sensor {bench.sensor.name} has {size[0]} x {size[1]};"
                    " name another sensor, or describe this one in workflow/sensors.toml"
                )
            if number < STILL:
                first.append(image)
            if number in chosen:
                write_png(part / "images" / f"{chosen[number]}.png", image)
        rest = np.rint(np.mean(first, axis=0)).astype(np.uint8)
        write_png(part / "nocontact" / f"{bench.sensor.name}.png", rest)
        write_log(part / "log.csv", rows)
        write_text(part / "dataset.toml", DATASET_TOML.format(sensor=bench.sensor.name, gel=bench.sensor.gel))


def _told(*recordings: Recording) -> list[str]:
    """Rates and dropped samples of recordings, a sentence each."""
    said = []
    for one in recordings:
        lapses = one.lapses
        drops = (
            f"; {len(lapses)} gaps of up to {lapses.max():.2f} s, where nothing is interpolated"
            if len(lapses)
            else ""
        )
        said.append(f"{one.name}: {len(one.times)} samples, one each {1e3 * one.interval:.3g} ms{drops}")
    return said


def _clock_told(name: str, clock: MatchedClock) -> str:
    """Offset, drift and error of a clock, one sentence."""
    rival = (
        "; another offset fits nearly as well, as where presses are alike and evenly apart: check it"
        if clock.rival
        else ""
    )
    return (
        f"clock of the {name}: {1e3 * clock.offset_s:+.1f} ms to the gauge's, drift {1e6 * clock.drift:+.0f} ppm, from {clock.presses} presses;"
        f" error {1e3 * clock.error_s:.1f} ms{rival}"
    )


def _check_height(path: Recording, rows: list[LoggedPress]) -> None:
    """BadInput where force does not begin near the gel's surface, which lies a little below its apex, z = 0."""
    first: dict[str, float] = {}
    for row in rows:
        first.setdefault(row.press_id, float(row.dz_mm))
    usual = float(np.median(list(first.values())))
    if not -0.5 < usual < 0.1:
        raise BadInput(
            f"{path.name}: force begins at z = {usual:.2f} mm, and z = 0 is the apex of the gel: give the apex's place on the path as"
            " --origin X,Y,Z"
        )


def _timed_rows(path: Path, what: str, columns: tuple[str, ...] = ()) -> tuple[list[dict[str, str]], np.ndarray]:
    """Rows of a CSV and their times (n,) s."""
    numbered = filled_rows(path, columns, what, HINT)
    names = [name for name in numbered[0][1] if name == "time_utc" or name in {f"time_{unit}" for unit in SECONDS}]
    if len(names) != 1:
        raise BadInput(
            f"{path}: {len(names)} columns of time; give one of time_s, time_ms, time_us, time_ns, time_utc"
        )
    times = [_time(path, number, names[0], row[names[0]]) for number, row in numbered]
    return [row for _, row in numbered], np.array(times)


def _time(path: Path, number: int, column: str, cell: str) -> float:
    """A time in s; BadInput for what is none."""
    try:
        if column == "time_utc":
            return datetime.fromisoformat(cell.replace("Z", "+00:00")).timestamp()
        unit = column.removeprefix("time_")
        # nanoseconds since 1970 have more digits than a float holds
        seconds = int(cell) / 1e9 if unit == "ns" else float(cell) * SECONDS[unit]
    except ValueError as error:
        raise BadInput(f"{path} line {number}: {cell!r} is no {column}; {HINT}") from error
    if not np.isfinite(seconds):
        raise BadInput(f"{path} line {number}: {column} is {cell}; {HINT}")
    return seconds


def _column(path: Path, row: dict[str, str], name: str, units: dict[str, float], needed: bool) -> tuple[str, float]:
    """The column of a quantity and its unit; empty where it is not needed and not there."""
    found = [(column, units[unit]) for column in row for unit in units if column.lower() == f"{name}_{unit}"]
    if len(found) > 1 or (needed and not found):
        raise BadInput(
            f"{path}: {len(found)} columns {name}_UNIT, seen: {', '.join(row)}; give one, with a unit of {', '.join(units)}"
        )
    return found[0] if found else ("", 1.0)


def _numbers(path: Path, rows: list[dict[str, str]], column: str) -> np.ndarray:
    """A column (n,) as numbers; BadInput names the first cell that is none."""
    for number, row in enumerate(rows, 1):
        try:
            finite = np.isfinite(float(row[column]))
        except ValueError:
            finite = False
        if not finite:
            raise BadInput(f"{path}: {column} of sample {number} is {row[column]!r}, no number; {HINT}")
    return np.array([float(row[column]) for row in rows])
