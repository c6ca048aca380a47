"""Labels beside the readings of the bench's force sensor: by how much they differ, and by how much they should."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gelforge.flow.tables import CalibrateTable, MaterialTable

COMPARED = ["press", "indenter", "label (N)", "95 % from", "to", "force sensor (N)", "label / sensor", "deviations",
            "bench", "material", "mesh", "calibration"]  # fmt: skip
LEAST_N = 2.0  # below, the sensor's own noise is a large part of the ratio
NAMED = 3.0  # standard deviations from which a difference is named
STEEPEST = 2.0  # exponent of force over depth, the largest of usual bodies: 1 under a punch, 1.5 under a ball


@dataclass(frozen=True)
class Spreads:
    """Standard deviations: of C10 and of meshes as fractions of a force, noise in N, depth of touch in mm; C10's 95 %.

    low, high: ends of the interval of C10 over its value.
    """

    c10: float
    low: float
    high: float
    mesh: float
    noise: float
    touch: float


@dataclass(frozen=True)
class Compared:
    """Normal force of one press by its label and by the force sensor, N, and variances of their difference, N^2.

    label: with what fell outside the image, which the force sensor feels, too.
    """

    name: str
    indenter: str
    label: float
    low: float
    high: float
    sensor: float
    bench: float
    material: float
    mesh: float
    used: bool

    @property
    def variance(self) -> float:
        return self.bench + self.material + self.mesh

    @property
    def deviations(self) -> float:
        """The difference over its standard deviation."""
        return (self.label - self.sensor) / self.variance**0.5

    @property
    def ratio(self) -> float:
        return self.label / self.sensor

    def fractions(self) -> list[str]:
        """What of the variance the bench, the material and the mesh have."""
        return [f"{part / self.variance:.0%}" for part in (self.bench, self.material, self.mesh)]


def spreads(material: MaterialTable, summary: Mapping[str, Any], calibrate: CalibrateTable) -> Spreads:
    """How uncertain forces are: by the frozen interval of C10, the posterior of the bench, and the priors about meshes.

    summary: of the calibration, empty where there is none; the bench's priors serve then.
    """
    priors, found = calibrate.priors, summary.get("parameters", {})

    def middle(name: str) -> float:
        numbers = getattr(priors, name).numbers
        return float(found[name]["median"] if name in found else numbers.get("median", 0.0))

    c10 = material.c10 if isinstance(material.c10, float) else float(summary.get("c10", {}).get("median", 1.0))
    known = summary.get("c10", {}) if isinstance(material.c10, str) else {}
    pair68 = material.c10_interval68 or known.get("interval68", (c10, c10))
    pair95 = material.c10_interval95 or known.get("interval95", (c10, c10))
    mesh = [float(getattr(priors, name).numbers.get("spread", 0.0)) for name in ("discretisation", "indenter")]
    return Spreads(
        c10=(pair68[1] - pair68[0]) / (2 * c10), low=pair95[0] / c10, high=pair95[1] / c10,
        mesh=float(np.linalg.norm(mesh)), noise=middle("noise"), touch=middle("scatter"),
    )  # fmt: skip


def compare_forces(rows: Sequence[Mapping[str, Any]], of: Spreads, used: Collection[str]) -> list[Compared]:
    """Presses that have a label and a reading, in the order of the page's rows.

    The bench's part is the sensor's noise and the error of touch, which counts by the slope of force over depth.
    """
    found = []
    for row in rows:
        label, sensor = row.get("label_fz"), row.get("measured_fz")
        if label is None or sensor is None or not np.isfinite([label, sensor]).all() or not label or not sensor:
            continue
        label += row["outside_fz"]
        depth = max(-(row["z0_mm"] + row["dz_mm"]), 0.05)
        bench = of.noise**2 + (STEEPEST * sensor / depth * of.touch) ** 2
        low, high = sorted((label * of.low, label * of.high))
        found.append(Compared(row["id"], row["indenter"], label, low, high, sensor, bench, (of.c10 * sensor) ** 2,
                              (of.mesh * sensor) ** 2, row["id"] in used))  # fmt: skip
    return found


def force_rows(presses: Sequence[Compared]) -> list[list]:
    """Rows of the table under COMPARED."""
    return [[p.name, p.indenter, p.label, p.low, p.high, p.sensor, f"{p.ratio:.3f}", f"{p.deviations:+.1f}",
             *p.fractions(), "used" if p.used else ""] for p in presses]  # fmt: skip


def force_sentences(presses: Sequence[Compared]) -> list[str]:
    """Differences of labels and force sensor, and the presses where they are larger than they should be."""
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
        bench, material, mesh = p.fractions()
        said.append(
            f"{p.name} ({p.indenter}): the label says {p.label:.2f} N ({p.high:.2f} to {p.low:.2f} by the interval of C10), the"
            f" force sensor {p.sensor:.2f} N, {abs(p.deviations):.1f} standard deviations apart. Of what explains a difference"
            f" the bench has {bench}, the material {material}, the mesh {mesh}: check its row, its indenter, and its touch."
        )
    return said
