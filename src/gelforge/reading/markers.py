"""The printed markers of a gel: detected in a no-contact image, and tracked to other images.

Light does not move markers, so their motion is mechanical on a unit of any contrast: they spread around a press and
follow a drag. Together they show whether the gel is mounted as it was (`faults.py`).

Registration undoes a shift of the gel in its holder since the no-contact image. The shift is the median motion of the
rim's markers, where contact moves them least. Only the part beyond what contact causes there is undone, which grows
from 0 without a jump. Rotation and zoom are not fitted: contact spreads markers, which a similarity takes for zoom.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from gelforge.errors import BadInput

# Detection.
PITCH_RANGE = (12.0, 90.0)  # px between neighbouring markers of any known GelSight Mini image, with a margin of two
LARGEST_TURN = 25.0  # degrees: largest rotation of a gel in its holder at which lattice directions are told apart
REACH = 0.3  # of the pitch: largest distance of a marker from its expected place
LIT = 0.3  # of the brightest colour's background: below, a colour no longer separates noise from ink
LEAST_FRACTION = 0.5  # of the markers must be found for a grid to be believed
LEAST_FOR_PITCH = 8  # least number of markers that gives a pitch
UNEVEN = 0.15  # fraction by which marker distances differ in one print

# Tracking.
# Size of the tracked lattice: a GelSight Mini shows 7 x 9 markers, or fewer where it is cropped.
ROWS, COLS = 9, 11
FAR = {"winSize": (21, 21), "maxLevel": 3}  # optical flow to another image: its pyramid reaches about 40 px
# Optical flow near a known place: no pyramid, at most five iterations or until a step is below 0.03 px.
NEAR = {"winSize": (15, 15), "maxLevel": 0, "criteria": (3, 5, 0.03)}
HOME = 0.5  # px: largest forward-backward error of a tracked marker
# Levels of difference, and px of forward-backward error with NEAR, below which a marker is surely found.
ALIKE, CLOSELY = 6.0, 0.05
UNLIKE = 12.0  # levels by which a marker's surroundings may differ on average
RIM = 0.8  # pitches: width of the rim, inwards from the outermost markers
OF_CONTACT = 2.5  # px: largest common motion of the rim's markers that contact causes
LEAST_FOUND = 0.5  # of the rim's markers that must be found


@dataclass(frozen=True)
class Markers:
    """Dark round markers of an image: points (n, 2) as (u, v) px from the image's corner, and diameters (n,) px.

    background: levels (h, w, 3) of the image without markers, plus 1; None for selected or transformed markers.
    """

    points: np.ndarray
    diameters: np.ndarray
    background: np.ndarray | None = None

    @cached_property
    def pitch(self) -> float:
        """Median distance in px of markers to their nearest neighbours; 0 where they are unevenly spaced."""
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
        """Row and column (k, 2) of the markers on one lattice, and their indices (k,); empty where there is none."""
        try:
            return lattice_of(self.points)
        except BadInput:
            return np.zeros((0, 2), int), np.zeros(0, int)

    def only(self, chosen: np.ndarray) -> "Markers":
        """The chosen markers, (n,) bool, without `background`."""
        return Markers(self.points[chosen], self.diameters[chosen])

    @property
    def diameter(self) -> float:
        """Median diameter, px; 0 where there are none."""
        return float(np.median(self.diameters)) if len(self.diameters) else 0.0

    def grid(self, rows: int, cols: int, where: str = "image") -> "MarkerGrid":
        """Fit a grid of `rows` x `cols` of them, some missing or specks added; BadInput where there is no grid."""
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
    """Row and column (n, 2) of the points (m, 2) px that lie on one lattice, and the indices (n,) of these points.

    Raises BadInput where none do.
    """
    index, used = _walk(points)
    return _complete(points, index, used)


def markers_in(image: np.ndarray) -> Markers:
    """The dark round markers of an image (h, w, 3) uint8.

    Each colour is divided by its own median-filtered background. Ink is dark in every colour and a marker's
    shadow only in the colour of the light it hides, so the least dark colour counts; a colour whose light
    hardly reaches a corner is ignored there. Centres are weighted by darkness; coordinates start at the image's
    edge, as those of label cells do, so the first pixel's centre is at 0.5.
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
    """Mask (h, w) of an image (h, w, 3) uint8: pixels of dark spots narrower than `wide`, and those within `near`.

    wide, near: structuring elements. darker: fraction of the largest level by which a spot is darker than its
    surroundings.
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
    """Add the markers beyond a gap to the lattice, and drop those that lie off it."""
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
    pitch = np.array([spacing(index, points, 1), spacing(index, points, 0)])
    return MarkerGrid(
        rows, cols, index[order], points[order], pitch, float(turn), centre, residual, float(np.median(widths))
    )


def spacing(index: np.ndarray, points: np.ndarray, axis: int) -> float:
    """Mean distance of markers that are neighbours along rows (axis 1) or columns (axis 0)."""
    at = {tuple(i): k for k, i in enumerate(index.tolist())}
    step = (0, 1) if axis else (1, 0)
    pairs = [(k, at[i + step[0], j + step[1]]) for (i, j), k in at.items() if (i + step[0], j + step[1]) in at]
    here, there = np.array(pairs).T
    return float(np.hypot(*(points[there] - points[here]).T).mean())


@dataclass(frozen=True)
class Tracks:
    """Markers (n,) of a no-contact image in another image: `motion` (n, 2) px, NaN where lost; `unlike` (n,) bool.

    A marker is lost if tracking it back misses its start. It is unlike if its surroundings look different, or if it
    is lost.
    """

    motion: np.ndarray
    unlike: np.ndarray

    @functools.cached_property
    def found(self) -> np.ndarray:
        """Which markers are not lost, (n,) bool."""
        return np.asarray(np.isfinite(self.motion[:, 0]))


class MarkerTracker:
    """Tracks the markers of a no-contact image (h, w, 3) uint8 to other images.

    printed: the markers as detected. points: (n, 2) px in OpenCV's convention, where a pixel's centre is an integer.
    diameter: px, median. rim: (n,) bool, the outermost markers. at: (n, 2) row and column on the ROWS x COLS lattice,
    whose central place has the marker nearest to the image's centre; -1 for a marker outside it. on_grid: (n,) bool,
    markers on this lattice. known: whether these are enough to use them.
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
        """Lattice places (m, 2) px without a marker in the no-contact image, within the outer rows and columns."""
        index, used = self.printed.lattice if self.known else (np.zeros((0, 2), int), np.zeros(0, int))
        if not len(used):
            return np.zeros((0, 2))
        low, high = index.min(axis=0), index.max(axis=0)
        grid = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True))), -1).reshape(
            -1, 2
        )
        bare = grid[~(grid[:, None] == index[None]).all(axis=2).any(axis=1)]
        # the spacing grows outwards, so positions are fitted by cubics of row and column
        fit, *_ = np.linalg.lstsq(_cubic(index, low, high), self.points[used], rcond=None)
        return np.asarray(_cubic(bare, low, high) @ fit)

    def track(self, image: np.ndarray) -> Tracks:
        """Track the markers in an image (h, w, 3) uint8 of the no-contact image's size and under its light."""
        import cv2

        if not len(self.points):
            return Tracks(np.zeros((0, 2)), np.zeros(0, bool))
        grey, start = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), self.points.astype(np.float32)
        there, seen, unlike = _follow(self.grey, grey, start, FAR)
        kept = seen & self._home(grey, start, there, unlike)
        motion = np.where(kept[:, None], (there - start).astype(float), np.nan)
        return Tracks(motion, ~kept | (unlike > UNLIKE))

    def _home(self, grey: np.ndarray, start: np.ndarray, there: np.ndarray, unlike: np.ndarray) -> np.ndarray:
        """Which markers (n,) bool return to their start (n, 2) px when they are tracked back from `there`.

        Most look the same and are tracked back with NEAR, in a sixth of the time; the others with FAR, as on the way
        there.
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
        """Motion of the markers on their lattice, (3, ROWS, COLS) float32.

        Motion along u and v in px, and 1 where a marker was found, 0 where there is none.
        """
        found = np.zeros((3, ROWS, COLS), np.float32)
        kept = tracks.found & self.on_grid
        rows, cols = self.at[kept].T
        found[:2, rows, cols], found[2, rows, cols] = tracks.motion[kept].T, 1.0
        return found


def _cubic(index: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Terms (n, 6) of row and column, scaled to -1..1 between `low` and `high`: 1, both, their product and cubes."""
    row, col = (2.0 * (index - low) / np.maximum(high - low, 1) - 1.0).T
    return np.stack([np.ones_like(row), row, col, row * col, row**3, col**3], axis=1)


def _follow(
    before: np.ndarray, after: np.ndarray, points: np.ndarray, how: dict[str, Any]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Track points (n, 2) float32 by optical flow: their places, whether found (n,) bool, difference (n,) levels."""
    import cv2

    nothing: Any = None  # no initial guess; OpenCV's type stubs do not allow None here
    there, seen, unlike = cv2.calcOpticalFlowPyrLK(before, after, points[:, None], nothing, **how)
    return there[:, 0], seen[:, 0] > 0, unlike[:, 0]


def rim_shift(markers: MarkerTracker, tracks: Tracks) -> np.ndarray:
    """Shift (2,) px of the gel along u and v that registration is to undo; 0 where the rim shows none."""
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
