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
from gelforge.reading.light import Light, Reference
from gelforge.reading.markers import MarkerTracker, Tracks, markers_in, rim_shift, shifted_back, spacing
from gelforge.reading.picture import Picture
from gelforge.reading.untouched import touch_of
from gelforge.reading.wear import appeared, painted_over, pale, places_in, printed_in, vanished

NO_SHIFT = np.zeros(2)
NOWHERE = np.zeros((0, 2))
COLOUR_FALL = 0.04 / 0.055  # weight of one colour's change of distribution beside that of all
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
        return Pair(self.picture, self.picture, self, None, self.frame.shape, self.picture, self.coloured)

    def compare(self, image: np.ndarray, given: tuple[int, ...] | None = None) -> "Pair":
        """Undo shift of the gel, change of light and wear of an image (h, w, 3) uint8 in the network's frame.

        given: shape of the camera's image, if it is not that of the no-contact image.
        """
        pair = self.under_its_light(image, given)
        if self.frame.shows_rim:  # else it is not known how the gel is mounted
            shift = rim_shift(self.markers, pair.tracks)
            if shift.any():
                framed = pair.framed
                pair = replace(self.under_its_light(shifted_back(image, shift), given, shift), framed=framed)
        return self._without_worn(pair)

    def under_its_light(
        self, image: np.ndarray, given: tuple[int, ...] | None = None, shift: np.ndarray = NO_SHIFT
    ) -> "Pair":
        """Undo only the change of light of an image (h, w, 3) uint8 in the network's frame; shift: undone before, px."""
        lit, light = self.reference.normalised(image)
        seen, shape = Picture(image, self.frame.shown), given or self.frame.shape
        return Pair(seen, Picture(lit, self.frame.shown), self, light, shape, seen, self.coloured, shift)

    def _without_worn(self, pair: "Pair") -> "Pair":
        """The same without the markers that only one of the two images shows."""
        tracks, markers = pair.tracks, self.markers
        if not tracks.unlike.any() and not len(markers.empty):
            return pair
        gone = vanished(markers, self.printed, tracks, pair.lit.darkness)
        more = NOWHERE
        if len(markers.empty):
            more = appeared(markers, self.picture.darkness, self.printed, tracks, pair.lit.darkness)
        if not gone.any() and not len(more):
            return pair
        worn = self.without(gone) if gone.any() else self
        places = np.concatenate([places_in(tracks, markers)[gone], more])
        lit, light = worn.reference.normalised(painted_over(pair.image.image, places, markers.diameter))
        return replace(pair, lit=Picture(lit, self.frame.shown), nocontact=worn, light=light, places=places)

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
class Pair:
    """An image and the no-contact image of its sensor, compared.

    image: in the network's frame, registered; lit: also under the light of the no-contact image, without worn markers.
    nocontact: without the same markers; None for a network that reads the image alone, to which both pictures are one.
    light: the change of light that was undone. given: shape of the camera's image. framed: the image before registration. coloured: whether colour is expected.
    shift: (2,) px of the gel in its holder that was undone. places: (k, 2) px of markers that only one of both shows, painted over in both.
    """

    image: Picture
    lit: Picture
    nocontact: NoContact | None
    light: Light | None
    given: tuple[int, ...]
    framed: Picture
    coloured: bool = True
    shift: np.ndarray = field(default_factory=lambda: NO_SHIFT)
    places: np.ndarray = field(default_factory=lambda: NOWHERE)

    @cached_property
    def tracks(self) -> Tracks:
        """The no-contact image's markers, tracked to `lit`."""
        if self.nocontact is None:
            return Tracks(NOWHERE, np.zeros(0, bool))
        return self.nocontact.markers.track(self.lit.image)

    @cached_property
    def fall(self) -> float:
        """Change of the light's distribution from the middle to the edge of the image, as a fraction of its level.

        Of all colours together, or of one, of which the fraction COLOUR_FALL counts.
        """
        if self.nocontact is None or self.light is None:
            return 0.0
        mean, most = self.nocontact.reference.fall_of(self.image.image, self.light)
        return max(mean, most * COLOUR_FALL)

    @property
    def vanished(self) -> int:
        """Number of markers that only one of the two images shows."""
        return len(self.places)

    def features(self) -> dict[str, np.ndarray]:
        """Values (1, h, w, 3) uint8 RGB of a graph's inputs, by name."""
        found = {"image": np.ascontiguousarray(self.lit.image[None])}
        if self.nocontact is not None:
            found["nocontact"] = np.ascontiguousarray(self.nocontact.picture.image[None])
        return found


def alone(image: np.ndarray, given: tuple[int, ...], coloured: bool) -> Pair:
    """An image (h, w, 3) uint8 in a network's frame, for a network that reads it alone."""
    seen = Picture(image)
    return Pair(seen, seen, None, None, given, seen, coloured)
