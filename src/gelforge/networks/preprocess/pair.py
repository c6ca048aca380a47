"""From a picture to what the graph of a model reads: all that ONNX cannot hold, on one page of numpy and OpenCV.

    prepare = Preprocessor(metadata, nocontact)  # metadata: of the model's file (networks.checkpoint.modelfile)
    session = onnxruntime.InferenceSession("model.onnx")
    given = {one.name: prepare(image).feature(one.name) for one in session.get_inputs()}
    (forces,) = session.run(["forces"], given)  # (1, 3, rows, cols) N per cell

`Predictor` does this, subtracts what is predicted for the no-contact image itself, and multiplies by the factor of a profile.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.networks.models.inputs import needs_nocontact
from gelforge.networks.preprocess.illumination import Light, Reference
from gelforge.networks.preprocess.markertracks import MarkerTracker, Tracks, rim_shift, shifted_back
from gelforge.networks.preprocess.scale import WHOLE, fit_size, view_of
from gelforge.records.markers import pitch_of

INPUTS = ("image", "nocontact")  # what the inputs of a graph may be named


class NoContact:
    """A sensor while nothing touches it, as a model reads it: the picture at the model's scale, its light and its markers.

    picture: (h, w, 3) uint8 RGB of any size. fault: what is wrong with its shape or markers, empty for nothing.
    """

    def __init__(self, picture: np.ndarray, metadata: Mapping[str, Any]) -> None:
        self.sized, self.fault = fit_size(picture, metadata["image"])
        learnt, self.view = metadata.get("pitch_px"), WHOLE
        pitch = pitch_of(self.sized) if learnt else 0.0
        if learnt and pitch:
            self.view = view_of(self.sized, pitch, learnt)
        elif learnt and not self.fault:
            self.fault = "the no-contact image shows no markers, which the network learnt from: it is blurred, or of another gel"
        self.picture = self.view.of(self.sized)
        self.reference = Reference(self.picture, self.view)

    @cached_property
    def markers(self) -> MarkerTracker:
        """Its markers."""
        return MarkerTracker(self.picture)


@dataclass(frozen=True)
class Prepared:
    """A picture as the graph of a model reads it, and what was measured on the way.

    image: (h, w, 3) uint8 at the model's size and scale, registered; lit: under the light of the no-contact image, too, from which its
    own differed by `light`. fault: what is wrong with its shape. nocontact and light are None beside a model of one picture.
    """

    image: np.ndarray
    lit: np.ndarray
    fault: str
    light: Light | None
    nocontact: NoContact | None

    @cached_property
    def tracks(self) -> Tracks:
        """Where the markers of the no-contact image are."""
        return self._reference().markers.track(self.lit)

    def feature(self, name: str) -> np.ndarray:
        """What a graph's input is given, (1, h, w, 3) uint8 RGB: `image`, or `nocontact`; BadInput for another name."""
        if name not in INPUTS:
            raise BadInput(
                f"the graph of the model reads {name!r}, only {' and '.join(INPUTS)} are there; train it again"
            )
        picture = self.lit if name == "image" else self._reference().picture
        return np.ascontiguousarray(picture[None])

    def _reference(self) -> NoContact:
        if self.nocontact is None:
            raise BadInput(
                "this network reads one picture alone, and no markers: there is no no-contact image to compare with"
            )
        return self.nocontact


class Preprocessor:
    """Prepares pictures of one sensor for a model.

    metadata: of the model. nocontact: (h, w, 3) uint8 RGB of any size, of the sensor while nothing touches it; BadInput where
    the model needs one and none is given.
    """

    def __init__(self, metadata: Mapping[str, Any], nocontact: np.ndarray | None = None) -> None:
        self.size = metadata["image"]
        self.nocontact: NoContact | None = None
        if needs_nocontact(metadata["normalisation"]["reads"]):
            if nocontact is None:
                raise BadInput(
                    "this network compares an image with a no-contact image of the same sensor:"
                    " give it with --nocontact PICTURE or --profile FILE (in Python nocontact=, and profile= of Reader)"
                )
            self.nocontact = NoContact(nocontact, metadata)

    def __call__(self, image: np.ndarray) -> Prepared:
        """Prepare an image (h, w, 3) uint8 RGB of any size."""
        sized, fault = fit_size(image, self.size)
        if self.nocontact is None:
            return Prepared(sized, sized, fault, None, None)
        prepared = self._beside(self.nocontact, self.nocontact.view.of(sized), fault)
        if not self.nocontact.view.whole:  # a view without the gel's rim does not show how it is mounted
            return prepared
        shift = rim_shift(self.nocontact.markers, prepared.tracks)
        return self._beside(self.nocontact, shifted_back(prepared.image, shift), fault) if shift.any() else prepared

    @staticmethod
    def _beside(nocontact: NoContact, image: np.ndarray, fault: str) -> Prepared:
        lit, light = nocontact.reference.normalised(image)
        return Prepared(image, lit, fault, light, nocontact)

    def at_rest(self) -> Prepared | None:
        """The no-contact image itself, whose forces are subtracted from all others (tare); None beside a model of one picture."""
        if self.nocontact is None:
            return None
        picture = self.nocontact.picture
        return Prepared(picture, picture, "", None, self.nocontact)
