"""Weighing: presses held still on the sensor, and the grams that a person reads off the scale below it.

A film stops at each press that is held and asks for its grams; a camera goes on, and what is typed counts for the
frames of that moment.
"""

import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import write_csv
from gelforge.live.reading import Reading, readings
from gelforge.reading.forcereading import goes_beyond, interval_text
from gelforge.reading.profile import LEAST_N, check_readings, fit_gain, odd_readings
from gelforge.reading.reader import Reader
from gelforge.records.film import Frame
from gelforge.records.image import write_png
from gelforge.records.press import parse_number

GRAMS = 1000.0 / 9.80665  # that a scale shows per newton
HELD = 5  # frames in a row that must have the same predicted force
STEADY, STEADY_N = 0.04, 0.1  # range of these forces: as a fraction, and in N
HELP = "hold a press still, type the scale's grams, Enter; - drops the last reading, an empty line skips, q ends"


@dataclass
class Moment:
    """The last frames of a stream, (h, w, 3) uint8 BGR, and their readings."""

    frames: deque[Frame] = field(default_factory=lambda: deque(maxlen=HELD))
    found: deque[Reading] = field(default_factory=lambda: deque(maxlen=HELD))

    def unsteady(self) -> str:
        """Why the frames show no press that is held still; empty where they do."""
        normal = [-float(one.found.total[2]) for one in self.found]
        if len(normal) < HELD:
            return "too few frames yet"
        if min(normal) < LEAST_N:
            return f"no contact: {max(min(normal), 0.0):.1f} N are predicted"
        if max(normal) - min(normal) > STEADY_N + STEADY * max(normal):
            return f"it moves: {min(normal):.1f} to {max(normal):.1f} N are predicted for the last {HELD} frames"
        return ""

    def fault(self) -> str:
        """Why the frames cannot be weighed; empty where they can."""
        if moves := self.unsteady():
            return moves
        if any(goes_beyond(one.found.edge_peak) for one in self.found):
            return "the image shows only a part of the contact: press nearer to the middle"
        return next((one.found.reason for one in self.found if one.found.flag), "")

    def picture(self) -> np.ndarray:
        """The mean of the frames (h, w, 3) uint8 RGB, which has less noise than any of them."""
        mean = np.mean([frame.image for frame in self.frames], axis=0)
        return np.ascontiguousarray(np.rint(mean).astype(np.uint8)[..., ::-1])


def watched(reader: Reader, frames: Iterable[Frame], moment: Moment) -> Iterator[Reading]:
    """Readings of frames, each kept in `moment` as it comes."""

    def kept() -> Iterator[Frame]:
        for frame in frames:
            moment.frames.append(frame)
            yield frame

    for reading in readings(reader, kept()):
        moment.found.append(reading)
        yield reading


class Weighing:
    """Pictures of presses and their measured forces, written to a folder as they come."""

    def __init__(self, folder: Path, reader: Reader) -> None:
        self.folder, self.reader = folder, reader
        self.names: list[str] = []
        self.measured: list[float] = []
        self.read: list[float] = []

    def add(self, moment: Moment, grams: str) -> str:
        """Add the mean of the frames with the scale's grams; return a message with the factor so far.

        BadInput where they cannot be used.
        """
        if fault := moment.fault():
            raise BadInput(fault)
        value = parse_number(grams)
        if value is None or value <= 0.0:
            raise BadInput(f"{grams!r}: give the scale's grams as a number above 0")
        picture, name = moment.picture(), f"{len(self.names) + 1:02d}.png"
        force, read = value / GRAMS, -float(self.reader(picture).total[2])
        check_readings([name], np.array([force]), np.array([read]))
        write_png(self.folder / name, picture)
        self.names.append(name)
        self.measured.append(force)
        self.read.append(read)
        self._write()
        gain = fit_gain(np.array(self.measured), np.array(self.read))
        text = interval_text(gain.value, (gain.high - gain.low) / 2).lstrip("+")
        return f"{name}: {value:g} g are {force:.2f} N, {read:.2f} N are predicted; factor so far {text}"

    def drop(self) -> str:
        """Forget the last reading; BadInput where there is none."""
        if not self.names:
            raise BadInput("there is no reading to drop")
        name = self.names.pop()
        self.measured.pop(), self.read.pop()
        (self.folder / name).unlink()
        self._write()
        return f"{name}: dropped"

    def _write(self) -> None:
        rows = [{"image": n, "force_n": f"{f:.4f}"} for n, f in zip(self.names, self.measured, strict=True)]
        write_csv(self.folder / "readings.csv", ["image", "force_n"], rows)

    def odd(self) -> dict[str, str]:
        """Readings that contradict most others, by name."""
        return odd_readings(self.names, np.array(self.measured), np.array(self.read)) if len(self.names) > 2 else {}


def ask(weighing: Weighing, moment: Moment, line: str) -> bool:
    """Handle one typed line and print the result; return whether it added a reading."""
    counted = False
    try:
        print(weighing.drop() if line == "-" else weighing.add(moment, line), flush=True)
        counted = line != "-"
    except BadInput as error:
        print(f"not counted: {error}", flush=True)
    for name, fault in weighing.odd().items():
        print(f"{name} contradicts the others: {fault}", flush=True)
    return counted


def typed() -> Iterator[str]:
    """Lines of the terminal until q, its end or Ctrl-C."""
    try:
        for line in sys.stdin:
            if line.strip().lower() == "q":
                return
            yield line.strip()
    except KeyboardInterrupt:
        return


def weigh_film(weighing: Weighing, frames: Iterable[Frame], send: Callable[[Reading], None]) -> None:
    """Play a film, stop at each press that is held, and ask for its grams."""
    moment, lines, asked = Moment(), typed(), False
    for reading in watched(weighing.reader, frames, moment):
        send(reading)
        held = not moment.unsteady()
        if held and not asked:
            where, read = f"frame {reading.frame}, {reading.time_s:.1f} s: held", -float(reading.found.total[2])
            if fault := moment.fault():
                print(f"{where}, but cannot be weighed: {fault}", flush=True)
            else:
                line, counted = None, False
                while line != "" and not counted:
                    print(f"{where}, {read:.2f} N are predicted. Grams?", flush=True)
                    line = next(lines, None)
                    if line is None:
                        return
                    counted = line != "" and ask(weighing, moment, line)
        asked = held


def weigh_camera(weighing: Weighing, frames: Iterable[Frame], send: Callable[[Reading], None]) -> None:
    """Read a camera until the typed lines end; each line counts for the frames at its Enter."""
    moment, lock, over = Moment(), threading.Lock(), threading.Event()
    fault: list[BadInput] = []

    def go_on() -> None:
        try:
            for reading in watched(weighing.reader, frames, fresh):
                with lock:
                    moment.frames, moment.found = deque(fresh.frames, HELD), deque(fresh.found, HELD)
                send(reading)
                if over.is_set():
                    return
        except BadInput as error:
            fault.append(error)

    fresh = Moment()
    camera = threading.Thread(target=go_on, daemon=True)
    camera.start()
    for line in typed():
        if fault or not camera.is_alive():
            break
        with lock:
            now = Moment(deque(moment.frames, HELD), deque(moment.found, HELD))
        if line:
            ask(weighing, now, line)
    over.set()
    camera.join()
    if fault:
        raise fault[0]
