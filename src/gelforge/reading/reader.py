"""The Python interface: predicts forces in images of one sensor."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.reading.forcereading import ForceReading
from gelforge.reading.predictor import Predictor, load_for_use
from gelforge.reading.profile import with_profile


def predict(
    image: np.ndarray, nocontact: np.ndarray | None = None, model: Any = None
) -> tuple[np.ndarray, dict[str, Any]]:
    """Predict forces from one image; for many of one sensor make a `Reader` once.

    Args:
        image: (h, w, 3) uint8 RGB.
        nocontact: picture (h, w, 3) uint8 RGB of the same sensor while nothing touches it.
        model: path of a model; None: the shipped one.

    Returns:
        Force on the gel per cell, (3, rows, cols) N along gel x, y and z, pressing negative; and a dict of
        the attributes of `ForceReading`. Its `flag` is True where something is wrong with the images,
        and `reason` says what.

    Raises:
        BadInput: an invalid image, no no-contact image where the model needs one, or a file that is no model.
    """
    found = Reader(nocontact, model=model)(image)
    return found.cells, vars(found) | {"flag": found.flag}


class Reader:
    """Predicts forces from images of one sensor, NumPy in and out.

    Args:
        nocontact: picture (h, w, 3) uint8 RGB of the sensor while nothing touches it; may be left out with a profile,
            which holds one.
        profile: path of a profile that `gelforge sensor` wrote; its factor multiplies the forces.
        model: path of a model; None: the shipped one.
        device: "cpu", or "cuda" where onnxruntime has it.
        threads: per image.

    Raises:
        BadInput: images that are not of this sensor, or a file that is no profile or no model.
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
        picture, gain = with_profile(path, picture, loaded.metadata)
        self._predictor = Predictor(loaded, picture, gain, device, threads)

    def __call__(self, image: np.ndarray) -> ForceReading:
        """Predict one image; nothing carries over from one to the next.

        Args:
            image: (h, w, 3) uint8 RGB.

        Returns:
            Forces in N, their prediction intervals, and what is wrong with the image.

        Raises:
            BadInput: anything that is no such image.
        """
        return self._predictor.predict(check_image(image))

    def stream(self, images: Iterable[np.ndarray]) -> Iterator[ForceReading]:
        """Predict images as they come from a camera: the same as one by one.

        Args:
            images: each (h, w, 3) uint8 RGB.

        Returns:
            One reading of each, as soon as it is asked for.

        Raises:
            BadInput: anything that is no such image; it ends the stream.
        """
        return map(self, images)

    def batch(self, images: Iterable[np.ndarray]) -> list[ForceReading]:
        """Predict images: the same as one by one.

        Args:
            images: each (h, w, 3) uint8 RGB.

        Returns:
            One reading of each.

        Raises:
            BadInput: anything that is no such image.
        """
        return [self(image) for image in images]


def check_image(image: np.ndarray) -> np.ndarray:
    """An image (h, w, 3) uint8; anything else raises BadInput."""
    image = np.asarray(image)
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or not image.size:
        raise BadInput(f"an image of shape {image.shape} and type {image.dtype}: give (height, width, 3) uint8 RGB")
    return image
