"""Readings of frames, and the check of a no-contact image that was found in a stream."""

import base64
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gelforge.errors import BadInput
from gelforge.reading.forcereading import TOTAL_COLUMNS, ForceReading, total_columns
from gelforge.reading.reader import Reader
from gelforge.records.film import Frame
from gelforge.records.image import encode_jpeg
from gelforge.reporting.parts import JPEG_QUALITY, pack

# Ratio of predicted force with a frame and the no-contact image exchanged, for frames above DOUBTED_N: at most 1.2 in
# 34 films of real sensors that begin at rest, 2.9 in one that begins in a grasp, 1.2 to 9 in films that begin in
# presses of the rig.
DOUBTED_N, MORE = 1.0, 1.3
CHECKS, APART = 3, 5  # checks whose majority decides, and the frames between them
REPEATED = "the frame is identical to the one before: the camera or its recording stands still"

COLUMNS = ("frame", "time_s", *TOTAL_COLUMNS, "flag", "reason", "ms")


@dataclass(frozen=True)
class Reading:
    """One frame: number, time, prediction, and how long that took in ms."""

    frame: int
    time_s: float
    found: ForceReading
    ms: float

    @cached_property
    def jpeg(self) -> bytes:
        """The image below the cells as JPEG, encoded once for all outputs."""
        return encode_jpeg(self.found.image, JPEG_QUALITY)

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
        return self.row() | {"half_width": rounded, "grid": list(cells.shape[1:]), "image": base64.b64encode(self.jpeg).decode(),
                             "forces": pack({"forces": cells})}  # fmt: skip


class StartInDoubt:
    """Checks a no-contact image that was found in a stream: if it shows a press, a released gel reads as one.

    The network predicts less force from a contact that is gone than from one that is there, so in this case it
    predicts more once frame and no-contact image are exchanged. The majority of the first CHECKS decides, once.
    """

    def __init__(self, reader: Reader, name: str) -> None:
        self.reader, self.name = reader, name
        self.asked, self.next = 0, 0
        self.doubts: list[str] = []

    def look(self, number: int, image: np.ndarray, normal: float) -> None:
        """Check a frame, if it is one to check; BadInput where the last check shows that the stream began in a press.

        image: (h, w, 3) uint8 RGB. normal: its predicted normal force, N.
        """
        if self.asked == CHECKS or number < self.next or -normal < DOUBTED_N:
            return
        self.asked, self.next, other = self.asked + 1, number + APART, exchanged(self.reader, image)
        if other < MORE * normal:
            self.doubts.append(
                f"{self.name}: begins in a press: {-normal:.1f} N are predicted for frame {number} with the no-contact image found at its start, and"
                f" {-other:.1f} N with both images exchanged. Start it while nothing touches the sensor, or give a no-contact image with --nocontact"
            )
        if self.asked == CHECKS:
            self.end()

    def end(self) -> None:
        """BadInput if more than half of the checks show that the stream began in a press."""
        if 2 * len(self.doubts) > self.asked:
            raise BadInput(self.doubts[-1])


def exchanged(reader: Reader, image: np.ndarray) -> float:
    """Normal force in N that a reader predicts with an image (h, w, 3) uint8 and its no-contact image exchanged."""
    if reader.nocontact is None:
        return 0.0
    other = Reader(reader.frame(image), model=reader.model)
    return float(other(reader.nocontact.picture.image).total[2]) * reader.gain.value


def readings(
    reader: Reader, frames: Iterable[Frame], paced: bool = False, start: StartInDoubt | None = None
) -> Iterator[Reading]:
    """Predict frames; one that repeats the frame before is flagged, because it shows no force of now.

    paced: wait for each frame's time, as a film is played. start: checks the no-contact image, if it was found in
    them.
    """
    import cv2

    began, before = None, None
    for frame in frames:
        now = time.perf_counter()
        began = now - frame.time_s if began is None else began
        if paced:
            time.sleep(max(0.0, began + frame.time_s - now))
        now = time.perf_counter()
        image = cv2.cvtColor(frame.image, cv2.COLOR_BGR2RGB)
        found = reader(image)
        if before is not None and np.array_equal(image, before):
            found = replace(found, reason=found.reason or REPEATED)
        elif start is not None:
            start.look(frame.number, image, float(found.total[2]))
        before = image
        yield Reading(frame.number, frame.time_s, found, 1e3 * (time.perf_counter() - now))
    if start is not None:
        start.end()
