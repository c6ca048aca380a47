"""How the pictures of one sitting lie on the untouched one: told by all of them together, before any of them is read."""

from collections.abc import Iterable

import numpy as np

from gelforge.networks.dots import Followed
from gelforge.networks.placement import Placement, place, tells_place
from gelforge.networks.use import GIVEN, Untouched, fit_size

# Pictures from which the middle of what each tells is nearer to how the gel sits than what one does.
LEAST_SITTING = 4


def place_sitting(untouched: Untouched, images: Iterable[np.ndarray]) -> Placement | None:
    """How pictures of one sitting, (h, w, 3) uint8 of any size, lie on the untouched one a user gave.

    None where none was given, where the view does not show the gel's rim, which the reader of places has not learnt from,
    and of fewer than LEAST_SITTING pictures that tell. images: each is looked at once and not kept.
    """
    tells = GIVEN in untouched.known and untouched.view.zoom == 1.0
    # all are read, because one that cannot be is to be named before anything is written
    followed = [_follow(untouched, image) if tells else None for image in images]
    telling = [one for one in followed if one is not None and tells_place(untouched.dots(GIVEN), one)]
    if len(telling) < LEAST_SITTING:
        return None
    return place(untouched.trained.places, untouched.dots(GIVEN), telling)


def _follow(untouched: Untouched, image: np.ndarray) -> Followed:
    """The dots of the untouched picture in an image (h, w, 3) uint8 of any size, at its size and under its light."""
    sized = fit_size(image, untouched.trained.about["image"])[0]
    return untouched.dots(GIVEN).follow(untouched.canonical(untouched.view.of(sized), GIVEN)[0])
