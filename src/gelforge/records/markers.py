"""The printed markers of a gel in an image without contact."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gelforge.errors import BadInput

PITCH_RANGE = (12.0, 90.0)  # px between neighbouring markers of any GelSight Mini image we know, with a margin of two
LARGEST_TURN = 25.0  # degrees a gel can be mounted turned in its holder and still be distinguished from the next lattice direction
REACH = 0.3  # of the pitch: how far from its expected place a marker is still that marker
LIT = 0.3  # of the brightest colour's background: below, a colour no longer separates noise from ink
LEAST_FRACTION = 0.5  # of the markers must be found for a grid to be believed
LEAST_FOR_PITCH = 8  # markers that give their distance
UNEVEN = 0.15  # fraction by which such distances differ in one print

MARKER_PITCH_MM = 2.0  # of a GelSight Mini's printed markers to their nearest neighbours
# What hides the light of the gel.
HIDES = 0.2  # of the largest level, by which markers are darker than what surrounds them
MARKER_MM = 1.45  # width of the largest marker
SPREAD_MM = 0.45  # across a marker's edge, where levels say nothing of slopes


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


def find_markers(image: np.ndarray, rows: int, cols: int, where: str = "image") -> MarkerGrid:
    """Find a grid of `rows` x `cols` dark spots in an image (h, w, 3) uint8, markers missing or specks added.

    Raises BadInput where no such grid is there.
    """
    found = markers_in(image)
    points, widths = found.points, found.diameters
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


def marker_mask(image: np.ndarray, px_per_mm: float) -> np.ndarray:
    """Which pixels (h, w) of an image (h, w, 3) uint8 are of markers, or near one."""
    import cv2

    wide, near = (cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * int(half) + 1,) * 2)
                  for half in (MARKER_MM / 2 * px_per_mm, SPREAD_MM / 2 * px_per_mm))  # fmt: skip
    return dark_spots(image, wide, near, HIDES)


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
