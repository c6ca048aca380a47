"""What is read of one frame, and readings as JSON lines and CSV."""

import csv
import json
from collections.abc import Iterable
from dataclasses import dataclass

from gelforge.records.forcereading import ForceReading
from gelforge.records.totals import TOTAL_COLUMNS, total_columns
from gelforge.reporting.parts import jpeg, pack

COLUMNS = ("frame", "time_s", *TOTAL_COLUMNS, "flag", "reason", "ms")


@dataclass(frozen=True)
class Reading:
    """One frame: its number, its time, what was predicted from it, and how long that took."""

    frame: int
    time_s: float
    found: ForceReading
    ms: float

    @property
    def flag(self) -> bool:
        """Whether something is wrong with the frame."""
        return self.found.flag

    def row(self) -> dict:
        """Totals and diagnostics as one row."""
        return {
            "frame": self.frame, "time_s": round(self.time_s, 4), **total_columns(self.found),
            "flag": self.found.flag, "reason": self.found.reason, "ms": round(self.ms, 2),
        }  # fmt: skip

    def event(self) -> dict:
        """All that the page shows of it."""
        half, cells = self.found.half_width, self.found.cells
        rounded = None if half is None else [round(float(v), 4) for v in half]
        return self.row() | {"half_width": rounded, "grid": list(cells.shape[1:]), "image": jpeg(self.found.image),
                             "forces": pack({"forces": cells})}  # fmt: skip


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
