"""An image beside the no-contact image of its sensor, as a network reads both, in numpy and OpenCV.

    nocontact = NoContact(picture, (240, 320), learnt)  # once for each sensor
    pair = nocontact.compare(nocontact.frame(image))
    pair.lit.image, pair.nocontact.picture.image  # what the graph reads

`Reader` does this, runs the graph, subtracts what it reads of the no-contact image itself, and multiplies by the factor of a
profile. Stages 15 and 60 compare the images of a log by the same lines.
"""

from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from gelforge.reading.frame import WHOLE, ImageFrame, Learnt, image_frame
from gelforge.reading.light import SAME_LIGHT, Light, Reference, fall_size
from gelforge.reading.markers import MarkerTracker, Tracks, markers_in, rim_shift, shifted_back, spacing
from gelforge.reading.picture import Picture
from gelforge.reading.untouched import touch_of
from gelforge.reading.wear import appeared, painted_over, pale, places_in, printed_in, vanished

NO_SHIFT = np.zeros(2)
NOWHERE = np.zeros((0, 2))
MOST_WORN = 8  # cached no-contact images without vanished markers


class NoContact:
    """The no-contact image of a sensor in the frame of a network, with its light and its markers.

    given: (h, w, 3) uint8 RGB of any size. size: (rows, cols) of the network's input. learnt: view of its training; None:
    images stay as they are, as those of a log do. coloured: whether its images are expected to have colour. rest: what a
    reader predicts for it, N, once it did.
    """

    def __init__(
        self, given: np.ndarray, size: tuple[int, int], learnt: Learnt | None = None, coloured: bool = True
    ) -> None:
        if learnt is None:
            self.frame, markers = ImageFrame(size, size), markers_in(given)
        else:
            self.frame, markers = image_frame(given, size, learnt)
        self.coloured, self.expects_markers = coloured, bool(learnt and learnt.usual)
        self.picture = Picture(self.frame(given), self.frame.shown)
        self.markers = MarkerTracker(self.picture.image, markers.only(np.ones(len(markers.points), bool)))
        self.reference = Reference(self.picture.image, self.frame.shown)
        self.rest: np.ndarray | None = None
        self._worn: dict[bytes, NoContact] = {}

    @cached_property
    def printed(self) -> np.ndarray:
        """Darkness of each of its markers, (n,)."""
        return printed_in(self.markers, self.picture.darkness)

    @cached_property
    def touch(self) -> float:
        """How much it looks as if something touched the gel; above 1 something does."""
        return touch_of(self.picture.image, self.markers, self.frame.shown)

    @cached_property
    def stretch(self) -> float:
        """Ratio of the distances of its markers along u and v, 1 or more; 1 where images are not cropped by their markers."""
        index, used = self.markers.printed.lattice if self.frame.part != WHOLE else (NOWHERE, NOWHERE)
        if not len(used) or not np.ptp(index, axis=0).all():
            return 1.0
        one, other = (spacing(index, self.markers.printed.points[used], axis) for axis in (0, 1))
        return max(one / other, other / one)

    @cached_property
    def pale(self) -> float:
        """Fraction of its markers that absorb less of the light than ink does."""
        return pale(self.markers)

    def itself(self) -> "Pair":
        """This image beside itself; what is read in it is subtracted from all other forces."""
        return self._pair(self.picture, self.picture, SAME_LIGHT, self.frame.shape)

    def compare(self, image: np.ndarray, given: tuple[int, ...] | None = None) -> "Pair":
        """Undo shift of the gel, change of light and wear of an image (h, w, 3) uint8 in the network's frame.

        given: shape of the camera's image, if it is not that of the no-contact image.
        """
        pair = self.under_its_light(image, given)
        if self.frame.shows_rim:  # else it is not known how the gel is mounted
            shift = rim_shift(self.markers, pair.tracks)
            if shift.any():
                seen = self.under_its_light(shifted_back(image, shift), given)
                pair = replace(seen, framed=pair.framed, shift=shift)
        return self._without_worn(pair)

    def under_its_light(self, image: np.ndarray, given: tuple[int, ...] | None = None) -> "Pair":
        """Undo only the change of light of an image (h, w, 3) uint8 in the network's frame."""
        lit, light = self.reference.normalised(image)
        return self._pair(
            Picture(image, self.frame.shown), Picture(lit, self.frame.shown), light, given or self.frame.shape
        )

    def _pair(self, image: Picture, lit: Picture, light: Light, given: tuple[int, ...]) -> "Pair":
        return Pair(image, given, self.frame.shape, self.coloured, lit, self, light, framed=image)

    def _without_worn(self, pair: "Pair") -> "Pair":
        """The same without the markers that only one of the two images shows."""
        tracks, markers = pair.tracks, self.markers
        if not tracks.unlike.any() and not len(markers.empty):
            return pair
        gone = vanished(markers, self.printed, tracks, pair.lit.darkness)
        more = appeared(markers, self.picture.darkness, self.printed, tracks, pair.lit.darkness)
        if not gone.any() and not len(more):
            return pair
        worn = self.without(gone) if gone.any() else self
        places = np.concatenate([places_in(tracks, markers)[gone], more])
        lit, light = worn.reference.normalised(painted_over(pair.image.image, places, markers.diameter))
        return replace(
            pair, lit=Picture(lit, self.frame.shown), nocontact=worn, light=light, places=places, unhidden=pair
        )

    def without(self, gone: np.ndarray) -> "NoContact":
        """The same with the markers `gone`, (n,) bool, painted over. Cached for later images, because wear stays."""
        key = gone.tobytes()
        worn = self._worn.get(key)
        if worn is None:
            worn = copy(self)
            for name in ("printed", "touch", "pale"):
                worn.__dict__.pop(name, None)
            bare = painted_over(self.picture.image, self.markers.points[gone], self.markers.diameter)
            worn.picture, worn.rest = Picture(bare, self.frame.shown), None
            worn.markers = MarkerTracker(bare, self.markers.printed.only(~gone))
            worn.reference = Reference(bare, self.frame.shown)
            if len(self._worn) >= MOST_WORN:
                self._worn.clear()  # threads may share the cache: each of these lines is atomic
            self._worn[key] = worn
        return worn


@dataclass(frozen=True, eq=False)
class Framed:
    """An image in the frame of a network, as one that reads it alone sees it.

    given: shape of the camera's image; expected: of the one that defined the frame. coloured: whether colour is expected.
    """

    image: Picture
    given: tuple[int, ...]
    expected: tuple[int, ...]
    coloured: bool

    @property
    def vanished(self) -> int:
        """Number of markers that only one of the images shows: none, where there is one image."""
        return 0

    def features(self) -> dict[str, np.ndarray]:
        """Values (1, h, w, 3) uint8 RGB of a graph's inputs, by name."""
        return {"image": np.ascontiguousarray(self.image.image[None])}


@dataclass(frozen=True, eq=False)
class Pair(Framed):
    """An image, registered, and the no-contact image of its sensor, compared.

    lit: the image also under the light of the no-contact image, without worn markers. nocontact: without the same markers.
    light: the change of light that was undone. framed: the image before registration. shift: (2,) px of the gel in its
    holder that was undone. places: (k, 2) px of markers that only one of both shows, painted over in both; unhidden: the
    same before that, None where there are none.
    """

    lit: Picture
    nocontact: NoContact
    light: Light
    framed: Picture
    shift: np.ndarray = field(default_factory=lambda: NO_SHIFT)
    places: np.ndarray = field(default_factory=lambda: NOWHERE)
    unhidden: "Pair | None" = None

    @cached_property
    def tracks(self) -> Tracks:
        """The no-contact image's markers, tracked to `lit`."""
        return self.nocontact.markers.track(self.lit.image)

    @cached_property
    def fall(self) -> float:
        """Change of the light's distribution from the middle to the edge of the image, as a fraction of its level."""
        return fall_size(self._falls)

    @cached_property
    def _falls(self) -> np.ndarray:
        return self.nocontact.reference.falls_of(self.image.image, self.light)

    def evenly_lit(self) -> "Pair":
        """The same with the distribution of the no-contact image's light."""
        return replace(
            self, lit=Picture(self.nocontact.reference.evened(self.lit.image, self._falls), self.lit.shown)
        )

    @property
    def vanished(self) -> int:
        """Number of markers that only one of the two images shows."""
        return len(self.places)

    def features(self) -> dict[str, np.ndarray]:
        """Values (1, h, w, 3) uint8 RGB of a graph's inputs, by name."""
        both = {"image": self.lit, "nocontact": self.nocontact.picture}
        return {name: np.ascontiguousarray(picture.image[None]) for name, picture in both.items()}
