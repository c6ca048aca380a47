"""From a picture to a reading: the one way that predict, Reader, stream, live and every benchmark share.

It keeps no state from one picture to the next, so the same picture gives the same answer everywhere.
"""

from collections.abc import Callable, Mapping
from copy import copy
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np

from gelforge.errors import BadInput
from gelforge.networks.checkpoint.graph import Graph
from gelforge.networks.checkpoint.modelfile import ForceModel, load_model, require_sensor
from gelforge.networks.inference.height import height_of
from gelforge.networks.inference.sensorprofile import AS_READ, Gain
from gelforge.networks.preprocess.illumination import Light
from gelforge.networks.preprocess.pair import FEATURES, Prepared, Preprocessor
from gelforge.networks.preprocess.scale import WHOLE, View
from gelforge.networks.preprocess.slopetable import SlopeTable
from gelforge.networks.uncertainty.conformal import half_widths
from gelforge.networks.uncertainty.ood import (
    as_arrays,
    monochrome_fault,
    pair_diagnostics,
    pair_score_fault,
    relief,
    relief_fault,
)
from gelforge.records.forcereading import ForceReading
from gelforge.records.markers import MARKER_PITCH_MM
from gelforge.records.totals import edge_peak

SLOPES = "slopes"  # name of the first stage of a model of two, and of what it estimates first
LEAST_PULL = 1.0  # N above which a prediction that no contact can make is flagged
SHIPPED = Path(__file__).parents[1] / "weights/default.onnx"
# A stage of a model: arrays by name, each with a first axis of one picture, to those that it adds.
Stage = Callable[[Mapping[str, np.ndarray]], dict[str, np.ndarray]]


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
    forces are multiplied by, of the sensor's profile. device, threads: of onnxruntime (networks.checkpoint.graph). table: the
    sensor's own, of its profile, whose slopes take the place of those that a model of two stages estimates. fault: what is wrong
    with the no-contact image, empty for nothing.
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
        where = f"model {self.metadata['name']}"
        self.stages: dict[str, Stage] = {
            name: Graph(graph, where, device, threads) for name, graph in model.stages.items()
        }
        self.table = table
        self.statistics = as_arrays(self.metadata["statistics"])
        self.fault = self._nocontact_fault()

    def framed(self, nocontact: np.ndarray | None) -> np.ndarray | None:
        """The no-contact image (h, w, 3) uint8 RGB as it is compared with others; here as it is given."""
        return nocontact

    @cached_property
    def rest(self) -> np.ndarray:
        """Forces (3, rows, cols) N that the graphs predict for the no-contact image; 0 beside a model of one picture."""
        rest = self.prepare.at_rest()
        return np.zeros((3, 1, 1), np.float32) if rest is None else self.raw(rest)

    @property
    def view(self) -> View:
        """How pictures of the sensor are scaled."""
        return WHOLE if self.prepare.nocontact is None else self.prepare.nocontact.view

    def with_table(self, table: SlopeTable | None) -> Self:
        """The same with another table of slopes."""
        other = copy(self)
        other.table = table
        for tare in ("rest", "rest_slopes"):
            other.__dict__.pop(tare, None)  # cached, by the table of before
        return other

    def raw(self, seen: Prepared) -> np.ndarray:
        """Forces (3, rows, cols) N of a prepared picture as the graphs predict them, without tare and factor."""
        known = _Known(seen)
        for name, stage in self.stages.items():
            known.update(stage(known))
            own = self._slopes_by_table(seen) if name == SLOPES else None
            if own is not None:
                known[SLOPES] = own[None]
        return np.asarray(known["forces"][0])

    def slopes(self, seen: Prepared) -> np.ndarray | None:
        """Slopes (2, h / 2, w / 2) of the gel's surface along u and v in a prepared picture; None where nothing estimates them."""
        own = self._slopes_by_table(seen)
        if own is None and SLOPES in self.stages:
            return self.stages[SLOPES](_Known(seen))[SLOPES][0]
        return own

    def _slopes_by_table(self, seen: Prepared) -> np.ndarray | None:
        return self.table.slopes(seen.lit, seen.nocontact.picture) if self.table and seen.nocontact else None

    @cached_property
    def rest_slopes(self) -> np.ndarray | None:
        """Slopes that are estimated in the no-contact image; None where nothing estimates slopes."""
        rest = self.prepare.at_rest()
        return None if rest is None else self.slopes(rest)

    def height(self, image: np.ndarray) -> np.ndarray | None:
        """Height (h / 2, w / 2) mm of the gel's surface above the unloaded one in an image (h, w, 3) uint8 RGB of any size.

        None where neither the model nor a table of the sensor estimates slopes.
        """
        if self.rest_slopes is None:
            return None
        return height_of(self.slopes(self.prepare(image)) - self.rest_slopes, 2.0 / self.px_per_mm)

    @property
    def px_per_mm(self) -> float:
        """Scale of prepared pictures."""
        if self.table:
            return self.table.px_per_mm
        return sum(self.metadata["pitch_px"]) / 2 / MARKER_PITCH_MM

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


class _Known(dict[str, np.ndarray]):
    """Arrays by name: those that stages returned, and the features of a picture, each made when a stage asks for it."""

    def __init__(self, seen: Prepared) -> None:
        super().__init__()
        self._seen = seen

    def __missing__(self, name: str) -> np.ndarray:
        if name not in FEATURES:
            raise BadInput(
                f"a graph of the model reads {name!r}, which neither a picture nor a stage before it gives; train it again"
            )
        self[name] = self._seen.feature(name)
        return self[name]


def light_fault(light: Light | None) -> str:
    """What is wrong with a pair of pictures whose light cannot be compared; empty where it can."""
    return "" if light is None or light.known else "nothing in it has the light of the no-contact image"


def pull_fault(normal: float) -> str:
    """What is wrong with a gel that pulls on what touches it; empty where it presses, total normal force in N."""
    if normal < LEAST_PULL:
        return ""
    return f"the gel seems to pull with {normal:.1f} N: something may have touched it in the no-contact image"
