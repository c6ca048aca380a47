"""Force readings of a raw log, and the faults that would make a calibration meaningless."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from gelforge.errors import BadInput
from gelforge.geometry.gel import USUAL_GEL
from gelforge.geometry.solids import Indenter, feels_tilt
from gelforge.mechanics.contact.law import Coulomb, NoSlip
from gelforge.records.frames import NEAR_MM, presses_of
from gelforge.records.log import read_log
from gelforge.records.press import FORCE, MOMENT, POSE, TILT, LoggedPress, Press, RawRow, parse, with_tilt

FIRM_N = 1.0  # least normal force whose centre of pressure is used
FEWEST = 2  # straight presses of a mounting, with moments, of a body that feels tilt, from which its tilt is found
SLIDES = 1.0  # travel over depth above which a contact slides as a whole at any usual friction


@dataclass(frozen=True)
class Readings:
    """n presses with a force reading each.

    rows: (n,) line numbers in the log. ids, indenters, gels, mountings: (n,) str. pose: (n, 9) in the order of POSE
    and TILT. force: (n, 3) N on the gel; nan where a sideways component was not logged. moment: (n, 2) N mm about gel x
    and y, nan where one was not logged. stated: (n,) bool, whether the log or its dataset states the tilt.
    """

    source: str
    rows: np.ndarray
    ids: np.ndarray
    indenters: np.ndarray
    pose: np.ndarray
    force: np.ndarray
    gels: np.ndarray
    mountings: np.ndarray
    moment: np.ndarray
    stated: np.ndarray

    def __len__(self) -> int:
        return len(self.rows)

    def take(self, index) -> "Readings":
        return Readings(
            self.source, self.rows[index], self.ids[index], self.indenters[index], self.pose[index], self.force[index],
            self.gels[index], self.mountings[index], self.moment[index], self.stated[index],
        )  # fmt: skip

    @property
    def depth(self) -> np.ndarray:
        """Commanded depth, (n,) mm, positive into the gel."""
        return -self.pose[:, 5]

    @property
    def sheared(self) -> np.ndarray:
        """Whether the press moves sideways, (n,) bool."""
        return self.travel > 0

    @property
    def travel(self) -> np.ndarray:
        """Commanded sideways travel, (n,) mm."""
        return np.hypot(self.pose[:, 3], self.pose[:, 4])

    @property
    def centre(self) -> np.ndarray:
        """Where the sensor's moments put the force of a straight press, (n, 2) mm along gel x and y; else nan.

        Presses lighter than FIRM_N are left out: there the noise of the moments decides.
        """
        firm = ~self.sheared & (self.force[:, 2] < -FIRM_N)
        normal = np.where(firm, self.force[:, 2], np.nan)[:, None]
        return np.column_stack([-self.moment[:, 1], self.moment[:, 0]]) / normal

    def press(self, i: int, depth: float) -> Press:
        """Path of press i to another depth, with its own sideways travel."""
        x0, y0, z0, dx, dy, _, *turns = (float(v) for v in self.pose[i])
        return Press(x0, y0, z0, dx, dy, -depth, *turns)

    def name(self, index) -> str:
        """Rows for an error message, at most five."""
        index = np.atleast_1d(index)
        shown = ", ".join(f"row {self.rows[i]} ({self.ids[i]})" for i in index[:5])
        return shown + (f" and {len(index) - 5} more" if len(index) > 5 else "")


NEEDED = ("indenter", *POSE, *FORCE, *MOMENT[:2])


def read_readings(
    log: Path | str, known_bad: Collection[int] = (), gels: Mapping[str, str] = MappingProxyType({})
) -> Readings:
    """Readings of a raw log; see `readings_of`."""
    return readings_of(read_log(log), str(log), known_bad, gels)


def readings_of(
    rows: Sequence[RawRow],
    log: str,
    known_bad: Collection[int] = (),
    gels: Mapping[str, str] = MappingProxyType({}),
    tilt_deg: Sequence[float] = (0.0, 0.0),
    mounting_tilt_deg: Mapping[str, Sequence[float]] = MappingProxyType({}),
) -> Readings:
    """Every press of a log's rows that has a normal force; rows without one are skipped.

    Rows of several sensors that saw one press and are otherwise equal make one reading. Of the frames of a press only
    the last is used.
    known_bad: lines of the log that are rejected. gels: name of the gel by sensor, "" for rows that name no
    sensor; USUAL_GEL for all others. tilt_deg, mounting_tilt_deg: of the bench and of single mountings, degrees about
    gel x and y, for rows that state none. Sideways forces may be empty. A log in which no row has a force, or a value
    that is no number, raises BadInput.
    """
    missing = [column for column in ("indenter", *POSE, "fz_n") if column not in rows[0].cells]
    if missing:
        raise BadInput(f"{log}: column {missing[0]} is missing; seen: {', '.join(rows[0].cells)}")
    presses: list = []
    stated: set[int] = set()
    seen_by: dict = {}
    for raw in rows:
        if raw.row in known_bad or not raw.cells["fz_n"]:
            continue
        press, wrong = parse(raw, log, [column for column in NEEDED if column in raw.cells])
        if press is None:
            first = wrong[0]
            raise BadInput(
                f"{log}: row {first.row}, column {first.column}: {first.value!r}: {first.reason}; {first.hint}"
            )
        if (
            press.mounting in mounting_tilt_deg
            or any(tilt_deg)
            or any(getattr(press, name) is not None for name in TILT)
        ):
            stated.add(press.row)
        press = with_tilt(press, tilt_deg, mounting_tilt_deg)
        same = tuple(raw.cells.get(c) for c in ("time_utc", "indenter", *POSE, *FORCE))
        if seen_by.setdefault(same, press.sensor_id) == press.sensor_id:
            presses.append(press)
    # frames of one press share its touch error: with more than one it would be treated as independent
    presses = [frames[-1] for frames in presses_of(presses)]
    if not presses:
        raise BadInput(f"{log}: no row has a normal force (fz_n); calibration needs a force sensor's readings")
    return Readings(
        log, np.array([p.row for p in presses]), np.array([p.sample_id for p in presses]),
        np.array([p.indenter for p in presses]), np.array([path_of(p) for p in presses]),
        np.array([p.force for p in presses]), np.array([gels.get(p.sensor_id, USUAL_GEL) for p in presses]),
        np.array([p.mounting for p in presses]), 1e3 * np.array([(p.mx_nm, p.my_nm) for p in presses], dtype=float),
        np.array([p.row in stated for p in presses]),
    )  # fmt: skip


def path_of(press: LoggedPress) -> list[float]:
    """Pose, path and tilt of a press, by POSE and TILT; sideways travel within the error of the axes (NEAR_MM) is 0."""
    sideways = np.hypot(press.dx_mm, press.dy_mm) > NEAR_MM
    path = [float(getattr(press, column)) if sideways or column not in ("dx_mm", "dy_mm") else 0.0 for column in POSE]
    return [*path, *press.tilt]


def check_readings(readings: Readings) -> None:
    """Refuse readings that a force sensor and a press cannot have produced; raise BadInput.

    Detected: no depth, duplicated rows, a constant sensor, the wrong sign convention.
    """
    source, depth, fz = readings.source, readings.depth, readings.force[:, 2]
    up = np.flatnonzero(depth <= 0)
    if len(up):
        raise BadInput(
            f"{source}: {readings.name(up)}: dz_mm is not negative, so there is no depth and no contact, yet a force "
            "is logged; dz is the travel into the gel and must be negative"
        )
    content = np.column_stack([readings.pose, readings.force])
    _, first, inverse = np.unique(
        np.column_stack([np.unique(readings.indenters, return_inverse=True)[1], np.nan_to_num(content, nan=1e300)]),
        axis=0, return_index=True, return_inverse=True,
    )  # fmt: skip
    twice = np.flatnonzero(first[inverse.ravel()] != np.arange(len(readings)))
    if len(twice):
        raise BadInput(
            f"{source}: {readings.name(twice)}: pose and force repeat an earlier row to the last digit; a copied row "
            "counts one measurement twice and narrows the posterior falsely: remove the copies"
        )
    if len(readings) > 2 and np.ptp(fz) <= 1e-9 * np.abs(fz).max():
        raise BadInput(
            f"{source}: fz_n is {fz[0]:g} N in all {len(readings)} rows though the presses differ; the force sensor "
            "was not connected, or the column holds a constant"
        )
    check_sign(readings)


def check_sign(readings: Readings) -> None:
    """Refuse readings whose normal forces pull: forces act on the gel, so a press is negative."""
    fz = readings.force[:, 2]
    large = np.abs(fz) > 0.1 * np.abs(fz).max()
    pulling = np.flatnonzero(large & (fz > 0))
    if len(pulling) > 0.5 * large.sum():
        # a constant force keeps the order: deeper presses still log less pull
        if (readings.depth - readings.depth.mean()) @ fz < 0.0:
            raise BadInput(
                f"{readings.source}: fz_n is positive in {len(pulling)} of the {large.sum()} large readings, but falls with depth, for"
                f" example {readings.name(pulling[:1])} with {fz[pulling[0]]:g} N; the force sensor reads a constant force along z"
                " without contact: tare it and log again, or subtract that force from the force columns"
            )
        raise BadInput(
            f"{readings.source}: fz_n is positive in {len(pulling)} of the {large.sum()} large readings, for example "
            f"{readings.name(pulling[:1])} with {fz[pulling[0]]:g} N; a press pushes the gel along -z, so fz_n "
            "must be negative: the log uses the opposite sign convention, multiply its force columns by -1"
        )


def check_enough(count: int) -> None:
    """Raise BadInput for fewer than two readings."""
    if count < 2:
        raise BadInput(
            "one force reading is not enough: predictions are checked on readings that are left out; log two presses or more"
        )


def slides(readings: Readings) -> np.ndarray:
    """Whether a press moves so far that its whole contact slides, (n,) bool; the ratio of its forces is then mu."""
    return readings.travel > SLIDES * readings.depth


def choose_presses(
    readings: Readings, most: int, law: str, bodies: Mapping[str, Indenter] = MappingProxyType({})
) -> np.ndarray:
    """Indices of at most `most` presses, spread over indenters and, within each, over depth.

    bodies: the indenters by name, of which those that feel tilt are flat. Of several mountings each gives at most
    `most`. Round robin over the indenters with most presses, at most half as many as `most`, because an indenter pressed to only one depth adds
    little. Each gives its presses in bisection order of depth, so that any number of them spans the range. Under
    Coulomb's law at least a quarter are presses that slide, as far as there are any, because only those determine
    friction. Without slip these are left out, because the law does not hold for them. FEWEST straight presses of flat
    bodies with moments are among them, as far as there are any, because only those determine the tilt.
    """
    every = [np.flatnonzero(readings.mountings == name) for name in np.unique(readings.mountings)]
    if len(every) > 1:
        return np.sort(np.concatenate([of[choose_presses(readings.take(of), most, law, bodies)] for of in every]))
    flat = [name for name in np.unique(readings.indenters).tolist() if name in bodies and feels_tilt(bodies[name])]
    sliding = slides(readings)
    firm, loose = np.flatnonzero(~sliding), np.flatnonzero(sliding)
    if law == Coulomb.name and len(loose) and len(readings) > most:
        loose = loose[spread(readings.take(loose), max(most // 4, most - len(firm)))]
        return np.sort(np.append(firm[firmly_spread(readings.take(firm), most - len(loose), flat)], loose))
    served = firm if law == NoSlip.name and len(firm) > 1 else np.arange(len(readings))
    return served[firmly_spread(readings.take(served), most, flat)]


def firmly_spread(readings: Readings, most: int, flat: Collection[str]) -> np.ndarray:
    """Indices of at most `most` presses by `spread`, with FEWEST that show the tilt if there are so many."""
    chosen = spread(readings, most)
    showing = np.flatnonzero(np.isin(readings.indenters, list(flat)) & np.isfinite(readings.centre).all(axis=1))
    if np.isin(chosen, showing).sum() >= FEWEST or not len(showing):
        return chosen
    showing = showing[spread(readings.take(showing), min(FEWEST, most))]
    others = np.setdiff1d(np.arange(len(readings)), showing)
    return np.sort(np.append(showing, others[spread(readings.take(others), most - len(showing))]))


def spread(readings: Readings, most: int) -> np.ndarray:
    """Indices of at most `most` presses by the round robin of `choose_presses`."""
    if len(readings) <= most:
        return np.arange(len(readings))
    queues = []
    names, counts = np.unique(readings.indenters, return_counts=True)
    for name in sorted(names[np.argsort(-counts, kind="stable")][: max(1, most // 2)]):
        members = np.flatnonzero(readings.indenters == name)
        members = members[np.argsort(readings.depth[members], kind="stable")]
        queues.append([int(members[k]) for k in bisection_order(len(members))])
    chosen: list[int] = []
    for turn in range(max(map(len, queues))):
        chosen.extend(queue[turn] for queue in queues if turn < len(queue))
    return np.sort(np.array(chosen[:most], int))


def bisection_order(n: int) -> list[int]:
    """0 … n-1 with the ends first, then always the middle of the widest gap."""
    order = [n - 1, 0][: max(n, 0)] if n > 1 else list(range(n))
    gaps = [(0, n - 1)] if n > 2 else []
    while gaps:
        gaps.sort(key=lambda g: g[0] - g[1])
        low, high = gaps.pop(0)
        middle = (low + high) // 2
        order.append(middle)
        gaps += [g for g in ((low, middle), (middle, high)) if g[1] - g[0] > 1]
    return order
