"""A dataset in FEATS' published layout: a folder per split, with one .npy file, a pickled dict, per sample."""

from pathlib import Path

import cv2
import numpy as np

from gelforge.formats.featsfile import LabelSample, write_label
from gelforge.records.samplefile import SPLITS, TRAINING, UNSEEN_SENSOR

DEMO = Path(__file__).parents[2] / "data" / "demo" / "images"
FRACTIONS = (0.8, 0.05, 0.05, 0.05, 0.05)  # of the published splits


def publish(folder: Path, count: int, grid: tuple[int, int] = (24, 32)) -> dict[str, int]:
    """Write about `count` samples; return how many each split has.

    Images are the demo's with random shift and brightness, labels a single bump of force. The first sample of the
    training split and that of the unseen sensor are without contact.
    """
    rng = np.random.default_rng(5)
    pictures = [cv2.imread(str(path)) for path in sorted(DEMO.glob("*.png"))]
    counts = {name: max(1, round(fraction * count)) for name, fraction in zip(SPLITS, FRACTIONS)}
    rows, cols = np.mgrid[: grid[0], : grid[1]]
    for name, many in counts.items():
        for k in range(many):
            moved = np.roll(pictures[rng.integers(len(pictures))], rng.integers(-8, 9, 2), (0, 1))
            image = np.clip(moved.astype(int) + rng.integers(-9, 10, 3), 0, 255).astype(np.uint8)[..., ::-1]
            centre = rng.uniform((4, 4), (grid[0] - 4, grid[1] - 4))
            lump = np.exp(-((rows - centre[0]) ** 2 + (cols - centre[1]) ** 2) / 8)
            size = rng.uniform((-0.02, -0.02, -2.0), (0.02, 0.02, -0.05)) * (
                k > 0 or name not in (TRAINING, UNSEEN_SENSOR)
            )
            write_label(folder / name / f"20250101-{k:06d}.npy", LabelSample(image, size[:, None, None] * lump))
    return counts
