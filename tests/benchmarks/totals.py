"""Whether total forces alone adapt a network to a sensor whose force maps it never saw: `make benchmark-totals`.

There are two synthetic sensors (tests/support/synthetic_presses.py); the second one shades less, and its markers move
farther. Networks are trained on maps of the first one alone, also on totals of the second one, or also on its maps.
All are tested on unseen presses of the second one.
"""

from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from gelforge.flow.cli import command, option
from gelforge.learning.data import Data, open_data
from gelforge.learning.predictions import predict_rows
from gelforge.stages.train import train
from tests.support.figures import Figure, publish_figures
from tests.support.parameters import with_values
from tests.support.synthetic_presses import SETTINGS, write_dataset

IMAGE, GRID = (48, 64), (6, 8)
OTHER = {"shade": 0.5, "travel": 1.6}  # factors of the second sensor
MODEL = {"kind": "grid", "width": 12, "blocks": 2}
PRESSES = 320
LEARNING = {"epochs": 40, "learning_rate": 4e-3, "total_weight": 1.0, "total_huber": 0.1}


def of_totals(data: Data) -> Data:
    """The same presses with only their total forces as labels."""
    return replace(data, labels=data.labels[:].sum((2, 3), keepdims=True), maps=np.zeros(len(data.table), bool))


@command(
    option("--presses", type=int, default=PRESSES, help="of each sensor"),
    option("--out", type=Path, default=Path("results/benchmarks/totals.json")),
)
def main(args: Namespace) -> None:
    settings = with_values(SETTINGS, **LEARNING)
    with TemporaryDirectory() as folder:
        own, other = (
            open_data(write_dataset(Path(folder) / name, args.presses, IMAGE, GRID, seed, **unit))
            for seed, (name, unit) in enumerate({"own": {}, "other": OTHER}.items(), 1)
        )
        other = replace(other, info=other.info | {"name": "other"})
        rows = np.concatenate([found for name, found in other.splits.items() if name.startswith("test")])
        errors, likeness = {}, {}
        for name, also in {"nothing": [], "totals": [of_totals(other)], "maps": [other]}.items():
            made = train(own, "small", MODEL, settings, also=also)
            forces = predict_rows(made.model, other, rows).forces
            errors[name] = float(np.abs((forces.sum((2, 3), dtype=float) - other.totals(rows))[:, 2]).mean())
            pairs = zip(forces[:, 2], other.labels[rows][:, 2], strict=True)
            likeness[name] = float(np.median([np.corrcoef(a.ravel(), b.ravel())[0, 1] for a, b in pairs]))
    said = ", ".join(f"{name} {error:.2f} N" for name, error in errors.items())
    alike = ", ".join(f"{name} {r:.3f}" for name, r in likeness.items())
    publish_figures(
        args.out,
        [
            Figure("totals alone of another sensor: error of normal force over that of its maps", errors["totals"] / errors["maps"], "<=", 1.3, "", f"{said}; {len(rows)} presses"),
            Figure("the same: correlation of normal maps over that of its maps", likeness["totals"] / likeness["maps"], ">=", 0.97, "", alike),
        ],
    )  # fmt: skip


if __name__ == "__main__":
    main.exit()
