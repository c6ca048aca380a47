"""From an image to its prediction: the one path that predict, Reader, stream, live and every benchmark share.

It keeps no state from one image to the next, so the same image gives the same result everywhere.
"""

from pathlib import Path
from weakref import WeakKeyDictionary

import numpy as np

from gelforge.errors import BadInput
from gelforge.reading.faults import first_fault, nocontact_fault
from gelforge.reading.forcereading import ForceReading, edge_peak
from gelforge.reading.interval import half_widths
from gelforge.reading.model import ForceModel, Graph, check_runtime, load_model, require_sensor
from gelforge.reading.pair import NoContact, Prepared, Preprocessor, at_rest
from gelforge.reading.profile import AS_READ, Gain

COLOURED = 3.0 / 255  # least range of the mean colours (0 to 1) of colour images
SHIPPED = Path(__file__).with_name("weights") / "default.onnx"


def load_for_use(path: Path | str | None, sensor: str | None = None) -> ForceModel:
    """Load a model for prediction, None: the shipped one; check that it is for `sensor`, where one is named."""
    require_opencv()
    if path is None and not SHIPPED.exists():
        raise BadInput(
            "no model came with this copy of gelforge: train one with `make train` and name it with --model"
        )
    model = load_model(path or SHIPPED)
    if sensor:
        require_sensor(model, {sensor})
    return model


def require_opencv() -> None:
    """Raise BadInput where OpenCV is missing or incomplete."""
    try:
        import cv2

        missing = [name for name in ("resize", "calcOpticalFlowPyrLK", "imdecode") if not hasattr(cv2, name)]
        fault = f"it lacks {', '.join(missing)}" if missing else ""
    except ImportError as error:
        fault = str(error)
    if fault:
        raise BadInput(
            f"OpenCV cannot be used ({fault}): most likely two of its packages are installed, or one for desktops on a computer without a"
            " display; run `pip uninstall -y opencv-python opencv-contrib-python opencv-python-headless opencv-contrib-python-headless`, then"
            " `pip install opencv-contrib-python-headless`"
        )


class Predictor:
    """Predicts the forces in images of one sensor, of any size, crop and orientation of its camera.

    nocontact: (h, w, 3) uint8 RGB of any size, of the sensor while nothing touches it, where the model needs one.
    gain: factor on all forces, of the sensor's profile. device, threads: of onnxruntime (reading.model). fault: what
    is wrong with the no-contact image, empty for nothing.
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
        check_runtime(self.graph, self.metadata)
        self.limits: dict[str, float] = self.metadata["limits"]
        self.coloured = bool(np.ptp(self.metadata["normalisation"]["image_mean"]) > COLOURED)
        self._rest: WeakKeyDictionary[NoContact, np.ndarray] = WeakKeyDictionary()
        beside = self.prepare.nocontact
        self.fault = "" if beside is None else nocontact_fault(beside, self.limits, self.coloured)

    @property
    def text(self) -> str:
        """What is done to images, in one line; empty for nothing."""
        return self.prepare.frame.text

    def rest(self, nocontact: NoContact | None) -> np.ndarray:
        """Forces (3, rows, cols) N that the graph predicts for a no-contact image; 0 for a single-image model."""
        if nocontact is None:
            return np.zeros((3, 1, 1), np.float32)
        if nocontact not in self._rest:
            self._rest[nocontact] = self.raw(at_rest(nocontact))
        return self._rest[nocontact]

    def raw(self, seen: Prepared) -> np.ndarray:
        """Forces (3, rows, cols) N that the graph predicts for a prepared image, without tare and factor."""
        found = self.graph({name: seen.feature(name) for name in self.graph.inputs})
        return np.asarray(found["forces"][0])

    def predict(self, image: np.ndarray) -> ForceReading:
        """Predict an image (h, w, 3) uint8 RGB of any size."""
        return self.predict_shown(image)[0]

    def predict_shown(self, image: np.ndarray) -> tuple[ForceReading, np.ndarray]:
        """Predict an image (h, w, 3) uint8 RGB of any size; also return the image (rows, cols, 3) below the cells."""
        seen = self.prepare(image)
        cells = (self.raw(seen) - self.rest(seen.nocontact)) * np.float32(self.gain.value)
        total = cells.sum((1, 2), dtype=float)
        found = ForceReading(
            cells=cells,
            total=total,
            half_width=half_widths(self.metadata, total, self.gain),
            reason=first_fault(seen, self.limits, self.coloured, float(total[2]), self.fault),
            edge_peak=edge_peak(cells, self.prepare.frame.cells_shown(cells.shape[1:])),
            vanished=seen.vanished,
        )
        return found, seen.image

    def exchanged(self, image: np.ndarray) -> float:
        """Normal force in N with an image (h, w, 3) uint8 RGB and the no-contact image exchanged.

        It is 0 for a single-image model.
        """
        if self.prepare.nocontact is None:
            return 0.0
        seen = Preprocessor(self.metadata, self.prepare.frame(image))(self.prepare.nocontact.picture)
        rest = 0.0 if seen.nocontact is None else self.raw(at_rest(seen.nocontact))
        return float((self.raw(seen) - rest)[2].sum(dtype=float)) * self.gain.value
