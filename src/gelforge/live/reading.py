"""Readings of frames, and the check of a no-contact image that was found in a stream."""

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.reading.forcereading import TOTAL_COLUMNS, ForceReading, total_columns
from gelforge.records.film import Frame
from gelforge.reporting.parts import jpeg, pack

# Ratio of predicted force with a frame and the no-contact image exchanged, for frames above DOUBTED_N: at most 1.2 in
# 34 films of real sensors that begin at rest, 2.9 in one that begins in a grasp, 1.2 to 9 in films that begin in
# presses of the rig.
DOUBTED_N, MORE = 1.0, 1.3
CONFIRMED, APART = 3, 5  # checks that must agree, and the frames between them

COLUMNS = ("frame", "time_s", *TOTAL_COLUMNS, "flag", "reason", "ms")


@dataclass(frozen=True)
class Reading:
    """One frame: number, time, prediction, how long that took in ms, and the image (h, w, 3) RGB below the cells."""

    frame: int
    time_s: float
    found: ForceReading
    ms: float
    image: np.ndarray

    def row(self) -> dict:
        """Totals and diagnostics by COLUMNS."""
        return {
            "frame": self.frame, "time_s": round(self.time_s, 4), **total_columns(self.found),
            "flag": self.found.flag, "reason": self.found.reason, "ms": round(self.ms, 2),
        }  # fmt: skip

    def event(self) -> dict:
        """Everything that the page shows of it."""
        half, cells = self.found.half_width, self.found.cells
        rounded = None if half is None else [round(float(v), 4) for v in half]
        return self.row() | {"half_width": rounded, "grid": list(cells.shape[1:]), "image": jpeg(self.image),
                             "forces": pack({"forces": cells})}  # fmt: skip


class StartInDoubt:
    """Checks a no-contact image that was found in a stream: if it shows a press, a released gel reads as one.

    The network predicts less force from a contact that is gone than from one that is there, so in this case it
    predicts more once frame and no-contact image are exchanged.
    """

    def __init__(self, predictor: Any, name: str) -> None:
        self.predictor, self.name = predictor, name
        self.confirmed, self.asked, self.next, self.doubt = 0, 0, 0, ""

    def look(self, number: int, image: np.ndarray, normal: float) -> None:
        """Raise BadInput once CONFIRMED checks in a row show that the stream began in a press.

        image: (h, w, 3) uint8 RGB. normal: its predicted normal force, N.
        """
        if number < self.next or -normal < DOUBTED_N:
            return
        self.next, exchanged = number + APART, self.predictor.exchanged(image)
        self.asked += 1
        self.confirmed = self.confirmed + 1 if exchanged < MORE * normal else 0
        if self.confirmed:
            self.doubt = (
                f"{self.name}: begins in a press: {-normal:.1f} N are predicted for frame {number} with the no-contact image found at its start, and"
                f" {-exchanged:.1f} N with both images exchanged. Start it while nothing touches the sensor, or give a no-contact image with --nocontact"
            )
        if self.confirmed == CONFIRMED:
            raise BadInput(self.doubt)

    def end(self) -> None:
        """Raise BadInput if the stream ends early and its last two checks, or all, show so: one alone may be odd."""
        if self.confirmed > 1 or 0 < self.confirmed == self.asked:
            raise BadInput(self.doubt)


def readings(
    predictor: Any, frames: Iterable[Frame], paced: bool = False, start: StartInDoubt | None = None
) -> Iterator[Reading]:
    """Predict frames.

    paced: wait for each frame's time, as a film is played. start: checks the no-contact image, if it was found in
    them.
    """
    import cv2

    started = None
    for frame in frames:
        now = time.perf_counter()
        started = now - frame.time_s if started is None else started
        if paced:
            time.sleep(max(0.0, started + frame.time_s - now))
        now = time.perf_counter()
        image = cv2.cvtColor(frame.image, cv2.COLOR_BGR2RGB)
        found, shown = predictor.predict_shown(image)
        if start is not None:
            start.look(frame.number, image, float(found.total[2]))
        yield Reading(frame.number, frame.time_s, found, 1e3 * (time.perf_counter() - now), shown)
    if start is not None:
        start.end()
