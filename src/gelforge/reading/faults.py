"""What may be wrong with the images of a sensor: each fault is a function of what is seen, with its limit and its sentence.

A no-contact image is judged by itself (`nocontact_fault`), an image beside it (`pair_fault`), and what is predicted of both
(`pull_fault`). `Reader`, `gelforge live` and `gelforge sensor`, and stages 15 and 60 ask these functions alone. What pairs are like that
a network learnt from sets some of the limits (`pair_limits`, in the model's `limits`); the others are those of real Minis.
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
TOUCH_MARGIN = 1.1  # beyond the most of the no-contact images that a network learnt beside
# Of the distance of markers: how far one may move, and how much farther than its neighbour; and the first of these and a fraction of
# markers that are lost. Of 132 drags by 1.5 to 2.5 mm (rig, four bodies, six units), which are read half as large as they are, all are beyond; of those
# by 1 mm, read within 25 %, a third; of real films the farthest frames of one in ten.
MOST_MOVED, MOST_TORN, FAR_MOVED, FAR_LOST = 0.6, 0.45, 0.4, 0.1
# What good pairs and no-contact images stay within, by its name in a model file; one that is absent bounds nothing.
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
GOOD_PERCENTILE = 99.0  # per cent of good pairs that the limits are set by: the worst of many are odd ones
LEAST_UNEVEN = 0.2  # px to which markers are tracked, whatever the limit

# Markers of one gel that is mounted differently, or of another gel, move alike: one of ten by more than this fraction of what another one of
# ten does, and than so many px. Of 700 presses of the rig, dragged ones too, four in a thousand do.
ALIKE_FRACTION, ALIKE_PX = 0.55, 1.0
# Another gel's markers look otherwise, too: beyond the first fraction of such markers less of a common motion suffices, beyond the second
# no motion is needed. Of 238 frames of real films none is flagged so beside its own no-contact image, beside that of the
# gripper's other finger 99 % are; of presses of the rig, cropped to seven tenths, 2 %, most of them of 30 N and more.
OTHER_LOOK, OTHER_LOOK_ALIKE_FRACTION, MOST_OTHER_LOOK = 0.27, 0.25, 0.5
LEAST_LEVEL, LEAST_CONTRAST = 40.0, 30  # grey levels of a no-contact image
SHARP_MARGIN = (
    0.45  # of the logarithm of sharpness, below the least sharp no-contact image that a network learnt beside
)
# Of an image beside its no-contact image: logarithm of sharpness, and fraction of white pixels beyond. Of 130 images of real sensors the
# least sharp has -0.42, and none has white pixels; all have -1.0 and less once they are blurred by a pixel of 320.
LEAST_SHARPNESS, WHITE, MOST_WHITE = -0.7, 254, 0.1
MOST_BRIGHTER = 1.8  # times: with more or less light than that markers look otherwise
MOST_CROWDED = 1.35  # markers of an image over those of its no-contact image: real films have 1.14 at most, one cropped by a seventh 1.8
GREY = 1.5  # levels by which the colours of a picture differ in the mean where it has none
# Of all markers: with so many half worn, in the image alone or in both, forces are within 10 %.
MOST_FADED, MOST_PALE = 0.25, 0.33
MOST_VANISHED = 8  # markers, of 63: with so many painted over in both images, nine of ten forces are within 11 %
# Of the light's level, from the middle to the edge of the image: of all colours together, and of one. Of 114 frames of real films
# that nothing else flags none is beyond, of 51 real presses of a ball the largest is 0.8 %.
MOST_FALL, MOST_COLOUR_FALL = 0.04, 0.055
LEAST_PULL = 1.0  # N above which a prediction that no contact can make is flagged
MARKER_AREA, MARKER_DEPTH = (
    (25, 500),
    18,
)  # px at 320 x 240 (FEATS' markers have 106), and grey levels below their surroundings

# Limits of the light's pattern. Of 480 frames of real films, 51 real presses of a ball and 48 of the rig, beside their own no-contact images,
# it is alike to 0.59 and more (0.9 in the median), to 0.625 and more where the light is otherwise, too, as under wide strong
# contacts; beside that of another unit to 0.49 to 0.64, below 0.62 nine of ten.
PATTERN = (40, 30)  # px, width and height
OTHER_PATTERN = 0.62  # likeness below which an image is of another unit, if its light is otherwise, too
NO_PATTERN = 0.4  # likeness below which an image whose light cannot be compared shows no gel of the sensor
OWN_PATTERN = 0.75  # likeness above which a turned or mirrored no-contact image fits
FLIPPED = 0.1  # by which it then fits better
OTHER_DISTANCE, OTHER_RESIDUAL = 9.0, 16.0  # levels
FLIPS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "mirrored left to right": lambda image: image[:, ::-1],
    "mirrored top to bottom": lambda image: image[::-1],
    "turned by 180 degrees": lambda image: image[::-1, ::-1],
}
ORDERS = {**FLIPS, "with red and blue exchanged": lambda image: image[..., ::-1]}


# No-contact images.


def nocontact_fault(nocontact: NoContact, limits: Limits, coloured: bool = True) -> str:
    """What is wrong with a no-contact image by itself; empty where nothing is.

    limits: of the network that reads, or none. coloured: whether images are expected to have colour.
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
        return "the markers of the no-contact image are pale: they are worn, or printed otherwise than those that the network learnt from"
    most = limits.get("largest_touch", 1.0)
    touched = touch_fault(nocontact.picture, nocontact.markers, nocontact.frame.shown, most)
    return touched or (BLUE_FIRST if nocontact.frame.blue_first else "")


def is_blank(image: np.ndarray) -> bool:
    """Whether an image (h, w, 3) uint8 is of one level."""
    import cv2

    low, high, _, _ = cv2.minMaxLoc(np.ascontiguousarray(image).reshape(len(image), -1))
    return high - low < LEAST_CONTRAST


def is_grey(image: np.ndarray) -> bool:
    """Whether an image (h, w, 3) uint8 has no colour. Photometric normalisation would give it some, so it is asked before that."""
    import cv2

    small = cv2.resize(image, PATTERN, interpolation=cv2.INTER_AREA).astype(int)
    return float(np.ptp(small, axis=2).mean()) < GREY


def sharpness(image: np.ndarray) -> float:
    """Logarithm of how much a pixel of an image (h, w, 3) uint8 differs from its neighbours."""
    import cv2

    rough = spread_of(cv2.Laplacian(grey_of(cv2.split(image)), cv2.CV_16S))
    return math.log(1 + rough**2)


def spread_of(plane: np.ndarray) -> float:
    """Standard deviation of a plane (h, w) of whole numbers, from sums that are exact: OpenCV's own takes ten times as long."""
    import cv2

    mean = cv2.sumElems(plane)[0] / plane.size
    return math.sqrt(max(0.0, cv2.norm(plane, cv2.NORM_L2SQR) / plane.size - mean**2))


# Pairs.


@dataclass(frozen=True)
class MarkerSigns:
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
class PairSigns:
    """Signs whether an image and a no-contact image are of one sensor that was mounted alike.

    distance: of the image, brought to the other's light, levels. light: what was taken back. markers: what they show.
    """

    distance: float
    light: Light
    markers: MarkerSigns = MarkerSigns()


def pair_signs(seen: Prepared) -> PairSigns | None:
    """Signs whether an image and its no-contact image belong together; None beside a model of one image."""
    if seen.nocontact is None or seen.light is None:
        return None
    markers = seen.nocontact.markers
    rim = seen.nocontact.frame.shows_rim
    found = rim_signs(markers, seen.tracks) if rim else rimless_signs(seen.tracks)
    return PairSigns(distance(seen.lit, seen.nocontact.picture), seen.light, found)


def distance(image: np.ndarray, nocontact: np.ndarray) -> float:
    """Median over the picture of how far an image is from the no-contact image, grey levels; images (h, w, 3) uint8.

    A press changes less than half of the picture by much: another sensor's light changes most.
    """
    import cv2

    difference = cv2.resize(cv2.absdiff(image, nocontact), (80, 60), interpolation=cv2.INTER_AREA)
    # the sum of whole planes, a quarter of the time of a mean along the colours
    red, green, blue = cv2.split(difference)
    return float(np.median(red.astype(np.uint16) + green + blue)) / 3


def rim_signs(markers: MarkerTracker, tracks: Tracks) -> MarkerSigns:
    """Signs by where a no-contact image's markers are in an image that shows the gel's rim."""
    rim = markers.rim
    if not rim.any():
        return MarkerSigns()
    moved = np.hypot(*tracks.motion[rim & tracks.found].T)
    rim_px = float(np.median(moved)) if len(moved) else 0.0
    return MarkerSigns(rim_px, float(tracks.unlike[rim].mean()), unevenness(markers.on_lattice(tracks)))


def rimless_signs(tracks: Tracks) -> MarkerSigns:
    """Signs by where a no-contact image's markers are in an image that does not show the gel's rim.

    What drags a gel moves markers the less the farther they are; a gel that is mounted differently moves all of them. Markers of another
    gel do not look like those of the no-contact image either, which those around a contact need not.
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
    """How far places (3, rows, cols), the third 1 where there is one, depart from the middle of two neighbours', (n,) px."""
    found = []
    for rows in (moved, moved.transpose(0, 2, 1)):
        known = (rows[2, :, :-2] > 0) & (rows[2, :, 1:-1] > 0) & (rows[2, :, 2:] > 0)
        beside = rows[:2, :, 1:-1] - (rows[:2, :, :-2] + rows[:2, :, 2:]) / 2
        found.append(np.hypot(*beside[:, known]))
    return np.concatenate(found)


def unevenness(motion: np.ndarray) -> float:
    """Lower quartile of how far markers' motions (3, ROWS, COLS) depart from the middle of two neighbours', px.

    The quartile, because a contact's edge is uneven, too.
    """
    bent = bends(motion)
    return float(np.partition(bent, len(bent) // 4)[len(bent) // 4]) if len(bent) else 0.0


def pair_limits(found: Sequence[PairSigns]) -> dict[str, float]:
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


def nocontact_limits(sensors: Sequence[NoContact]) -> dict[str, float]:
    """What the no-contact images of the sensors that a network learnt from stay within."""
    touch = [touch_of(one.picture, one.markers, one.frame.shown) for one in sensors]
    return {
        "largest_touch": max(1.0, TOUCH_MARGIN * max(touch)),
        "least_sharp": min(sharpness(one.picture) for one in sensors) - SHARP_MARGIN,
    }


def wider(known: Limits, found: Limits) -> dict[str, float]:
    """Limits that hold what either of two do, where a network goes on from another one."""
    return {
        name: (min if name.startswith("least_") else max)(known.get(name, value), value)
        for name, value in {**known, **found}.items()
    }


def pair_fault(limits: Limits, pair: PairSigns) -> str:
    """The sign that the images of a pair do not belong together; empty where nothing does."""
    light, markers = pair.light, pair.markers
    unlike = light.residual > limits.get("largest_residual", np.inf) or light.fraction < limits.get(
        "least_share", 0.0
    )
    faults = {
        "another sensor than the no-contact image": pair.distance > limits.get("largest_distance", np.inf),
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


def wear_fault(seen: Prepared) -> str:
    """What is wrong with a pair that differs by more markers than a prediction without them allows; empty where it does not."""
    if seen.vanished > MOST_VANISHED:
        return f"{seen.vanished} markers are in the image or in the no-contact image alone: take a new one, or change the gel"
    if seen.nocontact is None or seen.change is None:
        return ""
    fainter = faded(seen.nocontact.markers, seen.nocontact.printed, seen.tracks, seen.darkness)
    if fainter <= MOST_FADED:
        return ""
    return f"{fainter:.0%} of its markers are fainter than in the no-contact image: take a new one, focus the camera, or change the gel"


def crowd_fault(seen: Prepared) -> str:
    """What is wrong with an image that shows many more markers than its no-contact image: their number, and what that means."""
    known = 0 if seen.nocontact is None else len(seen.nocontact.markers.points)
    if not known:
        return ""
    count = count_markers(seen.darkness)
    if count <= MOST_CROWDED * known:
        return ""
    return f"{count} markers are in it, {known} in the no-contact image: crop and scale both alike"


def count_markers(darkness: np.ndarray) -> int:
    """Number of dark markers of an image, by its `darkness_of`."""
    import cv2

    _, mask = cv2.threshold(darkness, MARKER_DEPTH, 255, cv2.THRESH_BINARY)
    # one of several ways that OpenCV has to the same components, and twice as fast as what it takes by itself
    _, _, boxes, _ = cv2.connectedComponentsWithStatsWithAlgorithm(mask, 8, cv2.CV_32S, cv2.CCL_BBDT)
    scale = darkness.shape[0] * darkness.shape[1] / (240 * 320)
    area = boxes[1:, cv2.CC_STAT_AREA]
    return int(((area >= MARKER_AREA[0] * scale) & (area <= MARKER_AREA[1] * scale)).sum())


def light_fault(seen: Prepared) -> str:
    """What is wrong with the light of a pair of images: it cannot be compared, or falls from another side; empty where it is right."""
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
            return f"the image is {how} against the no-contact image"
    if alike >= OWN_PATTERN:
        return ""
    if not light.known:
        unknown = "the image shows nothing of this sensor: it is dark, covered or of something else"
        return "" if alike >= NO_PATTERN else unknown
    if alike >= OTHER_PATTERN or _same_light(image, rest, light):
        return ""
    return "the image and the no-contact image are of two sensors: their light comes from other sides"


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

    Only what makes it useless in a dataset: what a network reads is judged where it reads.
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
    """What a camera did to an image (h, w, 3) uint8 and not to its no-contact image: out of focus, overexposed, in other light; empty for nothing.

    A reader flags such images by their markers.
    """
    if sharpness(image) - sharpness(nocontact) < LEAST_SHARPNESS:
        return "the image is blurred beside its no-contact image, or of another unit: focus the camera, and log images when it is still"
    if _white(image) - _white(nocontact) > MOST_WHITE:
        return f"the image is overexposed, more than {MOST_WHITE:.0%} of its pixels are white: shorten the exposure"
    if not 1.0 / MOST_BRIGHTER < image.mean() / max(nocontact.mean(), 1.0) < MOST_BRIGHTER:
        return "the image has about twice the light of its no-contact image, or half of it: take a no-contact image in the light of the presses"
    return ""


def _white(image: np.ndarray) -> float:
    """Fraction of pixels of which a colour is as bright as it can be."""
    return float((image.max(axis=2) >= WHITE).mean())


def shear_fault(seen: Prepared) -> str:
    """What is wrong with an image in which markers moved so far that they may be taken for their neighbours; empty where none did."""
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
        f"its markers moved by {max(most, apart):.0%} of their distance: farther than the network learnt, and each may be taken for its"
        " neighbour; drag the gel less"
    )


def torn(moved: np.ndarray) -> float:
    """The most by which motions (3, rows, cols) of neighbours differ, the third 1 where there is one, px."""
    most = 0.0
    for rows in (moved, moved.transpose(0, 2, 1)):
        known = (rows[2, :, :-1] > 0) & (rows[2, :, 1:] > 0)
        most = max(most, float(np.hypot(*(rows[:2, :, 1:] - rows[:2, :, :-1])[:, known]).max(initial=0.0)))
    return most


# Predictions.


def pull_fault(normal: float) -> str:
    """What is wrong with a gel that pulls on what touches it; empty where it presses, total normal force in N."""
    if normal < LEAST_PULL:
        return ""
    return f"the gel seems to pull with {normal:.1f} N: something may have touched it in the no-contact image"


def first_fault(seen: Prepared, limits: Limits, coloured: bool, normal: float, of_nocontact: str) -> str:
    """The first fault of an image, a pair and what is predicted of them, (N) normal force; empty where there is none.

    of_nocontact: what is wrong with the no-contact image.
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
