"""A trained network at work on one image: the model, the untouched sensor beside it, forces and a judgement."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.networks.agreement import dots_fault, settle
from gelforge.networks.canonical import WHOLE, Light, view_of
from gelforge.networks.dots import Followed, PrintedDots
from gelforge.networks.intervals import half_widths
from gelforge.networks.placement import LEAST_MOVE, UNPLACED, Placement, place
from gelforge.networks.statistics import (
    PairEvidence,
    distance,
    dot_evidence,
    judge,
    relief,
    relief_fault,
)
from gelforge.records.markers import pitch_of

LEAST_PULL = 1.0  # N above which a reading that no contact can make is told
SHIPPED = Path(__file__).parent / "default.pt"


def load_for_use(path, sensor: str | None = None):
    """Load a model for prediction and check that it is for `sensor`, where one is named."""
    from gelforge.networks.modelfile import load_model, require_sensor

    if path is None and not SHIPPED.exists():
        raise BadInput(
            "no model came with this copy of gelforge: train one with `make train` and name it with --model"
        )
    trained = load_model(path or SHIPPED)
    if sensor:
        require_sensor(trained, {sensor})
    return trained


def fit_size(image, size) -> tuple[np.ndarray, str]:
    """Bring an image to a model's (height, width); the second value says what was done, empty for nothing."""
    import cv2

    if image.shape[:2] == tuple(size):
        return image, ""
    resized = cv2.resize(image, (size[1], size[0]), interpolation=cv2.INTER_AREA)
    return resized, f"size {image.shape[1]} x {image.shape[0]}, trained on {size[1]} x {size[0]}"


class Untouched:
    """Finds the picture of the untouched sensor that an image is read against.

    picture: (h, w, 3) uint8 RGB of any size, given by the user. sensor: name of a training sensor. With neither,
    each image is read against the training sensor it is nearest to. gain: what all forces are multiplied by
    (networks.sensorprofile). fault: what is wrong with the given picture, empty if nothing. view: how pictures of the sensor are scaled; those of training sensors are at the right scale.
    """

    def __init__(self, trained, picture: np.ndarray | None = None, sensor: str | None = None, gain: float = 1.0):
        self.trained, self.known, self.gain = trained, trained.untouched, gain
        self.view = WHOLE
        if not trained.needs_untouched:
            self.known = {"": None}
        elif picture is not None:
            sized = fit_size(picture, trained.about["image"])[0]
            self.known = {"given": sized}
            if "pitch_px" in trained.about:
                self.view = view_of(sized, pitch_of(sized), trained.about["pitch_px"])
        elif sensor in trained.untouched:
            self.known = {sensor: trained.untouched[sensor]}
        elif sensor or not trained.untouched:
            raise BadInput(
                f"model {trained.about['name']} has no picture of the untouched sensor {sensor or 'of any name'}: give "
                "one with --untouched"
            )
        self.fault = (
            relief_fault(trained.about["statistics"], relief(self.known["given"])) if "given" in self.known else ""
        )
        self._pictures: dict[str, np.ndarray] = {}
        self._dots: dict[str, PrintedDots] = {}
        self._readers: dict[str, Any] = {}
        self._rest: dict[str, np.ndarray] = {}

    def of(self, image) -> str:
        """Name of the picture for an image (h, w, 3) of the model's size."""
        if len(self.known) == 1:
            return next(iter(self.known))
        return min(self.known, key=lambda name: distance(image, self.known[name]))

    def picture(self, name: str) -> np.ndarray:
        """The untouched picture of that name at the network's scale."""
        if name not in self._pictures:
            self._pictures[name] = self.view.of(self.known[name])
        return self._pictures[name]

    def canonical(self, image, name: str, placement: Placement | None = None) -> tuple[np.ndarray, Light]:
        """An image as the network reads it against the picture of that name, and what its light was."""
        seen = self.view.of(image)
        return self.view.match(seen if placement is None else placement.undo(seen), self.picture(name))

    def dots(self, name: str) -> PrintedDots:
        """Dots of the picture of that name at the network's scale."""
        if name not in self._dots:
            self._dots[name] = PrintedDots(self.picture(name))
        return self._dots[name]

    def pair(self, image, name: str, placement: Placement | None = None) -> "CanonicalPair":
        """An image as the network reads it against the picture of that name.

        placement: how it lies on that picture, as its sitting tells it; None: as the image's own dots do, where its rim
        moved. A view that does not show the gel's rim tells nothing of it.
        """
        lit, light = self.canonical(image, name, placement)
        dots, rest = self.dots(name), self.picture(name)
        followed = dots.follow(lit)
        if self.view.zoom != 1.0:
            return CanonicalPair(lit, PairEvidence(distance(lit, rest), light), dots, followed, placement or UNPLACED)
        told = dot_evidence(dots, followed)
        if placement is None and told.rim_px > LEAST_MOVE:
            placement = place(self.trained.places, dots, [followed])
            if placement.moves:
                # dots that lay beside each other told of light, too
                lit, light = self.canonical(image, name, placement)
                followed = dots.follow(lit)
                told = dot_evidence(dots, followed)
        return CanonicalPair(
            lit, PairEvidence(distance(lit, rest), light, told), dots, followed, placement or UNPLACED
        )

    def reader(self, name: str):
        """The network for the sensor of that picture."""
        from gelforge.networks.modelfile import SensorNet

        if name not in self._readers:
            picture = None if self.known[name] is None else self.picture(name)
            self._readers[name] = SensorNet(self.trained, picture).eval()
        return self._readers[name]

    def rest(self, name: str) -> np.ndarray:
        """Forces (3, rows, cols) that the network reads in that picture itself: what it is off by where nothing is."""
        from gelforge.networks.latency import predict_images

        if name not in self._rest:
            self._rest[name] = predict_images(self.reader(name), self.picture(name)[None])[0]
        return self._rest[name]


@dataclass(frozen=True)
class CanonicalPair:
    """An image as the network reads it beside an untouched picture, and what is known of how they belong together.

    lit: (h, w, 3) uint8 in the light, at the scale and in the place of the untouched one. dots: of the untouched one, and
    where the image has them. placement: what was put right in how the image lay.
    """

    lit: np.ndarray
    evidence: PairEvidence
    dots: PrintedDots
    followed: Followed
    placement: Placement

    def by_dots(self, reader) -> np.ndarray | None:
        """Total force (3,) N that the dots tell by themselves (networks.dotreader); None where nothing reads them."""
        if reader is None or not self.dots.known:
            return None
        return reader.totals(self.dots.on_lattice(self.followed)[None])[0]


def predict_one(
    untouched: Untouched, image, placement: Placement | None = None
) -> tuple[np.ndarray, np.ndarray, dict]:
    """Predict an image of any size; return it as the network sees it, forces (3, rows, cols), and the judgement.

    A network that reads differences is given the image under the light of the untouched picture, at the scale it learnt,
    and laid onto that picture by `placement` (None: by what the image's own dots tell); what it reads in that picture
    itself is taken off, as a scale is tared. The judgement is that of networks.statistics.judge, with `untouched`, what
    picture the image was read against, `light`, what its light differed by (networks.canonical), `placed`, what was put
    right in how it lay (empty for nothing), `by_dots`, the totals (3,) N that the dots tell by themselves (None where
    nothing reads them; else the forces' totals are the mean of both), and `half_width` (3,) N of the totals' intervals
    (networks.intervals; None where the model knows none).
    """
    from gelforge.networks.latency import predict_images

    trained = untouched.trained
    image, resized = fit_size(image, trained.about["image"])
    name = untouched.of(image)
    pair = untouched.pair(image, name, placement) if trained.needs_untouched else None
    lit = pair.lit if pair else image
    light = pair.evidence.light if pair else None
    verdict = judge(trained.about["statistics"], lit, pair.evidence if pair else None)
    verdict |= {"untouched": name, "light": light, "placed": pair.placement.told if pair else ""}
    forces = predict_images(untouched.reader(name), lit[None])[0]
    if trained.needs_untouched:
        forces = forces - untouched.rest(name)
    by_dots, contradicted = pair.by_dots(trained.dots) if pair else None, ""
    if by_dots is not None:
        contradicted = dots_fault(trained.about["dots"]["apart"], forces.sum((1, 2), dtype=float), by_dots)
        forces = settle(forces, by_dots, trained.about["dots"]["weight"])
    forces = forces * np.float32(untouched.gain)
    verdict["by_dots"] = None if by_dots is None else untouched.gain * by_dots
    verdict["half_width"] = half_widths(trained.about, "total", forces.sum((1, 2), dtype=float), untouched.gain)
    faults = [resized, untouched.fault, verdict["reason"], light_fault(light), pull_fault(forces), contradicted]
    faults += [pair.placement.fault] if pair else []
    reason = "; ".join(filter(None, faults))
    return untouched.view.of(image), forces, verdict | {"flag": verdict["flag"] or bool(reason), "reason": reason}


@dataclass(frozen=True)
class Told:
    """What `predict` tells of some rows of a dataset: forces (n, 3, rows, cols) N and half widths (n, 3) N of the totals.

    half_widths: None where the model knows none. by_dots: totals (n, 3) N of the reader of dots alone, None where there is
    none. in_place: whether all cells are those of the labels; False where a sensor's pictures were scaled, because then its
    cells show other places.
    """

    forces: np.ndarray
    half_widths: np.ndarray | None
    by_dots: np.ndarray | None
    in_place: bool


def tell_rows(trained, data, rows) -> Told:
    """What `predict` tells of some rows of a dataset (networks.data.Data), each against its own untouched sensor."""
    names = data.names("sensor_id")[rows].tolist()
    # One row of each sensor is enough to find its picture.
    first = dict(zip(names, rows, strict=True))
    beside = {name: _beside(trained, name, data.untouched([row])[0]) for name, row in first.items()}
    forces, widths, by_dots = [], [], []
    for row, name in zip(rows, names, strict=True):
        _, told, verdict = predict_one(beside[name], np.ascontiguousarray(data.images[row]))
        forces.append(told)
        widths.append(verdict["half_width"])
        by_dots.append(verdict["by_dots"])
    in_place = all(one.view.zoom == 1.0 for one in beside.values())
    return Told(np.stack(forces), _all_or_none(widths), _all_or_none(by_dots), in_place)


def _all_or_none(found: list) -> np.ndarray | None:
    """Rows as one array; None where one of them is none."""
    return None if any(one is None for one in found) else np.stack(found)


def _beside(trained, name: str, picture: np.ndarray) -> Untouched:
    try:
        return Untouched(trained, picture)
    except BadInput as error:
        raise BadInput(f"sensor {name}: {error}") from None


def light_fault(light) -> str:
    """What is wrong with a pair of pictures whose light cannot be compared; empty where it can."""
    return "" if light is None or light.known else "nothing in it has the light of the untouched picture"


def pull_fault(forces: np.ndarray) -> str:
    """What is wrong with a gel that pulls on what touches it; empty where it presses, forces (3, rows, cols) N."""
    pull = float(forces[2].sum())
    if pull < LEAST_PULL:
        return ""
    return f"the gel seems to pull with {pull:.1f} N: something may have touched it in the untouched picture"
