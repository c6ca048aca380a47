"""Forces in images of one sensor, of any size, crop and orientation of a GelSight Mini's driver: what a Python program reads with."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.networks.inference.predictor import Predictor, load_for_use
from gelforge.networks.inference.sensorprofile import with_profile
from gelforge.records.cameraframe import CameraFrame, camera_frame
from gelforge.records.forcereading import ForceReading

BLUE_FIRST = "red and blue seem to be exchanged in the no-contact image: give all images in RGB, not in OpenCV's BGR"


class CameraPredictor(Predictor):
    """Predicts as `Predictor` does, from images that are brought to the network's frame first (records.cameraframe).

    frame: how they are turned and cropped, found in the no-contact image; None beside a network that reads none.
    """

    frame: CameraFrame | None = None

    def framed(self, nocontact: np.ndarray | None) -> np.ndarray | None:
        """The no-contact image in the network's frame, which is found in it."""
        if nocontact is None or not self.model.needs_nocontact:
            return nocontact
        rows, cols = self.metadata["image"]
        self.frame = camera_frame(nocontact, (rows, cols))
        return self.frame(nocontact)

    def _nocontact_fault(self) -> str:
        return super()._nocontact_fault() or (BLUE_FIRST if self.frame and self.frame.blue_first else "")

    @property
    def text(self) -> str:
        """What is done to images, in one line; empty for nothing."""
        return self.frame.text if self.frame else ""

    def predict(self, image: np.ndarray) -> ForceReading:
        """Read an image (h, w, 3) uint8 RGB of any size."""
        if self.frame is None:
            return super().predict(image)
        reading = super().predict(self.frame(image))
        return replace(reading, reason=self.frame.fault(image) or reading.reason)

    def height(self, image: np.ndarray) -> np.ndarray | None:
        """Height (h / 2, w / 2) mm of the gel's surface in an image (h, w, 3) uint8 RGB of any size (`Predictor.height`)."""
        return super().height(image if self.frame is None else self.frame(image))


def predict(
    image: np.ndarray, nocontact: np.ndarray | None = None, model: Any = None
) -> tuple[np.ndarray, dict[str, Any]]:
    """Predict forces from one image (h, w, 3) uint8 RGB; return (3, rows, cols) N and how far to trust it.

    nocontact: a picture of the same sensor while nothing touches it. model: path; the network that ships where None.
    The second value has what `ForceReading` has, by the same names: its `flag` is True where something is wrong with the
    pictures, and `reason` says what.
    """
    found = Reader(nocontact, model=model)(image)
    return found.cells, vars(found) | {"flag": found.flag}


class Reader:
    """Predicts forces from images of one sensor, NumPy in and out.

    nocontact: picture (h, w, 3) uint8 RGB of the sensor while nothing touches it; may be left out with a profile, which holds
    one. profile: path of a profile that `gelforge sensor` wrote, whose factor the forces are multiplied by. model:
    path of a model; the shipped network where None. device: "cpu", or "cuda" where onnxruntime has it. threads: that one
    image is predicted with. Raises BadInput for pictures that are none of this sensor.
    """

    def __init__(
        self,
        nocontact: np.ndarray | None = None,
        profile: Path | str | None = None,
        model: Any = None,
        device: str = "cpu",
        threads: int = 1,
    ):
        picture = None if nocontact is None else check_image(nocontact)
        path, loaded = None if profile is None else Path(profile), load_for_use(model)
        picture, gain, table = with_profile(path, picture, loaded.metadata)
        self._predictor = CameraPredictor(loaded, picture, gain, device, threads, table)

    def __call__(self, image: np.ndarray) -> ForceReading:
        """Predict one image (h, w, 3) uint8 RGB. Nothing carries over from one image to the next."""
        return self._predictor.predict(check_image(image))

    def height(self, image: np.ndarray) -> np.ndarray | None:
        """Height (h / 2, w / 2) mm of the gel above the unloaded one in an image (h, w, 3) uint8 RGB (`Predictor.height`).

        None without a profile that `gelforge sensor --balls` wrote.
        """
        return self._predictor.height(check_image(image))

    def stream(self, images: Iterable[np.ndarray]) -> Iterator[ForceReading]:
        """Predict images (h, w, 3) uint8 RGB as they come from a camera, one reading each: the same as one by one.

        One that is no image raises BadInput and ends the stream.
        """
        return map(self, images)

    def batch(self, images: Iterable[np.ndarray]) -> list[ForceReading]:
        """Predict images (h, w, 3) uint8 RGB, one reading each: the same as one by one."""
        return [self(image) for image in images]


def check_image(image: np.ndarray) -> np.ndarray:
    """An image (h, w, 3) uint8; anything else raises BadInput."""
    image = np.asarray(image)
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or not image.size:
        raise BadInput(f"an image of shape {image.shape} and type {image.dtype}: give (height, width, 3) uint8 RGB")
    return image
