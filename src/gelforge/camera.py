"""A network behind a camera's frame: forces in images of any size, crop and orientation of a GelSight Mini's driver."""

from dataclasses import replace

import numpy as np

from gelforge.networks.checkpoint.modelfile import ForceModel
from gelforge.networks.inference.predictor import Predictor
from gelforge.networks.inference.sensorprofile import AS_READ, Gain
from gelforge.networks.preprocess.slopetable import SlopeTable
from gelforge.records.cameraframe import CameraFrame, camera_frame
from gelforge.records.forcereading import ForceReading

BLUE_FIRST = "red and blue seem to be exchanged in the no-contact image: give all images in RGB, not in OpenCV's BGR"


class CameraPredictor(Predictor):
    """Predicts as `Predictor` does, from images that are brought to the network's frame first (records.cameraframe).

    frame: how they are turned and cropped, found in the no-contact image; None beside a network that reads none.
    """

    def __init__(
        self,
        model: ForceModel,
        nocontact: np.ndarray | None = None,
        gain: Gain = AS_READ,
        device: str = "cpu",
        threads: int = 1,
        table: SlopeTable | None = None,
    ) -> None:
        self.frame: CameraFrame | None = None
        if nocontact is not None and model.needs_nocontact:
            rows, cols = model.metadata["image"]
            self.frame = camera_frame(nocontact, (rows, cols))
            nocontact = self.frame(nocontact)
        super().__init__(model, nocontact, gain, device, threads, table)
        if self.frame and self.frame.blue_first and not self.fault:
            self.fault = BLUE_FIRST

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
