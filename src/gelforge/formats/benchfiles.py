"""Files of a bench, read and brought to one log: gauge log, path log, a film or a folder of images.

Times stand in a column `time_s`, `time_ms`, `time_us`, `time_ns` or `time_utc` (ISO 8601). A gauge log is a CSV with `fz_UNIT` and perhaps
`fx_UNIT` and `fy_UNIT`. A path log says where the tip was: a CSV of nothing but a time, `x_UNIT`, `y_UNIT`, `z_UNIT` and perhaps
`rot_deg`, or lines `TIME <STATE|WPos:x,y,z|…>`, GRBL's reports behind their time in s; with `MPos` one of them has the `WCO`, which never
changes. A folder of images has a `times.csv` with the columns `image` and a time.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput, printable
from gelforge.flow.files import write_text
from gelforge.formats.align import (
    LAPSE,
    MOST_DRIFT,
    MatchedClock,
    Recording,
    at_rest,
    match_clock,
    presses_of,
    without_level,
)
from gelforge.formats.feats_folder import NO_PRESS, new_folder
from gelforge.records.film import Film, open_source
from gelforge.records.image import read_image, write_png
from gelforge.records.log import write_log
from gelforge.records.nocontactimage import STILL
from gelforge.records.press import FORCE, POSE, LoggedPress, parse_number
from gelforge.records.regular import read_text
from gelforge.records.table import filled_rows

NEWTONS = {"n": 1.0, "mn": 1e-3, "kn": 1e3, "gf": 9.80665e-3, "kgf": 9.80665, "lbf": 4.4482216, "ozf": 0.27801385}
MILLIMETRES = {"mm": 1.0, "um": 1e-3, "m": 1e3, "in": 25.4}
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
HINT = "the head of src/gelforge/formats/benchfiles.py says which columns are read"
AXES = "xyz"
SMALL = (64, 48)  # px at which the change of an image is measured
HELD_MM = 0.01  # above its lowest height the tip goes back up
STATE_MM = 0.005  # nearer images show the same state
FASTEST_MM_S = 500.0  # of a tip that a bench moves
SLOWEST_S = 0.25  # from sample to sample of a path
DATED_S = 1e9  # from which on a clock counts from 1970
OTHER_RATE = 0.12  # of a film's frame rate, by which it may be wrong: 25 frames a second for 22
LEAST_LEVEL_N = 0.05
MOST_HEAD = 100  # lines above a header
NUMBER = r"(-?\d+\.\d{3})"
REPORT = re.compile(
    rf"(\d+(?:\.\d+)?) <(Idle|Run|Jog|Hold:[01])\|([MW])Pos:{NUMBER},{NUMBER},{NUMBER}(?:\|([^<>]*))?>", re.ASCII
)
OFFSET = re.compile(rf"(?:^|\|)WCO:{NUMBER},{NUMBER},{NUMBER}(?:\||$)")
# Why a line is none of a path's reports, by what it looks like.
STRANGE = (
    (
        r"\d+(\.\d+)? <(Alarm|Home|Check|Door|Sleep)",
        "the machine moves its own zero in this state, or does not move at all: leave it out",
    ),
    (r"<.*[MW]Pos:-?\d+\.\d{4}", "four digits behind the point are inches ($13=1): set $13=0 and log again"),
    (r"<.*[MW]Pos", "it is no report `TIME <STATE|WPos:x,y,z|...>` with its time in s first"),
    (r"(\d+(\.\d+)?\s+)?X:\s*-?\d", "M114 says where the tip shall go: log where it was, as time_s,x_mm,y_mm,z_mm"),
    (
        r"(?i)(\d[\d.]*\s+)?(\$J=|N\d+|[GM]\d)",
        "a line of G-code says when it was sent, not where the tip was: log the controller's reports",
    ),
)
DATASET_TOML = '# Aligned from the recordings of a bench by `gelforge align`.\nsensor = "{sensor}"\ngel = "{gel}"\n'


def read_gauge(path: Path, sign: int) -> tuple[Recording, tuple[str, ...]]:
    """The force that presses and those along the gel's axes (n, 1 + k) N of a gauge log, and the k columns of a log that it has.

    sign: -1 where pressing is positive.
    """
    rows, times, _ = _timed_rows(path, "readings", "fz_n")
    found: dict[str, np.ndarray] = {}
    for axis, name in enumerate(AXES):
        column, unit = _column(path, rows[0], f"f{name}", NEWTONS, needed=name == "z")
        if column:
            found[FORCE[axis]] = sign * unit * _numbers(path, rows, column)
    return Recording(str(path), times, np.column_stack([-found["fz_n"], *found.values()])), tuple(found)


def read_path(path: Path, origin: Sequence[float]) -> Recording:
    """Depth below the apex in mm, the tip's x, y, z in mm and its turn in degrees (n, 5) of a path log; origin (3,): the apex there."""
    text = read_text(path, HINT)
    reports = any("Pos:" in line or re.match(STRANGE[-1][0], line) for line in text.splitlines())
    times, places, lines = _reports(path, text) if reports else _samples(path)
    places[:, :3] -= np.asarray(origin, float)
    found = Recording(str(path), times, np.column_stack([-places[:, 2], places]))
    if found.interval > SLOWEST_S:
        raise BadInput(
            f"{path}: one sample each {found.interval:.3g} s, as where a line is a whole move: log where the tip is {1 / SLOWEST_S:.0f} times a"
            " second or more"
        )
    jump = np.linalg.norm(np.diff(places[:, :3], axis=0), axis=1)
    fast = np.flatnonzero(jump > FASTEST_MM_S * np.maximum(np.diff(times), SLOWEST_S / 10))
    if len(fast):
        raise BadInput(
            f"{path} line {lines[fast[0] + 1]}: the tip jumps by {jump[fast[0]]:.3g} mm; are work and machine coordinates, two units, or two"
            " recordings in one log?"
        )
    return found


def _samples(path: Path) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """Times (n,) s, positions x, y, z and turn (n, 4), and line numbers of a CSV of samples."""
    rows, times, lines = _timed_rows(path, "positions", "x_mm,y_mm,z_mm")
    places, known = np.zeros((len(rows), 4)), {"rot_deg"}
    for axis, name in enumerate(AXES):
        column, unit = _column(path, rows[0], name, MILLIMETRES, needed=True)
        places[:, axis] = unit * _numbers(path, rows, column)
        known.add(column)
    if "rot_deg" in rows[0]:
        places[:, 3] = _numbers(path, rows, "rot_deg")
    other = [name for name in rows[0] if name not in known and not name.startswith("time_")]
    if other:
        raise BadInput(
            f"{path}: column {printable(other[0])[:60]!r} is not known; a path has a time, x_UNIT, y_UNIT, z_UNIT and perhaps rot_deg, and"
            " nothing that could mean that these are of several kinds: leave it out"
        )
    return times, places, lines


def _reports(path: Path, text: str) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """The same of GRBL's reports, all of one frame of coordinates (github.com/gnea/grbl, interface.md, real-time status reports)."""
    found: list[list[float]] = []
    lines: list[int] = []
    frame, offset = "", None
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
                why
                or "only reports `TIME <STATE|WPos:x,y,z|...>` are read: leave other lines out, or begin them with #"
            )
            raise BadInput(f"{path} line {number}: {printable(line)[:60]!r}: {why}")
        time, _, of, x, y, z, rest = report.groups()
        if frame and of != frame:
            raise BadInput(
                f"{path} line {number}: {of}Pos, and {frame}Pos before it: log one frame of coordinates ($10)"
            )
        frame = of
        for seen in OFFSET.findall(rest or ""):
            if offset not in (None, seen):
                raise BadInput(
                    f"{path} line {number}: WCO:{','.join(seen)}, and WCO:{','.join(offset)} before it: the zero of the work coordinates was"
                    " moved; leave out what lies before or after it"
                )
            offset = seen
        found.append([float(time), float(x), float(y), float(z), 0.0])
        lines.append(number)
    table = np.array(found, float).reshape(-1, 5)
    if frame == "M":
        if offset is None:
            raise BadInput(
                f"{path}: MPos without any WCO: log WPos ($10=0), or a report that has the offset of the work coordinates"
            )
        table[:, 1:4] -= np.array(offset, float)
    return table[:, 0], table[:, 1:], lines


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
            rows, times, _ = _timed_rows(path / "times.csv", "images", "image", ("image",))
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


@dataclass(frozen=True)
class Aligned:
    """Rows of a log, by the number of their image, with what they were found by and what is to be said of it.

    gauge: without its level. clocks: of `path` and `change` against it. rest: images without contact.
    """

    rows: dict[int, LoggedPress]
    gauge: Recording
    path: Recording
    change: Recording
    clocks: dict[str, MatchedClock]
    rest: list[int]
    notes: list[str] = field(default_factory=list)


def align(
    gauge: Recording, measured: Sequence[str], path: Recording, images: Images, bench, touch: float, every: int
) -> Aligned:
    """Rows of the images on the way down or sideways, each with the path's place and the gauge's force at its time.

    measured: columns of the gauge's values behind the first. Rows of one press share a press_id; images of one state are one
    row, with the middle one. touch: N from which on the gel is pressed. every: of so many states of a press one is taken.
    """
    levelled, change = without_level(gauge, touch), images.change()
    gauge, touch = levelled.gauge, levelled.touch
    clocks = {"path": match_clock(gauge, _filled(path), touch), "images": match_clock(gauge, change, touch)}
    notes = [*_level_told(levelled.level, measured), *_told(gauge, path, change)]
    notes += [_clock_told(name, clock, clock.offset_s) for name, clock in clocks.items()]
    at = clocks["images"].to_gauge(images.times)
    on_path = clocks["path"].from_gauge(at)
    felt, places = gauge.at(at), path.at(on_path)
    dates = _dates(at, {gauge.name: at, path.name: on_path, str(images.path): images.times}, notes)
    rows: dict[int, LoggedPress] = {}
    presses, alike = presses_of(gauge.values[:, 0], touch), 0
    for number, press in enumerate(presses, 1):
        began, ended = gauge.times[press.start], gauge.times[press.stop - 1]
        begin = path.at(clocks["path"].from_gauge(np.array([began])))[0]
        within = np.flatnonzero((at >= began) & (at <= ended))
        ends = clocks["path"].from_gauge(np.array([began, ended]))
        places[within] = _where_it_stood(path, on_path[within], places[within], ends)
        during = within[np.isfinite(felt[within, 0]) & np.isfinite(places[within, 0])]
        if not np.isfinite(begin).all() or not len(during):
            notes.append(
                f"press {number} at {shown(began)} of the gauge: path or images were dropped there, it is left out"
            )
            continue
        held = during[places[during, 0] >= places[during, 0].max() - HELD_MM]
        states = _states(during[during <= held[-1]], places)
        alike += sum(len(state) - 1 for state in states)
        for state in states[::every]:
            image = int(state[len(state) // 2])
            name = f"p{number:04d}-{image:06d}"
            x, y, z, turn = places[image, 1:]
            pose = (begin[1], begin[2], 0.0, x - begin[1], y - begin[2], z, turn)
            known = {
                **NO_PRESS,
                **dict(zip(POSE, map(float, pose), strict=True)),
                **dict(zip(measured, felt[image, 1:].tolist(), strict=True)),
                "sample_id": name, "time_utc": dates[image], "sensor_id": bench.sensor.name, "gel_id": bench.gel_id,
                "indenter": bench.indenter, "image": f"images/{name}.png", "press_id": f"p{number:04d}",
            }  # fmt: skip
            rows[image] = LoggedPress(row=0, **known)
    if not rows:
        raise BadInput(f"{images.path}: no image lies within a press of both gauge and path; " + "; ".join(notes))
    _check_height(path, list(rows.values()))
    if alike:
        notes.append(f"{alike} images show the state of another one, where the tip stood: a state is one row")
    if len(presses) == 1:
        notes.append(_cost_of_one(at[list(rows)], gauge, path, clocks["path"], images.path))
    lost = int((~(np.isfinite(felt[:, 0]) & np.isfinite(places[:, 0]))).sum())
    notes += [f"{lost} of {len(at)} images have no force or no place"] if lost else []
    quiet = at_rest(gauge, gauge.values[:, 0] >= touch)
    rest = [k for k, time in enumerate(at.tolist()) if quiet[np.abs(gauge.times - time).argmin()]]
    return Aligned(rows, gauge, path, change, clocks, rest, notes)


def _gaps(path: Recording) -> np.ndarray:
    """Numbers of the samples before which a path that is logged where it moves says nothing, because the tip stood in the gel."""
    before, after = path.values[:-1], path.values[1:]
    stood = (np.abs(after - before)[:, :4].max(axis=1) <= STATE_MM) & (before[:, 0] > 0.0)
    return np.flatnonzero(stood & (np.diff(path.times) > LAPSE * path.interval)) + 1


def _filled(path: Recording) -> Recording:
    """A path with samples where the tip stood, by which its clock is matched."""
    times, values = [path.times], [path.values]
    for at in _gaps(path).tolist():
        more = np.arange(path.times[at - 1] + path.interval, path.times[at] - 0.5 * path.interval, path.interval)
        times.append(more)
        values.append(np.repeat(path.values[at - 1 : at], len(more), axis=0))
    order = np.argsort(np.concatenate(times), kind="stable")
    return Recording(path.name, np.concatenate(times)[order], np.concatenate(values)[order])


def _where_it_stood(path: Recording, times: np.ndarray, places: np.ndarray, press: np.ndarray) -> np.ndarray:
    """Places (n, 5) at times (n,) of a press from and to (2,) s, with those of gaps within it at whose ends the tip is in one place."""
    places = places.copy()
    for at in _gaps(path).tolist():
        start, end = path.times[at - 1], path.times[at]
        if press[0] <= start and end <= press[1]:
            places[(times > start) & (times < end)] = path.values[at - 1]
    return places


def _states(images: np.ndarray, places: np.ndarray) -> list[np.ndarray]:
    """Images (n,) of one press in groups of one state: their places lie within STATE_MM of the first one's."""
    states: list[list[int]] = []
    for image in images.tolist():
        if states and np.abs(places[image, :4] - places[states[-1][0], :4]).max() <= STATE_MM:
            states[-1].append(image)
        else:
            states.append([image])
    return [np.array(state) for state in states]


def _cost_of_one(times: np.ndarray, gauge: Recording, path: Recording, clock: MatchedClock, film: Path) -> str:
    """What the largest drift may cost rows at these times (n,) s of one press, a sentence."""
    away, step = np.abs(times - times.mean()), gauge.interval
    speed = np.abs(path.at(clock.from_gauge(times + step)) - path.at(clock.from_gauge(times - step)))[:, 0] / (
        2 * step
    )
    rate = np.abs(gauge.at(times + step) - gauge.at(times - step))[:, 0] / (2 * step)
    off = [float(np.nanmax(away * value, initial=0.0)) for value in (speed, rate)]
    said = f"one press: the drift of its clocks is unknown; with {1e6 * MOST_DRIFT:.0f} ppm, the most of two clocks, rows are up to"
    said += f" {MOST_DRIFT * off[0]:.2g} mm and {MOST_DRIFT * off[1]:.2g} N off"
    if film.is_file():
        said += f"; with a film whose frame rate is wrong by {OTHER_RATE:.0%}, up to {OTHER_RATE * off[0]:.2g} mm and {OTHER_RATE * off[1]:.2g} N"
    return f"{said}; two presses or more tell it"


def _dates(at: np.ndarray, clocks: dict[str, np.ndarray], notes: list[str]) -> list[str]:
    """Times of the images as dates, by the first of these clocks that counts from 1970; else by the first one."""
    dated = next((times for times in clocks.values() if times[0] >= DATED_S), None)
    if dated is None:
        notes.append("no clock knows the date: time_utc counts from 1970 as the gauge's clock does")
    return [shown(float(time), True) for time in (at if dated is None else dated)]


def shown(time: float, date: bool = False) -> str:
    """A time in s of a clock for people: a date where it counts from 1970, or where that is asked for."""
    if time < DATED_S and not date:
        return f"{time:.2f} s"
    return datetime.fromtimestamp(max(time, 0.0), UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def nocontact_of(aligned: Aligned, images: Images) -> np.ndarray:
    """The mean (h, w, 3) uint8 RGB of the first images at rest; BadInput where there are none."""
    rest = set(aligned.rest[:STILL])
    free = [image for number, image in enumerate(images) if number in rest]
    if not free:
        raise BadInput(
            f"{images.path}: no image was taken while the gauge rests; film the gel free before the first press"
        )
    return np.rint(np.mean(free, axis=0)).astype(np.uint8)


def write_dataset(
    aligned: Aligned,
    images: Images,
    nocontact: np.ndarray,
    framed: Callable[[np.ndarray], np.ndarray],
    bench,
    data: Path,
) -> None:
    """Write the dataset folder `data`, which must not exist: log, images as `framed` makes them of the sensor's size, no-contact image."""
    with new_folder(data) as part:
        for number, image in enumerate(images):
            if number in aligned.rows:
                write_png(part / aligned.rows[number].image, framed(image))
        write_png(part / "nocontact" / f"{bench.sensor.name}.png", framed(nocontact))
        write_log(part / "log.csv", aligned.rows.values())
        write_text(part / "dataset.toml", DATASET_TOML.format(sensor=bench.sensor.name, gel=bench.sensor.gel))


def _level_told(level: np.ndarray, measured: Sequence[str]) -> list[str]:
    """What the gauge reads at rest, where it is worth a sentence."""
    said = []
    for column, values in zip(measured, level.T[1:], strict=True):
        if np.abs(values).max() >= LEAST_LEVEL_N:
            drift = f", and drifts by {np.ptp(values):.2g} N" if np.ptp(values) >= LEAST_LEVEL_N else ""
            said.append(f"the gauge reads {column} = {values[0]:+.2f} N at rest{drift}: this was taken off")
    return said


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


def _clock_told(name: str, clock: MatchedClock, offset: float) -> str:
    """Offset, drift and error of a clock, one sentence."""
    rival = (
        "; another offset fits nearly as well, as where presses are alike and evenly apart: check it"
        if clock.rival
        else ""
    )
    ahead = (
        f"{1e3 * offset:+.1f} ms to the gauge's"
        if abs(offset) < DATED_S
        else (f"its 0 s is {shown(offset)}" if offset > 0.0 else f"the gauge's 0 s is {shown(-offset)}")
    )
    drift = f"drift {1e6 * clock.drift:+.0f} ppm" if len(clock.presses) > 1 else "drift unknown"
    return f"clock of the {name}: {ahead}, {drift}, from {len(clock.presses)} presses; error {1e3 * clock.error_s:.1f} ms{rival}"


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


def _timed_rows(
    path: Path, what: str, example: str, columns: tuple[str, ...] = ()
) -> tuple[list[dict[str, str]], np.ndarray, list[int]]:
    """Rows of a CSV, their times (n,) s, and their lines; example: columns that stand beside the time."""
    _check_head(path, example)
    numbered = filled_rows(path, columns, what, HINT)
    names = [name for name in numbered[0][1] if name == "time_utc" or name in {f"time_{unit}" for unit in SECONDS}]
    if len(names) != 1:
        raise BadInput(
            f"{path}: {len(names)} columns of time; give one of time_s, time_ms, time_us, time_ns, time_utc"
        )
    times = [_time(path, number, names[0], row[names[0]]) for number, row in numbered]
    return [row for _, row in numbered], np.array(times), [number for number, _ in numbered]


def _check_head(path: Path, example: str) -> None:
    """BadInput where a table has no header, or one below other lines, or is of M114's answers."""
    lines = [(number, line.strip()) for number, line in enumerate(read_text(path, HINT).splitlines(), 1)]
    lines = [(number, line) for number, line in lines if line and not line.startswith("#")]
    for number, line in lines[:1]:
        cells = [cell.strip() for cell in line.split(",")]
        if re.match(STRANGE[3][0], line):
            raise BadInput(f"{path} line {number}: {printable(line)[:60]!r}: {STRANGE[3][1]}")
        if all(parse_number(cell) is not None for cell in cells):
            raise BadInput(
                f"{path}: has no header, it begins with {printable(line)[:60]!r}; write time_s,{example} above it"
            )
        if "time_" not in line:
            below = next((at for at, text in lines[1:MOST_HEAD] if re.match(r"(.*,)?\s*time_\w+\s*(,|$)", text)), 0)
            if below:
                raise BadInput(
                    f"{path}: its header stands in line {below}; remove the lines above it, or begin them with #"
                )


def _time(path: Path, number: int, column: str, cell: str) -> float:
    """A time in s; BadInput for what is none."""
    try:
        if column == "time_utc":
            return _date(cell)
        unit = column.removeprefix("time_")
        # nanoseconds since 1970 have more digits than a float holds
        seconds = int(cell) / 1e9 if unit == "ns" else float(cell) * SECONDS[unit]
    except ValueError as error:
        raise BadInput(f"{path} line {number}: {cell!r} is no {column}; {HINT}") from error
    if not np.isfinite(seconds):
        raise BadInput(f"{path} line {number}: {column} is {cell}; {HINT}")
    return seconds


def _date(cell: str) -> float:
    """Seconds since 1970 of a time in ISO 8601; one that names no zone is UTC."""
    when = datetime.fromisoformat(cell)
    return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()


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
    found = [parse_number(row[column]) for row in rows]
    if None in found:
        number = found.index(None)
        raise BadInput(f"{path}: {column} of sample {number + 1} is {rows[number][column]!r}, no number; {HINT}")
    return np.array(found, float)
