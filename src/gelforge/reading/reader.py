"""The Python interface: predicts forces in images of one sensor.

`predict`, `live`, `sensor`, training, evaluation and all benchmarks read by the lines of `Reader.__call__`. No state
carries over from one image to the next, so the same image gives the same result everywhere.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.labelling.grid import Grid
from gelforge.labelling.moment import Arms
from gelforge.labelling.sensor import Sensor, gelsight_mini
from gelforge.mechanics.material import REFERENCE_C10
from gelforge.reading.faults import EFFECTS, TOUCH, Asked, nocontact_fault, other_sensor, pair_fault, pull_fault
from gelforge.reading.forcereading import ForceReading, edge_peak
from gelforge.reading.frame import ImageFrame, Learnt
from gelforge.reading.interval import half_widths, moment_half_widths
from gelforge.reading.model import ForceModel, load_model
from gelforge.reading.pair import Framed, NoContact, Pair, Picture
from gelforge.reading.profile import AS_READ, Gain, read_profile, with_profile


def predict(
    image: np.ndarray, nocontact: np.ndarray | None = None, model: Any = None
) -> tuple[np.ndarray, dict[str, Any]]:
    """Predict forces from one image; for many of one sensor make a `Reader` once.

    Args:
        image: (h, w, 3) uint8 RGB.
        nocontact: picture (h, w, 3) uint8 RGB of the same sensor while nothing touches it.
        model: path of a model; None: the shipped one.

    Returns:
        Force on the gel per cell, (3, rows, cols) N along gel x, y and z, pressing negative; and a dict of
        the attributes of `ForceReading`. Its `flag` is True where something is wrong with the images,
        and `reason` says what.

    Raises:
        BadInput: an invalid image, no no-contact image where the model needs one, or a file that is no model.
    """
    reader = Reader(nocontact, model=model)
    found = reader(image)
    found = replace(found, reason=found.reason or reader.doubt)
    values = {name: value for name, value in vars(found).items() if name != "image"}
    return found.cells, values | {"flag": found.flag}


class Reader:
    """Predicts forces from images of one sensor, NumPy in and out. It can be pickled, and used by several threads.

    Args:
        nocontact: picture (h, w, 3) uint8 RGB of the sensor while nothing touches it; may be left out with a profile,
            which holds one.
        profile: path of a profile that `gelforge sensor` wrote; its factor multiplies the forces.
        model: path of a model; None: the shipped one. A model that `load_model` returned is shared by its readers.
        sensor: projection from gel to image in the network's frame, which places the cells for moments; None: a GelSight
            Mini with the image of its maker's driver.
        device: "cpu", or "cuda" where onnxruntime has it; of a model that is loaded here.
        threads: per image; of a model that is loaded here.

    Attributes:
        fault: what is wrong with the no-contact image, which flags all images; empty for nothing.
        doubt: that something seems to touch the gel in the no-contact image, which flags none; empty for nothing.
        text: what is done to images, in one line, empty for nothing.

    Raises:
        BadInput: images that are not of this sensor, or a file that is no profile or no model.
    """

    def __init__(
        self,
        nocontact: np.ndarray | None = None,
        profile: Path | str | None = None,
        model: Any = None,
        device: str = "cpu",
        threads: int = 1,
        sensor: Sensor | None = None,
    ):
        require_opencv()
        loaded = model if isinstance(model, ForceModel) else load_model(model, device, threads)
        picture = None if nocontact is None else check_image(nocontact)
        known = None if profile is None else read_profile(Path(profile))
        self._set(loaded, *with_profile(known, picture, loaded.metadata), sensor)
        pair = self.compare(known.nocontact) if known and picture is not None and known.gain.readings else None
        if known and isinstance(pair, Pair) and (fault := other_sensor(pair)):
            raise BadInput(
                f"the no-contact image and that of profile {known.name}, whose factor is {known.gain.value:.3g}: {fault}; make a profile of this"
                " sensor with `gelforge sensor`"
            )

    def _set(self, model: ForceModel, picture: np.ndarray | None, gain: Gain, sensor: Sensor | None = None) -> None:
        self.model, self.gain, self._given, self._sensor = model, gain, picture, sensor
        self.arms = Arms(sensor or gelsight_mini(), Grid(*model.metadata["grid"]))
        self.frame, self.nocontact = ImageFrame(model.size, model.size), None
        self.fault = self.doubt = ""
        if model.needs_nocontact:
            if picture is None:
                raise BadInput(
                    "this network compares an image with a no-contact image of the same sensor:"
                    " give it with --nocontact NOCONTACT or --profile FILE (in Python nocontact=, and profile= of Reader)"
                )
            self.nocontact = NoContact(picture, model.size, Learnt.of(model.metadata["frame"]), model.coloured)
            self.frame = self.nocontact.frame
            self.fault, self.doubt = nocontact_fault(self.nocontact, Asked.READER), TOUCH.of(self.nocontact)
        self.text = self.frame.text

    def __call__(self, image: np.ndarray) -> ForceReading:
        """Predict one image; nothing carries over from one to the next.

        Args:
            image: (h, w, 3) uint8 RGB.

        Returns:
            Forces in N, their prediction intervals, and what is wrong with the image.

        Raises:
            BadInput: anything that is no such image.
        """
        seen = self.compare(image)
        cells = self.forces(seen)
        total = cells.sum((1, 2), dtype=float)
        # a gel whose forces are multiplied by a factor is as many times as stiff
        moment = self.arms.moment(cells, REFERENCE_C10 * self.gain.value)
        half_width = half_widths(self.model.metadata, total, self.gain)
        return ForceReading(
            cells=cells,
            total=total,
            half_width=half_width,
            moment=moment,
            moment_half_width=moment_half_widths(total, moment, half_width),
            reason=self.fault
            or pair_fault(seen, Asked.READER)
            or self._changed(seen, total, half_width)
            or pull_fault(float(total[2])),
            edge_peak=edge_peak(cells, self.frame.cells_shown(cells.shape[1:])),
            image=seen.image.image,
            vanished=seen.vanished,
        )

    def _changed(self, seen: Framed, total: np.ndarray, half_width: np.ndarray | None) -> str:
        """What changes a total (3,) N by more than its half widths, of what can be undone (`EFFECTS`); empty for nothing."""
        for fault, without in EFFECTS:
            if isinstance(seen, Pair) and (text := fault.of(seen)):
                change = np.abs(self.forces(without(seen)).sum((1, 2), dtype=float) - total)
                if half_width is None or (change > half_width).any():
                    return text
        return ""

    def compare(self, image: np.ndarray) -> Framed:
        """Turn, crop and resize an image (h, w, 3) uint8 RGB as in training, and compare it with the no-contact image."""
        given = check_image(image)
        framed = self.frame(given)
        if self.nocontact is None:
            return Framed(Picture(framed), given.shape, framed.shape, self.model.coloured)
        return self.nocontact.compare(framed, given.shape)

    def forces(self, seen: Framed) -> np.ndarray:
        """Forces (3, rows, cols) N of an image or a pair, less those read in the pair's no-contact image itself (tare)."""
        read = np.asarray(self.model.graph(seen.features())[0])
        if isinstance(seen, Pair):
            nocontact = seen.nocontact
            if nocontact.rest is None:
                nocontact.rest = np.asarray(self.model.graph(nocontact.itself().features())[0])
            read = read - nocontact.rest
        return read * np.float32(self.gain.value)

    def stream(self, images: Iterable[np.ndarray]) -> Iterator[ForceReading]:
        """Predict images as they come from a camera: the same as one by one.

        Args:
            images: each (h, w, 3) uint8 RGB.

        Returns:
            One reading of each, as soon as it is asked for.

        Raises:
            BadInput: anything that is no such image; it ends the stream.
        """
        return map(self, images)

    def batch(self, images: Iterable[np.ndarray]) -> list[ForceReading]:
        """Predict images: the same as one by one.

        Args:
            images: each (h, w, 3) uint8 RGB.

        Returns:
            One reading of each.

        Raises:
            BadInput: anything that is no such image.
        """
        return [self(image) for image in images]

    def __reduce__(self) -> tuple[Any, ...]:
        return reader_with, (self.model, self._given, self.gain, self._sensor)


def reader_with(
    model: ForceModel, picture: np.ndarray | None, gain: Gain = AS_READ, sensor: Sensor | None = None
) -> Reader:
    """A reader with a known factor on forces."""
    reader = Reader.__new__(Reader)
    reader._set(model, picture, gain, sensor)
    return reader


def check_image(image: np.ndarray) -> np.ndarray:
    """A copy of an image (h, w, 3) uint8, because its owner may write into it again; anything else raises BadInput."""
    image = np.array(image)
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or not image.size:
        raise BadInput(f"an image of shape {image.shape} and type {image.dtype}: give (height, width, 3) uint8 RGB")
    return image


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
