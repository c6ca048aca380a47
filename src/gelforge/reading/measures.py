"""What an image and its no-contact image show of whether they belong together: one function for each measure of a pair."""

from collections.abc import Callable

import numpy as np

from gelforge.reading.light import Light, match_light
from gelforge.reading.markers import Tracks
from gelforge.reading.pair import Pair
from gelforge.reading.picture import likeness
from gelforge.reading.wear import faded

# Area in px at 320 x 240 (FEATS' markers have 106), and grey levels below the surroundings, of a marker.
MARKER_AREA, MARKER_DEPTH = (25, 500), 18
OWN_PATTERN = 0.75  # likeness above which a turned or mirrored no-contact image fits
FLIPPED = 0.1  # by how much its likeness must exceed that of the no-contact image as it is
OTHER_DISTANCE, OTHER_RESIDUAL = 9.0, 16.0  # levels up to which the light of two images may be that of one sensor
# A gel that is mounted differently, or another gel, shows as common motion: the 10 % quantile of marker motion exceeds
# this fraction of the 90 % quantile. It does so in 0.4 % of 700 presses of the rig, drags included. Where more markers
# than OTHER_LOOK look different, the second fraction applies.
ALIKE_FRACTION, OTHER_LOOK, OTHER_LOOK_ALIKE_FRACTION = 0.55, 0.27, 0.25
JUMP = 0.8  # pitches by which a marker that moves otherwise than a neighbour is mistaken for another one
FAR_LOST = 0.1  # fraction of lost markers beyond which their motion is that of the farthest one that was found
# Of a torn image: columns to which rows are averaged; steps that are looked at; rows on each side of a step; fraction of
# their difference that the step is at least; rows of a block of a compressed film.
COARSE, MOST_STEPS, SIDE, KEEPS, BLOCK = 20, 6, 5, 0.7, 8
MOST_EDGES = 15  # steps of a torn image; twice the next largest one is what its texture does by itself
WIDE = 10  # columns of the other sign, each as wide as a marker is far from the next
CLEAR, LEAST_CLEAR = 8, 0.2  # darkness up to which no marker is seen; least fraction of a column's pixels without one
# Weights of six rows, which continue the line through them to the step beside them.
EXTENT = np.array([0.5952, 0.4238, 0.2524, 0.081, -0.0905, -0.2619])
SPREAD, SMOOTH = 1.48, 0.3  # deviation over median magnitude; levels
# Levels and scales from which an image is torn. The largest of 703 whole pairs (552 frames of films, FEATS, balls, rig)
# have 1.6 and 2.9, drags by up to half a pitch 1.8.
STRONG, SHARED = 1.7, 3.1
FLIPS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "mirrored left to right": lambda image: image[:, ::-1],
    "mirrored top to bottom": lambda image: image[::-1],
    "turned by 180 degrees": lambda image: image[::-1, ::-1],
}
ORDERS = {**FLIPS, "in the other colour order (red and blue exchanged)": lambda image: image[..., ::-1]}


# Light and colours.


def sharper(pair: Pair) -> float:
    """Sharpness of the image, under the light of the no-contact image, less that of the latter."""
    return pair.lit.sharpness - pair.nocontact.picture.sharpness


def whiter(pair: Pair) -> float:
    """Fraction of white pixels in addition to those of the no-contact image."""
    return pair.image.white - pair.nocontact.picture.white


def brighter(pair: Pair) -> float:
    """Ratio of mean levels of the two images, the larger over the smaller one."""
    one, other = max(pair.image.level, 1.0), max(pair.nocontact.picture.level, 1.0)
    return max(one / other, other / one)


def distance(pair: Pair) -> float:
    """Median difference between the two images under one light, levels.

    A press changes less than half of the image by much; another sensor's light changes most of it.
    """
    return _distance(pair.lit.image, pair.nocontact.picture.image)


def _distance(image: np.ndarray, nocontact: np.ndarray) -> float:
    import cv2

    difference = cv2.resize(cv2.absdiff(image, nocontact), (80, 60), interpolation=cv2.INTER_AREA)
    # adding planes takes a quarter of the time of a mean along the colour axis
    red, green, blue = cv2.split(difference)
    return float(np.median(red.astype(np.uint16) + green + blue)) / 3


def residual(pair: Pair) -> float:
    """Difference of light that remains where the two images agree, levels; 0 where their light cannot be compared."""
    return pair.light.residual if pair.light.known else 0.0


def agreeing(pair: Pair) -> float:
    """Fraction of the image that agrees with the no-contact image; 1 where their light cannot be compared."""
    return pair.light.fraction if pair.light.known else 1.0


def unmatched(pair: Pair) -> float:
    """1 where the light of the image cannot be matched to that of the no-contact image, else 0."""
    return float(not pair.light.known)


def pattern_likeness(pair: Pair) -> float:
    """Likeness of the colours' patterns of the two images, 1 where their light is that of one sensor.

    The lamps of a sensor give the gel a pattern of colours that no press hides, and that another unit or a covered camera does
    not show.
    """
    alike = likeness(pair.framed.pattern, pair.nocontact.picture.pattern)
    if alike >= OWN_PATTERN or _same_light(pair.framed.image, pair.nocontact.picture.image, pair.light):
        return 1.0
    return alike


def dark_likeness(pair: Pair) -> float:
    """The same where the light cannot be compared; 1 elsewhere."""
    return pattern_likeness(pair) if unmatched(pair) else 1.0


def lit_likeness(pair: Pair) -> float:
    """The same where the light can be compared; 1 elsewhere."""
    return 1.0 if unmatched(pair) else pattern_likeness(pair)


def flipped(pair: Pair) -> str:
    """How the image is turned, mirrored or coloured compared with the no-contact image; empty where it is not."""
    image, rest = pair.framed, pair.nocontact.picture
    alike = likeness(image.pattern, rest.pattern)
    if alike >= 1.0 - FLIPPED:
        return ""
    fits = {how: likeness(image.pattern, order(rest.pattern)) for how, order in ORDERS.items()}
    how = max(fits, key=lambda one: fits[one])
    if fits[how] <= max(OWN_PATTERN, alike + FLIPPED):
        return ""
    other = np.ascontiguousarray(ORDERS[how](rest.image))
    return how if _same_light(image.image, other, match_light(image.image, other)) else ""


def _same_light(image: np.ndarray, nocontact: np.ndarray, light: Light) -> bool:
    return (
        light.known and light.residual <= OTHER_RESIDUAL and _distance(light.undo(image), nocontact) <= OTHER_DISTANCE
    )


def tear(pair: Pair) -> float:
    """How much the image looks as if its lower part were of another frame; above 1 it is torn.

    By one strong step of the difference between the two images from one row to the next, or by a weaker one that half of
    the image's width shares.
    """
    import cv2

    shown = pair.nocontact.frame.shown
    difference = cv2.subtract(pair.lit.image, pair.nocontact.picture.image, dtype=cv2.CV_32F)
    dark = cv2.dilate(cv2.max(pair.lit.darkness, pair.nocontact.picture.darkness), np.ones((3, 3), np.uint8))
    clear = cv2.resize((dark <= CLEAR).astype(np.float32), difference.shape[1::-1], interpolation=cv2.INTER_NEAREST)
    difference, clear = difference[shown], cv2.merge([clear] * 3)[shown]
    if pair.nocontact.frame.orientation.transposed:
        difference, clear = cv2.transpose(difference), cv2.transpose(clear)
    if len(difference) < MOST_EDGES + 2 * SIDE:
        return 0.0
    shared = shared_step(_columns(difference * clear, WIDE), _columns(clear, WIDE))
    return max(strong_step(_columns(difference, COARSE)) / STRONG, shared / SHARED)


def _columns(values: np.ndarray, count: int) -> np.ndarray:
    """Values (h, w, 3) averaged to (h, 3 count) columns."""
    import cv2

    return cv2.resize(values, (count, len(values)), interpolation=cv2.INTER_AREA).reshape(len(values), -1)


def strong_step(coarse: np.ndarray) -> float:
    """Largest step of differences (rows, columns) from one row to the next, levels.

    The mean along a row of the step's magnitude, less twice that of the rows beside it, because an edge that is pressed into
    the gel is blurred over several rows, and less what the image's texture does elsewhere. A step counts if the rows on both
    sides of it keep apart as far as it goes (KEEPS), and by a third where a film's blocks meet (BLOCK).
    """
    rows, step = len(coarse), np.diff(coarse, axis=0)
    size = np.abs(step).mean(axis=1)
    alone = size[1:-1] - 2.0 * np.maximum(size[:-2], size[2:])
    order, found = np.argsort(-alone), 0.0
    usual = 2.0 * max(float(alone[order[MOST_EDGES]]), 0.0)
    for at in (order[:MOST_STEPS] + 1).tolist():
        if not SIDE <= at < rows - SIDE:
            continue
        apart = coarse[at + 1 : at + 1 + SIDE].mean(axis=0) - coarse[at + 1 - SIDE : at + 1].mean(axis=0)
        if float(step[at] @ apart) >= KEEPS * max(float(apart @ apart), 1e-9):
            found = max(found, float(alone[at - 1]) / (1.0 if (at + 1) % BLOCK else 3.0) - usual)
    return found


def shared_step(sums: np.ndarray, clear: np.ndarray) -> float:
    """Largest step of differences between two rows that half of the columns share, over what they do elsewhere.

    sums, clear: (rows, columns), differences outside of markers, and the fraction of such pixels, because a drag moves
    the markers of one row alike. A column's step is that between the lines through the rows above and below (EXTENT). Its
    scale is the median over all rows, and SMOOTH levels at least. A contact's edge steps in its own columns alone; beside
    it nothing does.
    """
    reach = len(EXTENT)
    above = np.arange(reach - 1, len(sums) - reach)
    means = sums / np.maximum(clear, LEAST_CLEAR)
    size = np.abs(sum(part * (means[above + 1 + k] - means[above - k]) for k, part in enumerate(EXTENT)))
    middle = len(size) // 2  # a partition takes a third of the time of numpy's median
    scale = np.maximum(SPREAD * np.partition(size, middle, axis=0)[middle], SMOOTH)
    hidden = np.cumsum(np.pad(clear <= LEAST_CLEAR, ((1, 0), (0, 0))), axis=0)
    size[hidden[above + 1 + reach] > hidden[above + 1 - reach]] = 0.0
    rank = size.shape[1] // 2
    shared = np.partition(size / scale, rank, axis=1)[:, rank]
    return float((shared / np.where((above + 1) % BLOCK, 1.0, 3.0)).max())


# Markers.


def faint(pair: Pair) -> float:
    """Fraction of the markers that are fainter in the image than in the no-contact image."""
    return faded(pair.nocontact.markers, pair.nocontact.printed, pair.tracks, pair.lit.darkness)


def crowd(pair: Pair) -> float:
    """Number of markers of the image over that of the no-contact image; 0 where that shows none."""
    known = len(pair.nocontact.markers.points)
    return count_markers(pair.lit.darkness) / known if known else 0.0


def count_markers(darkness: np.ndarray) -> int:
    """Number of dark markers of an image, by its `darkness_of`."""
    import cv2

    _, mask = cv2.threshold(darkness, MARKER_DEPTH, 255, cv2.THRESH_BINARY)
    # twice as fast as OpenCV's default algorithm, with the same components
    _, _, boxes, _ = cv2.connectedComponentsWithStatsWithAlgorithm(mask, 8, cv2.CV_32S, cv2.CCL_BBDT)
    scale = darkness.shape[0] * darkness.shape[1] / (240 * 320)
    area = boxes[1:, cv2.CC_STAT_AREA]
    return int(((area >= MARKER_AREA[0] * scale) & (area <= MARKER_AREA[1] * scale)).sum())


def rim_px(pair: Pair) -> float:
    """Median motion of the rim's markers that registration left, px; 0 where no rim is shown."""
    if not pair.nocontact.frame.shows_rim:
        return 0.0
    moved = np.hypot(*pair.tracks.motion[pair.nocontact.markers.rim & pair.tracks.found].T)
    return float(np.median(moved)) if len(moved) else 0.0


def uneven(pair: Pair) -> float:
    """Lower quartile of the distance of a marker's motion from the mean of its two neighbours', px; 0 without a rim.

    Contact moves neighbours alike, whereas another gel's markers are printed at other places. A quartile, because the
    motion is uneven at a contact's edge, too.
    """
    if not pair.nocontact.frame.shows_rim or not pair.nocontact.markers.rim.any():
        return 0.0
    return unevenness(pair.nocontact.markers.on_lattice(pair.tracks))


def alike_px(pair: Pair) -> float:
    """10 % quantile of the markers' motion, px, where no rim is shown and it is common to most of them; else 0.

    A drag moves distant markers less; a gel that is mounted differently moves all of them.
    """
    return 0.0 if pair.nocontact.frame.shows_rim else common_motion(pair.tracks)


def common_motion(tracks: Tracks) -> float:
    """10 % quantile of markers' motion, px, or 0 where the motion is not common to most of them."""
    moved = np.hypot(*tracks.motion[tracks.found].T)
    if not len(moved):
        return 0.0
    fraction = OTHER_LOOK_ALIKE_FRACTION if float(tracks.unlike.mean()) > OTHER_LOOK else ALIKE_FRACTION
    least, most = np.quantile(moved, (0.1, 0.9)).tolist()
    return float(least) if least > fraction * most else 0.0


def other_look(pair: Pair) -> float:
    """Fraction of all markers that are lost or look different, where no rim is shown; else 0."""
    if pair.nocontact.frame.shows_rim or not len(pair.tracks.unlike):
        return 0.0
    return float(pair.tracks.unlike.mean())


def farthest(pair: Pair) -> float:
    """Largest motion of a marker that a neighbour follows, pitches; 0 without a pitch."""
    return _neighbours(pair)[0]


def farthest_of_lost(pair: Pair) -> float:
    """The same where more markers than FAR_LOST are lost; else 0."""
    found = pair.tracks.found
    return farthest(pair) if len(found) and float(found.mean()) < 1.0 - FAR_LOST else 0.0


def stretch(pair: Pair) -> float:
    """Largest difference of motion between a marker and a neighbour that follows it, pitches; 0 without a pitch."""
    return _neighbours(pair)[1]


def _neighbours(pair: Pair) -> tuple[float, float]:
    """Largest motion, and difference of motion, of neighbours on the lattice that differ by less than JUMP, pitches."""
    markers, most = pair.nocontact.markers, np.zeros(2)
    moved = markers.on_lattice(pair.tracks) / (markers.printed.pitch or np.inf)
    for rows in (moved, moved.transpose(0, 2, 1)):
        known = (rows[2, :, :-1] > 0) & (rows[2, :, 1:] > 0)
        one, other = rows[:2, :, :-1][:, known], rows[:2, :, 1:][:, known]
        apart = np.hypot(*(one - other))
        far = np.maximum(np.hypot(*one), np.hypot(*other))
        most = np.maximum(most, np.stack([far, apart])[:, apart < JUMP].max(axis=1, initial=0.0))
    return float(most[0]), float(most[1])


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
    """Lower quartile of `bends` of markers' motions (3, ROWS, COLS), px."""
    bent = bends(motion)
    return float(np.partition(bent, len(bent) // 4)[len(bent) // 4]) if len(bent) else 0.0
