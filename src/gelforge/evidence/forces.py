"""Diagnostics of the force sensor and the log from force readings.

Each function returns one sentence with its number, or None where there is nothing to report. Only numpy, because
`gelforge sensor` uses them, too. Normal forces are compression here, in N and positive, in the order of the log.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from gelforge.records.series import equal_largest

# Newtons in other units that sensors and scales show.
UNITS = {
    "kilograms-force": 9.80665,
    "pounds-force": 4.44822,
    "ounces-force": 0.278014,
    "grams-force": 9.80665e-3,
    "millinewtons": 1e-3,
    "kilonewtons": 1e3,
}
SEVERAL = 3.0  # ratio to the usual force: no gel of the kind is so soft or so hard
ALIKE = 1.5  # the factor within which a unit explains forces
FEWEST = 6  # presses that a statement about their order or directions needs
LEAST_N = 0.15  # least constant force or drift: smaller ones are usual, and change hardly anything
SURE = 4.0  # standard errors from which an effect is significant
SURE_OF_FEW = 3.5  # the same for a dozen readings of a scale
SPREAD = 0.1, 0.2  # scatter of readings about a predicted force: as a fraction, and in N
# Correlations of normal force: largest with the column that should hold it, least with the one that does.
NOT_FOLLOWED, FOLLOWED = 0.5, 0.9
ALONE = 1e-9  # least fraction of a fit's term that the other terms leave unexplained, or it is collinear with them
TAKEN_OVER = 0.6  # sideways over normal force where most contacts slip
TURNED_DEG = 20.0  # angle of sideways force to path that curved gels and sloping bodies explain
FOLLOWS = 0.6  # fraction of the variance of sideways forces that a cause must explain to be named
LEAST_SCATTER = 0.25  # least variance of a weighted reading
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
    """The fit of a model to n readings of a log.

    rows: (n,) their positions in the log. usual: (n,) N, compression on a usual gel before anything is fitted.
    residual: (n, 3) N, measured less predicted, nan where a component is not used. constant: constant forces in N
    with their standard errors, by axis. noise, largest_noise: N, fitted and the largest that its prior expects.
    """

    rows: np.ndarray
    usual: np.ndarray
    residual: np.ndarray
    constant: dict[str, tuple[float, float]]
    noise: float
    largest_noise: float


def first_said(causes: Iterable[Callable[[], str | None]]) -> list[str]:
    """Only the sentence of the first cause that has one; later causes are not evaluated."""
    for cause in causes:
        if said := cause():
            return [said]
    return []


def of_log(log: LogForces, fitted: Fitted) -> list[str]:
    """Diagnose the force sensor and the log: one cause, without its consequences."""
    felt = fitted.usual > LEAST_N
    rows, usual = fitted.rows[felt], fitted.usual[felt]
    causes = (
        lambda: equal_largest(log.normal[rows], usual),
        lambda: misplaced(log.force[rows], usual),
        lambda: unit(log.normal[rows], usual),
        lambda: shifted(log.normal, usual, rows),
        lambda: sideways(log),
        lambda: drift(fitted.residual, fitted.rows),
        lambda: constant(fitted.constant),
        lambda: noise(fitted.noise, fitted.largest_noise),
    )
    return first_said(causes)


def misplaced(force: np.ndarray, predicted: np.ndarray) -> str | None:
    """Normal forces in a column of sideways forces: the axes are those of the sensor or the world, not the gel's.

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
    """Forces (n,) several times larger or smaller than predicted: by a constant force, or else by a unit."""
    if not len(measured):
        return None
    ratio = float(np.median(np.abs(measured) / predicted))
    if 1.0 / SEVERAL < ratio < SEVERAL or not ratio:
        return None
    large = predicted > np.median(predicted)
    if len(measured) >= FEWEST and large.any():
        apart = [float(np.median(each[large]) - np.median(each[~large])) for each in (measured, predicted)]
        slope = apart[0] / apart[1]
        beyond = float(np.median(measured - slope * predicted))
        if 1.0 / SEVERAL < slope < SEVERAL and abs(beyond) > float(np.median(predicted)):
            return f"Forces are offset by {beyond:+.1f} N from the usual ones, equally in large and small presses: {HINT}."
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
    return off_axes(along, seen, "the sideways path", np.exp(1j * np.deg2rad(log.rot_deg[used])))


def off_axes(along: np.ndarray, seen: np.ndarray, what: str, turn: np.ndarray | None = None) -> str | None:
    """Sideways forces `seen` that do not follow `along`, (n,) complex, x + i y; what: `along` in words.

    turn: (n,) of the indenter, as complex numbers of size 1. The transformation of axes that explains them is named.
    """
    straight, angle = _explained(along, seen)
    if straight > FOLLOWS:
        if abs(angle) <= TURNED_DEG:
            return None
        if abs(angle) > 180.0 - TURNED_DEG:
            return _turned(what, "both have the opposite sign", straight, "multiply fx_n and fy_n by -1")
        how = f"they are turned by {angle:+.0f} degrees"
        return _turned(what, how, straight, "turn them back, or set the sensor's axes right")
    mirrored, axis = _explained(along.conj(), seen)
    by_turn = {sign: 0.0 if turn is None else _explained(along * turn**sign, seen)[0] for sign in (1, -1)}
    sign = max(by_turn, key=lambda one: by_turn[one])
    if by_turn[sign] > max(FOLLOWS, mirrored):
        how = f"they are in a frame that turns {'against' if sign < 0 else 'with'} the indenter's rot_deg"
        return _turned(what, how, by_turn[sign], "turn them by rot_deg")
    if mirrored > FOLLOWS:
        causes = {
            0: "the sign of y is flipped", 90: "x and y are exchanged", 180: "the sign of x is flipped",
            270: "x and y are exchanged, and their signs flipped",
        }  # fmt: skip
        nearest = 90 * round((axis % 360) / 90) % 360
        return _turned(what, causes[nearest], mirrored, "correct the columns fx_n and fy_n")
    if straight < 0.1:
        return (
            f"Sideways forces do not follow {what} (it explains {100 * straight:.0f} % of them), and no exchange of axes"
            " explains them: check the columns fx_n, fy_n, dx_mm and dy_mm."
        )
    return None


def _turned(what: str, how: str, explained: float, hint: str) -> str:
    return f"Sideways forces do not follow {what}: {how}, which explains {100 * explained:.0f} % of them; {hint}."


def _explained(along: np.ndarray, seen: np.ndarray) -> tuple[float, float]:
    """Fraction of complex `seen`, without trend, that a turned and scaled `along` explains; this turn, degrees."""
    along, seen = _level(along), _level(seen)
    common = np.vdot(along, seen)
    total = np.vdot(along, along).real * np.vdot(seen, seen).real
    return (float(abs(common) ** 2 / total) if total else 0.0), float(np.rad2deg(np.angle(common)))


def _level(values: np.ndarray) -> np.ndarray:
    """Values (n,) without their mean and their trend along the log, which a constant force and a drift cause."""
    order = np.arange(len(values)) - (len(values) - 1) / 2
    values = values - values.mean()
    return values - order * (order @ values) / (order @ order)


def drift(residual: np.ndarray, rows: np.ndarray) -> str | None:
    """Residuals (n, 3) N, measured less predicted, with a trend along the log. rows: (n,) positions in the log."""
    for axis, of in zip("zxy", residual.T[[2, 0, 1]], strict=True):
        used = np.isfinite(of)
        if used.sum() < FEWEST:
            continue
        at, away = rows[used] - rows[used].mean(), of[used] - of[used].mean()
        per_row = float(at @ away / (at @ at))
        left = away - per_row * at
        error = float(np.sqrt(left @ left / (len(at) - 2) / (at @ at)))
        if abs(per_row) > SURE * error and abs(per_row) * np.ptp(at) > 2 * LEAST_N:
            return drift_text(axis, per_row, np.ptp(at))
    return None


def mean_forces(straight: np.ndarray) -> dict[str, tuple[float, float]]:
    """Mean sideways force and its standard error, by axis.

    straight: (n, 2) N, sideways force beyond the prediction in presses without shear.
    """
    found = {}
    for axis, of in zip("xy", straight.T, strict=True):
        of = of[np.isfinite(of)]
        if len(of) >= FEWEST:
            found[axis] = float(of.mean()), float(of.std(ddof=1) / np.sqrt(len(of)))
    return found


def constant(forces: dict[str, tuple[float, float]], errors: float = SURE) -> str | None:
    """Constant forces that exceed `errors` of their standard errors; forces: N and standard error, by axis."""
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


def fitted(terms: np.ndarray, values: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Weighted least squares: coefficients (k,) of `terms` (n, k), their standard errors (k,), and the weighted sum of squares left.

    The error of a term that is collinear with the others is infinite.
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


def drift_text(axis: str, per_row: float, rows: float) -> str:
    return (
        f"The force sensor drifts: what it reads along {axis} beyond the prediction changes by {per_row:+.3f} N a row,"
        f" {per_row * rows:+.2f} N from the first row to the last; tare it more often."
    )


def of_readings(measured: np.ndarray, predicted: np.ndarray) -> list[str]:
    """Diagnose readings (n,) N of a scale against predictions (n,) N: unit, else a drift, else a constant force."""
    wrong = unit(measured, predicted, "the readings") or equal_largest(measured, predicted)
    if wrong:
        return [wrong]
    if len(measured) < FEWEST:
        return []
    weight = 1.0 / np.hypot(SPREAD[0] * predicted, SPREAD[1])
    order = np.arange(len(measured)) - (len(measured) - 1) / 2
    proportional = np.column_stack([predicted, np.ones(len(order))])
    found, errors, _ = fitted(np.column_stack([proportional, order]), measured, weight)
    drift = float(found[-1])
    if abs(drift) > SURE_OF_FEW * errors[-1] and abs(drift) * len(order) > 4 * LEAST_N:
        return [f"Readings drift by {drift:+.2f} N a press; tare the scale or sensor more often."]
    found, errors, _ = fitted(proportional, measured, weight)
    offset = float(found[-1])
    if abs(offset) > SURE_OF_FEW * errors[-1] and abs(offset) > 2 * LEAST_N:
        change = "falls" if offset > 0 else "rises"
        return [
            f"Readings have an offset of {offset:+.1f} N against the predicted forces, so that their ratio"
            f" {change} with force: tare the scale or sensor before each press."
        ]
    return []
