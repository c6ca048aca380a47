"""Import recordings of robots as a dataset: images with a force sensor's wrench, without a known indenter.

A small TOML names the topics:

    image = "/gelsight/image/compressed"  # CompressedImage (JPEG, PNG) or Image (colour, Bayer) of ROS; CompressedImage,
                                          # RawImage or CompressedVideo of Foxglove, protobuf or JSON
    wrench = "/ft/wrench"                 # geometry_msgs/WrenchStamped or Wrench, or any schema with:
    force = ["wrench.force.x", "wrench.force.y", "wrench.force.z"]  # its force fields, N; items of a list: "data.0"
    torque = []                           # its moment fields, N m, if any
    sensor = "gelsight_mini"              # in workflow/sensors.toml
    latest_s = 0.02                       # largest time between an image and its wrench
    every = 10                            # take every tenth image
    touch_n = 0.2                         # a press begins where the force exceeds this, N
    rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]  # from the wrench's frame to the gel's: x short side, z out of the gel
    sign = 1                              # -1 where the sensor states the force that the gel exerts

Messages are paired by the time in their headers; where a topic has no stamps, or the stamps of both topics come from
different clocks, by log time, with a note (formats.messagetime). Every image with a wrench becomes a row of log.csv
without a pose, and a label of one cell, the total force: `make train RES=1x1 MODEL=pair_16` learns from them. The
no-contact image is the mean of the first images without contact.
"""

import math
from bisect import bisect_left
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import read_toml, write_text
from gelforge.formats.feats_folder import NO_PRESS, new_folder
from gelforge.formats.mcap_messages import messages, recordings_of, topics_in
from gelforge.formats.messageimage import pictures
from gelforge.formats.messagetime import (
    MessageOrder,
    MessageTimes,
    PairingClock,
    by_log_times,
    choose_clock,
    stamp_of,
)
from gelforge.records import series
from gelforge.records.image import write_png
from gelforge.records.labelfile import write_labels
from gelforge.records.log import write_log
from gelforge.records.nocontactimage import STILL
from gelforge.records.press import FORCES, N_M, LoggedPress, pull_fault, size_fault

DEFAULTS = {
    "latest_s": 0.02,
    "every": 1,
    "sign": 1,
    "touch_n": 0.2,
    "rotation": np.eye(3).tolist(),
    "force": [],
    "torque": [],
    "sensor": "gelsight_mini",
}
SMALL = (32, 24)  # px of the copies of images that show whether they change
LEAST_CONTACT_S = 0.3
SPLIT_NS = 10**9  # a recorder that continues in a new file leaves a shorter gap
DATASET_TOML = """# Imported from recordings: images with total force, no indenter known: make train RES=1x1 MODEL=pair_16
sensor = "{sensor}"
gel = "{gel}"
catalogue = "indenters.toml"
"""


@dataclass(frozen=True)
class Topics:
    """Names of the topics of a recording, and how its wrench is read."""

    image: str
    wrench: str
    sensor: str
    latest_s: float
    every: int
    sign: int
    touch_n: float
    rotation: np.ndarray
    force: tuple[str, ...]
    torque: tuple[str, ...]

    @classmethod
    def read(cls, path: Path) -> "Topics":
        """Read the TOML; BadInput where a name is missing, unknown or of the wrong kind."""
        table = read_toml(path)
        for name in ("image", "wrench"):
            if not isinstance(table.get(name), str):
                raise BadInput(f"{path}: {name} is missing; give the topic of the {name}, as listed by `mcap info`")
        unknown = sorted(table.keys() - DEFAULTS.keys() - {"image", "wrench"})
        if unknown:
            raise BadInput(f"{path}: {unknown[0]} is not known; known: image, wrench, {', '.join(DEFAULTS)}")
        found = {**DEFAULTS, **table}
        try:
            rotation = np.array(found["rotation"], float)
            square = rotation.shape == (3, 3) and np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3)
            turned = square and np.linalg.det(rotation) > 0  # a reflection would flip the sign of one direction
        except (TypeError, ValueError, OverflowError):
            turned = False
        if not turned:
            raise BadInput(f"{path}: rotation = {found['rotation']!r}; give a 3 x 3 rotation matrix (no reflection)")
        if not isinstance(found["sensor"], str):
            raise BadInput(f"{path}: sensor = {found['sensor']!r}; give one name of workflow/sensors.toml")
        for name in ("force", "torque"):
            fields = found[name]
            if (
                not isinstance(fields, list)
                or len(fields) not in (0, 3)
                or not all(isinstance(one, str) for one in fields)
            ):
                raise BadInput(
                    f'{path}: {name} = {fields!r}; give three fields of the message, such as ["wrench.force.x", …]'
                )
        touch, latest = number(found["touch_n"]), number(found["latest_s"])
        if not touch >= 0:
            raise BadInput(f"{path}: touch_n = {found['touch_n']!r}; give a force in N, 0 or above")
        whole = type(found["every"]) is int and found["every"] >= 1 and found["sign"] in (1, -1)
        if not whole or not latest > 0:
            raise BadInput(f"{path}: every is a whole number from 1, sign is 1 or -1, latest_s is above 0")
        return cls(
            found["image"], found["wrench"], found["sensor"], latest, found["every"], found["sign"], touch, rotation,
            tuple(found["force"]), tuple(found["torque"]),
        )  # fmt: skip


def number(value: Any) -> float:
    """A number of the TOML as float; NaN for anything else, and for an integer that exceeds the range of floats."""
    try:
        return float(value) if type(value) in (int, float) else math.nan
    except OverflowError:
        return math.nan


def wrench_of(said: Any, where: str, topics: Topics) -> np.ndarray | None:
    """Force and moment (6,) of a message in the gel frame, N and N m.

    None where the force is not finite; a missing moment is NaN. BadInput where the message holds no wrench.
    """
    wrench = getattr(said, "wrench", said)  # messages have classes that only the file defines
    try:
        if topics.force:
            force, torque = (
                np.array([field_of(said, name) for name in fields], float) for fields in (topics.force, topics.torque)
            )
        else:
            force, torque = (
                np.array([getattr(part, axis) for axis in "xyz"], float) for part in (wrench.force, wrench.torque)
            )
    except (AttributeError, IndexError, TypeError, ValueError) as error:
        raise BadInput(
            f'{where} holds no wrench ({error}); name a topic of geometry_msgs/Wrench, or give its fields: force = ["…", "…", "…"]'
        ) from error
    parts = np.stack([force, torque if len(torque) else np.full(3, np.nan)])
    return topics.sign * (topics.rotation @ parts.T).T.ravel() if np.isfinite(force).all() else None


def field_of(said: Any, name: str) -> Any:
    """A field of a message, such as `wrench.force.x`, or `data.2` for an item of a list."""
    for part in name.split("."):
        said = said[int(part)] if part.isdigit() else getattr(said, part)
    return said


def frame_of(said: Any) -> str:
    """Name of the frame in which a message gives its forces; empty where it names none."""
    return str(getattr(getattr(said, "header", said), "frame_id", ""))


def within_limits(values: np.ndarray, where: str, topics: Topics) -> tuple[np.ndarray, list[str]]:
    """Which wrenches of images (n, 6) are within the limits of a log (n,), and notes on those that are not.

    BadInput where the wrench has another unit, or the opposite sign: where at least as many images pull as press.
    """
    for force in values.tolist():
        for column, value in zip(FORCES, force, strict=True):
            if fault := size_fault(column, value):
                raise BadInput(f"{where}: {column} = {value:.4g} beside an image, {fault[0]}; {fault[1]}")
    pulls = np.array([pull_fault(fz_n) is not None for fz_n in values[:, 2].tolist()], bool)
    if not pulls.any():
        return ~pulls, []
    said = f"{pulls.sum()} of {len(values)} images have a pulling force, fz_n up to +{values[:, 2].max():.3g} N"
    if pulls.sum() >= (touching(values, topics) & ~pulls).sum():
        raise BadInput(
            f"{where}: {said}; forces must be those on the gel, with pressing negative: set sign = {-topics.sign}, correct"
            " rotation, or tare the sensor and record again"
        )
    return ~pulls, [f"{topics.wrench}: {said}; they are left out"]


def nearest(times: np.ndarray, time: int, latest_ns: float) -> int | None:
    """Row of the entry of `times` nearest to `time`, ns; None where they differ by more than `latest_ns`."""
    after = bisect_left(times, time)
    found = min(
        (at for at in (after - 1, after) if 0 <= at < len(times)), key=lambda at: abs(times[at] - time), default=None
    )
    return None if found is None or abs(times[found] - time) > latest_ns else int(found)


@dataclass(frozen=True)
class Pairs:
    """Images of one recording with their wrenches, in order of time.

    images (n,): index of the message in its topic, from 0. times (n,): ns. values (n, 6): N and N m. gaps (n,): ns
    between an image and its wrench. alone: number of images without a wrench. notes: for the user.
    """

    images: np.ndarray
    times: np.ndarray
    values: np.ndarray
    gaps: np.ndarray
    alone: int
    notes: list[str]


def pair(path: Path, topics: Topics) -> Pairs:
    """Pair images with the wrenches nearest in time; leave out pairs that pull beyond the limits of a log."""
    images: list[tuple[int, int]] = []
    readings: list[tuple[int, int]] = []
    read: list[np.ndarray] = []
    notes: list[str] = []
    frames: dict[str, dict[str, None]] = {topics.image: {}, topics.wrench: {}}
    where = f"{path}: topic {topics.wrench}"
    for topic, time, said in messages(path, (topics.image, topics.wrench)):
        frames[topic][frame_of(said)] = None
        if topic == topics.image:
            images.append((time, stamp_of(said)))
        elif (force := wrench_of(said, where, topics)) is not None:
            readings.append((time, stamp_of(said)))
            read.append(force)
    for topic, named in frames.items():
        if len(named) > 1:
            why = "two cameras are on it" if topic == topics.image else "`rotation` is of one"
            raise BadInput(
                f"{path}: topic {topic} has messages of several frames ({', '.join(map(repr, named))[:200]}): {why}; let its driver keep to one, and"
                " record again"
            )
    image = MessageTimes.of(topics.image, images)
    values = np.array(read, float).reshape(-1, 6)
    kept = np.ones(len(values), bool)
    if len(values):
        kept, notes = series.confirmed(where, 1e-9 * np.array([time for time, _ in readings], float), values[:, :3])
    readings_kept = [time for time, good in zip(readings, kept.tolist(), strict=True) if good]
    values, wrench = values[kept], MessageTimes.of(topics.wrench, readings_kept)
    shown = small_copies(path, topics, len(images))
    clock = believed_clock(path, image, wrench, values, shown, topics)
    seen, felt = MessageOrder.by(image, clock.header), MessageOrder.by(wrench, clock.header)
    chosen = seen.index[:: topics.every]
    times = seen.times[:: topics.every]
    rows = [nearest(felt.times, time, 1e9 * topics.latest_s) for time in times.tolist()]
    has = np.array([row is not None for row in rows], bool)
    found = np.array([row for row in rows if row is not None], int)
    gaps = np.abs(times[has] - felt.times[found])
    forces = values[felt.index[found]]
    good, pulling = within_limits(forces, where, topics)
    ended, over = at_range_end(values[felt.index], shown.change, felt.times, times, chosen, topics)
    good &= ~ended[found]
    again = repeated(shown, chosen[has], forces, topics)
    good &= ~again
    if again.any():
        notes.append(
            f"{topics.image}: {again.sum()} images repeat the one before them although the force changed; they are left out"
        )
    notes += over
    if level := series.level_without_contact(
        np.linalg.norm(forces[:, :3], axis=1), shown.change[chosen[has]], topics.touch_n
    ):
        notes.append(f"{topics.wrench} {level}")
    notes += [*clock.notes, *seen.notes, *felt.notes, *untared(values, topics), *pulling]
    return Pairs(
        chosen[has][good],
        times[has][good],
        forces[good],
        gaps[good],
        int((~has).sum()),
        [f"{path}: {note.removeprefix(f'{path}: ')}" for note in notes],
    )


@dataclass(frozen=True)
class Shown:
    """What the images of a topic show: small copies (m, h, w, 3) uint8 by index (m,), and whether each repeats the one before.

    change (n,): of each message from the images without contact, levels; NaN where it was not decoded.
    """

    small: np.ndarray
    index: np.ndarray
    change: np.ndarray


def small_copies(path: Path, topics: Topics, count: int) -> Shown:
    """Small copies of the images that are taken, and how much each differs from the median of all."""
    import cv2

    wanted = set(range(0, count, topics.every))
    said = (message for _, _, message in messages(path, (topics.image,)))
    small, index = [], []
    for at, image in pictures(said, wanted, f"{path}: topic {topics.image}"):
        small.append(cv2.resize(image, SMALL, interpolation=cv2.INTER_AREA))
        index.append(at)
    return Shown(np.array(small, np.uint8).reshape(-1, *SMALL[::-1], 3), np.array(index, int), np.full(count, np.nan))


def believed_clock(
    path: Path, image: MessageTimes, wrench: MessageTimes, values: np.ndarray, shown: Shown, topics: Topics
) -> PairingClock:
    """The clock by which forces follow the pictures; BadInput where they do by neither.

    values: (k, 6) of the wrench. Fills `shown.change`.
    """
    clock = choose_clock(image, wrench)
    if not len(values) or not len(shown.index):
        return clock
    said: list[str] = []
    for one in (clock, by_log_times([])) if clock.header else (clock,):
        lag = lag_of(image, wrench, values, shown, one.header, topics)
        if lag is None or not lag.of_clocks:
            return PairingClock(one.header, [*one.notes] if one is clock else by_log_times(said).notes)
        which = "header" if one.header else "log"
        said.append(
            f"by {which} times the forces of {topics.wrench} are {abs(lag.seconds):.2f} s {'late' if lag.seconds > 0 else 'early'} beside what the pictures show"
        )
    raise BadInput(
        f"{path}: {' and '.join(said)}: their clocks differ; set them by one time server (chrony, PTP), stamp images and forces when they are"
        " measured, and record again"
    )


def lag_of(
    image: MessageTimes, wrench: MessageTimes, values: np.ndarray, shown: Shown, header: bool, topics: Topics
) -> series.Lag | None:
    """By how much forces lag behind the pictures of their contacts."""
    seen, felt = MessageOrder.by(image, header), MessageOrder.by(wrench, header)
    if len(felt.times) < series.FEWEST or len(seen.times) < series.FEWEST:
        return None
    start = felt.times[0]
    force = np.linalg.norm(values[felt.index, :3], axis=1)
    force = force - np.quantile(force, 0.05)
    times, at = 1e-9 * (felt.times - start), 1e-9 * (seen.times - start)
    touch = max(topics.touch_n, 0.05 * float(force.max()))
    contacts = [
        run
        for run in series.runs(force >= touch, times)
        if run.start > 0 and run.stop < len(times) and times[run.stop - 1] - times[run.start] > LEAST_CONTACT_S
    ]
    where = np.searchsorted(shown.index, seen.index)
    where = np.minimum(where, len(shown.index) - 1)
    taken = shown.index[where] == seen.index
    at, where, indices = at[taken], where[taken], seen.index[taken]
    small = shown.small[where].astype(np.float32)
    free = np.interp(at, times, force) < touch
    if not contacts or not free.any():
        return None
    change = np.abs(small - small[free][:STILL].mean(axis=0)).mean(axis=(1, 2, 3))
    shown.change[indices] = change
    return series.lag_of_pictures(
        (times, force), (at, change), [(float(times[run.start]), float(times[run.stop - 1])) for run in contacts]
    )


def at_range_end(
    values: np.ndarray, change: np.ndarray, felt: np.ndarray, seen: np.ndarray, chosen: np.ndarray, topics: Topics
) -> tuple[np.ndarray, list[str]]:
    """Which wrenches (k, 6) are at the end of the sensor's range (k,), and notes; felt, seen: times of wrenches and images, ns."""
    ended = np.zeros(len(values), bool)
    notes: list[str] = []
    if len(values) < 2 * series.FEWEST:
        return ended, notes
    known = np.isfinite(change[chosen]) if len(chosen) else np.zeros(0, bool)
    other = np.interp(felt, seen[known], change[chosen][known]) if known.sum() > 1 else None
    for name, each in zip(FORCES, values[:, :3].T, strict=False):
        for way in (each, -each):
            found = series.at_end(way, other if way is not each and name == "fz_n" else None)
            if found.any():
                ended |= found
                notes.append(
                    f"{series.end_told(f'{topics.wrench}, {name}', float(np.abs(way.max())), int(found.sum()))}; their images are left out"
                )
    return ended, notes


def repeated(shown: Shown, images: np.ndarray, forces: np.ndarray, topics: Topics) -> np.ndarray:
    """Images (n,) bool, by index of their message, that repeat the one before them although the force (n, 6) changed."""
    if not len(images) or not len(shown.index):
        return np.zeros(len(images), bool)
    where = np.minimum(np.searchsorted(shown.index, images), len(shown.index) - 1)
    if (shown.index[where] != images).any():
        return np.zeros(len(images), bool)
    return series.repeats(shown.small[where], forces[:, :3], touching(forces, topics))


def untared(values: np.ndarray, topics: Topics) -> list[str]:
    """A note where the force sensor always reads a force; values (n, 6): its readings."""
    least = float(np.linalg.norm(values[:, :3], axis=1).min(initial=np.inf))
    if not topics.touch_n < least < np.inf:
        return []
    return [
        f"{topics.wrench} never reads less than {least:.3g} N, above touch_n = {topics.touch_n:g}, so all images count as one"
        " contact; if the gel was free at any time, tare the sensor and record again"
    ]


def import_recordings(source: Path, data: Path, topics: Topics, sensor) -> dict:
    """Turn recordings into the dataset folder `data`, which must not exist; return counts and notes.

    source: a recording, or a folder of them. sensor: labelling.sensor.Sensor. If one fails, nothing is left behind.
    """
    files, passed = recordings_of(source)
    if not files:
        raise BadInput(
            f"{source}: holds no recordings (.mcap, .bag, folders of bags); give one or a folder of them as FROM=…"
        )
    rows: list[LoggedPress] = []
    forces: list[np.ndarray] = []
    alone, largest, notes = 0, 0.0, [*passed]
    rest: list[np.ndarray] = []
    with new_folder(data) as part:
        (part / "images").mkdir(parents=True)
        found = [(path, pair(path, topics)) for path in files]
        # sort parts of one recording by time, because names sort wrongly (…_10 before …_2)
        found.sort(key=lambda each: each[1].times[0] if len(each[1].times) else 0)
        ended, going = 0, ""
        for number, (path, pairs) in enumerate(found):
            near = len(pairs.times) > 0 and pairs.times[0] - ended < SPLIT_NS
            rows += take(path, number, pairs, part, topics, sensor, rest, going if near else "")
            if len(pairs.times):
                ended = pairs.times[-1]
                going = rows[-1].press_id if touching(pairs.values, topics)[-1] else ""
            forces += list(pairs.values[:, :3])
            alone += pairs.alone
            largest = max(largest, 1e-9 * float(pairs.gaps.max(initial=0)))
            notes += pairs.notes
        if not rows:
            there = topics_in(files[0])
            missing = [name for name in (topics.image, topics.wrench) if there and name not in there]
            notes += [f"{files[0]} has no topic {name}, but {', '.join(there[:20])}" for name in missing]
            seen = "; ".join([f"{alone} images were seen", *notes])
            raise BadInput(f"{source}: no image of {topics.image} has a wrench of {topics.wrench} within {topics.latest_s:g} s, {seen}; name other topics or a larger latest_s")  # fmt: skip
        if rest:
            write_png(part / "nocontact" / f"{sensor.name}.png", np.rint(np.mean(rest, axis=0)).astype(np.uint8))
        else:
            notes.append(
                f"{source}: no image shows the gel without contact (force below touch_n = {topics.touch_n:g} N); put one as nocontact/{sensor.name}.png into"
                f" {data}: networks compare images with it"
            )
        write_log(part / "log.csv", rows)
        write_totals(part / "labels" / "1x1.npz", rows, np.array(forces))
        write_text(part / "dataset.toml", DATASET_TOML.format(sensor=sensor.name, gel=sensor.gel))
    return {
        "files": len(files), "images": len(rows), "without_wrench": alone, "largest_gap_s": largest, "notes": notes,
    }  # fmt: skip


def touching(values: np.ndarray, topics: Topics) -> np.ndarray:
    """Whether each wrench (n, 6) shows contact (n,): a force above touch_n."""
    return np.linalg.norm(values[:, :3], axis=1) > topics.touch_n


def take(
    path: Path, number: int, pairs: Pairs, part: Path, topics: Topics, sensor, rest: list[np.ndarray], going: str = ""
) -> list[LoggedPress]:
    """Rows of the paired images of one file, in order of time.

    Writes their PNGs, and appends the first images without contact to `rest`, up to STILL of them. going: press_id of
    the contact in which the file before this one ended, empty for none.
    """
    touches = touching(pairs.values, topics)
    free = set(pairs.images[~touches].tolist()) if len(rest) < STILL else set()
    said = (message for _, _, message in messages(path, (topics.image,)))
    for at, image in pictures(said, set(pairs.images.tolist()), f"{path}: topic {topics.image}"):
        image = sensor.sized(image, f"{path}: images of {topics.image}")
        if at in free and len(rest) < STILL:
            rest.append(image)
        write_png(part / "images" / f"{name_of(number, at)}.png", image)
    # Images of one contact are frames of one press, so that they stay in one split.
    presses = np.cumsum(touches & ~np.concatenate([[False], touches[:-1]]))
    goes_on = np.logical_and.accumulate(touches) & bool(going)
    rows = []
    for at, time, values, press, on in zip(
        pairs.images.tolist(), pairs.times.tolist(), pairs.values, presses.tolist(), goes_on.tolist(), strict=True
    ):
        name = name_of(number, at)
        when = datetime.fromtimestamp(time / 1e9, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        known = {"sample_id": name, "sensor_id": sensor.name, "gel_id": sensor.gel, "image": f"images/{name}.png",
                 "time_utc": when, "press_id": going if on else f"r{number:03d}-p{press:05d}"}  # fmt: skip
        forces = dict(zip(FORCES, values.tolist(), strict=True))
        rows.append(LoggedPress(row=0, **{**NO_PRESS, **known, **forces}))
    return rows


def name_of(recording: int, message: int) -> str:
    """Name of the sample made of one image message."""
    return f"r{recording:03d}-{message:06d}"


def write_totals(path: Path, rows: list[LoggedPress], forces: np.ndarray) -> None:
    """Write labels of one cell: total force (n, 3) N along gel x, y, z, sorted by sample_id."""
    order = np.argsort([row.sample_id for row in rows])
    labels = forces[order].astype(np.float32)[:, :, None, None]
    arrays = {
        "sample_id": np.array([rows[at].sample_id for at in order]),
        "status": np.array(["OK"] * len(rows)),
        "outside": np.full((len(rows), 3), np.nan),
        "moment": np.array([rows[at].wrench[3:] for at in order]).reshape(-1, 3) / N_M,
        "outside_moment": np.full((len(rows), 3), np.nan),
    }
    write_labels(path, [labels], labels.shape, arrays)
