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
    contradicts,
    place,
    placed_nearer,
    places_of,
    tells_place,
)
from gelforge.networks.placereader import Places, PlacesOneByOne
from gelforge.networks.use import GIVEN, Judgement, Untouched, predict_one

# Pictures from which the middle of what each tells is nearer to how the gel sits than what one does.
LEAST_SITTING = 4
# Pictures of a sitting, spread over all, that are looked at again once it is known about how the gel sits.
MOST_KEPT = 64
# Of a stream the first LEAST_SITTING pictures are looked at, and then every so manyth: what the last REMEMBERED told is half a
# minute of 30 pictures a second.
LOOKED_AT, REMEMBERED = 15, 64


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
    tells, telling, seen = tells_sitting(untouched), [], Thinned()
    # all are read, because one that cannot be is to be named before anything is written
    for image in images:
        if not tells:
            continue
        sized = untouched.sized(image)
        followed = _follow(untouched, sized)
        if tells_place(untouched.dots(GIVEN), followed):
            telling.append(followed)
            seen.add(sized)
    if len(telling) < LEAST_SITTING:
        return None
    reader, dots = untouched.trained.places, untouched.dots(GIVEN)
    placement = place(reader, dots, telling)
    if not placement.moves:
        return placement
    return placed_nearer(placement, reader, dots, [_follow(untouched, placement.undo(sized)) for sized in seen.kept])


def tells_sitting(untouched: Untouched) -> bool:
    """Whether pictures can tell how the gel sits: against one untouched picture, in a view that shows the gel's rim."""
    return GIVEN in untouched.known and untouched.view.whole


class Stream:
    """Reads the pictures of a sensor as they come, laid on the untouched one as the last of them tell together.

    What a picture tells by itself is off by a part of what contact did in it, and where a gel is pressed hard a small move is
    not believed: forces would jump as a press begins. Where LEAST_SITTING pictures one after the other contradict what those
    before told, the gel was pushed meanwhile, and these are forgotten. Each is read by itself (`predict_one`) where they cannot
    tell how the gel sits: `place_sitting` says where.
    """

    def __init__(self, untouched: Untouched) -> None:
        self._untouched = untouched
        self._reader = (
            untouched.reader_of_places if tells_sitting(untouched) and untouched.dots(GIVEN).known else None
        )
        self._placement = UNPLACED
        self._told: deque[Places] = deque(maxlen=REMEMBERED)
        self._count = self._contradicting = 0  # pictures, and those at last that contradict what the others told

    def read(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray, Judgement]:
        """As `predict_one` of the next picture (h, w, 3) uint8 of any size."""
        if self._reader is None:
            return predict_one(self._untouched, image)
        if self._count < LEAST_SITTING or self._contradicting or self._count % LOOKED_AT == 0:
            self._look(self._reader, self._untouched.sized(image))
        self._count += 1
        return predict_one(self._untouched, image, self._placement)

    def _look(self, reader: PlacesOneByOne, sized: np.ndarray) -> None:
        """Let a picture tell how the gel sits, beside those before it."""
        dots, told = self._untouched.dots(GIVEN), self._tells(reader, sized)
        if told is None:
            return
        pushed = contradicts(dots, told, self._placement)
        self._contradicting = self._contradicting + 1 if pushed else 0
        if self._contradicting == LEAST_SITTING:
            self._told.clear()
            self._contradicting = 0
        self._told.append(told)
        self._placement = self._together()
        if pushed and self._placement.moves and not contradicts(dots, told, self._placement):
            # a picture tells nearer how it lies once it is laid about so
            self._told[-1] = self._tells(reader, sized) or told
            self._placement = self._together()

    def _tells(self, reader: PlacesOneByOne, sized: np.ndarray) -> Places | None:
        """What a picture (h, w, 3) uint8 tells of how it lies, looked at as it is laid now; None where it tells nothing."""
        dots, followed = self._untouched.dots(GIVEN), _follow(self._untouched, self._placement.undo(sized))
        if not tells_place(dots, followed):
            return None
        return as_they_lie(self._placement, places_of(reader, dots, [followed]))

    def _together(self) -> Placement:
        """What the pictures that are remembered tell together."""
        parts = ([getattr(told, name) for told in self._told] for name in ("a", "b", "contact"))
        told = Places(*(np.concatenate(part) for part in parts))
        # one press may last for all of them
        return believed(self._untouched.dots(GIVEN), told, 1, self._placement)


def _follow(untouched: Untouched, sized: np.ndarray) -> Followed:
    """The dots of the untouched picture in an image (h, w, 3) uint8 of its size, under its light."""
    return untouched.dots(GIVEN).follow(untouched.canonical(sized, GIVEN)[0])
