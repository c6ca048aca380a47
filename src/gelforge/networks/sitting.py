"""How the pictures of one sitting lie on the untouched one, told by several together: by all of them, or the last of a stream."""

from collections import deque
from collections.abc import Iterable

import numpy as np

from gelforge.networks.dots import Followed
from gelforge.networks.placement import (
    UNPLACED,
    Placement,
    as_they_lie,
    believed,
    place,
    placed_nearer,
    places_of,
    tells_place,
)
from gelforge.networks.placereader import Places
from gelforge.networks.use import GIVEN, Judgement, Untouched, fit_size, predict_one

# Pictures from which the middle of what each tells is nearer to how the gel sits than what one does.
LEAST_SITTING = 4
MOST_KEPT = 64  # pictures, spread over all, that are looked at again once it is known about how the gel sits
# Every so manyth picture of a stream is looked at for that; of 30 a second the last MOST_KEPT are those of half a minute.
LOOKED_AT = 15


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
    tells = tells_sitting(untouched)
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


def tells_sitting(untouched: Untouched) -> bool:
    """Whether pictures can tell how the gel sits: against one untouched picture, in a view that shows the gel's rim."""
    return GIVEN in untouched.known and untouched.view.zoom == 1.0


class Stream:
    """Reads the pictures of a sensor as they come, laid on the untouched one as the last of them tell together.

    What a picture tells by itself is off by a part of what contact did in it, and where a gel is pressed hard a small move is
    not believed: forces would jump as a press begins. A gel that is pushed meanwhile is followed when half of the pictures
    that are remembered show it.
    """

    def __init__(self, untouched: Untouched) -> None:
        self._untouched, self._reader = untouched, untouched.reader_of_places
        self._placement = UNPLACED if tells_sitting(untouched) and self._reader is not None else None
        self._told: deque[tuple[complex, complex, float]] = deque(maxlen=MOST_KEPT)
        self._count = 0

    def read(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray, Judgement]:
        """As `predict_one` of the next picture (h, w, 3) uint8 of any size."""
        if len(self._told) < LEAST_SITTING or self._count % LOOKED_AT == 0:
            self._look(image)
        self._count += 1
        return predict_one(self._untouched, image, self._placement)

    def _look(self, image: np.ndarray) -> None:
        """Let a picture tell how the gel sits, beside those before it."""
        if self._reader is None or self._placement is None:
            return
        dots, sized = self._untouched.dots(GIVEN), fit_size(image, self._untouched.trained.about["image"])[0]
        followed = _follow(self._untouched, self._placement.undo(sized))
        if not tells_place(dots, followed):
            return
        told = as_they_lie(self._placement, places_of(self._reader, dots, [followed]))
        self._told.append((*told.a, *told.b, *told.contact))
        remembered = Places(*(np.array(part) for part in zip(*self._told, strict=True)))
        # one press may last for all of them
        self._placement = believed(dots, remembered, 1, self._placement)


def _follow(untouched: Untouched, sized: np.ndarray) -> Followed:
    """The dots of the untouched picture in an image (h, w, 3) uint8 of its size, under its light."""
    return untouched.dots(GIVEN).follow(untouched.canonical(sized, GIVEN)[0])
