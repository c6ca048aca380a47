"""What force readings say about the force sensor and the log, beside what they were logged for.

Each function returns one sentence with its number, or None where there is nothing to say. Only numpy, because `gelforge
sensor` uses them, too. Normal forces are compression here, in N and positive, in the order of the log.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

# Newtons in other units that sensors and scales show.
UNITS = {
    "kilograms-force": 9.80665,
    "pounds-force": 4.44822,
    "ounces-force": 0.278014,
    "grams-force": 9.80665e-3,
    "millinewtons": 1e-3,
    "kilonewtons": 1e3,
}
SEVERAL = 3.0  # times what is usual: no gel of the kind is so soft or so hard
ALIKE = 1.5  # the factor within which a unit explains forces
FEWEST = 6  # presses that a statement about their order or directions needs
ENOUGH = 12  # presses that a constant force or a drift beside labels needs
OF_ONE = 3  # presses of one indenter that are compared with those of all others
OTHER_FORCE = 1.15  # the factor by which their forces then differ at least
OTHER_POWER = 0.05  # by which forces grow with another power of labels where the gel has another thickness
SURE_OF_THICKNESS = 3.5  # standard errors of it, which are never taken to be smaller than those of a scatter of 5 %
NEARLY = 1.5  # ratio of the sums of squares that two causes leave, within which both are named
STUCK, DIFFERS = 3, 0.3  # presses that read the same, and the fraction by which their labels differ
LEAST_N = 0.15  # of a constant force or a drift: smaller ones are usual, and change hardly anything
SURE = 4.0  # standard errors from which on something is no chance
SURE_OF_FEW = 3.5  # the same for a dozen readings of a scale
SPREAD = 0.1, 0.2  # of a predicted force: as a fraction, and in N
NOT_FOLLOWED, FOLLOWED = (
    0.5,
    0.9,
)  # correlations of normal force with the column that should hold it, and with the one that does
SPLITS = 25  # places of a log at which its gel may have been changed, tried at a time
LAGGING = 0.15  # of the force of the press before, that a reading may hold
ALONE = 1e-9  # of a term of a fit that the others must leave, or it cannot be told apart from them
TAKEN_OVER = 0.6  # sideways over normal force where most contacts slip
TURNED_DEG = 20.0  # by which sideways forces may be turned against the path, by curved gels and slopes of bodies
FOLLOWS = 0.6  # fraction of the variance of sideways forces that a cause must explain to be named
TOUCH_MM, COMPLIANCE, OWN = (
    0.03,
    0.01,
    0.03,
)  # mm, mm/N, fraction: of touch, a frame and an indenter's forces, before a calibration
USUAL_POWER, WIDE = 1.6, 0.5  # of depth, by which force grows; range of ln depth from which on labels show it
LEAST_LEFT = 0.05  # of a depth, where the frame yields
OFFSETS, STIFF_ENOUGH = (-0.6, 0.6), 0.1  # mm that touch may be missed by, mm/N that a frame yields at most
SURE_OF_INDENTER, NEARER = (
    4.0,
    1.1,
)  # standard errors of its factor; of two causes, by how much one must leave less to be the likelier
LEAST_SCATTER = 0.25  # of a weighted reading, squared
MISSED_MM = 0.15  # of touch: five times what is usual
HINT = "tare the sensor without contact and log again, or subtract it from the force columns"


@dataclass(frozen=True)
class LogForces:
    """All m force readings of a log, in its order.

    path: (m, 2) mm sideways. depth: (m,) mm. rot_deg: (m,) turn of the indenter. force: (m, 3) N on the gel, nan where not logged.
    """

    path: np.ndarray
    depth: np.ndarray
    rot_deg: np.ndarray
    force: np.ndarray

    @property
    def normal(self) -> np.ndarray:
        """Compression, (m,) N."""
        return -self.force[:, 2]


@dataclass(frozen=True)
class Fitted:
    """What a model says of n readings of a log.

    rows: (n,) their positions in the log. usual: (n,) N, compression on a usual gel before anything is fitted. residual: (n, 3) N,
    measured less predicted, nan where a component does not serve. constant: constant forces in N with their standard
    errors, by axis. noise, largest_noise: N, fitted and the largest that its prior expects.
    """

    rows: np.ndarray
    usual: np.ndarray
    residual: np.ndarray
    constant: dict[str, tuple[float, float]]
    noise: float
    largest_noise: float


def _first_said(causes: Iterable[Callable[[], str | None]]) -> list[str]:
    """The sentence of the first cause that has one, alone; those after it are not looked at."""
    for cause in causes:
        if said := cause():
            return [said]
    return []


def of_log(log: LogForces, fitted: Fitted) -> list[str]:
    """What the readings say of force sensor and log: a cause, without what follows from it."""
    felt = fitted.usual > LEAST_N
    rows, usual = fitted.rows[felt], fitted.usual[felt]
    causes = (
        lambda: misplaced(log.force[rows], usual),
        lambda: unit(log.normal[rows], usual),
        lambda: shifted(log.normal, usual, rows),
        lambda: sideways(log),
        lambda: drift(fitted.residual, fitted.rows),
        lambda: constant(fitted.constant),
        lambda: noise(fitted.noise, fitted.largest_noise),
    )
    return _first_said(causes)


def misplaced(force: np.ndarray, predicted: np.ndarray) -> str | None:
    """Normal forces that stand in a column of sideways forces: axes of the sensor, or of the world, in place of the gel's.

    force: (n, 3) N. predicted: (n,) N, compression.
    """
    if len(force) < FEWEST or not np.isfinite(force).all():
        return None
    if np.ptp(predicted) == 0.0 or (np.ptp(force, axis=0) == 0.0).any():
        return None
    follows = np.abs(np.corrcoef(force.T, predicted)[-1, :3])
    best = int(follows[:2].argmax())
    if follows[2] > NOT_FOLLOWED or follows[best] < FOLLOWED:
        return None
    return (
        f"{('fx_n', 'fy_n')[best]} follows the normal force of the presses (correlation {follows[best]:.2f}), fz_n does not"
        f" ({follows[2]:.2f}): the axes of the force sensor are not those of the gel; turn the forces into the gel's frame."
    )


def unit(measured: np.ndarray, predicted: np.ndarray, where: str = "fz_n and dz_mm in the log") -> str | None:
    """Forces (n,) several times as large or as small as predicted ones; the unit that would explain it is named."""
    if not len(measured):
        return None
    ratio = float(np.median(np.abs(measured) / predicted))
    if 1.0 / SEVERAL < ratio < SEVERAL or not ratio:
        return None
    name, of = min(UNITS.items(), key=lambda pair: abs(np.log(ratio * pair[1])))
    said = f"{ratio:.3g} times" if ratio > 1.0 else f"1/{1.0 / ratio:.3g} of"
    like = f", as where they are in {name} (1 is {of:g} N)" if abs(np.log(ratio * of)) < np.log(ALIKE) else ""
    return (
        f"Forces are {said} what is usual at these presses: most likely they are not in newtons{like}, or lengths are not in mm;"
        f" check the units of {where}."
    )


def shifted(measured: np.ndarray, predicted: np.ndarray, rows: np.ndarray) -> str | None:
    """Forces that fit the press of a neighbouring row.

    measured: (m,) of all rows. predicted: (n,) of the presses in `rows`, (n,) positions in measured.
    """
    inner = (rows > 0) & (rows < len(measured) - 1)
    rows, predicted = rows[inner], predicted[inner]
    if len(rows) < FEWEST:
        return None
    own, after, before = (_scatter(measured[rows + step], predicted) for step in (0, 1, -1))
    if min(before, after) > 0.5 * own or own < 0.25:
        return None
    which = "following" if after < before else "preceding"
    return (
        f"Forces fit the {which} row: they scatter by {100 * own:.0f} % about what their own press predicts, by"
        f" {100 * min(before, after):.0f} % with those of the {which} row; check whether the force columns are shifted by one row."
    )


def _scatter(measured: np.ndarray, predicted: np.ndarray) -> float:
    """Spread of ln(measured / predicted) about its median, as a standard deviation."""
    ratio = np.log(np.maximum(measured, 0.02) / predicted)
    return float(1.4826 * np.median(np.abs(ratio - np.median(ratio))))


def sideways(log: LogForces) -> str | None:
    """Sideways forces that do not follow the sideways path, by the transformation of axes that explains them.

    A gel is dragged along: force is along the path, and about as large as normal force times travel over depth until the
    contact slips.
    """
    travel = np.hypot(*log.path.T)
    used = (travel > 0) & np.isfinite(log.force).all(axis=1)
    if used.sum() < FEWEST:
        return None
    path, force, travel = log.path[used], log.force[used], travel[used]
    size = np.abs(force[:, 2]) * np.minimum(travel / log.depth[used], TAKEN_OVER) / travel
    along, seen = size * (path[:, 0] + 1j * path[:, 1]), force[:, 0] + 1j * force[:, 1]
    parts = (("fx_n", along.real, seen.real), ("fy_n", along.imag, seen.imag))
    still = [name for name, moved, of in parts if np.ptp(of) == 0.0 and np.ptp(moved) > 2 * LEAST_N]
    if still:
        return (
            f"{' and '.join(still)} never change{'s' * (len(still) == 1)} in {used.sum()} presses that move sideways: where the force sensor"
            " has no such axis, leave the cells empty, because 0 would be taken for a reading."
        )
    if np.sqrt(np.mean(np.abs(_level(seen)) ** 2)) < LEAST_N:
        return None
    turn = np.exp(1j * np.deg2rad(log.rot_deg[used]))
    straight, angle = _explained(along, seen)
    if straight > FOLLOWS:
        if abs(angle) <= TURNED_DEG:
            return None
        if abs(angle) > 180.0 - TURNED_DEG:
            return _turned("both have the opposite sign", straight, "multiply fx_n and fy_n by -1")
        return _turned(
            f"they are turned by {angle:+.0f} degrees", straight, "turn them back, or set the sensor's axes right"
        )
    mirrored, axis = _explained(along.conj(), seen)
    by_turn = {sign: _explained(along * turn**sign, seen) for sign in (1, -1)}
    sign = max(by_turn, key=lambda one: by_turn[one][0])
    if by_turn[sign][0] > max(FOLLOWS, mirrored):
        sense = "against" if sign < 0 else "with"
        return _turned(
            f"they are in a frame that turns {sense} the indenter's rot_deg", by_turn[sign][0], "turn them by rot_deg"
        )
    if mirrored > FOLLOWS:
        causes = {
            0: "the sign of y is flipped", 90: "x and y are exchanged", 180: "the sign of x is flipped",
            270: "x and y are exchanged, and their signs flipped",
        }  # fmt: skip
        nearest = 90 * round((axis % 360) / 90) % 360
        return _turned(causes[nearest], mirrored, "correct the columns fx_n and fy_n")
    if straight < 0.1:
        return (
            f"Sideways forces do not follow the sideways path (it explains {100 * straight:.0f} % of them), and no exchange of axes"
            " explains them: check the columns fx_n, fy_n, dx_mm and dy_mm."
        )
    return None


def _turned(what: str, explained: float, hint: str) -> str:
    return f"Sideways forces do not follow the sideways path: {what}, which explains {100 * explained:.0f} % of them; {hint}."


def _explained(along: np.ndarray, seen: np.ndarray) -> tuple[float, float]:
    """Fraction of complex `seen`, without its trend, that a turned and scaled `along` explains; its turn, degrees."""
    along, seen = _level(along), _level(seen)
    common = np.vdot(along, seen)
    total = np.vdot(along, along).real * np.vdot(seen, seen).real
    return (float(abs(common) ** 2 / total) if total else 0.0), float(np.rad2deg(np.angle(common)))


def _level(values: np.ndarray) -> np.ndarray:
    """Values (n,) without their mean and their trend along the log, as a constant force and a drift would make them."""
    order = np.arange(len(values)) - (len(values) - 1) / 2
    values = values - values.mean()
    return values - order * (order @ values) / (order @ order)


def drift(residual: np.ndarray, rows: np.ndarray) -> str | None:
    """Residuals (n, 3) N, measured less predicted, that go with the order of the presses. rows: (n,) positions in the log."""
    for axis, of in zip("zxy", residual.T[[2, 0, 1]], strict=True):
        used = np.isfinite(of)
        if used.sum() < FEWEST:
            continue
        at, away = rows[used] - rows[used].mean(), of[used] - of[used].mean()
        per_press = float(at @ away / (at @ at))
        left = away - per_press * at
        error = float(np.sqrt(left @ left / (len(at) - 2) / (at @ at)))
        if abs(per_press) > SURE * error and abs(per_press) * np.ptp(at) > 2 * LEAST_N:
            return _drifts(axis, per_press, np.ptp(at))
    return None


def mean_forces(straight: np.ndarray) -> dict[str, tuple[float, float]]:
    """Mean sideways force beyond the prediction, with its standard error, by axis; straight: (n, 2) N of presses without shear."""
    found = {}
    for axis, of in zip("xy", straight.T, strict=True):
        of = of[np.isfinite(of)]
        if len(of) >= FEWEST:
            found[axis] = float(of.mean()), float(of.std(ddof=1) / np.sqrt(len(of)))
    return found


def constant(forces: dict[str, tuple[float, float]], errors: float = SURE) -> str | None:
    """A constant force in N by axis, with its standard error, where it is surely there: so many of them."""
    sure = {axis: value for axis, (value, error) in forces.items() if abs(value) > max(errors * error, LEAST_N)}
    if not sure:
        return None
    said = " and ".join(f"{value:+.2f} N along {axis}" for axis, value in sure.items())
    return f"The force sensor reads a constant force of {said}: {HINT}."


def noise(found: float, largest: float) -> str | None:
    """Noise, N, beyond the largest that the prior expects."""
    if found <= largest:
        return None
    return (
        f"Readings scatter by {found:.2f} N about the prediction, where the prior of the noise expects {largest:.2f} N at most: the"
        " intervals rest on readings that the model does not explain; check the log's forces, poses and indenters."
    )


Fit = Callable[[], "_Bench"]  # of the bench, made once where a cause asks for it


def of_labels(log: LogForces, label: np.ndarray, indenters: Sequence[str], usual: float = 1.0) -> list[str]:
    """What readings say beside the labels of their presses: a cause, without what follows from it.

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
        lambda: shifted(log.normal, -label[felt, 2], felt),
        lambda: _lagging(log, label, felt, bench),
        lambda: sideways(log),
        lambda: _changed(log, label, felt, names, bench),
        lambda: _missed(log, label, felt, names, bench),
        lambda: _moved(log, label, felt, bench),
        lambda: _one_indenter(log, felt, names, bench),
        lambda: _other_thickness(log, felt, bench),
    )
    return _first_said(causes)


def _stuck(log: LogForces, label: np.ndarray) -> str | None:
    """Presses of different forces that all read the same: a reading that was not renewed, or the end of the sensor's range."""
    normal = log.normal
    usual = np.maximum(2 * LEAST_N, OTHER_FORCE - 1.0) * np.abs(label[1:, 2]).clip(1.0)
    differs = np.abs(np.diff(label[:, 2])) > usual
    same = (np.nan_to_num(np.diff(log.force, axis=0)) == 0.0).all(axis=1) & differs
    if same.sum() >= STUCK:
        return f"{same.sum()} presses read exactly the force of the press before, to which their labels differ: read the force sensor anew for each."
    largest = normal == normal.max()
    if largest.sum() >= STUCK and np.ptp(label[largest, 2]) > DIFFERS * normal.max():
        return (
            f"{largest.sum()} presses read the same largest force of {normal.max():.2f} N, while their labels differ: it is the end of the"
            " sensor's range; leave their cells empty, or press less deep."
        )
    return None


def _lagging(log: LogForces, label: np.ndarray, felt: np.ndarray, bench: Fit) -> str | None:
    """Readings that hold a part of the press before, as behind a filter or of a sensor that creeps."""
    later = felt > 0
    before = -label[felt - 1, 2]
    felt = felt[later]
    if len(felt) < ENOUGH:
        return None
    normal = -label[felt, 2]
    found, errors, _ = bench().fitted(log.normal[felt], _weight(normal), before, used=later)
    usual = float(np.median(log.normal[felt]) / np.median(normal))
    share = float(found[-1]) / usual
    if share < LAGGING or found[-1] < SURE * errors[-1]:
        return None
    return (
        f"Readings hold {100 * share:.0f} % of the force of the press before: the force sensor or its filter had not settled; wait longer at each"
        " press, or log what is not filtered."
    )


def _changed(log: LogForces, label: np.ndarray, felt: np.ndarray, names: np.ndarray, bench: Fit) -> str | None:
    """Forces that differ from their labels by another factor from some press on: another gel, or another setting of the sensor."""
    normal, measured, names, fit = -label[felt, 2], log.normal[felt], names[felt], bench()
    weight, order = _weight(normal), np.arange(len(felt))
    low, high, tried = FEWEST, len(felt) - FEWEST, {}
    for _ in range(2):  # some, then those about the best of them
        for at in np.unique(np.linspace(low, high, SPLITS).round().astype(int)) if low <= high else ():
            if set(names[:at]) & set(names[at:]):  # else it is rather an indenter
                tried[at] = fit.fitted(measured, weight, np.where(order < at, 0.0, normal))
        if not tried:
            return None
        at = min(tried, key=lambda one: tried[one][2])
        step = (high - low) // (SPLITS - 1) + 1
        low, high = max(FEWEST, at - step), min(len(felt) - FEWEST, at + step)
    found, errors, left = tried[at]
    drifting = fit.fitted(measured, weight, np.ones(len(felt)), order)[2]
    if left > min(drifting, 0.5 * fit.left) or abs(found[-1]) < SURE * errors[-1]:
        return None
    ratio = 1.0 + float(np.median(found[-1] * normal[at:] / (fit.terms @ found[:-1])[at:]))
    if 1.0 / OTHER_FORCE < ratio < OTHER_FORCE:
        return None
    return (
        f"From press {felt[at] + 1} of those with readings on forces are {ratio:.2f} times as large beside their labels as before: was the gel or the"
        " range of the force sensor changed? Give each gel a sensor_id and a gel_id of its own."
    )


@dataclass(frozen=True)
class _Bench:
    """Readings of n presses beside labels at the commanded depth, on a frame that yields and with touch that was missed.

    terms: (n, k), by which readings change: with stiffness (the first column is the label on the gel as it is pressed), depth of
    touch, compliance, and each indenter's own factor. prior: (k, k) and (k,), rows and values of what is known of their
    coefficients. offset: mm deeper than logged. left: weighted sum of squares.
    """

    terms: np.ndarray
    prior: tuple[np.ndarray, np.ndarray]
    offset: float
    left: float

    def fitted(self, values: np.ndarray, weight: np.ndarray, *more: np.ndarray, used=np.s_[:]):
        """Like `_fitted`, of some of the presses, with further terms (n,) each, whose coefficients come last."""
        rows, known = self.prior
        terms = np.column_stack([self.terms, *more])[used]
        below = np.hstack([rows, np.zeros((len(rows), len(more)))])
        return _fitted(
            np.vstack([terms * weight[:, None], below]),
            np.append(values * weight, known),
            np.ones(len(terms) + len(rows)),
        )


def _bench(log: LogForces, label: np.ndarray, felt: np.ndarray, names: np.ndarray, touch: float = TOUCH_MM) -> _Bench:
    """Stiffness, depth of touch, compliance and indenters' factors that fit readings best, by Gauss and Newton.

    label: (m, 3) N of all presses, of which `felt` (n,) serve. touch: mm that it is usually missed by. Force goes as a power of
    depth, which the labels of an indenter show.
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
        # what is known: offset, compliance and factors, each by its usual size; readings scatter by half of SPREAD
        sizes = 2.0 * stiffness * np.array([touch, COMPLIANCE, *[OWN] * len(kinds)])
        rows = np.diag(1.0 / sizes)
        known = stiffness * np.array([-offset, COMPLIANCE - compliance, *[0.0] * len(kinds)]) / sizes
        prior = np.hstack([np.zeros((len(rows), 1)), rows]), known
        found, _, squares = _Bench(terms, prior, offset, 0.0).fitted(read, weight)
        stiffness = max(float(found[0]), 1e-3)
        offset = float(np.clip(offset + found[1] / stiffness, *OFFSETS))
        compliance = float(np.clip(compliance + found[2] / stiffness, 0.0, STIFF_ENOUGH))
    return _Bench(terms, prior, offset, squares)


def _weight(normal: np.ndarray) -> np.ndarray:
    """Weight of readings at labels (n,) N."""
    return 1.0 / np.hypot(SPREAD[0] * normal, SPREAD[1])


def _missed(log: LogForces, label: np.ndarray, felt: np.ndarray, names: np.ndarray, bench: Fit) -> str | None:
    """Presses that go deeper, or less deep, than logged: touch that was missed, where a constant force explains it less well."""
    if len(felt) < ENOUGH:
        return None
    usual, free = bench(), _bench(log, label, felt, names, OFFSETS[1])
    by_constant = usual.fitted(log.normal[felt], _weight(-label[felt, 2]), np.ones(len(felt)))[2]
    scatter = max(free.left / len(felt), LEAST_SCATTER)
    if abs(free.offset) < MISSED_MM or usual.left - free.left < SURE**2 * scatter or free.left > by_constant:
        return None
    return (
        f"Forces are those of presses {abs(free.offset):.2f} mm {'deeper' if free.offset > 0 else 'less deep'} than logged: check at which z0_mm and"
        " dz_mm the tip touched the gel, or set [poses] touch_offset_mm."
    )


def _moved(log: LogForces, label: np.ndarray, felt: np.ndarray, bench: Fit) -> str | None:
    """A drift, else a constant force, beyond what labels explain."""
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
        if axis == "z":  # of a force along -z
            found, errors, _ = bench().fitted(-values[used], weight, -ones, -order, used=used)
        else:
            own = (
                own * bench().terms[:, 0] / -label[felt, 2]
            )  # as much less as the normal force where the frame yields
            found, errors, _ = _fitted(np.column_stack([own, ones, order])[used], values[used], weight)
        constants[axis], drifts[axis] = zip(found[-2:].tolist(), errors[-2:].tolist(), strict=True)
    for axis, (per_press, error) in drifts.items():
        if abs(per_press) > SURE * error and abs(per_press) * np.ptp(felt) > 2 * LEAST_N:
            return _drifts(axis, per_press, np.ptp(felt))
    return constant(dict(sorted(constants.items())))


def _fitted(terms: np.ndarray, values: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Weighted least squares: coefficients (k,) of `terms` (n, k), their standard errors (k,), and the weighted sum of squares left.

    The error of a term that the others make up is infinite.
    """
    weighted = terms * weight[:, None]
    found, *_ = np.linalg.lstsq(weighted, values * weight, rcond=None)
    left = float(np.sum((weight * (values - terms @ found)) ** 2))
    scatter = np.sqrt(max(left / (len(values) - terms.shape[1]), LEAST_SCATTER))
    errors = np.full(len(found), np.inf)
    for k, own in enumerate(weighted.T):
        others = np.delete(weighted, k, axis=1)
        apart = np.linalg.norm(own - others @ np.linalg.lstsq(others, own, rcond=None)[0])
        if apart > ALONE * np.linalg.norm(own):
            errors[k] = scatter / apart
    return found, errors, left


def _one_indenter(log: LogForces, felt: np.ndarray, names: np.ndarray, bench: Fit) -> str | None:
    """An indenter whose forces differ from its labels by another factor than those of all others."""
    fit, measured, names = bench(), log.normal[felt], names[felt]
    on_gel = fit.terms[:, 0]
    weight, left, sure = _weight(on_gel), {}, {}
    for name in sorted(set(names)):
        own = names == name
        if own.sum() < OF_ONE or len(set(names[~own])) < 2 or (~own).sum() < FEWEST:
            continue
        found, errors, left[name] = fit.fitted(measured, weight, np.where(own, on_gel, 0.0))
        sure[name] = 1.0 + float(found[-1] / found[0]), abs(found[-1]) > SURE_OF_INDENTER * errors[-1]
    worst = min(left, key=lambda name: left[name], default="")
    # rather the gel is of another thickness, or there is a constant force
    for rather in (on_gel * np.log(on_gel), np.ones(len(felt))):
        if not worst or NEARER * fit.fitted(measured, weight, rather)[2] < left[worst]:
            return None
    ratio, certain = sure[worst]
    if 1.0 / OTHER_FORCE < ratio < OTHER_FORCE or not certain:
        return None
    return (
        f"Forces of {worst} are {ratio:.2f} times what its labels say beside those of the other indenters: check its shape, size and"
        " unit in the catalogue, and the column `indenter`."
    )


def _other_thickness(log: LogForces, felt: np.ndarray, bench: Fit) -> str | None:
    """Forces that grow otherwise with the size of a contact than stiffness, touch, a frame that yields and indenters make them grow.

    A layer resists the more, the wider a contact is beside its thickness: on a gel a fifth thinner than its labels say forces grow with
    1.1 times the power, on one a third thicker with 0.9 times.
    """
    if len(felt) < ENOUGH:
        return None
    fit, measured = bench(), log.normal[felt]
    normal = fit.terms[:, 0]
    weight = _weight(normal)
    found, errors, left = fit.fitted(measured, weight, normal * np.log(normal))
    offset, error, by_offset = fit.fitted(measured, weight, np.ones(len(felt)))
    # a tare too small to be sure of beside touch and compliance, but likelier than another thickness
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
        f"Forces grow otherwise with the size of a contact than labels do, by {by:.2f} times from small to large presses beyond what stiffness,"
        f" touch, a frame that yields and indenters explain: most likely the gel is {'thinner' if power > 0 else 'thicker'} than its table says;"
        f" check its thickness, and the column `gel_id`.{other}"
    )


def _drifts(axis: str, per_press: float, presses: float) -> str:
    return (
        f"The force sensor drifts: what it reads along {axis} beyond the prediction changes by {per_press:+.3f} N a press,"
        f" {per_press * presses:+.2f} N from the first press to the last; tare it more often."
    )


def of_readings(measured: np.ndarray, predicted: np.ndarray) -> list[str]:
    """What readings (n,) of a scale say that were compared with predicted forces (n,): unit, else a drift, else a constant force."""
    wrong = unit(measured, predicted, "the readings")
    if wrong:
        return [wrong]
    if len(measured) < FEWEST:
        return []
    weight = 1.0 / np.hypot(SPREAD[0] * predicted, SPREAD[1])
    order = np.arange(len(measured)) - (len(measured) - 1) / 2
    proportional = np.column_stack([predicted, np.ones(len(order))])
    found, errors, _ = _fitted(np.column_stack([proportional, order]), measured, weight)
    drift = float(found[-1])
    if abs(drift) > SURE_OF_FEW * errors[-1] and abs(drift) * len(order) > 4 * LEAST_N:
        return [f"Readings drift by {drift:+.2f} N a press; tare the scale or sensor more often."]
    found, errors, _ = _fitted(proportional, measured, weight)
    offset = float(found[-1])
    if abs(offset) > SURE_OF_FEW * errors[-1] and abs(offset) > 2 * LEAST_N:
        change = "falls" if offset > 0 else "rises"
        return [
            f"Readings are {offset:+.1f} N beyond what is in proportion to the forces that the network reads, so that their ratio"
            f" {change} with force: tare the scale or sensor before each press."
        ]
    return []
