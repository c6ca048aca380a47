"""The two ways in which the benchmark of real pictures predicts them."""

from collections.abc import Callable

import numpy as np

from gelforge.networks.checkpoint.modelfile import ForceModel
from gelforge.networks.inference.predictor import Predictor
from gelforge.networks.preprocess.pair import Prepared

Way = Callable[[np.ndarray], np.ndarray]  # a picture (h, w, 3) to forces (3, rows, cols) N


def as_used(model: ForceModel, nocontact: np.ndarray) -> Way:
    """As `predict` does."""
    predictor = Predictor(model, nocontact)
    return lambda image: predictor.predict(image).cells


def bare(model: ForceModel, nocontact: np.ndarray) -> Way:
    """The network alone on the two pictures as they are, without photometric normalisation and tare."""
    predictor = Predictor(model, nocontact)

    def read(image: np.ndarray) -> np.ndarray:
        seen = predictor.prepare(image)
        return predictor.raw(Prepared(seen.image, seen.image, "", None, seen.nocontact))

    return read
