"""Branch study: error of one network against the presses and the units of a sensor that it learnt from.

Writes JSON and, beside it, the same as CSV and as a chart.
"""

from argparse import Namespace
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.files import publish, read_json, write_csv, write_json
from gelforge.flow.layout import beside
from gelforge.flow.main import command, option
from gelforge.records.axes import CHANNELS
from gelforge.records.splits import TRAINING, VALIDATION
from gelforge.reporting.networkcharts import draw_study

VERSION = 2
WHOLE = "all"


def rows_of(name: str, evaluation: dict) -> list[dict]:
    """What a network that learnt from a part makes of each split: errors of total force, as `predict` reports it."""
    learnt = evaluation["dataset"]
    rows = []
    for split, found in evaluation["splits"].items():
        if split == VALIDATION:  # it chose the epoch
            continue
        row = {
            "part": name,
            "presses": learnt["presses"],
            "units": learnt["units"],
            "images": learnt["samples"][TRAINING],
            "seconds": evaluation["cost"]["seconds"],
            "split": split,
        }
        for axis in CHANNELS:
            error = found["total"][axis]
            row |= {f"{axis}_n": error["mae"], f"{axis}_low_n": error["mae_low"], f"{axis}_high_n": error["mae_high"]}
        rows.append(row)
    return rows


@command(
    option("--whole", type=Path, help="80_evaluate/RES/MODEL.json of the network that learnt from all presses"),
    option("--parts", type=Path, nargs="*", default=[], help="study/RES/MODEL/evaluations/PART.json"),
    option("--out", type=Path),
)
def main(args: Namespace) -> None:
    whole = read_json(args.whole)
    evaluations = {path.name.removesuffix(".json"): read_json(path) for path in args.parts} | {WHOLE: whole}
    for name, evaluation in evaluations.items():
        if evaluation["model"] != whole["model"]:
            raise BadInput(
                f"part {name} was learnt by {evaluation['model']!r}, all presses by {whole['model']!r}: give one network's"
            )
    rows = [row for name, evaluation in evaluations.items() for row in rows_of(name, evaluation)]
    write_csv(beside(args.out, ".csv"), list(rows[0]), rows)
    with publish(beside(args.out, ".png")) as part:
        draw_study(part, rows, whole["model"])
    write_json(args.out, {"model": whole["model"], "rows": rows})
    for row in sorted(rows, key=lambda row: (row["split"], row["presses"])):
        print(f"{row['split']:22s} {row['part']:14s} {row['presses']:5d} presses  {row['grid_z_n']:.3f} N")


if __name__ == "__main__":
    main.exit()
