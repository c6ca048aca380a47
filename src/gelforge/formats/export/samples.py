"""A dataset of stage 60, as every export reads it, with the units, frame and calibration of its numbers."""

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import read_json
from gelforge.flow.layout import command_for
from gelforge.records.axes import AXES
from gelforge.records.image import stays_inside
from gelforge.records.regular import file_fault
from gelforge.records.rowfile import map_array
from gelforge.records.samplefile import DatasetSample, read_samples
from gelforge.records.table import read_table

SUFFIXES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}
FRAME = "gel: origin on the apex of the undeformed gel, x the short side, y the long side, z out of the gel; mm, N"


@dataclass(frozen=True)
class Sample:
    """One image with its label.

    row, record: its row of samples.csv as text and parsed. picture, media_type: the encoded image. label: (3, rows,
    cols) N per cell.
    """

    row: dict[str, str]
    record: DatasetSample
    picture: bytes
    media_type: str
    label: np.ndarray

    @property
    def name(self) -> str:
        return self.row["sample_id"]

    @property
    def cells(self) -> dict[str, str | float | None]:
        """The row with numbers parsed, None where unknown."""
        numbers = {name: value for name, value in self.record.numbers().items() if name in self.row}
        return self.row | {name: None if math.isnan(value) else value for name, value in numbers.items()}

    def wrench(self) -> list[float]:
        """Total force and moment about the gel's apex along gel x, y, z, (6,) N and N m, as the dataset states them."""
        return self.record.wrench.tolist()


@dataclass(frozen=True)
class Samples:
    """All samples of a dataset, and what they share.

    data: data/DATASET, whose images are copied unchanged. dataset: 60_dataset/RES. sensors: sensors.json.
    """

    data: Path
    dataset: Path
    rows: list[dict[str, str]]
    records: list[DatasetSample]
    labels: np.ndarray
    info: dict
    sensors: dict

    @classmethod
    def open(cls, data: Path, dataset: Path, sensors: Path) -> "Samples":
        """Open a dataset; BadInput where it is missing, inconsistent or without images."""
        hint = command_for("dataset", dataset)
        for name in ("samples.csv", "labels.npy", "dataset.json"):
            if not (dataset / name).exists():
                raise BadInput(f"{dataset}: {name} is missing; make it with `{hint}`, RES being the grid you want")
        rows, records = read_table(dataset / "samples.csv", hint), read_samples(dataset / "samples.csv")
        if not rows or not any(row.get("image") for row in rows):
            raise BadInput(f"{dataset}: holds no sample with a picture; fill the log's column `image` and run {hint}")
        labels = map_array(dataset / "labels.npy")
        if len(labels) != len(rows):
            raise BadInput(f"{dataset}: {len(labels)} labels for {len(rows)} samples; remove it and run {hint}")
        return cls(data, dataset, rows, records, labels, read_json(dataset / "dataset.json"), read_json(sensors))

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[Sample]:
        return (self.sample(at) for at in range(len(self)))

    def sample(self, at: int) -> Sample:
        """One sample; BadInput where its image is missing, or lies outside the dataset's folder."""
        row = self.rows[at]
        path = self.data / row["image"]
        if not stays_inside(self.data, row["image"]):
            raise BadInput(
                f"{self.data}/log.csv: image {row['image']!r} points outside the dataset's folder; give a path inside it"
            )
        media_type = SUFFIXES.get(path.suffix.lower())
        if media_type is None or file_fault(path):
            raise BadInput(f"{path}: is not a readable PNG or JPEG of sample {row['sample_id']}; restore it")
        return Sample(row, self.records[at], path.read_bytes(), media_type, np.asarray(self.labels[at]))

    def least_bytes(self) -> int:
        """Total size in bytes of the image files, which every format copies unchanged; missing ones count as 0."""
        paths = (self.data / row["image"] for row in self.rows)
        return sum(path.stat().st_size for path in paths if path.is_file())

    @cached_property
    def frames_of_presses(self) -> list[list[int]]:
        """Row indices of each press, presses in order of their first row.

        Rows of one split and sensor that share a press_id are one press; a row without a press_id is a press of its
        own.
        """
        found: dict[tuple, list[int]] = {}
        for at, row in enumerate(self.rows):
            name = row.get("press_id", "")
            found.setdefault((row["split"], row["sensor_id"], name) if name else (at,), []).append(at)
        return list(found.values())

    @cached_property
    def grid(self) -> tuple[int, int]:
        return self.labels.shape[2], self.labels.shape[3]

    def facts(self) -> dict:
        """Units, frame, sensors and calibration."""
        named = {row["sensor_id"] for row in self.rows}
        return {
            "dataset": self.info["name"],
            "grid": list(self.grid),
            "image": self.info["image"],
            "units": {
                "forces": "N per cell",
                "total": "N",
                "moment": "N m about the origin of the frame",
                "pose": "mm and degrees",
            },
            "channels": [f"force along gel {axis}" for axis in AXES],
            "signs": "compression is negative z; force that acts on the gel, as FEATS",
            "frame": FRAME,
            "sensors": {name: self.sensors[name] for name in sorted(named & self.sensors.keys())},
            "calibration": {name: value for name, value in self.info.items() if name.startswith("c10")},
        }

    def facts_text(self) -> str:
        """The facts as JSON."""
        return json.dumps(self.facts(), sort_keys=True)
