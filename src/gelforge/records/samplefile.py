"""The table of stage 60, samples.csv: each press of a dataset with its label's total and its split."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.records.press import FORCES, KNOWN, POSE, TILT, PressRecord, RawRow, parse, parse_number
from gelforge.records.table import read_table, write_table

# Names of the splits of a dataset: FEATS' own, and tests on indenters and sensors that training never saw.
TRAINING, VALIDATION, TEST = "train", "val", "test"
UNSEEN_INDENTER, UNSEEN_SENSOR, UNSEEN_BOTH = "test_unseen_indenter", "test_unseen_sensor", "test_unseen_both"
SPLITS = (TRAINING, VALIDATION, TEST, UNSEEN_INDENTER, UNSEEN_SENSOR, UNSEEN_BOTH)
HINT = "remove the folder and make the dataset again"
NAMES = ("sample_id", "indenter", "sensor_id", "gel_id")
COLUMNS = (
    *NAMES, "split", "group", *(f"{kind}{name}" for kind in ("", "outside_", "measured_", "true_") for name in FORCES),
    *POSE, "image",
)  # fmt: skip


@dataclass(frozen=True)
class DatasetSample:
    """A press of a dataset; `press.wrench` is the measured force and moment.

    wrench: force and moment about the gel's apex of its label, outside: of what fell outside the image, (6,) N and N m
    along the gel's axes, NaN if unknown. truth: what a virtual rig knows of both, cells by FORCES. group: shared by
    samples that must be in one split.
    """

    press: PressRecord
    wrench: np.ndarray
    outside: np.ndarray
    truth: dict[str, str]
    split: str = ""
    group: str = ""

    @property
    def total(self) -> np.ndarray:
        """Force of its label, (3,) N."""
        return self.wrench[:3]

    def numbers(self) -> dict[str, float]:
        """Every number of the row by column, NaN if unknown."""
        found = {name: float(getattr(self.press, name)) for name in POSE}
        found |= dict(zip(TILT, self.press.tilt, strict=True))
        for at, name in enumerate(FORCES):
            found |= {name: float(self.wrench[at]), f"outside_{name}": float(self.outside[at])}
            true = parse_number(self.truth.get(name, ""))
            found |= {
                f"measured_{name}": float(self.press.wrench[at]),
                f"true_{name}": np.nan if true is None else true,
            }
        return found

    def text(self, column: str) -> str:
        """A text of the row by column: of the press, or `split` or `group`."""
        return str(getattr(self if column in ("split", "group") else self.press, column))

    def cells(self) -> dict[str, Any]:
        """One row of the table."""
        own = self.press.cells()
        row: dict[str, Any] = {name: own[name] for name in (*NAMES, *POSE, *TILT, "image", "press_id")}
        for at, name in enumerate(FORCES):
            row[name] = _rounded(self.wrench[at])
            row[f"outside_{name}"] = _rounded(self.outside[at])
            row[f"measured_{name}"], row[f"true_{name}"] = own[name], self.truth.get(name, "")
        return row | {"split": self.split, "group": self.group}


def _rounded(force: float) -> float | str:
    return "" if np.isnan(force) else round(float(force), 9)


def write_samples(path: str | Path, samples: Sequence[DatasetSample]) -> None:
    """Write the table, whole or not at all."""
    write_table(path, COLUMNS, [sample.cells() for sample in samples])


def read_samples(path: str | Path) -> list[DatasetSample]:
    """Read the table; a row without sample_id or split, or with a malformed number, raises BadInput."""
    return [_sample(path, at, row) for at, row in enumerate(read_table(path, HINT), 2)]


def _sample(path: str | Path, at: int, row: dict[str, str]) -> DatasetSample:
    measured = {name: row.get(f"measured_{name}") or "" for name in FORCES}
    press, wrong = parse(
        RawRow(at, {k: v for k, v in row.items() if k in KNOWN} | measured), str(path), ("sample_id",)
    )
    if press is None or not row.get("split"):
        why = f"{wrong[0].column}: {wrong[0].reason}" if wrong else "its split is missing"
        raise BadInput(f"{path}: row {at}: {why}; {HINT}")
    wrench, outside = (np.array([_force(path, at, row.get(f"{kind}{name}") or "") for name in FORCES])
                       for kind in ("", "outside_"))  # fmt: skip
    truth = {name: row.get(f"true_{name}") or "" for name in FORCES}
    return DatasetSample(press, wrench, outside, truth, row["split"], row.get("group") or "")


def _force(path: str | Path, at: int, text: str) -> float:
    value = parse_number(text) if text else np.nan
    if value is None:
        raise BadInput(f"{path}: row {at}: {text[:40]!r} is not a force; {HINT}")
    return value
