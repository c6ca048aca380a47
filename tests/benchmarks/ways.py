"""The two ways in which the benchmark of real pictures reads them."""

from collections.abc import Callable, Sequence

import numpy as np

from gelforge.networks.modelfile import SensorNet, Trained, predict_images
from gelforge.networks.placement import UNPLACED
from gelforge.networks.sitting import place_sitting
from gelforge.networks.use import Untouched, fit_size, predict_one

Way = Callable[[np.ndarray], np.ndarray]  # a picture (h, w, 3) to forces (3, rows, cols) N


def as_used(trained: Trained, untouched: np.ndarray, sitting: Sequence[np.ndarray] = ()) -> Way:
    """How `predict` reads the pictures of a sitting, or, where fewer than four are named, one picture by itself."""
    one = Untouched(trained, untouched)
    placement = place_sitting(one, sitting)
    return lambda image: predict_one(one, image, placement)[1]


def as_it_lies(trained: Trained, untouched: np.ndarray) -> Way:
    """How `predict` reads a picture whose gel it takes to sit as in the no-contact image."""
    one = Untouched(trained, untouched)
    return lambda image: predict_one(one, image, UNPLACED)[1]


def bare(trained: Trained, untouched: np.ndarray, _sitting: Sequence[np.ndarray] = ()) -> Way:
    """The network alone on the two pictures as they are."""
    reader = SensorNet(trained, fit_size(untouched, trained.about["image"])[0]).eval()
    return lambda image: predict_images(reader, image[None])[0]
