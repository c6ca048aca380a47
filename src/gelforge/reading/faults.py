"""Faults of a sensor's images: each fault is a function of the images, with its limit and its message.

A no-contact image is checked by itself (`nocontact_fault`), an image against it (`pair_fault`), and then the
prediction (`pull_fault`). `Reader`, `gelforge live`, `gelforge sensor`, and stages 15 and 60 use only these
functions. Some limits come from the image pairs of training (`pair_limits`, in the model's `limits`); the others come
from real Minis.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gelforge.reading.frame import BLUE_FIRST
from gelforge.reading.light import Light, match_light
from gelforge.reading.markers import MarkerTracker, Tracks, grey_of
from gelforge.reading.pair import NoContact, Prepared
from gelforge.reading.untouched import touch_fault, touch_of
from gelforge.reading.wear import faded, pale

Limits = Mapping[str, float]
TOUCH_MARGIN = 1.1  # factor on the largest `touch_of` of the no-contact images of training
# Limits of shear, in marker pitches: motion of a marker, and its difference between neighbours; or FAR_MOVED, with
# more than a fraction FAR_LOST of the markers lost. Beyond them are all of 132 drags by 1.5 to 2.5 mm (rig, four
# bodies, six units), whose forces are predicted half too small; a third of the drags by 1 mm (within 25 %); the
# farthest frames of a tenth of real films.
MOST_MOVED, MOST_TORN, FAR_MOVED, FAR_LOST = 0.6, 0.45, 0.4, 0.1
# Names of the limits of good pairs and no-contact images in a model file; an absent limit does not apply.
LIMITS = (
    "largest_distance",
    "largest_residual",
    "least_share",
    "largest_rim_px",
    "largest_rim_lost",
    "largest_uneven",
    "largest_touch",
    "least_sharp",
)
MARGIN = 1.5
GOOD_PERCENTILE = 99.0  # percentile of good pairs that sets a limit: the few worst pairs are outliers
LEAST_UNEVEN = 0.2  # px: precision of tracked markers, and lower bound of the limit "largest_uneven"

# A gel that is mounted differently, or another gel, shows as common motion: the 10 % quantile of marker motion
# exceeds this fraction of the 90 % quantile, and so many px. It does so in 0.4 % of 700 presses of the rig, drags
# included.
ALIKE_FRACTION, ALIKE_PX = 0.55, 1.0
# Another gel's markers also look different. Above the first fraction of such markers, the second number replaces
# ALIKE_FRACTION; above the third, no motion is needed. This flags none of 238 frames of real films against their own
# no-contact images, 99 % against that of the gripper's other finger, and 2 % of the rig's presses cropped to 70 %,
# most of 30 N and more.
OTHER_LOOK, OTHER_LOOK_ALIKE_FRACTION, MOST_OTHER_LOOK = 0.27, 0.25, 0.5
LEAST_LEVEL, LEAST_CONTRAST = 40.0, 30  # grey levels: least mean of a no-contact image, least range of any image
SHARP_MARGIN = 0.45  # of the logarithm of sharpness, below the least sharp no-contact image of training
# Of an image relative to its no-contact image: least logarithm of sharpness; level of a white pixel, and largest
# additional fraction of these. The least sharp of 130 images of real sensors has -0.42, and none has white pixels;
# blurred by a pixel of 320, all have -1.0 or less.
LEAST_SHARPNESS, WHITE, MOST_WHITE = -0.7, 254, 0.1
MOST_BRIGHTER = 1.8  # ratio of mean levels, either way, beyond which markers look different
# Ratio of marker counts, image to no-contact image: at most 1.14 in real films, 1.8 in one that is cropped by a
# seventh.
MOST_CROWDED = 1.35
GREY = 1.5  # levels: mean range between the colours of a pixel, below which an image counts as monochrome
# Largest fraction of half-worn markers, in the image alone and in both images, at which forces are within 10 %.
MOST_FADED, MOST_PALE = 0.25, 0.33
MOST_VANISHED = 8  # of 63 markers: with so many painted over in both images, 90 % of the forces are within 11 %
# Largest change of the light's distribution from the middle to the edge of an image, as a fraction of its level: of
# all colours together, and of one. None of 114 frames of real films that nothing else flags exceeds it; the largest
# of 51 real presses of a ball is 0.8 %.
MOST_FALL, MOST_COLOUR_FALL = 0.04, 0.055
LEAST_PULL = 1.0  # N above which a prediction that no contact can make is flagged
# Area in px at 320 x 240 (FEATS' markers have 106), and grey levels below the surroundings.
MARKER_AREA, MARKER_DEPTH = (25, 500), 18

# Limits of the likeness of the light patterns of an image and a no-contact image. In 480 frames of real films, 51
# real presses of a ball and 48 of the rig it is at least 0.59 against the own no-contact image (median 0.9), and at
# least 0.625 where the light also differs, as under wide strong contacts. Against another unit's it is 0.49 to 0.64,
# and below 0.62 in 90 %.
PATTERN = (40, 30)  # px, width and height
OTHER_PATTERN = 0.62  # likeness below which an image is of another unit, if its light also differs
NO_PATTERN = 0.4  # likeness below which an image whose light cannot be compared shows no gel of the sensor
OWN_PATTERN = 0.75  # likeness above which a turned or mirrored no-contact image fits
FLIPPED = 0.1  # by how much its likeness must exceed that of the no-contact image as it is
OTHER_DISTANCE, OTHER_RESIDUAL = 9.0, 16.0  # levels
FLIPS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "mirrored left to right": lambda image: image[:, ::-1],
    "mirrored top to bottom": lambda image: image[::-1],
    "turned by 180 degrees": lambda image: image[::-1, ::-1],
}
ORDERS = {**FLIPS, "in the other colour order (red and blue exchanged)": lambda image: image[..., ::-1]}


# No-contact images.


def nocontact_fault(nocontact: NoContact, limits: Limits, coloured: bool = True) -> str:
    """What is wrong with a no-contact image by itself; empty where nothing is.

    limits: of the network, may be empty. coloured: whether images are expected to have colour.
    """
    picture = nocontact.picture[nocontact.frame.shown]
    level = float(picture.mean())
    if nocontact.fault:
        return nocontact.fault
    if is_blank(picture):
        return "the no-contact image shows no gel: it is dark, covered or of one colour"
    if coloured and is_grey(picture):
        return "the no-contact image is monochrome, but colours are compared: set the camera to colour (RGB or BGR)"
    if level < LEAST_LEVEL:
        return f"the no-contact image is dark: its mean level is {level:.0f} of 255, at least {LEAST_LEVEL:.0f} is usual; check the lamps and the exposure"
    sharp, least = sharpness(picture), limits.get("least_sharp", -math.inf)
    if sharp < least:
        return (
            f"the no-contact image is blurred: its sharpness is {math.exp(sharp - least):.0%} of the least that is usual; focus the camera and"
            " hold it still"
        )
    if pale(nocontact.markers) > MOST_PALE:
        return "the markers of the no-contact image are pale: they are worn, or their print differs from that of the sensors in training"
    most = limits.get("largest_touch", 1.0)
    touched = touch_fault(nocontact.picture, nocontact.markers, nocontact.frame.shown, most)
    return touched or (BLUE_FIRST if nocontact.frame.blue_first else "")


def is_blank(image: np.ndarray) -> bool:
    """Whether the levels of an image (h, w, 3) uint8 span less than LEAST_CONTRAST."""
    import cv2

    low, high, _, _ = cv2.minMaxLoc(np.ascontiguousarray(image).reshape(len(image), -1))
    return high - low < LEAST_CONTRAST


def is_grey(image: np.ndarray) -> bool:
    """Whether an image (h, w, 3) uint8 has no colour. Call it before photometric normalisation, which adds colour."""
    import cv2

    small = cv2.resize(image, PATTERN, interpolation=cv2.INTER_AREA).astype(int)
    return float(np.ptp(small, axis=2).mean()) < GREY


def sharpness(image: np.ndarray) -> float:
    """Logarithm of 1 plus the variance of the Laplacian of an image (h, w, 3) uint8, in grey levels."""
    import cv2

    rough = spread_of(cv2.Laplacian(grey_of(cv2.split(image)), cv2.CV_16S))
    return math.log(1 + rough**2)


def spread_of(plane: np.ndarray) -> float:
    """Standard deviation of a plane (h, w) of integers, from exact sums: OpenCV's own takes ten times as long."""
    import cv2

    mean = cv2.sumElems(plane)[0] / plane.size
    return math.sqrt(max(0.0, cv2.norm(plane, cv2.NORM_L2SQR) / plane.size - mean**2))


# Pairs.


@dataclass(frozen=True)
class MarkerSigns:
    """Signs from tracked markers of whether an image and its no-contact image show one sensor, mounted alike.

    Where the rim is shown, else 0: rim_px, median motion of the rim's markers, px; rim_lost, fraction of them that
    are lost or look different; uneven, lower quartile of the distance of a marker's motion from the mean of its two
    neighbours', px (contact moves neighbours alike, whereas another gel's markers are printed at other places).

    Where no rim is shown, else 0: alike_px, 10 % quantile of marker motion, px, or 0 where the motion is not common
    to most markers; other_look, fraction of all markers that are lost or look different.
    """

    rim_px: float = 0.0
    rim_lost: float = 0.0
    uneven: float = 0.0
    alike_px: float = 0.0
    other_look: float = 0.0


@dataclass(frozen=True)
class PairSigns:
    """Signs of whether an image and a no-contact image are of one sensor with the gel mounted alike.

    distance: between them after photometric normalisation, levels. light: the change of light that it removed.
    markers: signs from the markers.
    """

    distance: float
    light: Light
    markers: MarkerSigns = MarkerSigns()


def pair_signs(seen: Prepared) -> PairSigns | None:
    """Signs of whether an image and its no-contact image belong together; None for a single-image model."""
    if seen.nocontact is None or seen.light is None:
        return None
    markers = seen.nocontact.markers
    rim = seen.nocontact.frame.shows_rim
    found = rim_signs(markers, seen.tracks) if rim else rimless_signs(seen.tracks)
    return PairSigns(distance(seen.lit, seen.nocontact.picture), seen.light, found)


def distance(image: np.ndarray, nocontact: np.ndarray) -> float:
    """Median difference between an image and a no-contact image, grey levels; images (h, w, 3) uint8.

    A press changes less than half of the image by much; another sensor's light changes most of it.
    """
    import cv2

    difference = cv2.resize(cv2.absdiff(image, nocontact), (80, 60), interpolation=cv2.INTER_AREA)
    # adding planes takes a quarter of the time of a mean along the colour axis
    red, green, blue = cv2.split(difference)
    return float(np.median(red.astype(np.uint16) + green + blue)) / 3


def rim_signs(markers: MarkerTracker, tracks: Tracks) -> MarkerSigns:
    """Signs from the tracked markers of an image that shows the gel's rim."""
    rim = markers.rim
    if not rim.any():
        return MarkerSigns()
    moved = np.hypot(*tracks.motion[rim & tracks.found].T)
    rim_px = float(np.median(moved)) if len(moved) else 0.0
    return MarkerSigns(rim_px, float(tracks.unlike[rim].mean()), unevenness(markers.on_lattice(tracks)))


def rimless_signs(tracks: Tracks) -> MarkerSigns:
    """Signs from the tracked markers of an image that does not show the gel's rim.

    A drag moves distant markers less; a gel that is mounted differently moves all of them. Markers of another gel
    also look different from those of the no-contact image, but so may the markers around a contact.
    """
    if not len(tracks.unlike):
        return MarkerSigns()
    other_look = float(tracks.unlike.mean())
    moved = np.hypot(*tracks.motion[tracks.found].T)
    if not len(moved):
        return MarkerSigns(other_look=other_look)
    fraction = OTHER_LOOK_ALIKE_FRACTION if other_look > OTHER_LOOK else ALIKE_FRACTION
    least, most = np.quantile(moved, (0.1, 0.9)).tolist()
    return MarkerSigns(alike_px=least if least > fraction * most else 0.0, other_look=other_look)


def bends(moved: np.ndarray) -> np.ndarray:
    """Distances (n,) px of vectors from the mean of their two neighbours, along rows and along columns.

    moved: (3, rows, cols), components along u and v in px, and 1 where there is a vector.
    """
    found = []
    for rows in (moved, moved.transpose(0, 2, 1)):
        known = (rows[2, :, :-2] > 0) & (rows[2, :, 1:-1] > 0) & (rows[2, :, 2:] > 0)
        beside = rows[:2, :, 1:-1] - (rows[:2, :, :-2] + rows[:2, :, 2:]) / 2
        found.append(np.hypot(*beside[:, known]))
    return np.concatenate(found)


def unevenness(motion: np.ndarray) -> float:
    """Lower quartile of the distance of markers' motions (3, ROWS, COLS) from the mean of two neighbours, px.

    A quartile, because the motion is uneven at a contact's edge, too.
    """
    bent = bends(motion)
    return float(np.partition(bent, len(bent) // 4)[len(bent) // 4]) if len(bent) else 0.0


def pair_limits(found: Sequence[PairSigns]) -> dict[str, float]:
    """Limits derived from good pairs; the images of a pair beyond them do not belong together."""
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


def nocontact_limits(sensors: Sequence[NoContact]) -> dict[str, float]:
    """Limits of the no-contact images of the sensors that a network was trained on."""
    touch = [touch_of(one.picture, one.markers, one.frame.shown) for one in sensors]
    return {
        "largest_touch": max(1.0, TOUCH_MARGIN * max(touch)),
        "least_sharp": min(sharpness(one.picture) for one in sensors) - SHARP_MARGIN,
    }


def wider(known: Limits, found: Limits) -> dict[str, float]:
    """The wider of two sets of limits, for a fine-tuned network."""
    return {
        name: (min if name.startswith("least_") else max)(known.get(name, value), value)
        for name, value in {**known, **found}.items()
    }


def pair_fault(limits: Limits, pair: PairSigns) -> str:
    """Why the images of a pair do not belong together; empty where they are within all limits."""
    light, markers = pair.light, pair.markers
    unlike = light.residual > limits.get("largest_residual", np.inf) or light.fraction < limits.get(
        "least_share", 0.0
    )
    faults = {
        "the image and the no-contact image are of different sensors": (
            pair.distance > limits.get("largest_distance", np.inf)
        ),
        "too little of the image matches the no-contact image": light.known and unlike,
        f"the rim of the gel moved by {markers.rim_px:.1f} px since the no-contact image": (
            markers.rim_px > limits.get("largest_rim_px", np.inf)
        ),
        f"nearly all markers moved by at least {markers.alike_px:.1f} px: the gel is mounted differently than in the no-contact image, or"
        " the no-contact image is of another gel": markers.alike_px > ALIKE_PX,
        f"{markers.other_look:.0%} of its markers do not look like those of the no-contact image: the image is of another gel, or blurred": (
            markers.other_look > MOST_OTHER_LOOK
        ),
        "the markers at the rim are not those of the no-contact image, or blurred": (
            markers.rim_lost > limits.get("largest_rim_lost", np.inf)
        ),
        "the marker pattern differs from that of the no-contact image: the image is of another gel, or its markers cannot be tracked": (
            markers.uneven > limits.get("largest_uneven", np.inf)
        ),
    }
    return next((fault for fault, seen in faults.items() if seen), "")


def wear_fault(seen: Prepared) -> str:
    """Fault of a pair in which too many markers vanished or faded for a prediction; empty where there is none."""
    if seen.vanished > MOST_VANISHED:
        return f"{seen.vanished} markers are visible only in the image or only in the no-contact image: take a new no-contact image, or change the gel"
    if seen.nocontact is None or seen.change is None:
        return ""
    fainter = faded(seen.nocontact.markers, seen.nocontact.printed, seen.tracks, seen.darkness)
    if fainter <= MOST_FADED:
        return ""
    return f"{fainter:.0%} of its markers are fainter than in the no-contact image: take a new no-contact image, focus the camera, or change the gel"


def crowd_fault(seen: Prepared) -> str:
    """Fault of an image that shows many more markers than its no-contact image; empty where there is none."""
    known = 0 if seen.nocontact is None else len(seen.nocontact.markers.points)
    if not known:
        return ""
    count = count_markers(seen.darkness)
    if count <= MOST_CROWDED * known:
        return ""
    return f"the image shows {count} markers, the no-contact image {known}: crop and scale both alike"


def count_markers(darkness: np.ndarray) -> int:
    """Number of dark markers of an image, by its `darkness_of`."""
    import cv2

    _, mask = cv2.threshold(darkness, MARKER_DEPTH, 255, cv2.THRESH_BINARY)
    # twice as fast as OpenCV's default algorithm, with the same components
    _, _, boxes, _ = cv2.connectedComponentsWithStatsWithAlgorithm(mask, 8, cv2.CV_32S, cv2.CCL_BBDT)
    scale = darkness.shape[0] * darkness.shape[1] / (240 * 320)
    area = boxes[1:, cv2.CC_STAT_AREA]
    return int(((area >= MARKER_AREA[0] * scale) & (area <= MARKER_AREA[1] * scale)).sum())


def light_fault(seen: Prepared) -> str:
    """Fault of the light of a pair of images: it cannot be compared, or falls from another side; or empty."""
    if seen.light is None or seen.nocontact is None:
        return ""
    if not seen.light.known:
        return "the light of the image cannot be matched to that of the no-contact image"
    mean, most = seen.nocontact.reference.fall_of(seen.image, seen.light)
    if mean <= MOST_FALL and most <= MOST_COLOUR_FALL:
        return ""
    return (
        f"the light is distributed differently than in the no-contact image, by {max(mean, most):.0%} of its level from the middle to the edge:"
        " take a new no-contact image under the present light"
    )


def grey_fault(image: np.ndarray, coloured: bool) -> str:
    """What is wrong with an image (h, w, 3) uint8 without colour; coloured: whether it is expected to have some."""
    if not coloured or not is_grey(image):
        return ""
    return "the image is monochrome, but colours are compared: set the camera to colour (RGB or BGR)"


def pattern_fault(seen: Prepared) -> str:
    """Why an image is not of the sensor of its no-contact image; empty where it may be.

    The lamps of a sensor give the gel a pattern of colours that no press hides, and that another unit, a mirrored or a covered
    camera does not show.
    """
    if seen.nocontact is None or seen.light is None:
        return ""
    image, rest, light = seen.image, seen.nocontact.picture, seen.light
    pattern, own = light_pattern(image), light_pattern(rest)
    alike = likeness(pattern, own)
    if alike >= 1.0 - FLIPPED:
        return ""
    fits = {how: likeness(pattern, order(own)) for how, order in ORDERS.items()}
    how = max(fits, key=lambda one: fits[one])
    if fits[how] > max(OWN_PATTERN, alike + FLIPPED):
        other = np.ascontiguousarray(ORDERS[how](rest))
        if _same_light(image, other, match_light(image, other)):
            return f"the image is {how} compared with the no-contact image"
    if alike >= OWN_PATTERN:
        return ""
    if not light.known:
        unknown = "the image shows nothing of this sensor: it is dark, covered or of something else"
        return "" if alike >= NO_PATTERN else unknown
    if alike >= OTHER_PATTERN or _same_light(image, rest, light):
        return ""
    return "the image and the no-contact image are of different sensors: their light comes from different sides"


def light_pattern(image: np.ndarray) -> np.ndarray:
    """Colours (30, 40, 3) float32 of an image (h, w, 3) uint8, each without its mean."""
    import cv2

    small = cv2.resize(image, PATTERN, interpolation=cv2.INTER_AREA).astype(np.float32)
    return np.asarray(small - small.mean(axis=(0, 1)))


def likeness(one: np.ndarray, other: np.ndarray) -> float:
    """Normalised cross-correlation of two maps of one shape, from -1 to 1; 0 where one of them is flat."""
    one, other = one - one.mean(), other - other.mean()
    size = float(np.sqrt((one**2).sum() * (other**2).sum()))
    return float((one * other).sum()) / size if size > 0.0 else 0.0


def _same_light(image: np.ndarray, nocontact: np.ndarray, light: Light) -> bool:
    return (
        light.known and light.residual <= OTHER_RESIDUAL and distance(light.undo(image), nocontact) <= OTHER_DISTANCE
    )


def log_image_fault(seen: Prepared) -> str:
    """Why an image of a log is not of the sensor of its no-contact image; empty where it may be.

    Only faults that make it useless in a dataset; those that matter to a network are checked at prediction.
    """
    assert seen.nocontact is not None
    if is_blank(seen.image):
        return "the image shows nothing of this sensor: it is dark, covered or of one colour"
    return (
        grey_fault(seen.image, not is_grey(seen.nocontact.picture))
        or camera_fault(seen.image, seen.nocontact.picture)
        or pattern_fault(seen)
    )


def camera_fault(image: np.ndarray, nocontact: np.ndarray) -> str:
    """Camera fault of an image (h, w, 3) uint8 beside its no-contact image: blur, overexposure, brightness; or empty.

    At prediction such images are flagged by their markers.
    """
    if sharpness(image) - sharpness(nocontact) < LEAST_SHARPNESS:
        return "the image is blurred compared with its no-contact image, or of another unit: focus the camera, and log images while nothing moves"
    if _white(image) - _white(nocontact) > MOST_WHITE:
        return f"the image is overexposed, more than {MOST_WHITE:.0%} of its pixels are white: shorten the exposure"
    if not 1.0 / MOST_BRIGHTER < image.mean() / max(nocontact.mean(), 1.0) < MOST_BRIGHTER:
        return f"the image is more than {MOST_BRIGHTER:g} times brighter or darker than its no-contact image: take a no-contact image under the light of the presses"
    return ""


def _white(image: np.ndarray) -> float:
    """Fraction of pixels with at least one saturated colour."""
    return float((image.max(axis=2) >= WHITE).mean())


def shear_fault(seen: Prepared) -> str:
    """Fault of an image whose markers moved so far that they may be taken for their neighbours; or empty."""
    if seen.nocontact is None or seen.change is None:
        return ""
    markers = seen.nocontact.markers
    pitch = markers.printed.pitch
    if not pitch or not seen.tracks.found.any():
        return ""
    most = float(np.nanmax(np.hypot(*seen.tracks.motion.T))) / pitch
    apart = torn(markers.on_lattice(seen.tracks)) / pitch
    lost = most > FAR_MOVED and float(seen.tracks.found.mean()) < 1.0 - FAR_LOST
    if most <= MOST_MOVED and apart <= MOST_TORN and not lost:
        return ""
    return (
        f"its markers moved by {max(most, apart):.0%} of their pitch: farther than in training, so that a marker may be taken for its neighbour;"
        " drag the gel less"
    )


def torn(moved: np.ndarray) -> float:
    """Largest difference of motion between neighbouring markers, px; moved: as of `bends`."""
    most = 0.0
    for rows in (moved, moved.transpose(0, 2, 1)):
        known = (rows[2, :, :-1] > 0) & (rows[2, :, 1:] > 0)
        most = max(most, float(np.hypot(*(rows[:2, :, 1:] - rows[:2, :, :-1])[:, known]).max(initial=0.0)))
    return most


# Predictions.


def pull_fault(normal: float) -> str:
    """Fault of a predicted total normal force in N that pulls on the gel; empty where it presses."""
    if normal < LEAST_PULL:
        return ""
    return f"the gel seems to pull with {normal:.1f} N: something may have touched it in the no-contact image"


def first_fault(seen: Prepared, limits: Limits, coloured: bool, normal: float, of_nocontact: str) -> str:
    """The first fault of an image, its pair and its prediction; empty where there is none.

    normal: predicted total normal force, N. of_nocontact: fault of the no-contact image.
    """
    pair = None if seen.fault else pair_signs(seen)
    return (
        seen.fault
        or ("the image shows nothing: it is dark, covered or of one colour" if is_blank(seen.shown) else "")
        or grey_fault(seen.shown, coloured)
        or of_nocontact
        or wear_fault(seen)
        or crowd_fault(seen)
        or (pair_fault(limits, pair) if pair else "")
        or shear_fault(seen)
        or pattern_fault(seen)
        or light_fault(seen)
        or pull_fault(normal)
    )
