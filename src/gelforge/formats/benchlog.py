"""Combine a bench's recordings into one log: match clocks, find presses, make a row for each state in an image."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
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
from gelforge.formats.benchfiles import Images
from gelforge.formats.feats_folder import NO_PRESS, new_folder
from gelforge.records import series
from gelforge.records.image import write_png
from gelforge.records.log import write_log
from gelforge.records.nocontactimage import STILL
from gelforge.records.press import POSE, LoggedPress

LOST_MM = 0.2  # depth of a press that a gauge must show
HELD_MM = 0.01  # a tip this far above its lowest height is retracting
STATE_MM = 0.005  # images whose tip positions differ less show the same state
ABOVE_MM = 0.1  # heights above the gel at which the path is clipped
MOST_SHIFT_MM = 0.1  # of the height at which force begins, beyond which a path is refused
DATED_S = 1e9  # a clock with larger times counts from 1970
OTHER_RATE = 0.12  # relative error that a film's frame rate may have: 25 frames a second instead of 22
LEAST_LEVEL_N = 0.05  # smaller readings at rest are not reported
DATASET_TOML = '# Aligned from the recordings of a bench by `gelforge align`.\nsensor = "{sensor}"\ngel = "{gel}"\n'


@dataclass(frozen=True)
class Setup:
    """What a bench's recordings do not say: sensor (labelling.sensor.Sensor), names of indenter and piece of gel."""

    sensor: object
    indenter: str
    gel_id: str
    touch_height: Callable[[float, float, float], float] = lambda x, y, turn: 0.0  # of the tip at x, y, turned, mm


@dataclass(frozen=True)
class Aligned:
    """Rows of a log by image number, with the recordings and clocks that they come from, and notes for the user.

    gauge: with its reading at rest subtracted. clocks: "path" and "images" relative to the gauge's. rest: numbers of
    images without contact.
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
    """Make a row of each image until the tip retracts, with the path's position and the gauge's force at its time.

    measured: columns of the gauge's values after the first. Rows of one press share a press_id; images of one state
    become one row, with the middle image. touch: force from which on the gel is pressed, N. every: of a press, take
    every n-th state. BadInput where no image lies within a press.
    """
    new = series.renewed(gauge.values)
    gauge = Recording(gauge.name, gauge.times[new], gauge.values[new])
    kept, notes = series.confirmed(gauge.name, gauge.times, gauge.values)
    gauge, change = Recording(gauge.name, gauge.times[kept], gauge.values[kept]), images.change()
    raw, levelled = gauge, without_level(gauge, touch)
    gauge, touch = levelled.gauge, levelled.touch
    clocks = {"path": match_clock(gauge, _filled(path), touch), "images": match_clock(gauge, change, touch)}
    notes += [*_level_told(levelled.level, measured), *_told(gauge, path, change)]
    notes += [_clock_told(name, clock, clock.offset_s) for name, clock in clocks.items()]
    at = clocks["images"].to_gauge(images.times)
    on_path = clocks["path"].from_gauge(at)
    felt, places = gauge.at(at), path.at(on_path)
    dates = _dates(at, {gauge.name: at, path.name: on_path, str(images.path): images.times}, notes)
    rows: dict[int, LoggedPress] = {}
    presses, alike = presses_of(gauge.values[:, 0], touch), 0
    height = clocks["path"].to_gauge(path.times), -path.values[:, 0]
    spans = [(float(gauge.times[press.start]), float(gauge.times[press.stop - 1])) for press in presses]
    _note_lost(gauge.name, height, spans, notes)
    _check_shift(gauge, path, clocks["path"], spans, touch, bench, notes)
    _check_average(gauge, height, spans)
    bad = _beyond_range(raw, height, at, notes) | _repeated(images, places, at, spans, notes)
    for number, press in enumerate(presses, 1):
        began, ended = gauge.times[press.start], gauge.times[press.stop - 1]
        begin = path.at(clocks["path"].from_gauge(np.array([began])))[0]
        within = np.flatnonzero((at >= began) & (at <= ended))
        ends = clocks["path"].from_gauge(np.array([began, ended]))
        places[within] = _where_it_stood(path, on_path[within], places[within], ends)
        during = within[np.isfinite(felt[within, 0]) & np.isfinite(places[within, 0])]
        if not np.isfinite(begin).all() or not len(during):
            notes.append(
                f"press {number} at {shown(began)} on the gauge's clock: samples or images are missing there, so it is left out"
            )
            continue
        held = during[places[during, 0] >= places[during, 0].max() - HELD_MM]
        states = _states(during[(during <= held[-1]) & ~bad[during]], places)
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
        notes.append(
            f"{alike} images show the same state as another one, because the tip stood still: each state is one row"
        )
    if len(presses) == 1:
        notes.append(_cost_of_one(at[list(rows)], gauge, path, clocks["path"], images.path))
    lost = int((~(np.isfinite(felt[:, 0]) & np.isfinite(places[:, 0]))).sum())
    notes += [f"{lost} of {len(at)} images have no force or no position"] if lost else []
    quiet = at_rest(gauge, gauge.values[:, 0] >= touch)
    rest = [k for k, time in enumerate(at.tolist()) if quiet[np.abs(gauge.times - time).argmin()]]
    return Aligned(rows, gauge, path, change, clocks, rest, notes)


def _note_lost(
    name: str, height: tuple[np.ndarray, np.ndarray], spans: list[tuple[float, float]], notes: list[str]
) -> None:
    """Note presses of the path, LOST_MM deep at least, that the gauge does not show. height: times on its clock, s, and mm."""
    pressed = [(height[0][run.start], height[0][run.stop - 1]) for run in series.runs(height[1] < -LOST_MM)]
    lost = [begin for begin, end in pressed if not any(start <= end and stop >= begin for start, stop in spans)]
    if lost:
        notes.append(
            f"{name}: shows {len(pressed) - len(lost)} of {len(pressed)} presses of the path; the others, from {shown(lost[0])} on its clock"
            " on, have no force and are left out: did the gauge stop, or start late?"
        )


def _check_average(gauge: Recording, height: tuple[np.ndarray, np.ndarray], spans: list[tuple[float, float]]) -> None:
    """BadInput where the gauge averages: its peaks are low, and its times late."""
    found = series.averaging((gauge.times, gauge.values[:, 0]), (height[0], np.maximum(-height[1], -ABOVE_MM)), spans)
    if found is not None and found.width >= series.LEAST_WIDTH_S and found.gain > series.LEAST_GAIN:
        raise BadInput(
            f"{gauge.name}: force rises and falls beside the path as if each reading were a mean over about {found.width:.1f} s, which makes peaks too low:"
            " set the gauge to its shortest average and record again"
        )


def _check_shift(
    gauge: Recording,
    path: Recording,
    clock: MatchedClock,
    spans: list[tuple[float, float]],
    touch: float,
    bench,
    notes: list[str],
) -> None:
    """BadInput where force begins at another height in later presses than in earlier ones: the path has shifted."""
    force, times = gauge.values[:, 0], clock.to_gauge(path.times)
    least = max(3.0 * touch, 0.04 * float(force.max()))
    heights = series.onsets((gauge.times, force), (times, -path.values[:, 0]), spans, least)
    for k, (begin, _) in enumerate(spans):  # a dome is met lower beside its apex
        x, y, turn = (float(np.interp(begin, times, path.values[:, column])) for column in (1, 2, 4))
        heights[k] -= bench.touch_height(x, y, turn)
    change, where = series.shifted_heights(heights)
    if not len(where):
        return
    named = ", ".join(f"{k + 1} at {shown(spans[k][0])}" for k in where[:5].tolist()) + (
        f" and {len(where) - 5} more" if len(where) > 5 else ""
    )
    said = (
        f"{path.name}: the height at which force begins changes by {abs(change):.2f} mm during the recording (presses {named} differ from the"
        " others): did the machine lose steps, or its zero move?"
    )
    if abs(change) > MOST_SHIFT_MM:
        raise BadInput(f"{said} Give the presses before and after as two recordings, each with its own --origin")
    notes.append(said)


def _beyond_range(
    gauge: Recording, height: tuple[np.ndarray, np.ndarray], at: np.ndarray, notes: list[str]
) -> np.ndarray:
    """Images (m,) bool, at times (m,) s, whose force is at the end of the gauge's range."""
    bad = np.zeros(len(at), bool)
    depth = np.interp(gauge.times, height[0], -height[1])
    for number, values in enumerate(gauge.values.T):
        for way in (values, -values):
            if number and np.array_equal(np.abs(way), np.abs(gauge.values[:, 0])):
                continue  # the normal force, of which compression is the negative
            found = series.at_end(way, depth if number == 0 and way is values else None)
            if found.any():
                bad |= np.interp(at, gauge.times, found.astype(float)) > 0.0
                notes.append(
                    f"{series.end_told(gauge.name, float(way.max()), int(found.sum()))}; their images are left out"
                )
    return bad


def _repeated(
    images: Images,
    places: np.ndarray,
    at: np.ndarray,
    spans: list[tuple[float, float]],
    notes: list[str],
) -> np.ndarray:
    """Images (m,) bool that show the one before them again although the tip moved in the gel."""
    pressed = np.any([(at >= begin) & (at <= end) for begin, end in spans], axis=0)
    again = series.repeats(images.small, places[:, 1:4], pressed)
    if again.any():
        notes.append(
            f"{images.path}: {again.sum()} images repeat the one before them although the tip moved, as where a camera is too slow or stands still;"
            " they are left out"
        )
    return again


def _gaps(path: Recording) -> np.ndarray:
    """Indices of the samples after a gap in which the tip stood still in the gel; some logs hold motion only."""
    before, after = path.values[:-1], path.values[1:]
    stood = (np.abs(after - before)[:, :4].max(axis=1) <= STATE_MM) & (before[:, 0] > 0.0)
    return np.flatnonzero(stood & (np.diff(path.times) > LAPSE * path.interval)) + 1


def _filled(path: Recording) -> Recording:
    """A path with gaps filled where the tip stood still, for matching its clock."""
    times, values = [path.times], [path.values]
    for at in _gaps(path).tolist():
        more = np.arange(path.times[at - 1] + path.interval, path.times[at] - 0.5 * path.interval, path.interval)
        times.append(more)
        values.append(np.repeat(path.values[at - 1 : at], len(more), axis=0))
    order = np.argsort(np.concatenate(times), kind="stable")
    return Recording(path.name, np.concatenate(times)[order], np.concatenate(values)[order])


def _where_it_stood(path: Recording, times: np.ndarray, places: np.ndarray, press: np.ndarray) -> np.ndarray:
    """Positions (n, 5) at times (n,) s of a press (2,) s, with gaps filled in which the tip stood still."""
    places = places.copy()
    for at in _gaps(path).tolist():
        start, end = path.times[at - 1], path.times[at]
        if press[0] <= start and end <= press[1]:
            places[(times > start) & (times < end)] = path.values[at - 1]
    return places


def _states(images: np.ndarray, places: np.ndarray) -> list[np.ndarray]:
    """Group images (n,) of one press by state: positions within STATE_MM of the first one of the group."""
    states: list[list[int]] = []
    for image in images.tolist():
        if states and np.abs(places[image, :4] - places[states[-1][0], :4]).max() <= STATE_MM:
            states[-1].append(image)
        else:
            states.append([image])
    return [np.array(state) for state in states]


def _cost_of_one(times: np.ndarray, gauge: Recording, path: Recording, clock: MatchedClock, film: Path) -> str:
    """A note on the error that an unknown drift may cause in the rows of a single press, at times (n,) s."""
    away, step = np.abs(times - times.mean()), gauge.interval
    speed = np.abs(path.at(clock.from_gauge(times + step)) - path.at(clock.from_gauge(times - step)))[:, 0] / (
        2 * step
    )
    rate = np.abs(gauge.at(times + step) - gauge.at(times - step))[:, 0] / (2 * step)
    off = [float(np.nanmax(away * value, initial=0.0)) for value in (speed, rate)]
    said = f"one press: the drift of its clocks is unknown; with {1e6 * MOST_DRIFT:.0f} ppm, the largest drift of two clocks, rows have errors of up to"
    said += f" {MOST_DRIFT * off[0]:.2g} mm and {MOST_DRIFT * off[1]:.2g} N"
    if film.is_file():
        said += f"; with a film whose frame rate is wrong by {OTHER_RATE:.0%}, up to {OTHER_RATE * off[0]:.2g} mm and {OTHER_RATE * off[1]:.2g} N"
    return f"{said}; record two or more presses to measure the drift"


def _dates(at: np.ndarray, clocks: dict[str, np.ndarray], notes: list[str]) -> list[str]:
    """Times of the images as dates, by the first clock that counts from 1970; by the gauge's where none does."""
    dated = next((times for times in clocks.values() if times[0] >= DATED_S), None)
    if dated is None:
        notes.append("no clock has a date, so time_utc is the gauge's time, counted from 1970")
    return [shown(float(time), True) for time in (at if dated is None else dated)]


def shown(time: float, date: bool = False) -> str:
    """A time in s as text; a date where the clock counts from 1970, or where `date` is set."""
    if time < DATED_S and not date:
        return f"{time:.2f} s"
    return datetime.fromtimestamp(max(time, 0.0), UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def nocontact_of(aligned: Aligned, images: Images) -> np.ndarray:
    """The mean (h, w, 3) uint8 RGB of the first images at rest; BadInput where there are none."""
    rest = set(aligned.rest[:STILL])
    free = [image for number, image in enumerate(images) if number in rest]
    if not free:
        raise BadInput(
            f"{images.path}: no image was taken while the gauge was at rest; film the gel without contact before the first press"
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
    """Write log, images and no-contact image to the folder `data`, which must not exist; `framed` resizes images."""
    with new_folder(data) as part:
        for number, image in enumerate(images):
            if number in aligned.rows:
                write_png(part / aligned.rows[number].image, framed(image))
        write_png(part / "nocontact" / f"{bench.sensor.name}.png", framed(nocontact))
        write_log(part / "log.csv", aligned.rows.values())
        write_text(part / "dataset.toml", DATASET_TOML.format(sensor=bench.sensor.name, gel=bench.sensor.gel))


def _level_told(level: np.ndarray, measured: Sequence[str]) -> list[str]:
    """Notes on forces of LEAST_LEVEL_N and more that the gauge reads at rest, and on their drift."""
    said = []
    for column, values in zip(measured, level.T[1:], strict=True):
        if np.abs(values).max() >= LEAST_LEVEL_N:
            drift = f", and drifts by {np.ptp(values):.2g} N" if np.ptp(values) >= LEAST_LEVEL_N else ""
            said.append(f"the gauge reads {column} = {values[0]:+.2f} N at rest{drift}; this was subtracted")
    return said


def _told(*recordings: Recording) -> list[str]:
    """Notes on the sampling interval and the gaps of each recording."""
    said = []
    for one in recordings:
        lapses = one.lapses
        drops = (
            f"; {len(lapses)} gaps of up to {lapses.max():.2f} s, where nothing is interpolated"
            if len(lapses)
            else ""
        )
        said.append(f"{one.name}: {len(one.times)} samples, one every {1e3 * one.interval:.3g} ms{drops}")
    return said


def _clock_told(name: str, clock: MatchedClock, offset: float) -> str:
    """A note on the offset, drift and error of a clock."""
    rival = (
        "; another offset fits nearly as well, which happens if presses are similar and evenly spaced: check the offset"
        if clock.rival
        else ""
    )
    ahead = (
        f"{1e3 * offset:+.1f} ms relative to the gauge's"
        if abs(offset) < DATED_S
        else (f"its 0 s is {shown(offset)}" if offset > 0.0 else f"the gauge's 0 s is {shown(-offset)}")
    )
    drift = f"drift {1e6 * clock.drift:+.0f} ppm" if len(clock.presses) > 1 else "drift unknown"
    return f"clock of the {name}: {ahead}, {drift}, from {len(clock.presses)} presses; error {1e3 * clock.error_s:.1f} ms{rival}"


def _check_height(path: Recording, rows: list[LoggedPress]) -> None:
    """BadInput where force does not begin near the gel's surface: at or a little below its apex, z = 0."""
    first: dict[str, float] = {}
    for row in rows:
        first.setdefault(row.press_id, float(row.dz_mm))
    usual = float(np.median(list(first.values())))
    if not -0.5 < usual < 0.1:
        raise BadInput(
            f"{path.name}: force begins at z = {usual:.2f} mm, but z = 0 is the apex of the gel: give the position of the apex in the path's coordinates as"
            " --origin X,Y,Z"
        )
