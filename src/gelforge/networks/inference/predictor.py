"""From a picture to a reading: the one way that predict, Reader, stream, live and every benchmark share.

It keeps no state from one picture to the next, so the same picture gives the same answer everywhere.
"""

from functools import cached_property
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.networks.checkpoint.modelfile import ForceModel, Graph, load_model, require_sensor
from gelforge.networks.inference.sensorprofile import AS_READ, Gain
from gelforge.networks.preprocess.illumination import Light
from gelforge.networks.preprocess.pair import Prepared, Preprocessor
from gelforge.networks.preprocess.scale import WHOLE, View
from gelforge.networks.preprocess.slopetable import SlopeTable, height_of
from gelforge.networks.uncertainty.conformal import half_widths
from gelforge.networks.uncertainty.ood import (
    as_arrays,
    monochrome_fault,
    pair_diagnostics,
    pair_score_fault,
    relief,
    relief_fault,
)
from gelforge.records.forcereading import ForceReading, edge_peak

LEAST_PULL = 1.0  # N above which a prediction that no contact can make is flagged
SHIPPED = Path(__file__).parents[1] / "weights/default.onnx"


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
    """Predicts the forces in pictures of one sensor.

    nocontact: (h, w, 3) uint8 RGB of any size, of the sensor while nothing touches it, where the model needs one. gain: what all
    forces are multiplied by, of the sensor's profile. device, threads: of onnxruntime (networks.checkpoint.modelfile). table:
    the sensor's own, of its profile, by which heights are read. fault: what is wrong with the no-contact image, empty for nothing.
    """

    def __init__(
        self,
        model: ForceModel,
        nocontact: np.ndarray | None = None,
        gain: Gain = AS_READ,
        device: str = "cpu",
        threads: int = 1,
        table: SlopeTable | None = None,
    ) -> None:
        self.model, self.metadata, self.gain = model, model.metadata, gain
        self.prepare = Preprocessor(model.metadata, self.framed(nocontact))
        self.graph = Graph(model.graph, f"model {self.metadata['name']}", device, threads)
        self.table = table
        self.statistics = as_arrays(self.metadata["statistics"])
        self.fault = self._nocontact_fault()

    def framed(self, nocontact: np.ndarray | None) -> np.ndarray | None:
        """The no-contact image (h, w, 3) uint8 RGB as it is compared with others; here as it is given."""
        return nocontact

    @cached_property
    def rest(self) -> np.ndarray:
        """Forces (3, rows, cols) N that the graph predicts for the no-contact image; 0 beside a model of one picture."""
        rest = self.prepare.at_rest()
        return np.zeros((3, 1, 1), np.float32) if rest is None else self.raw(rest)

    @property
    def view(self) -> View:
        """How pictures of the sensor are scaled."""
        return WHOLE if self.prepare.nocontact is None else self.prepare.nocontact.view

    def raw(self, seen: Prepared) -> np.ndarray:
        """Forces (3, rows, cols) N of a prepared picture as the graph predicts them, without tare and factor."""
        found = self.graph({name: seen.feature(name) for name in self.graph.inputs})
        return np.asarray(found["forces"][0])

    @property
    def measures_height(self) -> bool:
        """Whether there is what heights are computed from: a table of the sensor's slopes, beside a no-contact image."""
        return self.table is not None and self.prepare.nocontact is not None

    def height(self, image: np.ndarray) -> np.ndarray | None:
        """Height (h / 2, w / 2) mm of the gel's surface above the unloaded one in an image (h, w, 3) uint8 RGB of any size.

        None where `measures_height` says so.
        """
        if self.table is None or self.prepare.nocontact is None:
            return None
        slopes = self.table.slopes(self.prepare(image).lit, self.prepare.nocontact.picture)
        return height_of(slopes, 2.0 / self.table.px_per_mm)

    def predict(self, image: np.ndarray) -> ForceReading:
        """Read an image (h, w, 3) uint8 RGB of any size."""
        seen = self.prepare(image)
        cells = (self.raw(seen) - self.rest) * np.float32(self.gain.value)
        total = cells.sum((1, 2), dtype=float)
        score, unlike = pair_score_fault(self.statistics, seen.lit, pair_diagnostics(seen))
        grey = monochrome_fault(self.statistics, seen.image, "the picture")
        faults = (seen.fault, grey, self.fault, unlike, light_fault(seen.light), pull_fault(total[2]))
        return ForceReading(
            cells=cells,
            total=total,
            half_width=half_widths(self.metadata, total, self.gain),
            reason=next(filter(None, faults), ""),
            edge_peak=edge_peak(cells, self.view.cells_shown(cells.shape[1:])),
            ood_score=score,
            image=seen.image,
        )

    def _nocontact_fault(self) -> str:
        nocontact = self.prepare.nocontact
        if nocontact is None or nocontact.fault:
            return "" if nocontact is None else nocontact.fault
        grey = monochrome_fault(self.statistics, nocontact.sized, "the no-contact image")
        return grey or relief_fault(self.statistics, relief(nocontact.sized))


def light_fault(light: Light | None) -> str:
    """What is wrong with a pair of pictures whose light cannot be compared; empty where it can."""
    return "" if light is None or light.known else "nothing in it has the light of the no-contact image"


def pull_fault(normal: float) -> str:
    """What is wrong with a gel that pulls on what touches it; empty where it presses, total normal force in N."""
    if normal < LEAST_PULL:
        return ""
    return f"the gel seems to pull with {normal:.1f} N: something may have touched it in the no-contact image"
