"""From a picture to a reading: the one way that predict, Reader, stream, live and every benchmark share.

It keeps no state from one picture to the next, so the same picture gives the same answer everywhere.
"""

from pathlib import Path
from weakref import WeakKeyDictionary

import numpy as np

from gelforge.errors import BadInput
from gelforge.reading.faults import (
    as_arrays,
    monochrome_fault,
    pair_score_fault,
    relief,
    relief_fault,
    sharpness_fault,
)
from gelforge.reading.forcereading import ForceReading, edge_peak
from gelforge.reading.frame import BLUE_FIRST
from gelforge.reading.interval import half_widths
from gelforge.reading.model import ForceModel, Graph, load_model, require_sensor
from gelforge.reading.pair import NoContact, Prepared, Preprocessor, at_rest
from gelforge.reading.profile import AS_READ, Gain

MOST_VANISHED = 8  # markers, of 63: with so many painted over in both images, nine of ten forces are within 11 %
# Of the light's level, from the middle to the edge of the image: of all colours together, and of one. Of 114 frames of real films
# that nothing else flags none is beyond, of 51 real presses of a ball the largest is 0.8 %.
MOST_FALL, MOST_COLOUR_FALL = 0.04, 0.055
LEAST_PULL = 1.0  # N above which a prediction that no contact can make is flagged
SHIPPED = Path(__file__).with_name("weights") / "default.onnx"


def load_for_use(path: Path | str | None, sensor: str | None = None) -> ForceModel:
    """Load a model for prediction and check that it is for `sensor`, where one is named; None: the one that ships."""
    if path is None and not SHIPPED.exists():
        raise BadInput(
            "no model came with this copy of gelforge: train one with `make train` and name it with --model"
        )
    model = load_model(path or SHIPPED)
    if sensor:
        require_sensor(model, {sensor})
    return model


class Predictor:
    """Predicts the forces in pictures of one sensor, of any size, crop and orientation of its camera.

    nocontact: (h, w, 3) uint8 RGB of any size, of the sensor while nothing touches it, where the model needs one. gain: what all
    forces are multiplied by, of the sensor's profile. device, threads: of onnxruntime (reading.model). fault: what is wrong with the no-contact image, empty for nothing.
    """

    def __init__(
        self,
        model: ForceModel,
        nocontact: np.ndarray | None = None,
        gain: Gain = AS_READ,
        device: str = "cpu",
        threads: int = 1,
    ) -> None:
        self.model, self.metadata, self.gain = model, model.metadata, gain
        self.prepare = Preprocessor(model.metadata, nocontact)
        self.graph = Graph(model.graph, f"model {self.metadata['name']}", device, threads)
        self.statistics = as_arrays(self.metadata["statistics"])
        self._rest: WeakKeyDictionary[NoContact, np.ndarray] = WeakKeyDictionary()
        self.fault = self._nocontact_fault()

    @property
    def text(self) -> str:
        """What is done to images, in one line; empty for nothing."""
        return self.prepare.frame.text

    def rest(self, nocontact: NoContact | None) -> np.ndarray:
        """Forces (3, rows, cols) N that the graph predicts for a no-contact image; 0 beside a model of one picture."""
        if nocontact is None:
            return np.zeros((3, 1, 1), np.float32)
        if nocontact not in self._rest:
            self._rest[nocontact] = self.raw(at_rest(nocontact))
        return self._rest[nocontact]

    def raw(self, seen: Prepared) -> np.ndarray:
        """Forces (3, rows, cols) N of a prepared picture as the graph predicts them, without tare and factor."""
        found = self.graph({name: seen.feature(name) for name in self.graph.inputs})
        return np.asarray(found["forces"][0])

    def predict(self, image: np.ndarray) -> ForceReading:
        """Read an image (h, w, 3) uint8 RGB of any size."""
        return self.predict_shown(image)[0]

    def predict_shown(self, image: np.ndarray) -> tuple[ForceReading, np.ndarray]:
        """Read an image (h, w, 3) uint8 RGB of any size; also the image (rows, cols, 3) that lies below the cells."""
        seen = self.prepare(image)
        cells = (self.raw(seen) - self.rest(seen.nocontact)) * np.float32(self.gain.value)
        total = cells.sum((1, 2), dtype=float)
        score, unlike = pair_score_fault(self.statistics, seen)
        grey = monochrome_fault(self.statistics, seen.image, "the picture")
        faults = (
            seen.fault,
            grey,
            self.fault,
            wear_fault(seen),
            unlike,
            light_fault(seen),
            pull_fault(total[2]),
        )
        found = ForceReading(
            cells=cells,
            total=total,
            half_width=half_widths(self.metadata, total, self.gain),
            reason=next(filter(None, faults), ""),
            edge_peak=edge_peak(cells, self.prepare.frame.cells_shown(cells.shape[1:])),
            ood_score=score,
            vanished=seen.vanished,
        )
        return found, seen.image

    def exchanged(self, image: np.ndarray) -> float:
        """Normal force in N where an image (h, w, 3) uint8 RGB and the no-contact image change places; 0 beside a model of one picture."""
        if self.prepare.nocontact is None:
            return 0.0
        seen = Preprocessor(self.metadata, self.prepare.frame(image))(self.prepare.nocontact.picture)
        rest = 0.0 if seen.nocontact is None else self.raw(at_rest(seen.nocontact))
        return float((self.raw(seen) - rest)[2].sum(dtype=float)) * self.gain.value

    def _nocontact_fault(self) -> str:
        nocontact = self.prepare.nocontact
        if nocontact is None or nocontact.fault:
            return "" if nocontact is None else nocontact.fault
        picture, shown = nocontact.picture, nocontact.frame.shown
        return (
            monochrome_fault(self.statistics, picture[shown], "the no-contact image")
            or sharpness_fault(self.statistics, picture[shown])
            or relief_fault(self.statistics, relief(picture, nocontact.markers.printed, shown))
            or (BLUE_FIRST if nocontact.frame.blue_first else "")
        )


def wear_fault(seen: Prepared) -> str:
    """What is wrong with a pair that differs by more markers than a prediction without them allows; empty where it does not."""
    if seen.vanished <= MOST_VANISHED:
        return ""
    return f"{seen.vanished} markers are in the image or in the no-contact image alone: take a new one, or change the gel"


def light_fault(seen: Prepared) -> str:
    """What is wrong with the light of a pair of pictures: it cannot be compared, or falls from another side; empty where it is right."""
    if seen.light is None or seen.nocontact is None:
        return ""
    if not seen.light.known:
        return "nothing in it has the light of the no-contact image"
    mean, most = seen.nocontact.reference.fall_of(seen.image, seen.light)
    if mean <= MOST_FALL and most <= MOST_COLOUR_FALL:
        return ""
    return (
        f"the light falls otherwise than in the no-contact image, by {max(mean, most):.0%} of its level from the middle to the edge: take a new"
        " one under the light of now"
    )


def pull_fault(normal: float) -> str:
    """What is wrong with a gel that pulls on what touches it; empty where it presses, total normal force in N."""
    if normal < LEAST_PULL:
        return ""
    return f"the gel seems to pull with {normal:.1f} N: something may have touched it in the no-contact image"
