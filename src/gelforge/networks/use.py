"""A trained network at work on one image: the model, the untouched sensor beside it, forces and a judgement."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.networks.agreement import blend, dots_fault, has_shape
from gelforge.networks.bothways import PictureReader, picture_reader
from gelforge.networks.canonical import WHOLE, Light, Resting, view_of
from gelforge.networks.data import Data
from gelforge.networks.dotreader import DotsOneByOne
from gelforge.networks.dots import Followed, PrintedDots
from gelforge.networks.intervals import half_widths
from gelforge.networks.modelfile import Trained, load_model, require_sensor
from gelforge.networks.placement import LEAST_MOVE, UNPLACED, Placement, place, placed_nearer
from gelforge.networks.placereader import PlacesOneByOne
from gelforge.networks.sensorprofile import AS_READ, Gain
from gelforge.networks.stacking import features
from gelforge.networks.statistics import (
    DotEvidence,
    PairEvidence,
    as_arrays,
    distance,
    dot_evidence,
    judge,
    relief,
    relief_fault,
    rimless_evidence,
)
from gelforge.records.markers import pitch_of
from gelforge.records.totals import edge_peak

LEAST_PULL = 1.0  # N above which a reading that no contact can make is told
SAME_SHAPE = 0.02  # share by which the sides of an untouched picture may be in another ratio than the model's
GIVEN = "given"  # what predictions call an untouched picture that the user gave; others have their sensor's name
SHIPPED = Path(__file__).parent / "default.pt"


def load_for_use(path: Path | str | None, sensor: str | None = None) -> Trained:
    """Load a model for prediction and check that it is for `sensor`, where one is named; None: the one that ships."""
    if path is None and not SHIPPED.exists():
        raise BadInput(
            "no model came with this copy of gelforge: train one with `make train` and name it with --model"
        )
    trained = load_model(path or SHIPPED)
    if sensor:
        require_sensor(trained, {sensor})
    return trained


def fit_size(image: np.ndarray, size: Sequence[int]) -> tuple[np.ndarray, str]:
    """Bring an image to a model's (height, width); the second value says what was done, empty for nothing."""
    import cv2

    if image.shape[:2] == tuple(size):
        return image, ""
    resized = cv2.resize(image, (size[1], size[0]), interpolation=cv2.INTER_AREA)
    return resized, f"size {image.shape[1]} x {image.shape[0]}, trained on {size[1]} x {size[0]}"


def untouched_faults(picture: np.ndarray, sized: np.ndarray, pitch: float | None, statistics: dict) -> Iterator[str]:
    """What is wrong with a picture (h, w, 3) that is given for the untouched sensor; sized: brought to the model's size.

    pitch: of its dots in px, 0 where it shows no print of them; None beside a network that learnt from gels without.
    """
    (height, width), (rows, cols) = picture.shape[:2], sized.shape[:2]
    if abs(width * rows - height * cols) > SAME_SHAPE * height * cols:
        yield f"the untouched picture is {width} x {height}, of another shape than the {cols} x {rows} trained on"
    if pitch == 0.0:
        yield "the untouched picture shows no print of dots, which the network learnt from: it is blurred, or of another gel"
    yield relief_fault(statistics, relief(sized))


class Untouched:
    """Finds the picture of the untouched sensor that an image is read against.

    picture: (h, w, 3) uint8 RGB of any size, given by the user. sensor: name of a training sensor. With neither, each
    image is read against the training sensor it is nearest to. gain: what all forces are multiplied by
    (networks.sensorprofile). fault: what is wrong with the given picture, empty if nothing. view: how pictures of the
    sensor are scaled; those of training sensors are at the right scale.
    """

    def __init__(
        self, trained: Trained, picture: np.ndarray | None = None, sensor: str | None = None, gain: Gain = AS_READ
    ) -> None:
        self.trained, self.gain = trained, gain
        self.known: dict[str, Any] = trained.untouched  # pictures; None beside a network that reads none
        self.view, self.fault = WHOLE, ""
        if not trained.needs_untouched:
            self.known = {"": None}
        elif picture is not None:
            sized = self.sized(picture)
            self.known = {GIVEN: sized}
            pitch = pitch_of(sized) if "pitch_px" in trained.about else None
            if pitch:
                self.view = view_of(sized, pitch, trained.about["pitch_px"])
            self.fault = "; ".join(filter(None, untouched_faults(picture, sized, pitch, trained.about["statistics"])))
        elif sensor in trained.untouched:
            self.known = {sensor: trained.untouched[sensor]}
        elif sensor or not trained.untouched:
            raise BadInput(
                f"this network (trained as {trained.about['name']}) reads a picture against one of the same sensor while "
                f"nothing touches it, and has none{f' of {sensor}' if sensor else ''}: give it with --untouched PICTURE or "
                "--profile FILE (in Python untouched=, and profile= of Reader)"
            )
        self.statistics = as_arrays(trained.about["statistics"])
        self.reader_of_dots = None if trained.dots is None else DotsOneByOne(trained.dots)
        self.reader_of_places = None if trained.places is None else PlacesOneByOne(trained.places)
        # what is known of each untouched picture by its name, made when it is first needed
        self._resting: dict[str, Resting] = {}
        self._dots: dict[str, PrintedDots] = {}
        self._readers: dict[str, PictureReader] = {}
        self._rest: dict[str, np.ndarray] = {}

    def sized(self, image: np.ndarray) -> np.ndarray:
        """An image (h, w, 3) uint8 of any size at that of the model."""
        return fit_size(image, self.trained.about["image"])[0]

    def of(self, image: np.ndarray) -> str:
        """Name of the picture for an image (h, w, 3) of the model's size."""
        if len(self.known) == 1:
            return next(iter(self.known))
        return min(self.known, key=lambda name: distance(image, self.known[name]))

    def picture(self, name: str) -> np.ndarray:
        """The untouched picture of that name at the network's scale."""
        return self.resting(name).picture

    def resting(self, name: str) -> Resting:
        """The untouched picture of that name, and its light."""
        if name not in self._resting:
            self._resting[name] = Resting(self.view.of(self.known[name]), self.view)
        return self._resting[name]

    def canonical(self, seen: np.ndarray, name: str) -> tuple[np.ndarray, Light]:
        """An image of the sensor's view as the network reads it against the picture of that name, and what its light was."""
        return self.view.match(seen, self.resting(name))

    def dots(self, name: str) -> PrintedDots:
        """Dots of the picture of that name at the network's scale."""
        if name not in self._dots:
            self._dots[name] = PrintedDots(self.picture(name))
        return self._dots[name]

    def pair(self, image: np.ndarray, name: str, placement: Placement | None = None) -> "CanonicalPair":
        """An image as the network reads it against the picture of that name.

        placement: how it lies on that picture, as its sitting tells it; None: as the image's own dots do, where its rim
        moved. A view that does not show the gel's rim tells nothing of it.
        """
        shown = self.view.of(image)
        pair = self._laid(shown, name, placement or UNPLACED)
        if placement is None and pair.whole and pair.of_dots.rim_px > LEAST_MOVE:
            return self._placed(shown, name, pair)
        return pair

    def _laid(self, shown: np.ndarray, name: str, placement: Placement) -> "CanonicalPair":
        """An image of the sensor's view as a placement lays it on the picture of that name."""
        seen, dots = placement.undo(shown), self.dots(name)
        lit, light = self.canonical(seen, name)
        return CanonicalPair(placement, seen, lit, light, self.picture(name), dots, dots.follow(lit), self.view.whole)

    def _placed(self, shown: np.ndarray, name: str, pair: "CanonicalPair") -> "CanonicalPair":
        """The same as its own dots lay it; as it lies where they tell nothing."""
        reader = self.reader_of_places
        placement = place(reader, pair.dots, [pair.followed])
        if not placement.moves:
            return pair
        # dots that lay beside each other told of light, too
        laid = self._laid(shown, name, placement)
        return self._laid(shown, name, placed_nearer(placement, reader, pair.dots, [laid.followed]))

    def reader(self, name: str) -> PictureReader:
        """The network for the sensor of that picture."""
        if name not in self._readers:
            picture = None if self.known[name] is None else self.picture(name)
            self._readers[name] = picture_reader(self.trained, picture)
        return self._readers[name]

    def rest(self, name: str) -> np.ndarray:
        """Forces (3, rows, cols) that the network reads in that picture itself: what it is off by where nothing is."""
        if name not in self._rest:
            self._rest[name] = self.reader(name).read(self.picture(name))[0]
        return self._rest[name]


@dataclass(frozen=True)
class CanonicalPair:
    """An image as the network reads it beside an untouched picture (h, w, 3), and what tells how they belong together.

    placement: what was put right in how the image lay. seen: (h, w, 3) uint8 at the scale and in the place of the untouched
    one; lit: in its light, too, from which its own differed by `light`. picture, dots: the untouched one and its dots; followed:
    where the image has them. whole: whether both show the gel's rim.
    """

    placement: Placement
    seen: np.ndarray
    lit: np.ndarray
    light: Light
    picture: np.ndarray
    dots: PrintedDots
    followed: Followed
    whole: bool

    @cached_property
    def motion(self) -> np.ndarray:
        """How the dots moved, (3, ROWS, COLS) (networks.dots)."""
        return self.dots.on_lattice(self.followed)

    @cached_property
    def of_dots(self) -> DotEvidence:
        """What the dots tell of whether both pictures belong together."""
        return dot_evidence(self.dots, self.followed) if self.whole else rimless_evidence(self.followed)

    @cached_property
    def evidence(self) -> PairEvidence:
        """All that tells whether they do."""
        return PairEvidence(distance(self.lit, self.picture), self.light, self.of_dots)


@dataclass(frozen=True)
class TwoReadings:
    """What each reader tells of a pair: forces (3, rows, cols) N of its brightness, tared; by_dots, totals (3,) N of its dots.

    by_dots: None where nothing reads them. dots_found: share of the print's places where one was found. pooled: (k,) what
    the network sees in the picture as a whole (`Unrolled.with_pooled`).
    """

    forces: np.ndarray
    by_dots: np.ndarray | None
    dots_found: float
    pooled: np.ndarray

    def with_dots(self, reader: DotsOneByOne, motion: np.ndarray) -> "TwoReadings":
        """The same beside what a reader tells of the motion of dots (3, ROWS, COLS)."""
        return replace(self, by_dots=reader.total(motion), dots_found=float(motion[2].mean()))


def read_both(untouched: Untouched, name: str, lit: np.ndarray, pair: CanonicalPair | None) -> TwoReadings:
    """What each reader tells of an image (h, w, 3) under the light of the untouched picture of that name.

    pair: that image beside the untouched picture; None beside a network that reads none, where nothing is tared.
    """
    forces, pooled = untouched.reader(name).read(lit)
    if pair is None:
        return TwoReadings(forces, None, 0.0, pooled)
    alone = TwoReadings(forces - untouched.rest(name), None, 0.0, pooled)
    reader = untouched.reader_of_dots
    return alone if reader is None or not pair.dots.known else alone.with_dots(reader, pair.motion)


def told_together(trained: Trained, readings: TwoReadings) -> np.ndarray:
    """Forces (3, rows, cols) N in which both readers have their say."""
    if readings.by_dots is None:
        return readings.forces
    forces = blend(readings.forces, readings.by_dots, trained.about["dots"]["weight"])
    if trained.stacking is not None and has_shape(readings.forces):
        seen = features(readings.forces, readings.by_dots, readings.dots_found, readings.pooled)
        factor = trained.stacking.factor(seen)
        forces = forces * np.array([1.0, 1.0, factor], np.float32)[:, None, None]
    return forces


@dataclass(frozen=True)
class Judgement:
    """How far what was read in an image may be trusted, and what was done to the image before.

    score: how unlike the training images it is, about 1 for one like them (networks.statistics). reason: what is wrong
    with it or the picture beside it, empty for nothing. untouched: name of the picture that it was read against, empty
    beside a network that reads none. light: what its light differed by (networks.canonical), None beside such a network.
    placed: what was put right in how it lay, empty for nothing. by_dots: totals (3,) N that the dots tell by themselves,
    None where nothing reads them; half_width: (3,) N, half of the totals' intervals (networks.intervals), None where the
    model knows none. Both in the order of the channels, times the sensor's gain. edge_peak: largest force
    at the edge of what the picture shows, over the largest of all (records.totals).
    """

    score: float
    reason: str
    untouched: str
    light: Light | None
    placed: str
    by_dots: np.ndarray | None
    half_width: np.ndarray | None
    edge_peak: float

    @property
    def flag(self) -> bool:
        """Whether something is wrong."""
        return bool(self.reason)


def predict_one(
    untouched: Untouched, image: np.ndarray, placement: Placement | None = None
) -> tuple[np.ndarray, np.ndarray, Judgement]:
    """Read an image (h, w, 3) uint8 of any size: it as it lies below the forces, forces (3, rows, cols) N, a judgement.

    Both lie as the untouched picture does, also where the gel sat otherwise when the image was taken.

    A network that reads differences is given the image under the light of the untouched picture, at the scale it
    learnt, and laid onto that picture by `placement` (None: by what the image's own dots tell); what it reads in that
    picture itself is taken off, as a scale is tared. Where the dots are read, too, the forces' totals are told by both
    together.
    """
    trained = untouched.trained
    image, resized = fit_size(image, trained.about["image"])
    name = untouched.of(image)
    pair = untouched.pair(image, name, placement) if trained.needs_untouched else None
    lit = pair.lit if pair else image
    light = pair.light if pair else None
    likeness = judge(untouched.statistics, lit, pair.evidence if pair else None)
    readings = read_both(untouched, name, lit, pair)
    by_dots, contradicted = readings.by_dots, ""
    if by_dots is not None:
        total = readings.forces.sum((1, 2), dtype=float)
        contradicted = dots_fault(trained.about["dots"]["apart"], total, by_dots, untouched.gain.value)
    forces = told_together(trained, readings) * np.float32(untouched.gain.value)
    faults = [resized, untouched.fault, likeness.reason, light_fault(light), pull_fault(forces), contradicted]
    faults += [pair.placement.fault] if pair else []
    judgement = Judgement(
        score=likeness.score,
        reason="; ".join(filter(None, faults)),
        untouched=name,
        light=light,
        placed=pair.placement.correction if pair else "",
        by_dots=None if by_dots is None else untouched.gain.value * by_dots,
        half_width=half_widths(trained.about, forces.sum((1, 2), dtype=float), untouched.gain),
        edge_peak=edge_peak(forces, untouched.view.cells_shown(forces.shape[1:])),
    )
    return pair.seen if pair else image, forces, judgement


@dataclass(frozen=True)
class Predicted:
    """What `predict` tells of some rows of a dataset: forces (n, 3, rows, cols) N and half widths (n, 3) N of the totals.

    half_widths: None where the model knows none. by_dots: totals (n, 3) N of the reader of dots alone, None where there is
    none. in_place: whether all cells are those of the labels; False where a sensor's pictures were scaled, because then its
    cells show other places.
    """

    forces: np.ndarray
    half_widths: np.ndarray | None
    by_dots: np.ndarray | None
    in_place: bool


def tell_rows(trained: Trained, data: Data, rows: np.ndarray) -> Predicted:
    """What `predict` tells of some rows of a dataset, each against its own untouched sensor."""
    names = data.names("sensor_id")[rows].tolist()
    # One row of each sensor is enough to find its picture.
    first = dict(zip(names, rows, strict=True))
    beside = {name: _beside(trained, name, data.untouched([row])[0]) for name, row in first.items()}
    forces, widths, by_dots = [], [], []
    for row, name in zip(rows, names, strict=True):
        _, told, judgement = predict_one(beside[name], np.ascontiguousarray(data.images[row]))
        forces.append(told)
        widths.append(judgement.half_width)
        by_dots.append(judgement.by_dots)
    in_place = all(one.view.whole for one in beside.values())
    return Predicted(np.stack(forces), _all_or_none(widths), _all_or_none(by_dots), in_place)


def _all_or_none(found: list) -> np.ndarray | None:
    """Rows as one array; None where one of them is none."""
    return None if any(one is None for one in found) else np.stack(found)


def _beside(trained: Trained, name: str, picture: np.ndarray) -> Untouched:
    try:
        return Untouched(trained, picture)
    except BadInput as error:
        raise BadInput(f"sensor {name}: {error}") from None


def light_fault(light: Light | None) -> str:
    """What is wrong with a pair of pictures whose light cannot be compared; empty where it can."""
    return "" if light is None or light.known else "nothing in it has the light of the untouched picture"


def pull_fault(forces: np.ndarray) -> str:
    """What is wrong with a gel that pulls on what touches it; empty where it presses, forces (3, rows, cols) N."""
    pull = float(forces[2].sum())
    if pull < LEAST_PULL:
        return ""
    return f"the gel seems to pull with {pull:.1f} N: something may have touched it in the untouched picture"
