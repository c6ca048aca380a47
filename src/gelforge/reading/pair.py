"""From an image to the inputs of a model's graph: the preprocessing that ONNX cannot hold, in numpy and OpenCV.

    prepare = Preprocessor(metadata, nocontact)  # metadata: of the model's file (reading.model)
    session = onnxruntime.InferenceSession("model.onnx")
    given = {one.name: prepare(image).feature(one.name) for one in session.get_inputs()}
    (forces,) = session.run(["forces"], given)  # (1, 3, rows, cols) N per cell

`Predictor` does this, subtracts what is predicted for the no-contact image itself, and multiplies by the factor of a profile.
"""

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.reading.frame import ImageFrame, Learnt, image_frame
from gelforge.reading.light import Light, Reference
from gelforge.reading.markers import MarkerTracker, Tracks, grey_of, markers_in, rim_shift, shifted_back
from gelforge.reading.wear import appeared, darkness_of, painted_over, places_in, printed_in, vanished
from gelforge.records.networkkind import kind_of

INPUTS = ("image", "nocontact")  # allowed names of a graph's inputs
NO_SHIFT = np.zeros(2)
MOST_WORN = 8  # cached no-contact images without vanished markers


@dataclass(frozen=True)
class Change:
    """Corrections of an image before a network sees it.

    light: change of light against the no-contact image. shift: (2,) px of the gel in its holder. gone: (n,) bool, markers
    of the no-contact image that the image lacks; places: (k, 2) px of these and of markers that only the image shows,
    all painted over.
    """

    light: Light
    shift: np.ndarray
    gone: np.ndarray
    places: np.ndarray


class NoContact:
    """The no-contact image of a sensor as a network reads it: in the network's frame, with its light and its markers.

    picture: (h, w, 3) uint8 RGB of any size. size: (rows, cols) of the network's input. learnt: view of its training;
    None: images stay as they are, as in a dataset for training. fault: what is wrong with the markers, empty for
    nothing.
    """

    def __init__(self, picture: np.ndarray, size: tuple[int, int], learnt: Learnt | None) -> None:
        self.fault = ""
        if learnt is None:
            self.frame, markers = ImageFrame(size, size), markers_in(picture)
        else:
            self.frame, markers = image_frame(picture, size, learnt)
            if learnt.usual and not markers.pitch:
                self.fault = "the no-contact image shows no markers, unlike those of training: it is blurred, or of another gel"
        self.picture = self.frame(picture)
        self.markers = MarkerTracker(self.picture, markers)
        self.reference = Reference(self.picture, self.frame.shown)
        self._worn: dict[bytes, NoContact] = {}

    def prepared(self, image: np.ndarray, fault: str = "", change: Change | None = None) -> "Prepared":
        """Correct light, mounting and wear of an image (h, w, 3) uint8 in the network's frame.

        fault: what is wrong with its shape. change: the corrections, where they are known; else they are found.
        """
        if change is not None:
            worn = self.without(change.gone) if change.gone.any() else self
            image = shifted_back(image, change.shift) if change.shift.any() else image
            cleaned = painted_over(image, change.places, self.markers.diameter) if len(change.places) else image
            return Prepared(image, worn.reference.under(change.light, cleaned), fault, change, worn)
        found = self.lit(image, fault)
        if self.frame.shows_rim:  # else it is not known how the gel is mounted
            shift = rim_shift(self.markers, found.tracks)
            if shift.any():
                found = self.lit(shifted_back(image, shift), fault, shift)
        return self._without_worn(found)

    def lit(self, image: np.ndarray, fault: str = "", shift: np.ndarray = NO_SHIFT) -> "Prepared":
        """Correct only the light of an image (h, w, 3) uint8 in the network's frame; shift: already undone, px."""
        lit, light = self.reference.normalised(image)
        change = Change(light, shift, np.zeros(len(self.markers.points), bool), np.zeros((0, 2)))
        return Prepared(image, lit, fault, change, self)

    def _without_worn(self, found: "Prepared") -> "Prepared":
        """The same without the markers that only one of the two images shows."""
        tracks, markers = found.tracks, self.markers
        if not tracks.unlike.any() and not len(markers.empty):
            return found
        gone = vanished(markers, self.printed, tracks, found.darkness)
        more = np.zeros((0, 2))
        if len(markers.empty):
            more = appeared(markers, self.darkness, self.printed, tracks, found.darkness)
        if not gone.any() and not len(more):
            return found
        worn = self.without(gone) if gone.any() else self
        places = np.concatenate([places_in(tracks, markers)[gone], more])
        lit, light = worn.reference.normalised(painted_over(found.image, places, markers.diameter))
        assert found.change is not None
        change = Change(light, found.change.shift, gone, places)
        return Prepared(found.image, lit, found.fault, change, worn)

    @cached_property
    def darkness(self) -> np.ndarray:
        """Its `darkness_of`, (h / 2, w / 2)."""
        return darkness_of(grey_of(list(np.moveaxis(self.picture, 2, 0))))

    @cached_property
    def printed(self) -> np.ndarray:
        """Darkness of each of its markers, (n,)."""
        return printed_in(self.markers, self.darkness)

    def without(self, gone: np.ndarray) -> "NoContact":
        """The same with the markers `gone`, (n,) bool, painted over. Cached for later images, because wear stays."""
        key = gone.tobytes()
        if key not in self._worn:
            while len(self._worn) >= MOST_WORN:
                self._worn.pop(next(iter(self._worn)))
            worn = copy(self)
            for name in ("darkness", "printed"):
                worn.__dict__.pop(name, None)
            worn.picture = painted_over(self.picture, self.markers.points[gone], self.markers.diameter)
            worn.markers = MarkerTracker(worn.picture, self.markers.printed.only(~gone))
            worn.reference = Reference(worn.picture, self.frame.shown)
            self._worn[key] = worn
        return self._worn[key]


@dataclass(frozen=True)
class Prepared:
    """An image as the graph of a model reads it, and its corrections.

    image: (h, w, 3) uint8 in the model's frame, registered; lit: also under the light of the no-contact image,
    without worn markers. fault: what is wrong with its shape. nocontact and change are None for a single-image model;
    change is None for a no-contact image itself, too.
    """

    image: np.ndarray
    lit: np.ndarray
    fault: str
    change: Change | None
    nocontact: NoContact | None

    @property
    def shown(self) -> np.ndarray:
        """The part of `image` that the camera shows, (h', w', 3), without the margin of a narrow view."""
        return self.image if self.nocontact is None else self.image[self.nocontact.frame.shown]

    @property
    def vanished(self) -> int:
        """Number of markers that only one of the two images shows; they are painted over in `lit` and `nocontact`."""
        return 0 if self.change is None else len(self.change.places)

    @property
    def light(self) -> Light | None:
        """The light that was corrected; None where `change` is."""
        return None if self.change is None else self.change.light

    @cached_property
    def tracks(self) -> Tracks:
        """The no-contact image's markers, tracked to `lit`."""
        return self._reference().markers.track(self.lit)

    @cached_property
    def darkness(self) -> np.ndarray:
        """Its `darkness_of`, (h / 2, w / 2), under the light of the no-contact image."""
        return darkness_of(grey_of(list(np.moveaxis(self.lit, 2, 0))))

    def feature(self, name: str) -> np.ndarray:
        """The value of a graph's input, (1, h, w, 3) uint8 RGB: `image` or `nocontact`; BadInput for another name."""
        if name not in INPUTS:
            raise BadInput(
                f"the graph of the model has the input {name!r}, but only {' and '.join(INPUTS)} are known; train it again"
            )
        picture = self.lit if name == "image" else self._reference().picture
        return np.ascontiguousarray(picture[None])

    def _reference(self) -> NoContact:
        if self.nocontact is None:
            raise BadInput(
                "this network reads the image alone: it has no no-contact image to compare with, and no markers"
            )
        return self.nocontact


class Preprocessor:
    """Prepares images of one sensor for a model.

    metadata: of the model. nocontact: (h, w, 3) uint8 RGB of any size, of the sensor while nothing touches it; BadInput where
    the model needs one and none is given.
    """

    def __init__(self, metadata: Mapping[str, Any], nocontact: np.ndarray | None = None) -> None:
        rows, cols = metadata["image"]
        self.frame = ImageFrame((rows, cols), (rows, cols))
        self.nocontact: NoContact | None = None
        if kind_of(metadata["model"]).pair:
            if nocontact is None:
                raise BadInput(
                    "this network compares an image with a no-contact image of the same sensor:"
                    " give it with --nocontact NOCONTACT or --profile FILE (in Python nocontact=, and profile= of Reader)"
                )
            self.nocontact = NoContact(nocontact, (rows, cols), Learnt.of(metadata["frame"]))
            self.frame = self.nocontact.frame

    def __call__(self, image: np.ndarray) -> Prepared:
        """Prepare an image (h, w, 3) uint8 RGB of any size."""
        framed, fault = self.frame(image), self.frame.fault(image)
        if self.nocontact is None:
            return Prepared(framed, framed, fault, None, None)
        return self.nocontact.prepared(framed, fault)


def at_rest(nocontact: NoContact) -> Prepared:
    """A no-contact image prepared as an image; the forces predicted for it are subtracted from all others (tare)."""
    return Prepared(nocontact.picture, nocontact.picture, "", None, nocontact)
