"""Branch calibrate: pictures of the posterior, drawn beside the stages that follow it."""

from argparse import Namespace
from pathlib import Path

import numpy as np

from gelforge.flow.cli import stage
from gelforge.flow.files import read_json, write_json
from gelforge.flow.layout import Layout
from gelforge.reporting.cornerplots import corner_plot, predictive_plot, trace_plot

VERSION = 1
# Names of the pictures after the target's stem, in the order of the report, and what they show.
CAPTIONS = {
    "predictive": "Readings beside what the posterior predicts of them.",
    "corner": "Posterior of C10 and of the parameters that correlate most with it, and of every two of them.",
    "trace": "Walkers of the chain.",
}


def draw(path: Path, folder: Path) -> dict[str, str]:
    """Draw the pictures of what a calibration wrote; returns their captions by file name in `folder`."""
    with np.load(path, allow_pickle=False) as read:
        of = {name: read[name] for name in read.files}
    files = {name: f"plots.{name}.png" for name in CAPTIONS}
    bands = [
        (str(name), of[f"band{k}"][0], of[f"band{k}"][1:], *of[f"measured{k}"]) for k, name in enumerate(of["bands"])
    ]
    predictive_plot(folder / files["predictive"], bands, of["observed"], of["mean"], of["scale"], of["ids"])
    corner_plot(folder / files["corner"], of["labels"].tolist(), of["draws"].astype(float))
    trace_plot(folder / files["trace"], of["labels"].tolist(), of["trace"], of["steps"], int(of["burn"]))
    return {files[name]: caption for name, caption in CAPTIONS.items()}


@stage(Layout.plots)
def main(args: Namespace) -> None:
    summary = args.of.calibration()
    failed = "failed" in read_json(summary)
    write_json(args.out, {} if failed else draw(summary.with_suffix(".draws.npz"), args.out.parent))


if __name__ == "__main__":
    main.exit()
