"""A network at work on one picture of one sensor: as the picture lies, or also turned by half, and the mean of both told.

A press turned by half is a press: its sideways force is reversed and its cells trade places. What a network is off by hangs on
how contact and light lie in the picture, and is another thing both times, so that the mean of both is nearer to the truth than
either (Krizhevsky, Sutskever and Hinton 2012, NeurIPS 25, section 4.1, average so over parts and mirror images of a picture).
The mean over mirror images as well is hardly nearer, and takes twice as long again.
"""

from typing import Protocol

import numpy as np

from gelforge.networks.modelfile import SensorNet, Trained, predict_pooled

# Sideways force, seen from a picture that is turned.
REVERSED = np.array([-1.0, -1.0, 1.0], np.float32)[:, None, None]


class PictureReader(Protocol):
    """What reads the pictures of one sensor."""

    def read(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forces (3, rows, cols) in N per cell of an image (h, w, 3) uint8 RGB, and what is seen in it as a whole, (k,)."""


class OneWay:
    """A network that reads pictures as they lie; untouched: as `SensorNet` takes it."""

    def __init__(self, trained: Trained, untouched: np.ndarray | None) -> None:
        self.net = SensorNet(trained, untouched).eval()

    def read(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        (forces,), (pooled,) = predict_pooled(self.net, image[None])
        return forces, pooled


class BothWays:
    """A network that reads pictures as they lie and turned by half; what is seen as a whole is that of the first."""

    def __init__(self, trained: Trained, untouched: np.ndarray) -> None:
        self.net = SensorNet(trained, np.stack([untouched, turned(untouched)])).eval()

    def read(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        (forces, other), (pooled, _) = predict_pooled(self.net, np.stack([image, turned(image)]))
        return 0.5 * (forces + REVERSED * other[:, ::-1, ::-1]), pooled


def picture_reader(trained: Trained, untouched: np.ndarray | None) -> PictureReader:
    """The reader of a sensor's pictures: both ways by a network that learnt from pictures whose light lay any way.

    One that learnt from its sensor's light alone knows no other: turned pictures would be another sensor's to it. Models of
    before, which say nothing of it, are read one way.
    """
    if untouched is None or not trained.about.get("both_ways", False):
        return OneWay(trained, untouched)
    return BothWays(trained, untouched)


def turned(image: np.ndarray) -> np.ndarray:
    """An image (h, w, 3) uint8 turned by half; by OpenCV, because numpy copies what is turned pixel by pixel."""
    import cv2

    return cv2.rotate(np.ascontiguousarray(image), cv2.ROTATE_180)
