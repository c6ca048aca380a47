"""How the pictures of one sitting lie on the untouched one: told by all of them together, before any of them is read."""

from collections.abc import Iterable

import numpy as np

from gelforge.networks.dots import Followed
from gelforge.networks.placement import Placement, place, placed_nearer, tells_place
from gelforge.networks.use import GIVEN, Untouched, fit_size

# Pictures from which the middle of what each tells is nearer to how the gel sits than what one does.
LEAST_SITTING = 4
MOST_KEPT = 64  # pictures, spread over all, that are looked at again once it is known about how the gel sits


class Thinned:
    """Every so manyth of the pictures that it is given, evenly spread over all, and at most MOST_KEPT of them."""

    def __init__(self) -> None:
        self.kept: list[np.ndarray] = []
        self._given, self._every = 0, 1

    def add(self, picture: np.ndarray) -> None:
        if self._given % self._every == 0:
            self.kept.append(picture)
        if len(self.kept) > MOST_KEPT:
            self.kept, self._every = self.kept[::2], 2 * self._every
        self._given += 1


def place_sitting(untouched: Untouched, images: Iterable[np.ndarray]) -> Placement | None:
    """How pictures of one sitting, (h, w, 3) uint8 of any size, lie on the untouched one a user gave.

    None where none was given, where the view does not show the gel's rim, which the reader of places has not learnt from,
    and of fewer than LEAST_SITTING pictures that tell. images: each is taken once, and at most MOST_KEPT are kept meanwhile.
    """
    tells = GIVEN in untouched.known and untouched.view.zoom == 1.0
    telling, seen = [], Thinned()
    # all are read, because one that cannot be is to be named before anything is written
    for image in images:
        if not tells:
            continue
        sized = fit_size(image, untouched.trained.about["image"])[0]
        followed = _follow(untouched, sized)
        if tells_place(untouched.dots(GIVEN), followed):
            telling.append(followed)
            seen.add(sized)
    if len(telling) < LEAST_SITTING:
        return None
    reader, dots = untouched.trained.places, untouched.dots(GIVEN)
    placement = place(reader, dots, telling)
    if reader is None or not placement.moves:
        return placement
    return placed_nearer(placement, reader, dots, [_follow(untouched, placement.undo(sized)) for sized in seen.kept])


def _follow(untouched: Untouched, sized: np.ndarray) -> Followed:
    """The dots of the untouched picture in an image (h, w, 3) uint8 of its size, under its light."""
    return untouched.dots(GIVEN).follow(untouched.canonical(sized, GIVEN)[0])
