"""The printed markers of a gel: found in a no-contact image, and followed to other images.

Light does not move markers. What they do is mechanics alone: they spread around a press and go along with a drag, on a unit
of any contrast. All together they show whether the gel is mounted as it was (`faults.py`).

Registration shifts an image back whose gel was shifted in its holder since the no-contact image. The shift is the median motion
of the markers at the image's rim, where contact does least. It is taken back as far as it exceeds what contact does there, which
grows from nothing without a jump. Turn and zoom are not fitted: contact spreads markers, which a similarity takes for zoom.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from gelforge.errors import BadInput

# Detection.
PITCH_RANGE = (12.0, 90.0)  # px between neighbouring markers of any GelSight Mini image we know, with a margin of two
LARGEST_TURN = 25.0  # degrees a gel can be mounted turned in its holder and still be distinguished from the next lattice direction
REACH = 0.3  # of the pitch: how far from its expected place a marker is still that marker
LIT = 0.3  # of the brightest colour's background: below, a colour no longer separates noise from ink
LEAST_FRACTION = 0.5  # of the markers must be found for a grid to be believed
LEAST_FOR_PITCH = 8  # markers that give their distance
UNEVEN = 0.15  # fraction by which such distances differ in one print

# Tracking.
# Of the lattice that is looked at: a GelSight Mini shows 7 x 9 markers, or fewer where it is cropped.
ROWS, COLS = 9, 11
FAR = {"winSize": (21, 21), "maxLevel": 3}  # how markers are followed: in a pyramid, which reaches about 40 px
# How a marker is looked for where it should be: in the pictures themselves, in at most five steps or till one is small.
NEAR = {"winSize": (15, 15), "maxLevel": 0, "criteria": (3, 5, 0.03)}
HOME = 0.5  # px by which a marker that is followed there and back may miss its start
ALIKE, CLOSELY = 6.0, 0.05  # levels and px within which a marker that is looked for so is surely at home
UNLIKE = 12.0  # levels by which a marker's surroundings may differ on average
RIM = 0.8  # pitches from the outermost markers inwards that still are the rim
OF_CONTACT = 2.5  # px that a contact may move the rim's markers together
LEAST_FOUND = 0.5  # of the rim's markers, that must be found


@dataclass(frozen=True)
class Markers:
    """Dark round markers of an image: points (n, 2) as (u, v) px from the image's corner, and diameters (n,) px.

    background: levels (h, w, 3) of the image as they were without markers, plus 1; None where the markers were moved to another image.
    """

    points: np.ndarray
    diameters: np.ndarray
    background: np.ndarray | None = None

    @cached_property
    def pitch(self) -> float:
        """Median distance in px of markers to their nearest neighbours; 0 where they are no even print."""
        if len(self.points) < LEAST_FOR_PITCH:
            return 0.0
        apart = np.hypot(*(self.points[:, None] - self.points[None]).transpose(2, 0, 1))
        np.fill_diagonal(apart, np.inf)
        nearest = apart.min(axis=1)
        pitch = float(np.median(nearest))
        even = np.abs(nearest - pitch) < UNEVEN * pitch
        return pitch if even.mean() >= LEAST_FRACTION else 0.0

    @cached_property
    def lattice(self) -> tuple[np.ndarray, np.ndarray]:
        """Row and column (k, 2) of the markers that stand on one lattice, and which these are, (k,); none where none do."""
        try:
            return lattice_of(self.points)
        except BadInput:
            return np.zeros((0, 2), int), np.zeros(0, int)

    def only(self, chosen: np.ndarray) -> "Markers":
        """Some of them, (n,) bool."""
        return Markers(self.points[chosen], self.diameters[chosen])

    @property
    def diameter(self) -> float:
        """Median diameter, px; 0 where there are none."""
        return float(np.median(self.diameters)) if len(self.diameters) else 0.0

    def grid(self, rows: int, cols: int, where: str = "image") -> "MarkerGrid":
        """A grid of `rows` x `cols` of them, some missing or specks added; BadInput where no such grid is there."""
        points, widths = self.points, self.diameters
        if len(points) < max(4, LEAST_FRACTION * rows * cols):
            raise BadInput(
                f"{where}: {len(points)} dark spots found, a grid of {rows} x {cols} is expected; use a sharp image"
                " without contact, and check `markers` in workflow/sensors.toml"
            )
        index, used = _window(*lattice_of(points), rows, cols)
        if len(used) < LEAST_FRACTION * rows * cols:
            raise BadInput(
                f"{where}: only {len(used)} of {rows} x {cols} markers stand on one grid; use an image without contact,"
                " and check `markers` in workflow/sensors.toml"
            )
        return _measure(rows, cols, index, points[used], widths[used])


@dataclass(frozen=True)
class MarkerGrid:
    """Markers found in an image, px; index (n, 2) is (row, col) and points (n, 2) is (u, v) of each.

    pitch (2,) is the mean distance of neighbouring markers along u and v. Rotation in degrees (positive turns
    u towards v), centre (2,) of the whole grid and residual (root mean square distance of the markers from an
    even grid) come from a least-squares affine fit. missing: (m, 2) indices of markers that were not found.
    """

    rows: int
    cols: int
    index: np.ndarray
    points: np.ndarray
    pitch: np.ndarray
    rotation: float
    centre: np.ndarray
    residual: float
    diameter: float

    @property
    def count(self) -> int:
        return len(self.points)

    @property
    def missing(self) -> np.ndarray:
        full = {(row, col) for row in range(self.rows) for col in range(self.cols)}
        return np.array(sorted(full - {tuple(i) for i in self.index.tolist()}), int).reshape(-1, 2)


def lattice_of(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Row and column (n, 2) of the points (m, 2) px that stand on one lattice, and which points these are, (n,).

    Raises BadInput where none do.
    """
    index, used = _walk(points)
    return _complete(points, index, used)


def markers_in(image: np.ndarray) -> Markers:
    """The dark round markers of an image (h, w, 3) uint8.

    Each colour is divided by its own median-filtered background. Ink is dark in every colour and a marker's
    shadow only in the colour of the light it hides, so the least dark colour counts; a colour whose light
    hardly reaches a corner says nothing there. Centres are weighted by darkness; coordinates run from the image's
    edge, as those of label cells do: a pixel's centre is half a pixel in.
    """
    import cv2

    darkness, light = [], []
    for colour in np.moveaxis(image.reshape(*image.shape[:2], -1), 2, 0):
        colour = np.ascontiguousarray(colour)
        smooth = cv2.GaussianBlur(colour, (0, 0), 1.0).astype(np.float32) + 1.0
        background = cv2.GaussianBlur(cv2.medianBlur(colour, 51).astype(np.float32), (0, 0), 12.0) + 1.0
        darkness.append(np.clip(1.0 - smooth / background, 0.0, 1.0))
        light.append(background)
    dark = np.where(light >= LIT * np.max(light, axis=0), darkness, 1.0).min(axis=0)
    level = cv2.threshold((255 * dark).astype(np.uint8), 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)[0] / 255
    mask = cv2.morphologyEx((dark > level).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    _, label, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
    blobs = []
    for k, (left, top, width, height, area) in enumerate(stats[1:].tolist(), 1):
        if area < 9 or max(width, height) > 2.5 * min(width, height) or area < 0.45 * width * height:
            continue
        window = np.s_[top : top + height, left : left + width]
        weight = np.where(label[window] == k, dark[window], 0.0)
        v, u = np.mgrid[top : top + height, left : left + width] + 0.5
        centre = (u * weight).sum() / weight.sum(), (v * weight).sum() / weight.sum()
        blobs.append((*centre, 2.0 * np.sqrt(area / np.pi)))
    found = np.array(blobs).reshape(-1, 3)
    if len(found):
        typical = np.median(found[:, 2])
        found = found[(found[:, 2] > 0.5 * typical) & (found[:, 2] < 1.7 * typical)]
    return Markers(found[:, :2], found[:, 2], np.stack(light, axis=2))


def dark_spots(image: np.ndarray, wide: np.ndarray, near: np.ndarray, darker: float) -> np.ndarray:
    """Which pixels (h, w) of an image (h, w, 3) uint8 are of spots narrower than `wide`, or within `near` of one.

    wide, near: elements of morphology. darker: fraction of the largest level by which a spot is darker than what surrounds it.
    """
    import cv2

    brightest = image.max(axis=2)
    depth = cv2.subtract(cv2.morphologyEx(brightest, cv2.MORPH_CLOSE, wide), brightest)
    return cv2.dilate((depth > darker * int(brightest.max())).astype(np.uint8), near) > 0


def _steps(points: np.ndarray) -> np.ndarray:
    """The lattice's two steps (2, 2): typical displacement to the nearest neighbour along u, and along v."""
    if len(points) < 2:
        raise BadInput("fewer than two dark spots were found; use a sharp image without contact")
    apart = points[None] - points[:, None]
    distance = np.hypot(*apart.T).T
    distance[(distance < PITCH_RANGE[0]) | (distance > PITCH_RANGE[1])] = np.inf
    steps = []
    for axis in (0, 1):
        turn = np.degrees(np.arctan2(np.abs(apart[..., 1 - axis]), apart[..., axis]))
        reach = np.where(turn < LARGEST_TURN, distance, np.inf)
        nearest = reach.argmin(axis=1)
        real = np.isfinite(reach[np.arange(len(points)), nearest])
        if real.sum() < 2:
            raise BadInput("the dark spots found form no grid; use a sharp image without contact")
        steps.append(np.median(apart[np.flatnonzero(real), nearest[real]], axis=0))
    return np.array(steps)


def _walk(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Walk from marker to marker along the lattice from every start; keep the largest patch: index (n, 2), marker (n,)."""
    steps = _steps(points)
    best: dict[tuple[int, int], int] = {}
    reach = REACH * np.hypot(*steps.T).min()
    unseen = set(range(len(points)))
    while unseen:
        patch: dict[tuple[int, int], int] = {}
        queue = [(min(unseen), (0, 0))]
        while queue:
            marker, at = queue.pop()
            if at in patch or marker in patch.values():
                continue
            patch[at] = marker
            for move in ((0, 1), (0, -1), (1, 0), (-1, 0)):
                target = points[marker] + move[0] * steps[1] + move[1] * steps[0]
                gap = np.hypot(*(points - target).T)
                if gap.min() < reach:
                    queue.append((int(gap.argmin()), (at[0] + move[0], at[1] + move[1])))
        unseen -= set(patch.values())
        best = max(best, patch, key=len)
    return np.array(list(best)), np.array(list(best.values()))


def _model(index: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Least-squares affine map (3, 2) from (1, col, row) to pixels."""
    design = np.column_stack([np.ones(len(index)), index[:, 1], index[:, 0]])
    return np.linalg.lstsq(design, points, rcond=None)[0]


def _complete(points: np.ndarray, index: np.ndarray, used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Give the markers that a gap cut off their place on the lattice; drop those that stand off it."""
    for _ in range(3):
        if len(used) < 4 or min(np.ptp(index, axis=0)) < 1:
            raise BadInput("the dark spots found form no grid; use a sharp image without contact")
        model = _model(index, points[used])
        place = (points - model[0]) @ np.linalg.inv(model[1:])
        nearest = np.rint(place).astype(int)
        off = np.abs(place - nearest).max(axis=1)
        best: dict[tuple[int, int], int] = {}
        for marker in np.flatnonzero(off < REACH).tolist():
            at = nearest[marker, 1], nearest[marker, 0]
            if at not in best or off[marker] < off[best[at]]:
                best[at] = marker
        index, used = np.array(list(best)), np.array(list(best.values()))
    return index, used


def _window(index: np.ndarray, used: np.ndarray, rows: int, cols: int) -> tuple[np.ndarray, np.ndarray]:
    """The `rows` x `cols` part of the lattice that holds most markers, counted from its top left marker."""
    best = np.zeros(0, int)
    corner = index.min(axis=0)
    for top in range(index[:, 0].min(), max(index[:, 0].max() - rows + 1, index[:, 0].min()) + 1):
        for left in range(index[:, 1].min(), max(index[:, 1].max() - cols + 1, index[:, 1].min()) + 1):
            inside = np.flatnonzero(((index >= (top, left)) & (index < (top + rows, left + cols))).all(axis=1))
            if len(inside) > len(best):
                best, corner = inside, np.array([top, left])
    return index[best] - corner, used[best]


def _measure(rows: int, cols: int, index: np.ndarray, points: np.ndarray, widths: np.ndarray) -> MarkerGrid:
    model = _model(index, points)
    right, down = model[1], model[2]
    fitted = model[0] + index[:, 1:] * right + index[:, :1] * down
    centre = model[0] + (cols - 1) / 2 * right + (rows - 1) / 2 * down
    turn = np.degrees(np.arctan2(right[1] - down[0], right[0] + down[1]))  # of the nearest rotation
    order = np.lexsort((index[:, 1], index[:, 0]))
    residual = float(np.sqrt(((points - fitted) ** 2).sum(axis=1).mean()))
    pitch = np.array([_spacing(index, points, 1), _spacing(index, points, 0)])
    return MarkerGrid(
        rows, cols, index[order], points[order], pitch, float(turn), centre, residual, float(np.median(widths))
    )


def _spacing(index: np.ndarray, points: np.ndarray, axis: int) -> float:
    """Mean distance of markers that are neighbours along rows (axis 1) or columns (axis 0)."""
    at = {tuple(i): k for k, i in enumerate(index.tolist())}
    step = (0, 1) if axis else (1, 0)
    pairs = [(k, at[i + step[0], j + step[1]]) for (i, j), k in at.items() if (i + step[0], j + step[1]) in at]
    here, there = np.array(pairs).T
    return float(np.hypot(*(points[there] - points[here]).T).mean())


@dataclass(frozen=True)
class Tracks:
    """Markers (n,) of a no-contact image in another picture: `motion` (n, 2) px, NaN where one is lost; `unlike` (n,) bool.

    A marker is lost that, followed back, does not come home. Unlike is one whose surroundings do not look as they did.
    """

    motion: np.ndarray
    unlike: np.ndarray

    @functools.cached_property
    def found(self) -> np.ndarray:
        """Which markers are not lost, (n,) bool."""
        return np.asarray(np.isfinite(self.motion[:, 0]))


class MarkerTracker:
    """Markers of a no-contact image (h, w, 3) uint8, followed to other images.

    printed: as they were found. points: (n, 2) px, OpenCV's: a pixel's centre is a whole number. diameter: px, of a typical marker.
    rim: (n,) bool, which are outermost ones. at: (n, 2) row and column on the lattice, whose middle place has the marker nearest to
    the picture's middle; -1 for one that stands on no lattice, or outside of ROWS x COLS. on_grid: (n,) bool, which do stand there.
    known: whether these are enough to read anything from them.
    """

    def __init__(self, nocontact: np.ndarray, markers: Markers):
        import cv2

        self.grey = cv2.cvtColor(nocontact, cv2.COLOR_RGB2GRAY)
        self.printed, self.diameter = markers, markers.diameter
        points, reach = markers.points, RIM * markers.pitch
        low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(2), np.zeros(2))
        self.rim = ((points < low + reach) | (points > high - reach)).any(axis=1)
        self.points = points - 0.5
        self.at = np.full((len(points), 2), -1)
        index, used = markers.lattice if len(points) >= LEAST_FOR_PITCH else (np.zeros((0, 2), int), np.zeros(0, int))
        if len(used):
            middle = np.hypot(*(self.points[used] - np.array(self.grey.shape[::-1]) / 2).T).argmin()
            index = index - index[middle] + (ROWS // 2, COLS // 2)
            inside = ((index >= 0) & (index < (ROWS, COLS))).all(axis=1)
            self.at[used[inside]] = index[inside]
        self.on_grid = self.at[:, 0] >= 0
        self.known = int(self.on_grid.sum()) >= LEAST_FOR_PITCH

    @functools.cached_property
    def empty(self) -> np.ndarray:
        """Places of the lattice where the no-contact image shows no marker, (m, 2) px, between its outermost rows and columns."""
        index, used = self.printed.lattice if self.known else (np.zeros((0, 2), int), np.zeros(0, int))
        if not len(used):
            return np.zeros((0, 2))
        low, high = index.min(axis=0), index.max(axis=0)
        grid = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True))), -1).reshape(
            -1, 2
        )
        bare = grid[~(grid[:, None] == index[None]).all(axis=2).any(axis=1)]
        # outer markers stand wider apart, so places are cubic in row and column
        fit, *_ = np.linalg.lstsq(_cubic(index, low, high), self.points[used], rcond=None)
        return np.asarray(_cubic(bare, low, high) @ fit)

    def track(self, image: np.ndarray) -> Tracks:
        """The markers in an image (h, w, 3) uint8 in light and size like the no-contact image."""
        import cv2

        if not len(self.points):
            return Tracks(np.zeros((0, 2)), np.zeros(0, bool))
        grey, start = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), self.points.astype(np.float32)
        there, seen, unlike = _follow(self.grey, grey, start, FAR)
        kept = seen & self._home(grey, start, there, unlike)
        motion = np.where(kept[:, None], (there - start).astype(float), np.nan)
        return Tracks(motion, ~kept | (unlike > UNLIKE))

    def _home(self, grey: np.ndarray, start: np.ndarray, there: np.ndarray, unlike: np.ndarray) -> np.ndarray:
        """Which markers (n,) bool come home to where they start, (n, 2) px, if they are followed back from an image's grey.

        Most look as they did and find home by what is close around them, at a sixth of the time; the others are followed
        as they were on their way there.
        """
        home = unlike < ALIKE
        if home.any():
            back, _, _ = _follow(grey, self.grey, there[home], NEAR)
            home[home] = np.hypot(*(back - start[home]).T) < CLOSELY
        if not home.all():
            back, _, _ = _follow(grey, self.grey, there[~home], FAR)
            home[~home] = np.hypot(*(back - start[~home]).T) < HOME
        return home

    def on_lattice(self, tracks: Tracks) -> np.ndarray:
        """What the markers did, on their lattice: (3, ROWS, COLS) float32.

        Motion along u and v in px, and 1 where a marker was found, 0 where there is none.
        """
        found = np.zeros((3, ROWS, COLS), np.float32)
        kept = tracks.found & self.on_grid
        rows, cols = self.at[kept].T
        found[:2, rows, cols], found[2, rows, cols] = tracks.motion[kept].T, 1.0
        return found


def _cubic(index: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Terms (n, 6) of row and column (n, 2): 1, both, their product and their cubes, from -1 to 1 between two ends (2,)."""
    row, col = (2.0 * (index - low) / np.maximum(high - low, 1) - 1.0).T
    return np.stack([np.ones_like(row), row, col, row * col, row**3, col**3], axis=1)


def _follow(
    before: np.ndarray, after: np.ndarray, points: np.ndarray, how: dict[str, Any]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (n, 2) float32 of one grey picture in another: where, whether at all (n,) bool, how unlike (n,) levels."""
    import cv2

    nothing: Any = None  # no guess; OpenCV's types know no None here
    there, seen, unlike = cv2.calcOpticalFlowPyrLK(before, after, points[:, None], nothing, **how)
    return there[:, 0], seen[:, 0] > 0, unlike[:, 0]


def rim_shift(markers: MarkerTracker, tracks: Tracks) -> np.ndarray:
    """Shift (2,) px along u and v that is to be taken back; 0 where the rim shows none."""
    found = markers.rim & tracks.found
    if not markers.known or found.sum() < max(1, LEAST_FOUND * markers.rim.sum()):
        return np.zeros(2)
    shift = np.median(tracks.motion[found], axis=0)
    squared = float(shift @ shift)
    return np.asarray(shift * max(0.0, 1.0 - OF_CONTACT**2 / squared) if squared > 0.0 else np.zeros(2))


def shifted_back(image: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """The image (h, w, 3) uint8 as it would be seen without a shift (2,) px."""
    import cv2

    matrix = np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]])
    how = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(image, matrix, image.shape[1::-1], flags=how, borderMode=cv2.BORDER_REPLICATE)


def grey_of(colours: Sequence[np.ndarray]) -> np.ndarray:
    """Mean (h, w) uint8 of the three colours (h, w) uint8 of an image."""
    import cv2

    red, green, blue = colours
    total = np.add(red, green, dtype=np.uint16)
    total += blue
    return cv2.convertScaleAbs(total, alpha=1 / 3)
