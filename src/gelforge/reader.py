"""Forces in images of one sensor: what a Python program reads with."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.networks.inference.predictor import Predictor, load_for_use
from gelforge.networks.inference.sensorprofile import with_profile
from gelforge.records.forcereading import ForceReading


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
        self._predictor = Predictor(loaded, picture, gain, device, threads, table)

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
