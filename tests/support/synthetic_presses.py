"""Small datasets of stage 60 whose images follow from their labels by an invented law that a network can learn."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from gelforge.flow.files import write_csv, write_json
from gelforge.flow.tables import TrainingTable
from gelforge.learning.pictures import write_pairs
from gelforge.records.press import FORCE
from tests.support.parameters import parameters

SPLITS = ("train", "val", "test", "test_unseen_indenter", "test_unseen_sensor")


def draw_press(rng, image, grid, strength: float = 1.0, shade: float = 1.0, travel: float = 1.0):
    """One image (h, w, 3) uint8 and its label (3, rows, cols): a bump that shades the image and moves its markers.

    strength: factor on the force; 0: no contact. shade, travel: of the sensor, factors on shading and marker motion.
    """
    height, width = image
    place = rng.uniform(0.3, 0.7, 2)
    spread = rng.uniform(0.10, 0.18)
    force = strength * np.array([rng.uniform(-2, 2), rng.uniform(-2, 2), -rng.uniform(1, 20)])

    def bump(rows, cols):
        v, u = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(cols) + 0.5) / cols, indexing="ij")
        return np.exp(-((v - place[0]) ** 2 + (u - place[1]) ** 2) / (2 * spread**2))

    cells = bump(*grid)
    label = force[:, None, None] * cells / cells.sum()
    field = bump(height, width)
    v, u = np.meshgrid(np.arange(height), np.arange(width), indexing="ij")
    pitch, travel = height / 7, travel * height / 60
    du, dv = (u - travel * force[1] * field) / pitch, (v - travel * force[0] * field) / pitch
    markers = np.exp(-(((du % 1) - 0.5) ** 2 + ((dv % 1) - 0.5) ** 2) * 30)
    slope = np.gradient(field, axis=(0, 1))
    light = 120 + shade * 4 * height / 10 * np.stack(
        [slope[0] * force[2], slope[1] * force[2], field * force[2] / height], -1
    )
    picture = light * (1 - 0.8 * markers[..., None]) + rng.normal(0, 1.5, (height, width, 3))
    return np.clip(picture, 0, 255).astype(np.uint8), label.astype(np.float32)


def write_dataset(folder, n=48, image=(240, 320), grid=(24, 32), seed=0, **sensor) -> Path:
    """Write a dataset of `n` presses with all five splits as stage 60; return its folder. sensor: of `draw_press`."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    pairs = [draw_press(rng, image, grid, **sensor) for _ in range(n)]
    labels = np.stack([label for _, label in pairs])
    np.save(folder / "images.npy", np.stack([picture for picture, _ in pairs]))
    np.save(folder / "labels.npy", labels)
    rows = []
    for i, total in enumerate(labels.sum((2, 3))):
        split = "train" if i % 8 < 4 else SPLITS[i % 8 - 3]
        forces = dict(zip(FORCE, total, strict=True))
        measured = {f"measured_{name}": value + 0.1 for name, value in forces.items()}
        true = {f"true_{name}": value for name, value in forces.items()}
        rows.append(
            {
                "sample_id": f"p{i:04d}",
                "indenter": f"ball{i % 3}",
                "sensor_id": "mini0",
                "split": split,
                **forces,
                **measured,
                **true,
            }
        )
    write_csv(folder / "samples.csv", list(rows[0]), rows)
    write_pairs(
        folder,
        np.load(folder / "images.npy"),
        ["mini0"] * n,
        {"mini0": draw_press(rng, image, grid, strength=0.0)[0]},
    )
    about = {"name": "made up", "sensor": "mini0", "nocontact": ["mini0"], "grid": list(grid)}
    write_json(folder / "dataset.json", about)
    return folder


TRAIN = parameters(
    train={
        "epochs": 4, "total_weight": 0.3, "checkpoint_seconds": 0.0, "shift_cells": 1,
        "augment": {"probability": 0.5},
    },
).train  # fmt: skip
SETTINGS = TrainingTable(**{field.name: getattr(TRAIN, field.name) for field in fields(TrainingTable)})


def with_pictures(data, images, nocontact, folder):
    """A dataset (learning.data.Data) with other images and no-contact images by name, compared as stage 60 does.

    folder: empty one for its arrays.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_pairs(folder, images, data.names("sensor_id").tolist(), nocontact)
    pairs, rests, beside = (np.load(folder / f"{name}.npy") for name in ("pairs", "nocontact", "beside"))
    return replace(data, images=images, pairs=pairs, rests=rests, beside=beside, nocontact=nocontact)
