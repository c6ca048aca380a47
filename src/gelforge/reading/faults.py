"""Out-of-distribution checks: how unlike its training images an image is, and whether a pair of pictures belongs together."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from gelforge.reading.light import ALL, Light
from gelforge.reading.markers import COLS, ROWS, Markers, MarkerTracker, Tracks, darkness_of, grey_of
from gelforge.reading.pair import Prepared

# Smallest standard deviation that a statistic is given, so that a uniform training set does not flag
# what no eye could distinguish: grey levels for the colours, a marker or two for the count.
FLOORS = np.array([4.0] * 12 + [2.0] * 3 + [0.15, 2.0, 4.0])
MARKER_AREA = (25, 500)  # pixels at 320 x 240; FEATS' markers have about 106
MARKER_DEPTH = 18  # grey levels below their surroundings
SHRINKAGE = 0.2
LEAST_THRESHOLD = 3.0
MOST_DESCRIBED = 500  # images, of training and held out each, that the reference is fitted to
MARGIN = 1.5
RELIEF_SIZE = (160, 120)  # px at which the relief of a picture is looked at
RELIEF_MARGIN = 1.25
# Markers of one gel that is mounted differently, or of another gel, move alike: one of ten by more than this fraction of what another one of
# ten does, and than so many px. Of 700 presses of the rig, dragged ones too, four in a thousand do.
ALIKE_FRACTION, ALIKE_PX = 0.55, 1.0
# Another gel's markers look otherwise, too: beyond the first fraction of such markers less of a common motion suffices, beyond the second
# no motion is needed. Of 238 frames of real films none is flagged so beside its own no-contact image, beside that of the
# gripper's other finger 99 % are; of presses of the rig, cropped to seven tenths, 2 %, most of them of 30 N and more.
OTHER_LOOK, OTHER_LOOK_ALIKE_FRACTION, MOST_OTHER_LOOK = 0.27, 0.25, 0.5
# Where `describe` has the mean levels of an image's quarters and its sharpness, and what a no-contact image has at least.
QUARTERS, SHARPNESS, COUNT = 12, 15, 16
LEAST_LEVEL, LEAST_SHARP = 40.0, 3.0  # grey levels; deviations below the mean of training images
MOST_CROWDED = 1.35  # markers of an image over those of its no-contact image: real films have 1.14 at most, one cropped by a seventh 1.8
GREY = 1.5  # levels by which the colours of a picture differ in the mean where it has none
LEAST_UNEVEN = 0.2  # px to which markers are tracked, whatever the limit
GOOD_PERCENTILE = 99.0  # per cent of good pairs that the limits are set by: the worst of many are odd ones

# What good pairs stay within, by its name in a model file; one that is absent bounds nothing.
LIMITS = (
    "largest_distance",
    "largest_relief",
    "largest_residual",
    "least_share",
    "largest_rim_px",
    "largest_rim_lost",
    "largest_uneven",
)


def quarters(image: np.ndarray) -> np.ndarray:
    """Mean levels (12,) of the quarters of an image (h, w, 3) uint8: by rows, columns and colours."""
    import cv2

    height, width = image.shape[:2]
    if height % 2 or width % 2:
        return cv2.resize(image, (2, 2), interpolation=cv2.INTER_AREA).astype(float).ravel()
    middle = height // 2
    halves = [cv2.reduce(half, 0, cv2.REDUCE_SUM, dtype=cv2.CV_32S) for half in (image[:middle], image[middle:])]
    total = np.concatenate(halves).reshape(4, -1, 3).sum(axis=1)
    return np.rint(total.ravel() / (middle * width // 2))


def spread_of(plane: np.ndarray) -> float:
    """Standard deviation of a plane (h, w) of whole numbers, from sums that are exact: OpenCV's own takes ten times as long."""
    import cv2

    mean = cv2.sumElems(plane)[0] / plane.size
    return math.sqrt(max(0.0, cv2.norm(plane, cv2.NORM_L2SQR) / plane.size - mean**2))


def count_markers(depth: np.ndarray) -> tuple[int, float]:
    """Number of dark markers of an image, by its `darkness_of`, and their mean darkness in grey levels."""
    import cv2

    _, mask = cv2.threshold(depth, MARKER_DEPTH, 255, cv2.THRESH_BINARY)
    # one of several ways that OpenCV has to the same components, and twice as fast as what it takes by itself
    _, _, boxes, _ = cv2.connectedComponentsWithStatsWithAlgorithm(mask, 8, cv2.CV_32S, cv2.CCL_BBDT)
    scale = depth.shape[0] * depth.shape[1] / (240 * 320)
    area = boxes[1:, cv2.CC_STAT_AREA]
    good = (area >= MARKER_AREA[0] * scale) & (area <= MARKER_AREA[1] * scale)
    return int(good.sum()), float(cv2.mean(depth, mask)[0])


def describe(image: np.ndarray, darkness: np.ndarray | None = None) -> np.ndarray:
    """Statistics (18,) of an image (h, w, 3) uint8: quadrant colours, spread, sharpness, markers and their depth.

    darkness: of the image (`darkness_of`), where it is known.
    """
    import cv2

    colours = cv2.split(image)
    grey = grey_of(colours)
    rough = spread_of(cv2.Laplacian(grey, cv2.CV_16S))
    return np.array(
        [
            *quarters(image),
            *map(spread_of, colours),
            math.log(1 + rough**2),
            *count_markers(darkness_of(grey) if darkness is None else darkness),
        ]
    )


def fit(train: np.ndarray, held_out: np.ndarray) -> dict:
    """Fit the reference of `score` to statistics (n, 18) of training images and set the threshold on others.

    The threshold is `MARGIN` times the worst score of held-out images of the same kind, at least
    `LEAST_THRESHOLD`.
    """
    mean = train.mean(0)
    spread = np.maximum(train.std(0), FLOORS)
    scaled = (train - mean) / spread
    covariance = (1 - SHRINKAGE) * (scaled.T @ scaled) / len(train) + SHRINKAGE * np.eye(train.shape[1])
    model = {"mean": mean.tolist(), "spread": spread.tolist(), "inverse": np.linalg.inv(covariance).tolist()}
    worst = max((score(model, row) for row in held_out), default=0.0)
    return model | {"threshold": max(LEAST_THRESHOLD, MARGIN * worst)}


def as_arrays(model: dict) -> dict:
    """The reference of `score` as a model file keeps it, its lists made arrays: `score` then need not, for every image."""
    return {name: np.asarray(value) if isinstance(value, list) else value for name, value in model.items()}


def score(model: dict, statistics: np.ndarray) -> float:
    """Mahalanobis distance of an image's statistics per dimension; about 1 for an image like the training ones."""
    scaled = (np.asarray(statistics) - model["mean"]) / model["spread"]
    return float(np.sqrt(scaled @ np.asarray(model["inverse"]) @ scaled / len(scaled)))


def fit_to_images(see, train_rows, held_out_rows) -> dict:
    """Fit `score`'s reference to at most MOST_DESCRIBED training and held-out rows, evenly picked; see(row): (h, w, 3) uint8."""

    def described(rows):
        picked = rows[np.linspace(0, len(rows) - 1, min(MOST_DESCRIBED, len(rows))).astype(int)]
        return np.stack([describe(see(int(row))) for row in picked])

    return fit(described(train_rows), described(held_out_rows))


def widened(known: dict, images: Iterable[np.ndarray], found: dict[str, float]) -> dict:
    """The limits of a network that goes on: those it knows, as wide as its new pictures (h, w, 3) uint8 want them.

    found: limits that are set on the pairs of these pictures.
    """
    worst = max((score(known, describe(image)) for image in images), default=0.0)
    wider = {"threshold": max(known["threshold"], MARGIN * worst)}
    for name, value in found.items():
        wider[name] = (min if name.startswith("least_") else max)(known.get(name, value), value)
    return known | wider


def distance(image, nocontact) -> float:
    """Median over the picture of how far an image is from the no-contact image, grey levels; images (h, w, 3) uint8.

    A press changes less than half of the picture by much: another sensor's light changes most.
    """
    import cv2

    difference = cv2.resize(cv2.absdiff(image, nocontact), (80, 60), interpolation=cv2.INTER_AREA)
    # the sum of whole planes, a quarter of the time of a mean along the colours
    red, green, blue = cv2.split(difference)
    return quantile((red.astype(np.uint16) + green + blue).ravel(), 0.5) / 3


def relief(nocontact: np.ndarray, markers: Markers, shown: tuple[slice, slice] = ALL) -> float:
    """How uneven the light of a no-contact image (h, w, 3) uint8 is between its markers, levels of the three colours together.

    shown: rows and columns of the image that show something.

    What touches a gel shades it within a few markers' distance; the gel's own light changes over the whole picture.
    """
    import cv2

    gel = np.ones(nocontact.shape[:2], np.uint8)
    for u, v in markers.points.astype(int).tolist():
        cv2.circle(gel, (u, v), int(0.9 * markers.diameter) + 3, 0, -1)
    small = cv2.resize(nocontact[shown], RELIEF_SIZE, interpolation=cv2.INTER_AREA).astype(np.float32)
    weight = cv2.resize(gel[shown], RELIEF_SIZE, interpolation=cv2.INTER_NEAREST).astype(np.float32)

    def smooth(width: float) -> np.ndarray:
        around = cv2.GaussianBlur(weight, (0, 0), width)[..., None] + 1e-3
        return cv2.GaussianBlur(small * weight[..., None], (0, 0), width) / around

    uneven = np.abs(smooth(1.5) - smooth(8.0)).sum(axis=2)
    inner = np.s_[6:-6, 6:-6]
    between = weight[inner] > 0
    return float(np.percentile(uneven[inner][between], 99.5)) if between.any() else 0.0


def sharpness_fault(limits: dict, nocontact: np.ndarray) -> str:
    """What is wrong with the light or the focus of a no-contact image (h, w, 3) uint8; empty where both are usual.

    limits: the statistics of a network's training images. Of the first frames of 32 real films the dimmest has a mean level of 63 and the least sharp
    lies 1.7 deviations below the mean; a blur of 1.5 px makes of sharp images 3.3 deviations.
    """
    found = describe(nocontact)
    level = float(found[:QUARTERS].mean())
    if level < LEAST_LEVEL:
        return f"the no-contact image is dark: its mean level is {level:.0f} of 255, at least {LEAST_LEVEL:.0f} is usual; check the lamps and the exposure"
    below = (float(limits["mean"][SHARPNESS]) - found[SHARPNESS]) / float(limits["spread"][SHARPNESS])
    if below > LEAST_SHARP:
        return f"the no-contact image is blurred, {below:.1f} deviations below the usual sharpness, at most {LEAST_SHARP:.0f} are usual; focus the camera and hold it still"
    return ""


def relief_fault(limits: dict, value: float) -> str:
    """The sign that something touches a sensor in its no-contact image; empty where nothing does."""
    most = limits.get("largest_relief", np.inf)
    if value <= most:
        return ""
    return f"something seems to touch the gel in the no-contact image: its light is uneven by {value:.0f} levels, {most:.0f} are usual"


@dataclass(frozen=True)
class MarkerDiagnostics:
    """Whether both images are of one sensor, mounted alike, by the markers of a no-contact image that are found in an image.

    rim_px: how far half of the rim's markers moved at least, px. rim_lost: fraction of them that does not look as it did.
    uneven: px; in the quarter of all places where it departs least, the motion of a marker departs from the middle of its
    neighbours' by no more. Contact moves neighbours alike, and the markers of another print stand where its printer put them.
    All three are 0 where no rim is shown. alike_px: by how much nine of ten markers moved at least, px, where no rim is shown
    and they moved much alike; else 0. other_look: fraction of all markers that do not look as they did, where no rim is shown.
    """

    rim_px: float = 0.0
    rim_lost: float = 0.0
    uneven: float = 0.0
    alike_px: float = 0.0
    other_look: float = 0.0


@dataclass(frozen=True)
class PairDiagnostics:
    """Signs whether an image and a no-contact image are of one sensor that was mounted alike.

    distance: of the image, brought to the other's light, levels. light: what was taken back. markers: what they show.
    """

    distance: float
    light: Light
    markers: MarkerDiagnostics = MarkerDiagnostics()


def pair_diagnostics(seen: Prepared) -> PairDiagnostics | None:
    """Diagnostics whether an image and its no-contact image belong together; None beside a model of one picture."""
    if seen.nocontact is None or seen.light is None:
        return None
    markers = seen.nocontact.markers
    found = (
        marker_diagnostics(markers, seen.tracks)
        if seen.nocontact.frame.shows_rim
        else rimless_diagnostics(seen.tracks)
    )
    return PairDiagnostics(distance(seen.lit, seen.nocontact.picture), seen.light, found)


def marker_diagnostics(markers: MarkerTracker, tracks: Tracks) -> MarkerDiagnostics:
    """Evidence of where a no-contact image's markers are in an image."""
    rim = markers.rim
    if not rim.any():
        return MarkerDiagnostics()
    moved = np.hypot(*tracks.motion[rim & tracks.found].T)
    rim_px = quantile(moved, 0.5) if len(moved) else 0.0
    return MarkerDiagnostics(rim_px, float(tracks.unlike[rim].mean()), unevenness(markers.on_lattice(tracks)))


def rimless_diagnostics(tracks: Tracks) -> MarkerDiagnostics:
    """Evidence of where a no-contact image's markers are in an image, in a view that does not show the gel's rim.

    What drags a gel moves markers the less the farther they are; a gel that is mounted differently moves all of them. Markers of another
    gel do not look like those of the no-contact image either, which those around a contact need not.
    """
    if not len(tracks.unlike):
        return MarkerDiagnostics()
    other_look = float(tracks.unlike.mean())
    moved = np.hypot(*tracks.motion[tracks.found].T)
    if not len(moved):
        return MarkerDiagnostics(other_look=other_look)
    least, fraction = quantile(moved, 0.1), OTHER_LOOK_ALIKE_FRACTION if other_look > OTHER_LOOK else ALIKE_FRACTION
    return MarkerDiagnostics(
        alike_px=least if least > fraction * quantile(moved, 0.9) else 0.0, other_look=other_look
    )


def _rows_of_three() -> np.ndarray:
    """Places of the lattice, counted row by row, of three markers in a row along it or across: (3, n), the second between."""
    at = np.arange(ROWS * COLS).reshape(ROWS, COLS)
    along = [at[:, :-2], at[:, 1:-1], at[:, 2:]]
    across = [at[:-2], at[1:-1], at[2:]]
    return np.stack([np.concatenate([a.ravel(), b.ravel()]) for a, b in zip(along, across, strict=True)])


ROWS_OF_THREE = _rows_of_three()


def unevenness(motion: np.ndarray) -> float:
    """Lower quartile of how far markers' motions (3, ROWS, COLS) (reading.markers) depart from the middle of two neighbours', px.

    The quartile, because a contact's edge is uneven, too.
    """
    before, middle, after = ROWS_OF_THREE
    moved = motion.reshape(3, -1)
    found = moved[2] > 0
    known = found[before] & found[middle] & found[after]
    before, middle, after = before[known], middle[known], after[known]
    bend = np.hypot(*(moved[:2, middle] - (moved[:2, before] + moved[:2, after]) / 2))
    return quantile(bend, 0.25) if len(bend) else 0.0


def quantile(values: np.ndarray, fraction: float) -> float:
    """The value that `fraction` of some values (n,), at least one, lie below, between two of them by proportion.

    As numpy's, which looks at so much else that it takes ten times as long for a hundred values.
    """
    place = fraction * (len(values) - 1)
    low, high = math.floor(place), math.ceil(place)
    ordered = np.partition(values, (low, high))
    return float(ordered[low]) + (place - low) * (float(ordered[high]) - float(ordered[low]))


def pair_limits(found: Sequence[PairDiagnostics]) -> dict[str, float]:
    """What good pairs stay within, from such ones: beyond, a pair does not belong together."""
    most = {
        name: float(np.percentile([getattr(one.markers, name) for one in found], GOOD_PERCENTILE))
        for name in ("rim_px", "rim_lost", "uneven")
    }
    return {
        "largest_distance": MARGIN * float(np.percentile([one.distance for one in found], GOOD_PERCENTILE)),
        "largest_residual": MARGIN * float(np.percentile([one.light.residual for one in found], GOOD_PERCENTILE)),
        "least_share": float(np.percentile([one.light.fraction for one in found], 100.0 - GOOD_PERCENTILE)) / MARGIN,
        "largest_rim_px": 1.0 + most["rim_px"],
        "largest_rim_lost": 0.15 + most["rim_lost"],
        "largest_uneven": max(LEAST_UNEVEN, MARGIN * most["uneven"]),
    }


def pair_fault(limits: dict, pair: PairDiagnostics) -> str:
    """The sign that the images of a pair do not belong together; empty where nothing does."""
    light, markers = pair.light, pair.markers
    unlike = light.residual > limits.get("largest_residual", np.inf) or light.fraction < limits.get(
        "least_share", 0.0
    )
    faults = {
        "another sensor than the no-contact image": pair.distance > limits["largest_distance"],
        "too little of it looks like the no-contact image": light.known and unlike,
        f"the rim of the gel moved by {markers.rim_px:.1f} px since the no-contact image": (
            markers.rim_px > limits.get("largest_rim_px", np.inf)
        ),
        f"all its markers moved by {markers.alike_px:.1f} px and more: the gel is mounted differently than in the no-contact image, or that"
        " is of another gel": markers.alike_px > ALIKE_PX,
        f"{markers.other_look:.0%} of its markers do not look like those of the no-contact image: it is of another gel, or blurred": (
            markers.other_look > MOST_OTHER_LOOK
        ),
        "the markers at the rim are not those of the no-contact image, or blurred": (
            markers.rim_lost > limits.get("largest_rim_lost", np.inf)
        ),
        "its markers do not stand as those of the no-contact image: it is of another gel, or its markers cannot be tracked": (
            markers.uneven > limits.get("largest_uneven", np.inf)
        ),
    }
    return next((fault for fault, seen in faults.items() if seen), "")


def pair_score_fault(model: dict, seen: Prepared) -> tuple[float, str]:
    """Score of a prepared image as `score` gives it, and what is wrong with it or its pair, empty for nothing."""
    statistics = describe(seen.lit, seen.darkness)
    value = score(model, statistics)
    if value <= model["threshold"]:
        pair = pair_diagnostics(seen)
        return value, "" if pair is None else crowd_fault(statistics[COUNT], seen) or pair_fault(model, pair)
    off = np.abs(statistics - model["mean"]) / model["spread"]
    groups = {"colour": off[:12].max(), "contrast": off[12:15].max(), "sharpness": off[15], "markers": off[16:].max()}
    return value, f"unlike the training images in its {max(groups, key=lambda name: groups[name])}"


def crowd_fault(count: float, seen: Prepared) -> str:
    """What is wrong with an image that shows many more markers than its no-contact image: their number, and what that means."""
    known = 0 if seen.nocontact is None else len(seen.nocontact.markers.points)
    if not known or count <= MOST_CROWDED * known:
        return ""
    return f"{count:.0f} markers are in it, {known} in the no-contact image: crop and scale both alike"


def monochrome_fault(model: dict, image: np.ndarray, what: str) -> str:
    """What is wrong with an image (h, w, 3) uint8 without colour, where the training images had some; empty where nothing is.

    what: it is called. Photometric normalisation would give it colour, so it is asked before that.
    """
    import cv2

    small = cv2.resize(image, (40, 30), interpolation=cv2.INTER_AREA).astype(int)
    coloured = float(np.ptp(np.asarray(model["mean"][:12]).reshape(4, 3), axis=1).max()) > 2 * GREY
    if not coloured or float(np.ptp(small, axis=2).mean()) >= GREY:
        return ""
    return f"{what} is monochrome, the network learnt from colour: set the camera to colour (RGB or BGR)"
