"""Compare labels with the bench's force sensor: first what many presses share, then each press beside the others.

Readings differ from labels for causes that presses share (stiffness or gain, zero, compliance, tare, tilt, friction, the
seating of a mounting, an indenter's size), and for those of one press (noise, mesh, scatter of touch). All are taken as
normal with known standard deviations, so that the relative difference of reading and label of n presses is normal, too,
with a covariance C. Its deviation from what the other presses predict is then [C^-1 d]_i / sqrt([C^-1]_ii) (leave-one-out
of a Gaussian process: Rasmussen and Williams 2006, eq. 5.12).
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gelforge.flow.tables import CalibrateTable, MaterialTable

COMPARED = ["press", "indenter", "label (N)", "95 % from", "to", "force sensor (N)", "sensor / label", "as others (N)",
            "deviations", "calibration"]  # fmt: skip
CAUSES = ["cause", "shared by", "expected (% of force)", "what it is"]
LEAST_N = 2.0  # at smaller forces the sensor's noise is a large part of the ratio
NAMED = 3.0  # standard deviations above which a press is named
# Standard deviation of the force of one gel at equal depth from mounting to mounting, as a fraction: 10 to 17 % in tables of a
# public bench. It counts where a calibration has one C10 for several mountings.
SEATING = 0.1
POWER = 1.6  # exponent of force over depth: 1.1 under flat bodies, 1.5 to 2 under balls and edges
SQUARE_DEG = 4.0  # tilt, squared, that a bench may have where labels follow no calibration
# What the posterior finds is said to differ from what labels assume beyond this many standard deviations, where it changes
# forces by this fraction at least, or tilt by this angle.
SURE, MATTERS, LEANS_DEG = 3.0, 0.03, 0.7
CALIBRATED = 'Write [params.material] c10 = "calibrated" into dataset.toml, and labels follow the calibration.'
TARED = "Tare the sensor without contact and log again, or subtract it from the force columns."
EXPECTED = {
    "material": "stiffness of the gel, gain of the force sensor, and the mesh of the calibration",
    "compliance": "yielding of the frame",
    "tare": "what the force sensor reads without contact",
    "friction": "the interval of the friction coefficient",
    "zero": "depth at which touch was logged",
    "tilt": "leaning of the gel or the tool, which flat bodies feel",
    "seating": "how a gel that is taken out and put back differs: 10 % of force at equal depth",
    "indenter": "tolerance of its shape",
    "press": "noise of the force sensor, error of the label's mesh, scatter of touch",
}


@dataclass(frozen=True)
class Spreads:
    """Standard deviations of what labels and readings are made of.

    c10: of the material's stiffness, indenter: of an indenter's size, seating: as fractions of a force. low, high: ends of
    the 95 % interval of C10, relative to its value. noise, tare: N. scatter, zero: of the depth of touch, of a press and
    of a mounting, mm. compliance: mm/N. tilt: by indenter whose response is known, as a fraction of a force.
    """

    c10: float
    low: float
    high: float
    indenter: float
    noise: float
    tare: float
    scatter: float
    zero: float
    compliance: float
    seating: float
    tilt: Mapping[str, float]


@dataclass(frozen=True)
class Compared:
    """Normal force of one press by its label and by the force sensor, N.

    label: with the force outside the image, which the force sensor measures, too. low, high: 95 % interval by C10, N.
    own: standard deviation of its reading by what it does not share, as a fraction of the label. used: whether the
    calibration used the press. expected: reading that the other presses predict, N; deviations: from it, in its
    standard deviations.
    """

    name: str
    indenter: str
    label: float
    low: float
    high: float
    sensor: float
    own: float
    used: bool
    expected: float = float("nan")
    deviations: float = float("nan")

    @property
    def ratio(self) -> float:
        return self.sensor / self.label


def spreads(
    material: MaterialTable, summary: Mapping[str, Any], calibrate: CalibrateTable, follows: bool = True
) -> Spreads:
    """Uncertainties of forces: by the posterior if labels follow it, else by the priors.

    summary: of the calibration; empty if there is none.
    """
    priors, found = calibrate.priors, summary.get("parameters", {})

    def middle(name: str) -> float:
        numbers = getattr(priors, name).numbers
        return float(found[name]["median"] if name in found else numbers.get("median", 0.0))

    def width(name: str) -> float:
        rows = [row for key, row in found.items() if key.split(" of ")[0] == name]
        if follows:
            return float(max(((row["interval68"][1] - row["interval68"][0]) / 2.0 for row in rows), default=0.0))
        spread = getattr(priors, name.removesuffix("_z")).numbers.get("spread", 0.0)
        return float(max([spread, *(abs(row["median"]) for row in rows)]))

    bench, c10 = summary.get("bench", {}), float(material.c10)
    pair68, pair95 = material.c10_interval68 or (c10, c10), material.c10_interval95 or (c10, c10)
    of_c10 = (pair68[1] - pair68[0]) / (2 * c10) if follows else priors.c10.numbers.get("spread", 0.0)
    mesh = float(priors.discretisation.numbers.get("spread", 0.0))
    return Spreads(
        c10=float(np.hypot(of_c10, mesh)), low=pair95[0] / c10, high=pair95[1] / c10,
        indenter=float(priors.indenter.numbers.get("spread", 0.0)), noise=middle("noise"),
        tare=float(np.hypot(priors.tare.numbers.get("spread", 0.0), width("tare_z"))), scatter=middle("scatter"), zero=width("offset"),
        compliance=width("compliance"), seating=SEATING if len(bench.get("mountings", ())) > 1 else 0.0,
        tilt=_of_tilt(found, bench.get("by_tilt", {}), follows),
    )  # fmt: skip


def _of_tilt(found: Mapping[str, Any], by_tilt: Mapping[str, float], follows: bool) -> dict[str, float]:
    """Standard deviation of each indenter's force, relative, by the posterior of the mounting whose tilt does most.

    by_tilt: change of force per square degree, relative, by indenter (`calibration.tilts`).
    """
    of_square = [0.0] if follows else [SQUARE_DEG]
    for name, row in found.items():
        if follows and name.split(" of ")[0] in ("tilt_x", "tilt_y"):
            low, high = row["interval68"]
            of_square.append(abs(high**2 - low**2) / 2.0 + ((high - low) / 2.0) ** 2)
    return {indenter: change * max(of_square) for indenter, change in by_tilt.items()}


def compare_forces(rows: Sequence[Mapping[str, Any]], of: Spreads, used: Collection[str]) -> list[Compared]:
    """Presses that have both a label and a force reading, in the order of the page's rows."""
    found, kept = [], []
    for row in rows:
        label, sensor = row.get("label_fz"), row.get("measured_fz")
        if label is None or sensor is None or not np.isfinite([label, sensor]).all() or not label or not sensor:
            continue
        label += row["outside_fz"]
        # stated errors hold for 90 to 97 % of presses, so they are about two standard deviations
        mesh = np.nan_to_num(float(row.get("error_n") or 0.0)) / 2.0
        own = np.linalg.norm([of.noise / label, mesh / label, POWER * of.scatter / _depth(row)])
        low, high = sorted((label * of.low, label * of.high))
        found.append(Compared(row["id"], row["indenter"], label, low, high, sensor, float(own), row["id"] in used))
        kept.append(row)
    return _beside_others(found, {name: shared for name, (_, shared) in _shared(kept, found, of).items()})


def _depth(row: Mapping[str, Any]) -> float:
    """Depth of a press below the gel's apex, mm."""
    return max(-(row["z0_mm"] + row["dz_mm"]), 0.05)


def _shared(
    rows: Sequence[Mapping[str, Any]], presses: Sequence[Compared], of: Spreads
) -> dict[str, tuple[str, np.ndarray]]:
    """Causes that presses share, each with what shares it and its effects (n, k), fractions of the n labels.

    Each of the k columns is one standard deviation of the cause in one mounting, of one indenter, or of all presses.
    """
    force, depth = np.array([abs(p.label) for p in presses]), np.array([_depth(row) for row in rows])
    friction = [np.nan_to_num(float(row.get("friction_error_n") or 0.0)) for row in rows]
    total = [
        np.linalg.norm([np.nan_to_num(float(row.get(f"label_{axis}") or 0.0)) for axis in ("fx", "fy", "fz")])
        for row in rows
    ]
    every = np.ones((len(rows), 1))
    mounting, indenter = (_groups([row.get(key, "") for row in rows]) for key in ("mounting", "indenter"))
    steep = POWER / depth
    return {
        "material": ("all presses", of.c10 * every),
        "compliance": ("all presses", (of.compliance * steep * force)[:, None]),
        "tare": ("all presses", (of.tare / force)[:, None]),
        "friction": ("all presses", (np.array(friction) / np.maximum(total, force))[:, None]),
        "zero": ("a mounting", of.zero * steep[:, None] * mounting),
        "tilt": ("a mounting", np.array([of.tilt.get(p.indenter, 0.0) for p in presses])[:, None] * mounting),
        "seating": ("a mounting", of.seating * mounting),
        "indenter": ("its presses", of.indenter * indenter),
    }  # fmt: skip


def _groups(names: Sequence[str]) -> np.ndarray:
    """Membership (n, k) of n rows in their k groups."""
    return (np.array(names, object)[:, None] == np.array(sorted(set(names)), object)).astype(float)


def _beside_others(presses: list[Compared], shared: Mapping[str, np.ndarray]) -> list[Compared]:
    """Presses with the reading that the others predict, and their deviations from it.

    A press beyond NAMED deviations is left out of those that predict, the largest one first.
    """
    if not presses:
        return []
    effects, own = np.hstack(list(shared.values())), np.array([p.own for p in presses])
    away = np.array([p.ratio - 1.0 for p in presses])
    covariance = np.diag(own**2) + effects @ effects.T
    judged = np.zeros((2, len(presses)))
    odd: list[int] = []
    while True:
        kept = np.setdiff1d(np.arange(len(presses)), odd)
        inverse = np.linalg.inv(covariance[np.ix_(kept, kept)])
        residual = inverse @ away[kept] / np.diag(inverse)
        judged[:, kept] = away[kept] - residual, residual * np.sqrt(np.diag(inverse))
        for i in odd:  # by all that are kept
            weights = inverse @ covariance[kept, i]
            expected = weights @ away[kept]
            judged[:, i] = expected, (away[i] - expected) / np.sqrt(covariance[i, i] - weights @ covariance[kept, i])
        worst = int(kept[np.abs(judged[1, kept]).argmax()])
        if abs(judged[1, worst]) <= NAMED or len(kept) == 1:
            break
        odd.append(worst)
    return [
        replace(p, expected=p.label * (1.0 + float(by)), deviations=float(z))
        for p, by, z in zip(presses, *judged, strict=True)
    ]


def force_rows(presses: Sequence[Compared]) -> list[list]:
    """Rows of the table under COMPARED."""
    return [[p.name, p.indenter, p.label, p.low, p.high, p.sensor, f"{p.ratio:.3f}", p.expected, f"{p.deviations:+.1f}",
             "used" if p.used else ""] for p in presses]  # fmt: skip


def expected_rows(presses: Sequence[Compared], rows: Sequence[Mapping[str, Any]], of: Spreads) -> list[list]:
    """Rows of the table under CAUSES: size of each cause, the root of its mean square over presses, in percent of a force, the largest first."""
    mine = {row["id"]: row for row in rows}
    shared = _shared([mine[p.name] for p in presses], presses, of)
    sizes = {name: (by, np.linalg.norm(effects, axis=1)) for name, (by, effects) in shared.items()}
    sizes["press"] = "no other press", np.array([p.own for p in presses])
    found = [
        [name, by, f"{100 * np.sqrt(np.mean(size**2)):.1f}", EXPECTED[name]]
        for name, (by, size) in sizes.items()
        if size.any()
    ]
    return sorted(found, key=lambda row: -float(row[2]))


def common_sentences(
    rows: Sequence[Mapping[str, Any]],
    presses: Sequence[Compared],
    summary: Mapping[str, Any],
    assumed: Mapping[str, float],
) -> list[str]:
    """What the posterior finds and labels do not follow: each with the fraction of the squared differences that it explains.

    assumed: values of the labels, by parameter of the posterior. Tilt stands first, because the rest does not explain
    moments; then what explains most.
    """
    mine = {row["id"]: row for row in rows}
    depth = np.array([_depth(mine[p.name]) for p in presses])
    away = np.array([p.ratio - 1.0 for p in presses])
    force, weight = np.array([abs(p.label) for p in presses]), np.array([1.0 / p.own for p in presses])
    mountings = np.array([mine[p.name].get("mounting", "") for p in presses], object)
    effects = {
        "c10": lambda change: np.full(len(presses), change / assumed["c10"]),
        "offset": lambda change: POWER * change / depth,
        "compliance": lambda change: -POWER * change * force / depth,
        "tare_z": lambda change: -change / force,
    }
    said: list[tuple[float, str, str]] = []
    for key, row in {"c10": summary["c10"], **summary["parameters"]}.items():
        name, _, mounting = key.partition(" of ")
        if name not in assumed:
            continue
        (low, high), (least, most) = row["interval68"], row["interval95"]
        change, what = row["median"] - assumed[name], row.get("label", "C10 (MPa)")
        if abs(change) < SURE * (high - low) / 2.0:
            continue
        values = f"{what}: labels assume {assumed[name]:.3g}, the calibration finds {row['median']:.3g} ({least:.3g} to {most:.3g})"
        if name in ("tilt_x", "tilt_y"):
            if abs(change) > LEANS_DEG:
                said.append((2.0, f"{values}, as the moments of flat presses show.", CALIBRATED))
        elif name == "mu":
            said.append((0.0, f"{values}, as presses that slide show.", CALIBRATED))
        else:
            effect = effects[name](change) * (mountings == mounting if mounting else 1.0)
            share = 1.0 - float(np.sum((weight * (away - effect)) ** 2) / np.sum((weight * away) ** 2))
            if np.sqrt(np.mean(effect**2)) > MATTERS and share > 0.0:
                also = " (a wrong gain of the force sensor looks the same)" if name == "c10" else ""
                hint = TARED if name == "tare_z" else CALIBRATED
                said.append((share, f"{values}, which explains {share:.0%} of the squared differences{also}.", hint))
    said.sort(key=lambda each: -each[0])
    return [f"{sentence} {hint}" if not at else sentence for at, (_, sentence, hint) in enumerate(said)]


def force_sentences(presses: Sequence[Compared]) -> list[str]:
    """Sentences on the ratio of labels to the force sensor, and on presses that differ from the others by more than NAMED."""
    held = [p for p in presses if not p.used and abs(p.sensor) >= LEAST_N]
    said = []
    if held:
        low, middle, high = np.quantile([p.ratio for p in held], [0.05, 0.5, 0.95])
        said.append(
            f"Normal force of the force sensor over the label's, with what lies outside the image, {len(held)} presses above"
            f" {LEAST_N:g} N that the calibration did not use: median {middle:.3f}, 5 to 95 % {low:.3f} to {high:.3f}."
        )
    rms = float(np.sqrt(np.mean([p.deviations**2 for p in presses])))
    said.append(
        f"Each press is judged beside the others: by what all presses, those of its mounting and those of its indenter share,"
        f" its reading is predicted; deviations from that have an rms of {rms:.2f} (expected: 1)."
    )
    for p in sorted((p for p in presses if abs(p.deviations) > NAMED), key=lambda p: -abs(p.deviations)):
        said.append(
            f"{p.name} ({p.indenter}): by the other presses the force sensor should read {p.expected:.2f} N, and reads"
            f" {p.sensor:.2f} N, {abs(p.deviations):.1f} standard deviations apart: check its row, indenter and touch."
        )
    return said
