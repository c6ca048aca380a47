"""False alarms of the sentences about forces on logs of ordinary benches, and how often they name a real fault.

    python -m tests.benchmarks.goodlogs --logs 400

Simulated logs of 12, 30 and 48 presses, with labels made without a calibration: compliance of the frame 0.002 to
0.02 mm/N, touch found to 0.03 mm, stiffness of the gel to 15 %, indenters and readings to 3 % (standard deviations),
noise of 0.02 to 0.3 N, all within the usual range of the priors.
"""

import re
from argparse import Namespace
from pathlib import Path

import numpy as np

from gelforge.evidence.forces import LogForces
from gelforge.evidence.labels import of_labels
from gelforge.flow.cli import command, option
from tests.support.figures import Figure, publish_figures

# Of shapes on the usual gel: force in N at 1 mm, and exponents of the force in depth, in the gel's thickness, and in
# the indenter's size.
SHAPES = {
    "sphere_10": (4.1, 1.75, -1.0, 0.8), "sphere_15": (5.9, 1.85, -1.1, 0.8), "cuboid_10": (27.0, 1.25, -1.7, 2.4),
    "cylinder_8": (13.0, 1.2, -1.5, 2.3), "triangle_10": (11.0, 1.2, -1.5, 2.3), "bar_5": (26.0, 1.25, -1.6, 1.4),
}  # fmt: skip
PRESSES = (12, 30, 48)
FAULTS = {
    "dz + 0.3 mm": r"0\.[23]\d mm",
    "an indenter 10 % smaller": r"Forces of cuboid_10 are|^$",
    "a gel a fifth thinner": "thinner",
    "a tare of -1.5 N": "along z",
    "pounds-force": "pounds-force",
}


def good_log(rng: np.random.Generator, count: int, fault: str = "") -> tuple[LogForces, np.ndarray, list[str]]:
    """Readings, labels (n, 3) N and indenters of a simulated log."""
    names = [str(name) for name in rng.choice(list(SHAPES), rng.integers(3, 7), replace=False)]
    if "indenter" in fault and "cuboid_10" not in names:
        names[0] = "cuboid_10"
    of = [names[k % len(names)] for k in range(count)]
    depth = rng.uniform(0.3, 1.5, count)
    force, power, thickness, size = np.array([SHAPES[name] for name in of]).T
    depth = np.minimum(depth, (45.0 / force) ** (1 / power))
    c10, own = np.exp(rng.normal(0.0, 0.15)), {name: np.exp(rng.normal(0.0, 0.03)) for name in names}
    scale = c10 * np.array([own[name] for name in of]) * np.exp(rng.normal(0.0, 0.03, count))
    if "thinner" in fault:
        scale = scale * 0.8**thickness
    if "smaller" in fault:
        scale = scale * np.where(np.array(of) == "cuboid_10", 0.9**size, 1.0)
    offset, compliance = rng.normal(0.0, 0.03), rng.uniform(0.002, 0.02)
    rng.standard_normal((60, count))  # not used: it keeps the random numbers below, and so the logs of each seed
    real = 0.5 * depth
    for _ in range(60):  # iterate to the real depth, less than the commanded one because the frame yields
        real = 0.5 * real + 0.5 * np.clip(depth + offset - compliance * scale * force * real**power, 1e-3, None)
    travel = depth * rng.uniform(0.0, 0.4, count) * (rng.random(count) < 0.7)
    heading = rng.uniform(0.0, 2 * np.pi, count)
    path = travel[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
    normal, label = scale * force * real**power, force * depth**power
    aside = np.minimum(0.8 * travel / depth, 0.5)[:, None] * path / np.maximum(travel, 1e-9)[:, None]
    noise = rng.uniform(0.02, 0.3)
    read = np.column_stack([normal[:, None] * aside, -normal]) + noise * rng.standard_normal((count, 3))
    if "tare" in fault:
        read[:, 2] -= 1.5
    if "pounds" in fault:
        read /= 4.44822
    if "dz" in fault:
        depth = depth + 0.3
        label = force * depth**power
    labels = np.column_stack([label[:, None] * aside, -label])
    return LogForces(path, depth, rng.uniform(0, 360, count), read), labels, of


def said(rng: np.random.Generator, count: int, fault: str = "") -> str:
    """The sentences about one log, "" if there are none."""
    log, label, names = good_log(rng, count, fault)
    return " ".join(of_labels(log, label, names))


def rates(logs: int) -> list[Figure]:
    """Frequency of each sentence on good logs of each length, and how often a fault is named on logs that have it."""
    figures = []
    for count in PRESSES:
        rng = np.random.default_rng(count)
        sentences = [said(rng, count) for _ in range(logs)]
        kinds = [" ".join(re.sub(r"[-+]?\d[\d.]*|\b\w+_\d+\b", "", one).split()[:7]) for one in sentences]
        for kind in sorted(set(kinds) - {""}) or ["anything"]:
            figures.append(Figure(f"{count} presses: {kind}", 100 * kinds.count(kind) / logs, "<=", 2.0, "%"))
    for fault, named in FAULTS.items():
        rng = np.random.default_rng(7)
        found = [said(rng, 30, fault) for _ in range(max(20, logs // 4))]
        right = [bool(re.search(named, one)) for one in found]
        wrong = next((one for one, ok in zip(found, right, strict=True) if not ok and one), "")
        figures.append(Figure(f"{fault}: named", 100 * float(np.mean(right)), ">=", 80.0, "%", wrong[:120]))
    return figures


@command(option("--logs", type=int, default=400), option("--out", type=Path, default=None))
def main(args: Namespace) -> None:
    publish_figures(args.out, rates(args.logs))


if __name__ == "__main__":
    main.exit()
