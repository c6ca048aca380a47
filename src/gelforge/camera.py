"""A network behind a camera's frame: forces in images of any size, crop and orientation of a GelSight Mini's driver."""

from dataclasses import replace

import numpy as np

from gelforge.networks.inference.predictor import Predictor
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
