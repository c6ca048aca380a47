"""The images of one dataset's log: what is kept of each to judge all of them together."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.evidence.imprints import Seen, Window, imprint
from gelforge.geometry.solids import Indenter
from gelforge.labelling.sensor import Sensor
from gelforge.reading.faults import log_image_fault, nocontact_fault, rim_signs
from gelforge.reading.pair import NoContact, Prepared
from gelforge.records.image import read_image, read_logged_image
from gelforge.records.press import PosedPress, PressRecord

KEEP = "or set judge_images = false under [params.poses] in dataset.toml to use the images as they are"


def nocontact_path(data: Path, name: str) -> Path:
    """Where the no-contact image of a sensor lies."""
    return data / "nocontact" / f"{name}.png"


def read_nocontact(data: Path, name: str, size: tuple[int, int]) -> np.ndarray | None:
    """The no-contact image (h, w, 3) uint8 RGB of a sensor, or None; BadInput if its size (width, height) differs."""
    path = nocontact_path(data, name)
    return read_image(path, size, "restore it, or remove it") if path.exists() else None


def rim_of(seen: Prepared) -> np.ndarray:
    """Median motion of the rim's markers, in pitches, and fraction of them that is lost or looks different, (2,)."""
    assert seen.nocontact is not None
    markers = seen.nocontact.markers
    signs = rim_signs(markers, seen.tracks)
    return np.array([signs.rim_px / max(markers.printed.pitch, 1.0), signs.rim_lost])


class LogImages:
    """Judges the images of presses against the no-contact images of their sensors, DATA/nocontact/SENSOR.png.

    sensors: by name, at least those of the presses. A faulty no-contact image raises BadInput at the first press of
    its sensor.
    """

    def __init__(self, data: Path, sensors: Mapping[str, Sensor]) -> None:
        self.data, self.sensors = data, sensors
        self._known: dict[str, tuple[NoContact, Window] | None] = {}

    def _of(self, name: str) -> tuple[NoContact, Window] | None:
        if name not in self._known:
            self._known[name] = self._read(name)
        return self._known[name]

    def _read(self, name: str) -> tuple[NoContact, Window] | None:
        sensor = self.sensors.get(name)
        picture = None if sensor is None else read_nocontact(self.data, name, sensor.image)
        if picture is None or sensor is None:
            return None
        nocontact = NoContact(picture, picture.shape[:2], None)
        fault = nocontact_fault(nocontact, {})
        if fault:
            raise BadInput(f"{nocontact_path(self.data, name)}: {fault}. Record it anew, {KEEP}")
        return nocontact, Window(sensor)

    def fault(self, press: PressRecord) -> str:
        """Why the image of a press is not of its sensor; empty where it may be, or there is no no-contact image."""
        known = self._of(press.sensor_id)
        if known is None or not press.image:
            return ""
        nocontact, window = known
        return log_image_fault(nocontact.lit(read_logged_image(self.data, press.image, window.sensor.image)))

    def see(self, press: PosedPress, body: Indenter) -> Seen | None:
        """What is kept of the image of a press, with its fault; None without an image or a no-contact image."""
        known = self._of(press.sensor_id)
        if known is None or not press.image:
            return None
        nocontact, window = known
        image = read_logged_image(self.data, press.image, window.sensor.image)
        path = press.press
        seen = nocontact.lit(image)
        return Seen(
            row=press.row,
            sample_id=press.sample_id,
            sensor=press.sensor_id,
            indenter=press.indenter,
            fault=log_image_fault(seen),
            measured=imprint(seen),
            expected=window.expected(body, path),
            centre=window.place(path),
            mm=window.mm,
            rim=rim_of(seen),
        )
