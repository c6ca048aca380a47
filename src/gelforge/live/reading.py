"""What is read of one frame, and readings as JSON lines and CSV."""

import csv
import json
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gelforge.records.totals import TOTAL_COLUMNS, total_columns
from gelforge.reporting.parts import jpeg, pack

COLUMNS = ("frame", "time_s", *TOTAL_COLUMNS, "flag", "reason", "ms")


@dataclass(frozen=True)
class Reading:
    """One frame: image (h, w, 3) uint8 RGB, forces (3, rows, cols) N per cell, its judgement, and its cost.

    flag, reason, edge_peak: as networks.use.Judgement has them. half_width: (3,) N, half of the 90 % interval of the totals;
    by_dots: (3,) N, what the dots tell by themselves; none where it is not known.
    """

    frame: int
    time_s: float
    image: np.ndarray
    forces: np.ndarray
    flag: bool
    reason: str
    ms: float
    edge_peak: float
    half_width: np.ndarray | None = None
    by_dots: np.ndarray | None = None

    def row(self) -> dict:
        """Totals and judgement as one row."""
        return {
            "frame": self.frame, "time_s": round(self.time_s, 4),
            **total_columns(self.forces, self.half_width, self.by_dots, self.edge_peak),
            "flag": bool(self.flag), "reason": self.reason, "ms": round(self.ms, 2),
        }  # fmt: skip

    def event(self) -> dict:
        """All that the page shows of it."""
        half = None if self.half_width is None else [round(float(v), 4) for v in self.half_width]
        return self.row() | {"half_width": half, "grid": list(self.forces.shape[1:]), "image": jpeg(self.image),
                             "forces": pack({"forces": self.forces})}  # fmt: skip


def write_lines(readings: Iterable[Reading], lines, table) -> tuple[int, int]:
    """Write readings as JSON lines and as CSV to open text streams, either may be none.

    Returns how many there were, and how many of them are flagged.
    """
    writer = csv.DictWriter(table, COLUMNS, lineterminator="\n") if table else None
    if writer:
        writer.writeheader()
    count = flagged = 0
    for reading in readings:
        row = reading.row()
        if lines:
            lines.write(json.dumps(row) + "\n")
            lines.flush()
        if writer:
            writer.writerow(row)
            table.flush()
        count += 1
        flagged += bool(reading.flag)
    return count, flagged
