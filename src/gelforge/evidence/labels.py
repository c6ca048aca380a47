"""Diagnostics of force sensor, bench, gel and indenters from force readings and the labels of their presses.

Labels may be made before any calibration. So the gel's stiffness, the frame's compliance, the offset of touch and the
factors of indenters are fitted first, with priors of their usual sizes, and reported only beyond these.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.evidence.forces import (
    FEWEST,
    LEAST_N,
    LEAST_SCATTER,
    SPREAD,
    SURE,
    LogForces,
    constant,
    drift_text,
    first_said,
    fitted,
    misplaced,
    shifted,
    sideways,
    unit,
)
from gelforge.records.series import equal_largest

ENOUGH = 12  # presses that show a constant force or a drift against labels
MANY = 18  # presses from which the standard errors of a constant force are reliable
OF_ONE = 3  # least number of presses of one indenter that are compared with those of all others
OTHER_FORCE = 1.15  # least factor by which their forces then differ
OTHER_POWER = 0.05  # least change of the power of labels with which forces grow on a gel of another thickness
SURE_OF_THICKNESS = 3.7  # standard errors from which it is significant; they assume a scatter of at least 5 %
NEARLY = 1.5  # ratio of the sums of squares that two causes leave, within which both are named
STUCK = 3  # presses with the reading of the press before, whose labels differ
SPLITS = 25  # presses tried per round as the one from which the gel is another
# Sideways over normal force that a straight press does not reach; least fraction of presses that exceed it.
DRAGGED, OFTEN = 0.12, 0.5
LAGGING = 0.15  # fraction of the previous press' force that a reading may hold
# Usual sizes before a calibration: offset of touch, mm; compliance of the frame, mm/N; error of an indenter's forces,
# as a fraction.
TOUCH_MM, COMPLIANCE, OWN = 0.03, 0.01, 0.03
USUAL_POWER, WIDE = 1.6, 0.5  # power of depth with which force grows; range of ln depth from which labels show it
LEAST_LEFT = 0.05  # least fraction of a depth that remains where the frame yields
OFFSETS, STIFF_ENOUGH = (-0.6, 0.6), 0.1  # limits of the offset of touch, mm, and of the compliance, mm/N
# Standard errors at which an indenter's factor is significant; ratio of sums of squares at which another cause is not
# excluded.
SURE_OF_INDENTER, NEARER = 4.0, 1.1
MISSED_MM = 0.15  # least offset of touch that is reported: five times the usual one

Fit = Callable[[], "_Bench"]  # the bench, fitted once when a cause asks for it


def of_labels(log: LogForces, label: np.ndarray, indenters: Sequence[str], usual: float = 1.0) -> list[str]:
    """Diagnose readings against the labels of their presses: one cause, without its consequences.

    label: (m, 3) N on the gel. usual: factor that takes labels to a gel of usual stiffness. Labels may be made without a calibration:
    stiffness, compliance and depth of touch are fitted here, roughly.
    """
    read = np.isfinite(log.force[:, 2]) & np.isfinite(label).all(axis=1) & np.isfinite(log.depth)
    log = LogForces(log.path[read], log.depth[read], log.rot_deg[read], log.force[read])
    label, names = label[read], np.asarray(indenters)[read]
    felt = np.flatnonzero((-label[:, 2] > LEAST_N) & (log.depth > 0))
    if len(felt) < FEWEST:
        return []
    bench = cache(lambda: _bench(log, label, felt, names))
    causes = (
        lambda: misplaced(log.force[felt], -label[felt, 2]),
        lambda: unit(log.normal[felt], -usual * label[felt, 2]),
        lambda: _stuck(log, label),
        lambda: equal_largest(log.normal, -label[:, 2]),
        lambda: shifted(log.normal, -label[felt, 2], felt),
        lambda: _lagging(log, label, felt, bench),
        lambda: sideways(log),
        lambda: _without_path(log, label, felt, bench),
        lambda: _changed(log, label, felt, names, bench),
        lambda: _missed(log, label, felt, names, bench),
        lambda: _moved(log, label, felt, bench),
        lambda: _one_indenter(log, felt, names, bench),
        lambda: _other_thickness(log, felt, bench),
    )
    return first_said(causes)


def _stuck(log: LogForces, label: np.ndarray) -> str | None:
    """Presses of different forces with the reading of the press before: it was not renewed."""
    usual = np.maximum(2 * LEAST_N, (OTHER_FORCE - 1.0) * np.abs(label[1:, 2]))
    differs = np.abs(np.diff(label[:, 2])) > usual
    same = (np.nan_to_num(np.diff(log.force, axis=0)) == 0.0).all(axis=1) & differs
    if same.sum() >= STUCK:
        return f"{same.sum()} presses have exactly the reading of the previous press, although their labels differ: take a new reading for each press."
    return None


def _without_path(log: LogForces, label: np.ndarray, felt: np.ndarray, bench: Fit) -> str | None:
    """Sideways forces of a log whose presses never move sideways, beyond those that labels have where a body's sides slope."""
    aside = log.force[felt, :2]
    if len(felt) < FEWEST or log.path.any() or not np.isfinite(aside).all():
        return None
    on_gel = bench().terms[:, 0] / -label[felt, 2]  # reduced like the normal force where the frame yields
    beyond = aside - label[felt, :2] * on_gel[:, None]
    beyond = np.hypot(*(beyond - np.median(beyond, axis=0)).T)
    dragged = beyond > np.maximum(3 * LEAST_N, DRAGGED * log.normal[felt])
    if dragged.mean() < OFTEN:
        return None
    return (
        f"Sideways forces reach {beyond.max():.1f} N beyond their labels, while dx_mm and dy_mm are 0 in all presses: log how far the indenter moves"
        " sideways in the gel, or check whether it turns or slides in its holder."
    )


def _lagging(log: LogForces, label: np.ndarray, felt: np.ndarray, bench: Fit) -> str | None:
    """Readings that hold a part of the previous press' force, because of a filter or a sensor that creeps."""
    later = felt > 0
    before = -label[felt - 1, 2]
    felt = felt[later]
    if len(felt) < ENOUGH:
        return None
    normal = -label[felt, 2]
    found, errors, _ = bench().fit(log.normal[felt], _weight(normal), before, used=later)
    usual = float(np.median(log.normal[felt]) / np.median(normal))
    share = float(found[-1]) / usual
    if share < LAGGING or found[-1] < SURE * errors[-1]:
        return None
    return (
        f"Readings contain {100 * share:.0f} % of the previous press' force: the force sensor or its filter had not settled; wait longer at each"
        " press, or log unfiltered readings."
    )


def _changed(log: LogForces, label: np.ndarray, felt: np.ndarray, names: np.ndarray, bench: Fit) -> str | None:
    """A factor between forces and labels that changes from some press on: another gel or setting of the sensor."""
    normal, measured, names, fit = -label[felt, 2], log.normal[felt], names[felt], bench()
    weight, order = _weight(normal), np.arange(len(felt))
    low, high, tried = FEWEST, len(felt) - FEWEST, {}
    for _ in range(2):  # coarse, then fine around the best
        for at in np.unique(np.linspace(low, high, SPLITS).round().astype(int)) if low <= high else ():
            if set(names[:at]) & set(names[at:]):  # else an indenter is the likelier cause
                tried[at] = fit.fit(measured, weight, np.where(order < at, 0.0, normal))
        if not tried:
            return None
        at = min(tried, key=lambda one: tried[one][2])
        step = (high - low) // (SPLITS - 1) + 1
        low, high = max(FEWEST, at - step), min(len(felt) - FEWEST, at + step)
    found, errors, left = tried[at]
    drifting = fit.fit(measured, weight, np.ones(len(felt)), order)[2]
    if left > min(drifting, 0.5 * fit.left) or abs(found[-1]) < SURE * errors[-1]:
        return None
    ratio = 1.0 + float(np.median(found[-1] * normal[at:] / (fit.terms @ found[:-1])[at:]))
    if 1.0 / OTHER_FORCE < ratio < OTHER_FORCE:
        return None
    return (
        f"From press {felt[at] + 1} (counted among those with readings) on, the ratio of forces to labels is {ratio:.2f} times that of earlier"
        " presses: was the gel or the range of the force sensor changed? Give each gel a sensor_id and a gel_id of its own."
    )


@dataclass(frozen=True)
class _Bench:
    """Linear model of the readings of n presses: labels at commanded depth, a compliant frame and an offset of touch.

    terms: (n, k), changes of readings with stiffness (the first column: the label at the depth that the gel is really
    pressed), offset of touch, compliance, and each indenter's own factor. prior: (k - 1, k) and (k - 1,), rows and
    values of the prior of the coefficients, without stiffness. offset: mm deeper than logged. left: weighted sum of
    squares.
    """

    terms: np.ndarray
    prior: tuple[np.ndarray, np.ndarray]
    offset: float
    left: float

    def fit(self, values: np.ndarray, weight: np.ndarray, *more: np.ndarray, used=np.s_[:]):
        """Like `fitted`, of some of the presses, with further terms (n,) each, whose coefficients come last."""
        rows, known = self.prior
        terms = np.column_stack([self.terms, *more])[used]
        below = np.hstack([rows, np.zeros((len(rows), len(more)))])
        return fitted(
            np.vstack([terms * weight[:, None], below]),
            np.append(values * weight, known),
            np.ones(len(terms) + len(rows)),
        )


def _bench(log: LogForces, label: np.ndarray, felt: np.ndarray, names: np.ndarray, touch: float = TOUCH_MM) -> _Bench:
    """Fit stiffness, offset of touch, compliance and indenters' factors to readings, by Gauss-Newton.

    label: (m, 3) N of all presses, of which `felt` (n,) are used. touch: usual offset of touch, mm. Force is a power
    of depth, which is fitted to the labels of each indenter.
    """
    normal, depth, read = -label[felt, 2], log.depth[felt], log.normal[felt]
    names, power = names[felt], np.full(len(felt), USUAL_POWER)
    kinds = sorted(set(names))
    for name in kinds:
        own = names == name
        if own.sum() >= OF_ONE and np.ptp(np.log(depth[own])) > WIDE:
            power[own] = np.clip(np.polyfit(np.log(depth[own]), np.log(normal[own]), 1)[0], 1.0, 3.0)
    weight = _weight(normal)
    stiffness = float(np.median(read / normal))
    offset, compliance = 0.0, COMPLIANCE
    which = (names[:, None] == kinds).astype(float)
    for _ in range(6):
        left = np.maximum(1.0 + (offset - compliance * read) / depth, LEAST_LEFT)
        on_gel, slope = normal * left**power, power * normal * left ** (power - 1.0) / depth
        terms = np.column_stack([on_gel, slope, -slope * read, on_gel[:, None] * which])
        # prior: usual sizes of offset, compliance and factors; readings scatter by half of SPREAD
        sizes = 2.0 * stiffness * np.array([touch, COMPLIANCE, *[OWN] * len(kinds)])
        rows = np.diag(1.0 / sizes)
        known = stiffness * np.array([-offset, COMPLIANCE - compliance, *[0.0] * len(kinds)]) / sizes
        prior = np.hstack([np.zeros((len(rows), 1)), rows]), known
        found, _, squares = _Bench(terms, prior, offset, 0.0).fit(read, weight)
        stiffness = max(float(found[0]), 1e-3)
        offset = float(np.clip(offset + found[1] / stiffness, *OFFSETS))
        compliance = float(np.clip(compliance + found[2] / stiffness, 0.0, STIFF_ENOUGH))
    return _Bench(terms, prior, offset, squares)


def _weight(normal: np.ndarray) -> np.ndarray:
    """Weight of readings at labels (n,) N."""
    return 1.0 / np.hypot(SPREAD[0] * normal, SPREAD[1])


def _missed(log: LogForces, label: np.ndarray, felt: np.ndarray, names: np.ndarray, bench: Fit) -> str | None:
    """Presses deeper or less deep than logged: an offset of touch that explains more than a constant force does."""
    if len(felt) < ENOUGH:
        return None
    usual, free = bench(), _bench(log, label, felt, names, OFFSETS[1])
    by_constant = usual.fit(log.normal[felt], _weight(-label[felt, 2]), np.ones(len(felt)))[2]
    scatter = max(free.left / len(felt), LEAST_SCATTER)
    if abs(free.offset) < MISSED_MM or usual.left - free.left < SURE**2 * scatter or free.left > by_constant:
        return None
    return (
        f"Forces match presses that are {abs(free.offset):.2f} mm {'deeper' if free.offset > 0 else 'less deep'} than logged: check at which z0_mm and"
        " dz_mm the tip touched the gel, or set [poses] touch_offset_mm."
    )


def _moved(log: LogForces, label: np.ndarray, felt: np.ndarray, bench: Fit) -> str | None:
    """A drift, else a constant force, beyond what labels and a slightly tilted force sensor explain."""
    if len(felt) < ENOUGH:
        return None
    order, ones = felt - felt.mean(), np.ones(len(felt))
    drifts: dict[str, tuple[float, float]] = {}
    constants: dict[str, tuple[float, float]] = {}
    for at, axis in ((2, "z"), (0, "x"), (1, "y")):
        values, own = log.force[felt, at], label[felt, at]
        used = np.isfinite(values)
        if used.sum() < ENOUGH:
            continue
        weight = _weight(np.abs(label[felt]).max(axis=1))[used]
        if axis == "z":  # fitted as compression, along -z
            found, errors, _ = bench().fit(-values[used], weight, -ones, -order, used=used)
        else:
            on_gel = bench().terms[:, 0]  # below the label where the frame yields; sideways force falls alike
            own = own * on_gel / -label[felt, 2]
            found, errors, _ = fitted(np.column_stack([own, on_gel, ones, order])[used], values[used], weight)
        constants[axis], drifts[axis] = zip(found[-2:].tolist(), errors[-2:].tolist(), strict=True)
    for axis, (per_press, error) in drifts.items():
        if abs(per_press) > SURE * error and abs(per_press) * np.ptp(felt) > 2 * LEAST_N:
            return drift_text(axis, per_press, np.ptp(felt))
    return constant(dict(sorted(constants.items())), SURE * max(1.0, MANY / len(felt)))


def _one_indenter(log: LogForces, felt: np.ndarray, names: np.ndarray, bench: Fit) -> str | None:
    """An indenter whose forces differ from its labels by another factor than those of all others."""
    fit, measured, names = bench(), log.normal[felt], names[felt]
    on_gel = fit.terms[:, 0]
    weight, left, sure = _weight(on_gel), {}, {}
    for name in sorted(set(names)):
        own = names == name
        if own.sum() < OF_ONE or len(set(names[~own])) < 2 or (~own).sum() < FEWEST:
            continue
        found, errors, left[name] = fit.fit(measured, weight, np.where(own, on_gel, 0.0))
        sure[name] = 1.0 + float(found[-1] / found[0]), abs(found[-1]) > SURE_OF_INDENTER * errors[-1]
    worst = min(left, key=lambda name: left[name], default="")
    # another thickness of the gel or a constant force may be the likelier cause
    for rather in (on_gel * np.log(on_gel), np.ones(len(felt))):
        if not worst or NEARER * fit.fit(measured, weight, rather)[2] < left[worst]:
            return None
    ratio, certain = sure[worst]
    if 1.0 / OTHER_FORCE < ratio < OTHER_FORCE or not certain:
        return None
    return (
        f"For {worst}, the ratio of forces to labels is {ratio:.2f} times that of the other indenters: check its shape, size and"
        " unit in the catalogue, and the column `indenter`."
    )


def _other_thickness(log: LogForces, felt: np.ndarray, bench: Fit) -> str | None:
    """Forces whose growth with the size of a contact is not explained by stiffness, touch, compliance and indenters.

    A layer is stiffer for contacts that are wide relative to its thickness: on a gel a fifth thinner than its labels
    assume, forces grow with 1.1 times the power, on one a third thicker with 0.9 times.
    """
    if len(felt) < ENOUGH:
        return None
    fit, measured = bench(), log.normal[felt]
    normal = fit.terms[:, 0]
    weight = _weight(normal)
    found, errors, left = fit.fit(measured, weight, normal * np.log(normal))
    offset, error, by_offset = fit.fit(measured, weight, np.ones(len(felt)))
    # a constant force that is not significant beside touch and compliance, but likelier than another thickness
    if NEARLY * by_offset < left:
        return constant({"z": (-float(offset[-1]), float(error[-1]))}, SURE_OF_THICKNESS)
    power = float(found[-1] / found[0])
    if abs(power) < OTHER_POWER or abs(found[-1]) < SURE_OF_THICKNESS * errors[-1]:
        return None
    other = ""
    if by_offset < NEARLY * left:
        other = f" A constant force of {-offset[-1]:+.2f} N along z would explain them about as well: tare the force sensor, too."
    ratio = np.quantile(normal, [0.9, 0.1])
    by = float(np.exp(power * np.log(ratio[0] / ratio[1])))
    return (
        f"From small to large presses, forces grow {by:.2f} times as much as labels do, which stiffness, touch, a compliant frame and"
        f" indenters do not explain: most likely the gel is {'thinner' if power > 0 else 'thicker'} than its table says;"
        f" check its thickness, and the column `gel_id`.{other}"
    )


UNSEEN = 0.5  # an image does not show a press if more than this fraction of its normal force lies outside
LEAST_PRESSES = 10  # of a sensor before the projection is judged


def refuse_unseen(sensors: Sequence[str], inside: np.ndarray, outside: np.ndarray, where: Path) -> None:
    """Raise BadInput if most presses of a sensor lie mostly outside its images: its projection or the log is wrong.

    sensors: of n presses. inside, outside: (n,) N, normal force within the image and beyond it. where: file of sensors.
    """
    bears = (inside + outside) != 0.0
    beyond = np.abs(outside) > UNSEEN * np.abs(inside + outside)
    for name in sorted(set(sensors)):
        own = bears & (np.array(sensors) == name)
        count, lost = int(own.sum()), int((own & beyond).sum())
        if count >= LEAST_PRESSES and 2 * lost > count:
            raise BadInput(
                f"{where}: by the projection of sensor {name}, {lost} of its {count} samples have most of their normal force"
                f" outside its images: measure the projection again with make projection SENSOR={name} (workflow/README.md),"
                " or correct x0_mm and y0_mm of the log"
            )
