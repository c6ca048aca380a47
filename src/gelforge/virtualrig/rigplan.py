"""Plans of the virtual rig: what is pressed where, how often, and the true parameters that its log does not show."""

import fnmatch
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime, timedelta
from functools import cached_property
from itertools import cycle
from pathlib import Path
from typing import Annotated

import numpy as np

from gelforge.errors import BadInput, nearest
from gelforge.flow.files import read_toml
from gelforge.flow.schema import SOME, Number, ParameterTable, Place, Span, Within, parse
from gelforge.flow.tables import Finite, FromNone, Name, Stiffness
from gelforge.geometry.gel import USUAL_GEL, Gel, load_gel
from gelforge.records.press import LARGEST
from gelforge.virtualrig.streams import MOST_FRAMES, MOUNTING, ORDER, WHO_SEES

EDGE = 2.0  # mm; least distance of the tip from the gel's outline
TINY = 1e-9
DEEPEST = 0.7  # largest depth of a press, as a fraction of the gel's height

Millimetres = Annotated[Number, Within(-1e3, 1e3, "mm")]


class RigTable(ParameterTable):
    """A table of a plan."""

    example = "workflow/rig/train.toml"


Tilt = Annotated[Number, Within(-LARGEST["tilt_x_deg"], LARGEST["tilt_x_deg"], "degrees")]


class Truth(RigTable):
    """True material and errors of the bench, which the log does not show; MPa, mm, N, N m, micrometres.

    touch_offset_mm: true height of the tip over the logged one when the log says "touch" (negative: deeper).
    compliance_mm_per_n: deflection of frame and gantry per newton of normal force, shear_compliance_mm_per_n:
    sideways. force_bias_n, drift_n: constant error of the load cell, and scale of its drift over the presses.
    tilt_deg: tilt of every indenter about gel x and then gel y, as of a bench whose axis is not square to the gel.
    """

    c10_mpa: Stiffness
    nu: Annotated[Number, Within(TINY, 0.4999)]
    friction: FromNone
    compliance_mm_per_n: FromNone
    shear_compliance_mm_per_n: FromNone
    touch_offset_mm: Millimetres
    touch_scatter_mm: FromNone
    force_noise_n: FromNone
    force_bias_n: tuple[Finite, Finite, Finite]
    drift_n: FromNone
    moment_noise_nm: FromNone
    cnc_um: FromNone
    tilt_deg: tuple[Tilt, Tilt] = (0.0, 0.0)


class Mountings(RigTable):
    """Mountings of the gel, each with its own values.

    Either every `presses` presses begin a new one, or each of `sensors` is one, which bears its name; the other sensors
    then share the bench's values. tilt_deg: size of its tilt, whose direction is any. touch_offset_mm: what is added to
    that of the bench. Both are uniform in these ranges. seating: standard deviation of the logarithm of a factor on the
    gel's stiffness.
    """

    tilt_deg: Span[Annotated[Number, Within(0.0, LARGEST["tilt_x_deg"], "degrees")]]
    touch_offset_mm: Span[Millimetres]
    presses: Annotated[int, Within(1, 1e7)] | None = None
    sensors: tuple[str, ...] = ()
    seating: Annotated[Number, Within(0.0, 1.0)] = 0.0

    def fault(self) -> str | None:
        """Not one of the two ways to divide presses into mountings."""
        if (self.presses is None) == (not self.sensors):
            return "give either presses, after how many the gel is re-seated, or sensors, each of which is a mounting"
        return None

    def number(self, index: int, sensor: str) -> int | None:
        """Number of the mounting of a press by a sensor, from 0; None if it has none of its own."""
        if self.presses is not None:
            return index // self.presses
        return self.sensors.index(sensor) if sensor in self.sensors else None

    def name(self, number: int) -> str:
        return f"mounting_{number + 1:02d}" if self.presses is not None else self.sensors[number]

    def names(self, presses: int) -> dict[str, int]:
        """Number of each mounting of so many presses, by its name."""
        count = len(self.sensors) if self.presses is None else -(-presses // self.presses)
        return {self.name(number): number for number in range(count)}


class Kind(RigTable):
    """One kind of press, with `weight` relative to the other kinds; values are uniform in these ranges.

    indenters: names of the plan's catalogue, or patterns: "*" is all of it. seen_by: number of `sensors` that see a
    press, each with a row in the log; which ones is drawn for every press. Computing a press takes a second, a
    further image of it a hundredth. shear: range of the sideways path as a fraction of the depth. max_force_n: the
    depth is limited so that the estimated normal force stays below it, as on a bench with a load limit.
    """

    weight: Annotated[Number, Within(TINY, 1e9)]
    indenters: Annotated[tuple[str, ...], SOME]
    sensors: Annotated[tuple[str, ...], SOME]
    x_mm: Span[Millimetres]
    y_mm: Span[Millimetres]
    depth_mm: Span[Annotated[Number, Within(TINY, 1e3, "mm")]]
    shear: Span[Annotated[Number, Within(0.0, 1e3)]]
    rot_deg: Span[Annotated[Number, Within(-LARGEST["rot_deg"], LARGEST["rot_deg"], "degrees")]]
    max_force_n: Annotated[Number, Within(TINY, 1e9, "N")]
    seen_by: Annotated[int, Within(1, 1e6)] = 1


class DrawnUnits(RigTable):
    """Virtual sensors drawn from ranges: `known` ones, known_01 and on, and as many `unseen` ones, unseen_01 and on.

    ranges: file in workflow/rig. `sensors` of a kind may name them by a pattern: "known_*" is all known ones.
    known_gels, unseen_gels: names of gels, such as gelsight_mini-3.6mm, assigned to them in turn; none: the plan's
    gel. Sensors that see one press have the same gel.
    """

    ranges: str
    known: Annotated[int, Within(0, 999)]
    unseen: Annotated[int, Within(0, 999)]
    known_gels: tuple[str, ...] = ()
    unseen_gels: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return (*self._group("known"), *self._group("unseen"))

    def _group(self, name: str) -> list[str]:
        return [f"{name}_{k + 1:02d}" for k in range(getattr(self, name))]

    def gel_of(self, name: str) -> str | None:
        """Name of a drawn unit's gel; None if it has the plan's, or is no drawn unit."""
        return self._gel_of_name.get(name)

    @cached_property
    def _gel_of_name(self) -> dict[str, str]:
        in_turn = (("known", self.known_gels), ("unseen", self.unseen_gels))
        return {
            name: gel for group, gels in in_turn for name, gel in zip(self._group(group), cycle(gels), strict=False)
        }

    @property
    def gels(self) -> tuple[str, ...]:
        return self.known_gels + self.unseen_gels


class FilmTable(RigTable):
    """A film of some presses by one sensor: film.avi, which begins with a second without contact.

    presses: their numbers in the plan. frames: number for each way down; the way up shows them in reverse.
    """

    sensor: str
    presses: Annotated[tuple[Annotated[int, Within(0, 1e7)], ...], SOME]
    frames: Annotated[int, Within(1, MOST_FRAMES)]


class Plan(RigTable):
    """A whole plan. `presses` may grow; a change of anything else but `params` and `film` makes it another plan.

    frames: recorded states of each press, evenly spaced along its way down and then sideways, the last at its end.
    """

    dataset: Name
    seed: Annotated[int, Within(0, 2**63)]
    presses: Annotated[int, Within(1, 1e7)]
    gel: str
    catalogue: str
    start_utc: str
    seconds_per_press: FromNone
    held_out_sensors: tuple[str, ...]  # written to dataset.toml as those that training must not see
    truth: Truth
    kinds: tuple[Kind, ...]
    # [params.TABLE] of the plan: parameters of the stages, written to dataset.toml. A dictionary has no hash.
    params: dict = field(hash=False)
    frames: Annotated[int, Within(1, MOST_FRAMES)] = 1
    film: FilmTable | None = None
    units: DrawnUnits | None = None
    mountings: Mountings | None = None

    def identity(self) -> str:
        """Canonical text of everything that a press depends on; the number of presses is left out."""
        content = {key: value for key, value in asdict(self).items() if key not in ("params", "presses", "film")}
        if self.mountings is None:
            del content["mountings"]
        return json.dumps(content, sort_keys=True)

    def mounting(self, index: int, sensor: str) -> str:
        """Name of the mounting of a press by a sensor; empty if the plan gives it none."""
        number = None if self.mountings is None else self.mountings.number(index, sensor)
        return "" if self.mountings is None or number is None else self.mountings.name(number)

    def truth_of(self, mounting: str) -> Truth:
        """The truth of a mounting: the plan's, with its own tilt, height of touch and stiffness."""
        of, truth = self.mountings, self.truth
        if of is None or not mounting:
            return truth
        rng = generator(self, of.names(self.presses)[mounting], MOUNTING)
        size, heading = rng.uniform(*of.tilt_deg), rng.uniform(0.0, 2 * np.pi)
        offset, stiffer = rng.uniform(*of.touch_offset_mm), of.seating * rng.standard_normal()
        x, y = truth.tilt_deg
        return replace(
            truth,
            c10_mpa=float(truth.c10_mpa * np.exp(stiffer)),
            touch_offset_mm=truth.touch_offset_mm + offset,
            tilt_deg=(x + size * float(np.cos(heading)), y + size * float(np.sin(heading))),
        )

    def gel_of(self, sensor: str) -> str:
        """Name of a sensor's gel."""
        return (self.units and self.units.gel_of(sensor)) or self.gel

    @property
    def gels(self) -> list[Gel]:
        """Every gel that is pressed."""
        return [load_gel(name) for name in dict.fromkeys(self.gel_of(sensor) for sensor in self.sensors)]

    @property
    def indenters(self) -> list[str]:
        return list(dict.fromkeys(name for kind in self.kinds for name in kind.indenters))

    @property
    def sensors(self) -> list[str]:
        return list(dict.fromkeys(name for kind in self.kinds for name in kind.sensors))


@dataclass(frozen=True)
class Order:
    """One frame of a press seen by one sensor: what the bench is asked to do, and its place in the plan.

    index: number of the press. unit: number of the sensor among those that see it. gel: name of the gel. press_id:
    shared by all orders of a press. frame: number of the frame from 0. film_id: shared by the frames of a press by
    one sensor; empty for a single frame. mounting: name of the mounting; empty in a plan without mountings.
    """

    index: int
    sample_id: str
    time_utc: str
    sensor: str
    indenter: str
    x: float
    y: float
    depth: float
    shear: tuple[float, float]  # mm along x and y at full depth
    rot_deg: float
    max_force_n: float
    unit: int = 0
    press_id: str = ""
    frame: int = 0
    film_id: str = ""
    gel: str = USUAL_GEL
    mounting: str = ""


def read_plan(path) -> Plan:
    """Read a plan and check its values; `check_names` checks the names, after `with_indenters`."""
    path = Path(path)
    raw, whole = read_toml(path), Place(str(path))
    kinds = raw.pop("kind", [])
    if not isinstance(kinds, list) or not kinds:
        raise BadInput(f"{path}: no [[kind]] table; write at least one with indenters, sensors and ranges")
    plan = parse(Plan, {"params": {}, **raw, "kinds": kinds}, whole)
    drawn = plan.units.names if plan.units else ()
    plan = replace(
        plan,
        kinds=tuple(replace(kind, sensors=_matching(kind.sensors, drawn)) for kind in plan.kinds),
        held_out_sensors=_matching(plan.held_out_sensors, drawn),
    )
    _check_values(plan, path)
    return plan


def with_indenters(plan: Plan, catalogue: Iterable[str]) -> Plan:
    """The plan with patterns among its indenters replaced by matching names of its catalogue."""
    return replace(
        plan, kinds=tuple(replace(kind, indenters=_matching(kind.indenters, catalogue)) for kind in plan.kinds)
    )


def _matching(asked: tuple[str, ...], known: Iterable[str]) -> tuple[str, ...]:
    """Names with a pattern such as "known_*" replaced by the known names that it matches, in their order."""
    found = [fnmatch.filter(known, name) or [name] for name in asked]
    return tuple(dict.fromkeys(name for names in found for name in names))


def _check_values(plan: Plan, path) -> None:
    for name in (plan.gel, *(plan.units.gels if plan.units else ())):
        try:
            load_gel(name)
        except BadInput as error:
            raise BadInput(f"{path}: {error}") from error
    try:
        start_time(plan)
        time_of(plan, plan.presses)
    except ValueError as error:
        raise BadInput(f"{path}: start_utc = {plan.start_utc!r} is not a time; write 2026-01-12T09:00:00Z") from error
    except OverflowError as error:
        raise BadInput(
            f"{path}: {plan.presses} presses of {plan.seconds_per_press:g} s from {plan.start_utc} on end after the year "
            "9999; check seconds_per_press and start_utc"
        ) from error
    if plan.film and max(plan.film.presses) >= plan.presses:
        raise BadInput(
            f"{path}: [film] presses = {list(plan.film.presses)}: the plan has presses 0 to {plan.presses - 1}"
        )
    for k, kind in enumerate(plan.kinds, 1):
        if kind.seen_by > 1 and plan.mountings and plan.mountings.sensors:
            raise BadInput(
                f"{path}: [[kind]] {k}: seen_by = {kind.seen_by}: a press is of one mounting, and [mountings] sensors makes each"
                " sensor one; leave out one of the two"
            )
        thinnest = min((load_gel(plan.gel_of(name)) for name in kind.sensors), key=lambda gel: gel.height)
        _check_kind(kind, thinnest, min(map(len, by_gel(plan, kind.sensors).values())), f"{path}: [[kind]] {k}")


def by_gel(plan: Plan, sensors: Sequence[str]) -> dict[str, list[str]]:
    """Sensors by their gel."""
    found: dict[str, list[str]] = {}
    for name in sensors:
        found.setdefault(plan.gel_of(name), []).append(name)
    return found


def _check_kind(kind: Kind, gel: Gel, fewest: int, where: str) -> None:
    """gel: the thinnest that is pressed. fewest: least number of the kind's sensors on one gel."""
    if not 1 <= kind.seen_by <= fewest:
        raise BadInput(
            f"{where}: seen_by = {kind.seen_by}: give 1 to {fewest}, as many sensors as it names on one gel"
        )
    deepest = DEEPEST * gel.height
    if kind.depth_mm[1] > deepest:
        raise BadInput(
            f"{where}: depth_mm reaches {kind.depth_mm[1]} mm; the gel is {gel.height} mm thick and a press may take "
            f"{deepest:.2f} mm of it, so lower the range"
        )
    slide = kind.shear[1] * kind.depth_mm[1]
    for name, half in (("x_mm", gel.width / 2), ("y_mm", gel.length / 2)):
        reach = max(abs(kind.__dict__[name][0]), abs(kind.__dict__[name][1])) + slide
        if reach > half - EDGE:
            raise BadInput(
                f"{where}: {name} = {list(getattr(kind, name))} with {slide:.2f} mm of shear reaches {reach:.2f} mm, "
                f"but the tip must stay within {half - EDGE:.2f} mm of the gel's centre; narrow the range"
            )


def check_names(plan: Plan, indenters, sensors, appearances, path) -> None:
    """Raise BadInput for a plan that names undefined indenters, sensors or appearances."""
    units = [*plan.sensors, *plan.held_out_sensors, *([plan.film.sensor] if plan.film else [])]
    units += plan.mountings.sensors if plan.mountings else ()
    for what, asked, known, where in (
        ("indenter", plan.indenters, indenters, plan.catalogue),
        ("sensor", units, sensors, "workflow/sensors.toml"),
        ("sensor's appearance", units, appearances, "workflow/rig/sensors.toml"),
    ):
        unknown = [name for name in dict.fromkeys(asked) if name not in known]
        if unknown:
            raise BadInput(f"{path}: unknown {what} {', '.join(unknown)} in {where}{nearest(unknown[0], known)}")


def start_time(plan: Plan) -> datetime:
    """Time of the first press."""
    return datetime.strptime(plan.start_utc, "%Y-%m-%dT%H:%M:%SZ")


def time_of(plan: Plan, index: int) -> datetime:
    """Time of a press; OverflowError if it is after the year 9999."""
    return start_time(plan) + timedelta(seconds=round(index * plan.seconds_per_press, 3))


def kind_of(plan: Plan, presses: int) -> tuple[np.ndarray, np.ndarray]:
    """Kind of each press and its number within that kind, two arrays (presses,).

    Each press gets the kind that is furthest behind its fraction, so the result does not depend on how many follow.
    """
    weight = np.array([kind.weight for kind in plan.kinds])
    fraction = weight / weight.sum()
    count = np.zeros(len(fraction), int)
    kinds, numbers = np.empty(presses, int), np.empty(presses, int)
    for i in range(presses):
        k = int(np.argmax(np.round(fraction * (i + 1) - count, 9)))
        kinds[i], numbers[i] = k, count[k]
        count[k] += 1
    return kinds, numbers


def generator(plan: Plan, index: int, purpose: int) -> np.random.Generator:
    """Random generator of one press and a purpose (a number of `streams`), independent of all others."""
    return np.random.default_rng([plan.seed, index, purpose])


def orders(plan: Plan) -> list[Order]:
    """All orders of the plan in the sequence of the log; those of one press are consecutive."""
    kinds, numbers = kind_of(plan, plan.presses)
    return [
        order
        for i, (k, n) in enumerate(zip(kinds, numbers, strict=True))
        for order in _orders_of_press(plan, i, plan.kinds[k], int(n))
    ]


def _orders_of_press(plan: Plan, index: int, kind: Kind, number: int) -> list[Order]:
    order = _order(plan, index, kind, number)
    seen = [order]
    if kind.seen_by > 1:
        seen = [
            replace(
                order, sample_id=f"{order.press_id}-{unit + 1}", sensor=sensor, gel=plan.gel_of(sensor), unit=unit
            )
            for unit, sensor in enumerate(_sensors_of_press(plan, index, kind))
        ]
    if plan.frames == 1:
        return seen
    return [
        replace(one, sample_id=f"{one.sample_id}-f{k + 1:02d}", film_id=one.sample_id, frame=k)
        for one in seen
        for k in range(plan.frames)
    ]


def _sensors_of_press(plan: Plan, index: int, kind: Kind) -> tuple[str, ...]:
    """The sensors that see a press, in the plan's order; all have the same gel."""
    rng, gels = generator(plan, index, WHO_SEES), by_gel(plan, kind.sensors)
    names = list(gels.values())
    # a gel is pressed in proportion to the number of its sensors; with a single gel nothing is drawn
    fractions = [len(group) / len(kind.sensors) for group in names]
    chosen = names[0] if len(names) == 1 else names[int(rng.choice(len(names), p=fractions))]
    drawn = rng.choice(len(chosen), kind.seen_by, replace=False)
    return tuple(chosen[k] for k in sorted(drawn))


def _order(plan: Plan, index: int, kind: Kind, number: int) -> Order:
    rng = generator(plan, index, ORDER)
    depth, fraction, heading = rng.uniform(*kind.depth_mm), rng.uniform(*kind.shear), rng.uniform(0.0, 2 * np.pi)
    sensor = kind.sensors[int(rng.integers(len(kind.sensors)))]
    return Order(
        index=index,
        sample_id=f"{plan.dataset}-{index:06d}",
        time_utc=time_of(plan, index).strftime("%Y-%m-%dT%H:%M:%SZ"),
        sensor=sensor,
        gel=plan.gel_of(sensor),
        indenter=kind.indenters[number % len(kind.indenters)],
        x=rng.uniform(*kind.x_mm),
        y=rng.uniform(*kind.y_mm),
        depth=depth,
        shear=(fraction * depth * np.cos(heading), fraction * depth * np.sin(heading)),
        rot_deg=rng.uniform(*kind.rot_deg),
        max_force_n=kind.max_force_n,
        press_id=f"{plan.dataset}-{index:06d}",
        mounting=plan.mounting(index, sensor),
    )
