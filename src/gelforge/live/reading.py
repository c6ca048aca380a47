"""What is read of one frame."""

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from gelforge.records.film import Frame
from gelforge.records.forcereading import TOTAL_COLUMNS, ForceReading, total_columns
from gelforge.reporting.parts import jpeg, pack

COLUMNS = ("frame", "time_s", *TOTAL_COLUMNS, "flag", "reason", "ms")


@dataclass(frozen=True)
class Reading:
    """One frame: its number, its time, what was predicted from it, and how long that took."""

    frame: int
    time_s: float
    found: ForceReading
    ms: float

    def row(self) -> dict:
        """Totals and diagnostics by COLUMNS."""
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


def readings(predictor: Any, frames: Iterable[Frame], paced: bool = False) -> Iterator[Reading]:
    """Read frames; paced: not before their time, as a film is shown."""
    import cv2

    started = None
    for frame in frames:
        now = time.perf_counter()
        started = now - frame.time_s if started is None else started
        if paced:
            time.sleep(max(0.0, started + frame.time_s - now))
        now = time.perf_counter()
        found = predictor.predict(cv2.cvtColor(frame.image, cv2.COLOR_BGR2RGB))
        yield Reading(frame.number, frame.time_s, found, 1e3 * (time.perf_counter() - now))
