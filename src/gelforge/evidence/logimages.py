"""The images of one dataset's log: what is kept of each to judge all of them together."""

import contextlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.evidence.imprints import Seen, Window, imprint, shading
from gelforge.geometry.solids import Indenter
from gelforge.labelling.sensor import Sensor
from gelforge.reading.faults import Asked, nocontact_fault, pair_fault
from gelforge.reading.frame import ImageFrame, as_shipped
from gelforge.reading.pair import NoContact, Pair
from gelforge.records.image import read_image, read_logged_image
from gelforge.records.press import PressRecord

WIDTH = 320  # px at which images are judged: what a network of Minis reads
KEEP = "or set judge_images = false under [params.poses] in dataset.toml to use the images as they are"


def nocontact_path(data: Path, name: str) -> Path:
    """Where the no-contact image of a sensor lies."""
    return data / "nocontact" / f"{name}.png"


def read_nocontact(data: Path, name: str, size: tuple[int, int]) -> np.ndarray | None:
    """The no-contact image (h, w, 3) uint8 RGB of a sensor, or None; BadInput if its size (width, height) differs."""
    path = nocontact_path(data, name)
    return read_image(path, size, "restore it, or remove it") if path.exists() else None


def rim_of(pair: Pair) -> np.ndarray:
    """Median motion of the rim's markers, in pitches, and fraction of them that is lost or looks different, (2,)."""
    assert pair.nocontact is not None
    markers = pair.nocontact.markers
    if not markers.rim.any():
        return np.zeros(2)
    moved = np.hypot(*pair.tracks.motion[markers.rim & pair.tracks.found].T)
    lost = float(pair.tracks.unlike[markers.rim].mean())
    return np.array([float(np.median(moved)) / max(markers.printed.pitch, 1.0) if len(moved) else 0.0, lost])


class LogPairs:
    """Compares images of a log with the no-contact image of their sensor (`reading.pair`).

    nocontact: (h, w, 3) uint8 RGB. Images wider than WIDTH are reduced to it. `logged` has the no-contact image as the camera
    sees it, `judged` as a reader with the shipped network sees it; mostly both are one.
    """

    def __init__(self, nocontact: np.ndarray) -> None:
        height, width = nocontact.shape[:2]
        scale = min(1.0, WIDTH / width)
        self._frame = ImageFrame((max(1, round(scale * height)), max(1, round(scale * width))), (height, width))
        rest, size = self._frame(nocontact), self._frame.size
        self.logged = self.judged = NoContact(rest, size)
        with contextlib.suppress(BadInput):  # it shows too little of the gel for that network
            seen = NoContact(rest, size, as_shipped(size))
            self.judged = self.logged if seen.frame.as_logged else seen

    def __call__(self, image: np.ndarray) -> Pair:
        """An image (h, w, 3) uint8 RGB beside the no-contact image, as faults are judged."""
        return self.judged.compare(self.judged.frame(self._frame(image)))

    def as_logged(self, image: np.ndarray, pair: Pair) -> Pair:
        """The same where the camera saw it: without registration of the gel, turn and zoom; pair: the judged one."""
        if self.judged is self.logged and not pair.shift.any():
            return pair
        return self.logged.under_its_light(self._frame(image))


class LogImages:
    """Judges the images of presses against the no-contact images of their sensors, DATA/nocontact/SENSOR.png.

    sensors: by name, at least those of the presses. A faulty no-contact image raises BadInput at the first press of
    its sensor.
    """

    def __init__(self, data: Path, sensors: Mapping[str, Sensor]) -> None:
        self.data, self.sensors = data, sensors
        self._known: dict[str, tuple[LogPairs, Window] | None] = {}

    def _of(self, name: str) -> tuple[LogPairs, Window] | None:
        if name not in self._known:
            self._known[name] = self._read(name)
        return self._known[name]

    def _read(self, name: str) -> tuple[LogPairs, Window] | None:
        sensor = self.sensors.get(name)
        picture = None if sensor is None else read_nocontact(self.data, name, sensor.image)
        if picture is None or sensor is None:
            return None
        compare = LogPairs(picture)
        fault = nocontact_fault(compare.judged, Asked.LOG)
        if fault:
            raise BadInput(f"{nocontact_path(self.data, name)}: {fault}. Record it anew, {KEEP}")
        return compare, Window(sensor)

    def fault(self, press: PressRecord) -> str:
        """Why the image of a press is not of its sensor; empty where it may be, or there is no no-contact image."""
        known = self._of(press.sensor_id)
        if known is None or not press.image:
            return ""
        compare, window = known
        return pair_fault(compare(read_logged_image(self.data, press.image, window.sensor.image)), Asked.LOG)

    def shading(self, press: PressRecord) -> tuple[np.ndarray, Window] | None:
        """Signed change of the image of a press (30, 40, 3), and the window of its sensor; None as in `see`."""
        known = self._of(press.sensor_id)
        if known is None or not press.image:
            return None
        compare, window = known
        image = read_logged_image(self.data, press.image, window.sensor.image)
        return shading(compare.as_logged(image, compare(image))), window

    def see(self, press: PressRecord, body: Indenter) -> Seen | None:
        """What is kept of the image of a press, with its fault; None without an image or a no-contact image."""
        known = self._of(press.sensor_id)
        if known is None or not press.image:
            return None
        compare, window = known
        image, path = read_logged_image(self.data, press.image, window.sensor.image), press.press
        pair = compare(image)
        logged = compare.as_logged(image, pair)
        return Seen(
            row=press.row,
            sample_id=press.sample_id,
            sensor=press.sensor_id,
            indenter=press.indenter,
            fault=pair_fault(pair, Asked.LOG),
            measured=imprint(logged),
            expected=window.expected(body, path),
            centre=window.place(path),
            mm=window.mm,
            rim=rim_of(logged),
        )
