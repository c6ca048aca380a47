"""Compare networks with FEATS' published errors, in the metrics of FEATS' own evaluation.

Numbers: Helmut et al., IROS 2025 (arXiv:2411.03315), tables of results and ablation; the paper gives no standard
deviations for its third test, and no errors per cell for the ablation. Metrics: feats-ai/feats, evaluate.py, which
leaves out images of presses of 40 N and more.
"""

import numpy as np

from gelforge.records.axes import CHANNELS
from gelforge.records.samplefile import TEST, UNSEEN_INDENTER, UNSEEN_SENSOR

SENSOR = "feats_mini"  # sensor of datasets with the published tests
STRONGEST_N = 40.0
TESTS = {TEST: "known indenters", UNSEEN_INDENTER: "unseen indenters", UNSEEN_SENSOR: "another sensor"}
UNET = "U-net 24 x 32 (paper)"
# Mean absolute errors of total force and of force per cell, N, along gel x, y, z (the paper prints y, x, z), and
# standard deviations where given.
PAPER: dict[str, dict[tuple[str, str], tuple[str, str, str]]] = {
    UNET: {
        (TEST, "total"): ("0.230 ± 0.341", "0.293 ± 0.417", "0.799 ± 1.014"),
        (TEST, "cell"): ("0.0010", "0.0010", "0.0030"),
        (UNSEEN_INDENTER, "total"): ("0.219 ± 0.284", "0.301 ± 0.378", "1.186 ± 1.300"),
        (UNSEEN_INDENTER, "cell"): ("0.0013", "0.0014", "0.0042"),
        (UNSEEN_SENSOR, "total"): ("0.25", "0.23", "1.79"),
    },
    "ResNet-34 (paper)": {(TEST, "total"): ("0.083", "0.077", "1.513")},
    "three single U-nets (paper)": {(TEST, "total"): ("0.401", "0.426", "0.783")},
    "U-net 12 x 16 (paper)": {(TEST, "total"): ("0.163", "0.206", "0.761")},
    "U-net 48 x 64 (paper)": {(TEST, "total"): ("0.272", "0.338", "1.037")},
}
NOTHING = ("-", "-", "-")


def published_errors(predicted: np.ndarray, labels: np.ndarray) -> dict | None:
    """Errors of one test, defined as in FEATS' own evaluation; None where no press is below STRONGEST_N.

    predicted, labels: (n, 3, rows, cols) N per cell; if their grids differ, only totals are compared. Each channel
    gets the mean of the absolute error over images, and its standard deviation over images (n - 1).
    """
    target = labels.sum((2, 3), dtype=np.float64)
    kept = target[:, 2] > -STRONGEST_N
    if not kept.any():
        return None
    found = {"n": int(kept.sum()), "total": _each(np.abs(predicted.sum((2, 3), dtype=np.float64) - target)[kept])}
    if predicted.shape == labels.shape:
        found["cell"] = _each(np.abs(predicted - labels).mean((2, 3), dtype=np.float64)[kept])
    return found


def _each(errors: np.ndarray) -> list[list[float]]:
    """Mean and standard deviation of each column of errors (n, 3)."""
    deviation = errors.std(axis=0, ddof=1) if len(errors) > 1 else np.zeros(3)
    return [[float(mean), float(std)] for mean, std in zip(errors.mean(axis=0), deviation, strict=True)]


def comparison(ours: dict[str, dict]) -> dict:
    """A table for the report: title, columns, rows; ours: {network: {split: `published_errors`}}."""
    others = [name for name in PAPER if name != UNET]
    rows = []
    for split, test in TESTS.items():
        for what in ("total", "cell"):
            for axis, channel in enumerate(CHANNELS):
                theirs = {name: errors.get((split, what), NOTHING)[axis] for name, errors in PAPER.items()}
                mine = [_text((errors.get(split) or {}).get(what), axis, what) for errors in ours.values()]
                rows.append([f"{test} ({split})", what, channel, theirs[UNET], *mine, *(theirs[n] for n in others)])
    return {
        "title": "FEATS' published tests: mean absolute error and deviation over pictures, N, presses below 40 N",
        "columns": ["test", "force", "channel", UNET, *ours, *others],
        "rows": rows,
    }


def _text(errors: list | None, axis: int, what: str) -> str:
    """An error ± its standard deviation, as the paper prints them."""
    return "-" if not errors else " ± ".join(f"{value:.{4 if what == 'cell' else 3}f}" for value in errors[axis])
