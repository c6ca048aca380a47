"""Stage 80: errors of one trained network in the paper's tables, against labels, force sensors and baselines."""

from argparse import Namespace

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.cli import stage
from gelforge.flow.files import publish, write_json
from gelforge.flow.layout import Layout, beside
from gelforge.flow.params import read_parameters
from gelforge.flow.tables import SHIPPED as SHIPS
from gelforge.records.axes import CHANNELS
from gelforge.records.predictionfile import write_predictions
from gelforge.records.samplefile import TRAINING
from gelforge.reporting import feats_tables
from gelforge.reporting.errortables import tables
from gelforge.reporting.networkcharts import draw_predictions

VERSION = 21


def keep_predictions(path, data, model, predictions: dict) -> None:
    """Write the predictions for all images, including the training images, in the order of samples.csv.

    predictions: those that exist already, from `evaluate`.
    """
    from gelforge.learning.predictions import moments_of, predict_rows

    learnt = data.splits[TRAINING]
    parts = list(predictions.values())
    if TRAINING not in predictions:
        parts.append((learnt, predict_rows(model, data, learnt).forces))
    forces = np.zeros((len(data.table), *parts[0][1].shape[1:]), np.float32)
    for rows, predicted in parts:
        forces[rows] = predicted
    write_predictions(path, data.names("sample_id"), forces, moments_of(data, np.arange(len(forces)), forces))


def paper_table(result: dict) -> str:
    """The paper's table of one evaluation as text: total and per-cell MAE with deviation, N, per split."""
    lines = [f"{'split':22s} {'n':>5s}  " + "".join(f"{'total ' + a:>18s}{'cell ' + a:>20s}" for a in CHANNELS)]
    for name, split in result["splits"].items():
        line = f"{name:22s} {split['n']:5d}  "
        for axis in CHANNELS:
            total, cell = split["total"][axis], (split["cell"] or {}).get(axis)
            line += f"{total['mae']:8.3f} +- {total['std']:6.3f}"
            line += f"{cell['mae']:10.5f} +- {cell['std']:6.5f}" if cell else f"{'-':>20s}"
        lines.append(line)
    return "\n".join(lines)


@stage(Layout.evaluation)
def main(args: Namespace) -> None:
    from gelforge.learning.data import open_data
    from gelforge.learning.evaluate import evaluate
    from gelforge.reading.model import SHIPPED, load_model

    of = args.of
    data = open_data(of.dataset(args.resolution))
    shipped = args.model == SHIPS
    model = load_model(SHIPPED if shipped else of.network(args.resolution, args.model))
    settings = read_parameters(of.parameters("evaluate")).evaluate
    try:
        result, predictions = evaluate(data, model, settings, "the shipped network" if shipped else "")
    except BadInput as error:
        # that a network does not fit a dataset is a result: the report shows it, and the card is refused with it
        print(f"note: not evaluated: {error}")
        for ending in (".png", ".predictions.npz"):
            beside(args.out, ending).unlink(missing_ok=True)
        write_json(args.out, {"failed": str(error)})
        return
    if feats_tables.SENSOR in data.info.get("sensors", ()):
        result["published"] = {
            name: feats_tables.published_errors(predictions[name][1], np.asarray(data.labels[predictions[name][0]]))
            for name in feats_tables.TESTS
            if name in predictions
        }
    print(paper_table(result))
    with publish(beside(args.out, ".png")) as part:
        draw_predictions(part, data, predictions)
    keep_predictions(beside(args.out, ".predictions.npz"), data, model, predictions)
    write_json(args.out, result | {"tables": tables(result)})


if __name__ == "__main__":
    main.exit()
