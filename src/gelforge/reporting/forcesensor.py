"""Compare labels with the bench's force sensor: their differences, and the expected standard deviations of these."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gelforge.flow.tables import CalibrateTable, MaterialTable

# What the variance of label minus force sensor is made of: the sensor's noise and drift, the mesh, the interval of C10, that of
# friction, the depth of touch (its scatter and the posterior of the zero), the posterior of tilt, and re-seatings.
PARTS = ("sensor", "mesh", "material", "friction", "zero", "tilt", "seating")
COMPARED = ["press", "indenter", "label (N)", "95 % from", "to", "force sensor (N)", "label / sensor", "deviations", *PARTS,
            "calibration"]  # fmt: skip
LEAST_N = 2.0  # at smaller forces the sensor's noise is a large part of the ratio
NAMED = 3.0  # standard deviations above which a press is named
# Standard deviation of the force of one gel at equal depth from mounting to mounting, as a fraction: 10 to 17 % in tables of a
# public bench. It counts where a calibration has one C10 for several mountings.
SEATING = 0.1
STEEPEST = 2.0  # exponent of force over depth, largest of usual indenters: 1 for a flat punch, 1.5 for a sphere


@dataclass(frozen=True)
class Spreads:
    """Standard deviations: c10, mesh and seating relative to a force, noise in N, touch (depth of first contact) in mm.

    low, high: ends of the 95 % interval of C10, relative to its value. tilt: by indenter, relative to a force, of those
    whose response to tilt is known.
    """

    c10: float
    low: float
    high: float
    mesh: float
    noise: float
    touch: float
    seating: float
    tilt: Mapping[str, float]


@dataclass(frozen=True)
class Compared:
    """Normal force of one press by its label and by the force sensor, N, and variances of their difference, N^2.

    label: with the force outside the image, which the force sensor measures, too. low, high: 95 % interval by C10, N.
    parts: the variances, by PARTS. used: whether the calibration used the press.
    """

    name: str
    indenter: str
    label: float
    low: float
    high: float
    sensor: float
    parts: Mapping[str, float]
    used: bool

    @property
    def variance(self) -> float:
        return sum(self.parts.values())

    @property
    def deviations(self) -> float:
        """The difference in units of its standard deviation."""
        return (self.label - self.sensor) / self.variance**0.5

    @property
    def ratio(self) -> float:
        return self.label / self.sensor

    def fractions(self) -> list[str]:
        """Fractions of the variance, in the order of PARTS."""
        return [f"{self.parts[name] / self.variance:.0%}" for name in PARTS]


def spreads(material: MaterialTable, summary: Mapping[str, Any], calibrate: CalibrateTable) -> Spreads:
    """Uncertainties of forces, from the interval of C10, the posterior of the bench, and the priors of mesh errors.

    summary: of the calibration; if empty, the medians of the priors are used.
    """
    priors, found = calibrate.priors, summary.get("parameters", {})

    def middle(name: str) -> float:
        numbers = getattr(priors, name).numbers
        return float(found[name]["median"] if name in found else numbers.get("median", 0.0))

    def width(name: str) -> float:
        low, high = found[name]["interval68"] if name in found else (0.0, 0.0)
        return float(high - low) / 2.0

    bench = summary.get("bench", {})
    several = len(bench.get("mountings", ())) > 1
    zero = max((width(name) for name in found if name == "offset" or name.startswith("offset of ")), default=0.0)
    c10 = float(material.c10)
    pair68, pair95 = material.c10_interval68 or (c10, c10), material.c10_interval95 or (c10, c10)
    mesh = [float(getattr(priors, name).numbers.get("spread", 0.0)) for name in ("discretisation", "indenter")]
    return Spreads(
        c10=(pair68[1] - pair68[0]) / (2 * c10), low=pair95[0] / c10, high=pair95[1] / c10,
        mesh=float(np.linalg.norm(mesh)), noise=middle("noise"), touch=float(np.hypot(middle("scatter"), zero)),
        seating=SEATING if several else 0.0, tilt=_of_tilt(found, bench.get("by_tilt", {})),
    )  # fmt: skip


def _of_tilt(found: Mapping[str, Any], by_tilt: Mapping[str, float]) -> dict[str, float]:
    """Standard deviation of each indenter's force, relative, by the posterior of the mounting whose tilt does most.

    by_tilt: change of force per square degree, relative, by indenter (`calibration.tilts`).
    """
    of_square = [0.0]
    for name, row in found.items():
        if name.split(" of ")[0] in ("tilt_x", "tilt_y"):
            low, high = row["interval68"]
            of_square.append(abs(high**2 - low**2) / 2.0 + ((high - low) / 2.0) ** 2)
    return {indenter: change * max(of_square) for indenter, change in by_tilt.items()}


def compare_forces(rows: Sequence[Mapping[str, Any]], of: Spreads, used: Collection[str]) -> list[Compared]:
    """Presses that have both a label and a force reading, in the order of the page's rows.

    That of the zero comes from the touch error times the slope of force over depth; that of friction is of the normal
    force's part of the total one.
    """
    found = []
    for row in rows:
        label, sensor = row.get("label_fz"), row.get("measured_fz")
        if label is None or sensor is None or not np.isfinite([label, sensor]).all() or not label or not sensor:
            continue
        label += row["outside_fz"]
        depth = max(-(row["z0_mm"] + row["dz_mm"]), 0.05)
        total = np.linalg.norm([row.get(f"label_{axis}") or 0.0 for axis in ("fx", "fy", "fz")])
        errors = {
            "sensor": of.noise,
            "mesh": of.mesh * sensor,
            "material": of.c10 * sensor,
            "friction": float(np.nan_to_num(row.get("friction_error_n") or 0.0))
            * abs(label)
            / max(total, abs(label)),
            "zero": STEEPEST * sensor / depth * of.touch,
            "tilt": of.tilt.get(row["indenter"], 0.0) * sensor,
            "seating": of.seating * sensor,
        }
        low, high = sorted((label * of.low, label * of.high))
        parts = {name: float(error) ** 2 for name, error in errors.items()}
        found.append(Compared(row["id"], row["indenter"], label, low, high, sensor, parts, row["id"] in used))
    return found


def force_rows(presses: Sequence[Compared]) -> list[list]:
    """Rows of the table under COMPARED."""
    return [[p.name, p.indenter, p.label, p.low, p.high, p.sensor, f"{p.ratio:.3f}", f"{p.deviations:+.1f}",
             *p.fractions(), "used" if p.used else ""] for p in presses]  # fmt: skip


def force_sentences(presses: Sequence[Compared]) -> list[str]:
    """Sentences on the ratio of labels to the force sensor, and on presses that differ by more than NAMED."""
    held = [p for p in presses if not p.used and abs(p.sensor) >= LEAST_N]
    said = []
    if held:
        low, middle, high = np.quantile([p.ratio for p in held], [0.05, 0.5, 0.95])
        said.append(
            f"Normal force of the label, with what lies outside the image, over the force sensor's, {len(held)} presses above"
            f" {LEAST_N:g} N that the calibration did not use: median {middle:.3f}, 5 to 95 % {low:.3f} to {high:.3f}."
        )
    odd = [p for p in presses if abs(p.deviations) > NAMED]
    for p in sorted(odd, key=lambda p: -abs(p.deviations)):
        parts = [f"{part} {name}" for name, part in zip(PARTS, p.fractions(), strict=True) if part != "0%"]
        said.append(
            f"{p.name} ({p.indenter}): the label says {p.label:.2f} N ({p.high:.2f} to {p.low:.2f} by the interval of C10), the"
            f" force sensor {p.sensor:.2f} N, {abs(p.deviations):.1f} standard deviations apart. The expected variance"
            f" is {', '.join(parts)}: check its row, indenter and touch."
        )
    return said
