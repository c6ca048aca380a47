"""Whether, when and where an indenter meets the undeformed gel on its path; only this module checks that.

Path parameter: 0 to 1 is the press, 1 to 2 the sideways travel; below 0 the press is extended upwards.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

from gelforge.geometry.gel import Gel
from gelforge.geometry.solids import Indenter
from gelforge.records.press import Press

PRESSED = (1.0, 1.25, 1.5, 1.75, 2.0)  # path parameters that are checked at full depth
ON_THE_WAY = (0.0, 0.5, 1.0, 1.5, 2.0)
TRIED = (0.0, 0.25, 0.5, 0.75, 1.0, 1.2, 1.4, 1.6, 1.8, 2.0)  # where a first touch is searched for
ABOVE_MM = 0.3  # how far a press may begin inside the gel: the height of touch is known to about 0.1 mm
HALVINGS = 30  # bisections of the interval that holds the first touch
SURELY = 2.0  # safety factor on the speed; no distance is known to fall faster than its point moves
EDGE_STEP, MOST_ON_EDGE = 0.1, 200  # mm between points on an indenter's edges, and most points per edge
NEAREST_STEP = 0.25  # mm between points of the top in the search for the nearest one
TOUCH_STEP = 0.2  # mm between points of the top in the search for the first touch
CLOSER = 10.0  # refinement of the spacing around the nearest point
SECTION = 0.2  # over the depth: height of a body's cross-section where contact ends if its edge radius is small
WITHIN, SIDE_HALVINGS = 2.0, 8  # TOUCH_STEPs that a side may lie within the outermost touched point; bisections


def pose_at(press: Press, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and translation (3,) mm of the indenter at path parameter t."""
    return press.pose(min(t, 1.0), max(t - 1.0, 0.0))


def gap(indenter: Indenter, press: Press, points: np.ndarray, t: float) -> np.ndarray:
    """Signed distance (m,) mm of points (m, 3) to the indenter at path parameter t."""
    rotation, translation = pose_at(press, t)
    return indenter.distance((points - translation) @ rotation)[0]


def top_points(gel: Gel, low: np.ndarray, high: np.ndarray, spacing: float) -> tuple[np.ndarray, tuple[int, int]]:
    """Points (m, 3) of the undeformed top in a rectangle low (2,) to high (2,), and how many along x and y.

    They are `spacing` mm apart or a little less. The rectangle is clipped to the gel's; none if they do not meet.
    """
    half = np.array([gel.width, gel.length]) / 2.0
    low, high = np.maximum(low, -half), np.minimum(high, half)
    if np.any(high <= low):
        return np.empty((0, 3)), (0, 0)
    counts = np.maximum(2, np.ceil((high - low) / spacing).astype(int))
    x, y = np.meshgrid(*(np.linspace(low[i], high[i], counts[i]) for i in range(2)), indexing="ij")
    return np.stack([x.ravel(), y.ravel(), np.asarray(gel.top(x, y), float).ravel()], axis=1), (counts[0], counts[1])


def under_path(
    gel: Gel, indenter: Indenter, press: Press, spacing: float, times: Sequence[float] = ON_THE_WAY
) -> tuple[np.ndarray, tuple[int, int]]:
    """`top_points` below and around the indenter on its path, as far as its radius reaches."""
    reach = indenter.radius() + spacing
    places = np.array([pose_at(press, t)[1][:2] for t in times])
    return top_points(gel, places.min(axis=0) - reach, places.max(axis=0) + reach, spacing)


def touched(
    indenter: Indenter,
    press: Press,
    points: np.ndarray,
    reach: float | np.ndarray = 0.0,
    times: Sequence[float] = PRESSED,
) -> np.ndarray:
    """Which points (m, 3) come within `reach` mm of the indenter somewhere on the path, (m,) bool."""
    near = np.zeros(len(points), bool)
    for t in times:
        near |= gap(indenter, press, points, t) < reach
    return near


@lru_cache(maxsize=64)  # rows of several sensors that saw one press share its path
def nearest(gel: Gel, indenter: Indenter, press: Press) -> float:
    """Least signed distance, mm, of the undeformed top from the indenter at its depth; negative: it touches.

    The top is sampled every NEAREST_STEP mm, then ten times finer around the nearest point. A blade may pass between
    these points, so if none touches the edges of the indenter's surface are checked, too. Infinite where the indenter
    is never above the gel.
    """
    least = np.inf
    for t in PRESSED:
        points = _on_outline(gel, under_path(gel, indenter, press, NEAREST_STEP, (t,))[0])
        if not len(points):
            continue
        value = gap(indenter, press, points, t)
        best = points[value.argmin(), :2]
        closer = _on_outline(gel, top_points(gel, best - NEAREST_STEP, best + NEAREST_STEP, NEAREST_STEP / CLOSER)[0])
        least = min(least, value.min(), gap(indenter, press, closer, t).min(initial=np.inf))
    if 0.0 <= least < np.inf:
        edges = _edge_points(indenter, gel.height)
        lowest = min(_heights(gel, press, edges, t).min(initial=np.inf) for t in PRESSED)
        least = min(least, lowest) if lowest < 0.0 else least
    return float(least)


def _on_outline(gel: Gel, points: np.ndarray) -> np.ndarray:
    """The points within the gel's rounded outline; all of them if none is."""
    keep = gel.inside(points[:, 0], points[:, 1])
    return points[keep] if keep.any() else points


def first_touch(gel: Gel, indenter: Indenter, press: Press) -> float | None:
    """Path parameter where the indenter first meets the undeformed gel, or None where it never does.

    Searched at points of the gel's surface. A blade may pass between these, so if none touches the edges of the
    indenter's surface are checked, too.
    """
    points, _ = under_path(gel, indenter, press, TOUCH_STEP)
    if not len(points):
        return None
    speed = max(abs(press.dz), float(np.hypot(press.dx, press.dy)))
    begin = -1.0 - ABOVE_MM / max(abs(press.dz), 0.1 * ABOVE_MM)
    met = _first_below(lambda which, t: gap(indenter, press, points[which], t), len(points), speed, begin)
    if met is None:
        edges = _edge_points(indenter, gel.height)
        met = _first_below(lambda which, t: _heights(gel, press, edges[which], t), len(edges), np.inf, begin)
    return met


def begins_inside(gel: Gel, indenter: Indenter, press: Press) -> bool:
    """Whether the indenter lies inside the undeformed gel even ABOVE_MM above the start of its path.

    Less than that is an error of the height of touch; more is a path whose beginning is missing. A tilted indenter is
    lifted by as much as its lowest point lies below its tip.
    """
    points, _ = under_path(gel, indenter, press, TOUCH_STEP, (0.0,))
    rotation, translation = pose_at(press, 0.0)
    lower = float(-(indenter.surface()[0] @ rotation[2]).min()) if press.tilted else 0.0
    lifted = translation + [0.0, 0.0, ABOVE_MM + max(0.0, lower)]
    return bool((indenter.distance((points - lifted) @ rotation)[0] < 0.0).any())


def _first_below(
    heights: Callable[[np.ndarray, float], np.ndarray], count: int, speed: float, low: float
) -> float | None:
    """Path parameter at which one of `count` heights first falls below zero; None where none does.

    heights(which, t): heights of the points with indices `which` at path parameter t. speed: of the path; heights do
    not change faster, so points that are too high to fall below zero are dropped. low: where the search begins.
    """
    every = np.arange(count)
    for high in TRIED:
        found = heights(every, high)
        if found.min(initial=np.inf) < 0.0:
            break
        low = high
    else:
        return None
    left = every
    for _ in range(HALVINGS):
        near = found < SURELY * speed * (high - low)
        left, middle = left[near], 0.5 * (low + high)
        found = heights(left, middle)
        if found.min(initial=np.inf) < 0.0:
            high = middle
        else:
            low = middle
    return float(low)


def _edge_points(indenter: Indenter, below: float) -> np.ndarray:
    """Points (m, 3) on those edges of the indenter's surface that reach below `below` mm, in its frame."""
    vertices, faces = indenter.surface()
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
    begin, end = vertices[edges[:, 0]], vertices[edges[:, 1]]
    low = np.minimum(begin[:, 2], end[:, 2]) < below
    begin, end = begin[low], end[low]
    counts = np.clip(np.ceil(np.linalg.norm(end - begin, axis=1) / EDGE_STEP).astype(int), 1, MOST_ON_EDGE)
    which = np.repeat(np.arange(len(begin)), counts)
    fraction = (np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts) + 0.5) / counts[which]
    return np.concatenate([begin, end, begin[which] + fraction[:, None] * (end - begin)[which]])


def _heights(gel: Gel, press: Press, points: np.ndarray, t: float) -> np.ndarray:
    """Heights (m,) mm of points (m, 3) of the indenter over the undeformed gel below them; infinite beside the gel."""
    rotation, translation = pose_at(press, t)
    x, y, z = (points @ rotation.T + translation).T
    over = (np.abs(x) <= gel.width / 2) & (np.abs(y) <= gel.length / 2)
    return np.where(over, z - gel.top(x, y), np.inf)


def spacing_of(points: np.ndarray, shape: tuple[int, int]) -> tuple[float, float]:
    """Spacing (x, y) in mm of the grid of `under_path`, from its points (n, 3) and their numbers along x and y."""
    return float(np.ptp(points[:, 0]) / (shape[0] - 1)), float(np.ptp(points[:, 1]) / (shape[1] - 1))


def width_of(touched: np.ndarray, spacing: tuple[float, float]) -> float:
    """Width in mm of a figure on a grid, touched (nx, ny) bool, cells of spacing mm: four times area over perimeter.

    The perimeter is that along grid lines times pi / 4, because these make it 4 / pi times too long on average over
    directions. So the width is the diameter of a disc and twice the wall of a thin ring, but 4 / pi times the side of
    a square whose sides lie along the grid: its perimeter is not too long.
    """
    padded = np.pad(touched, 1)
    along = [np.count_nonzero(np.diff(padded.astype(np.int8), axis=axis)) for axis in (0, 1)]
    perimeter = (along[0] * spacing[1] + along[1] * spacing[0]) * np.pi / 4.0
    return 4.0 * np.count_nonzero(touched) * spacing[0] * spacing[1] / perimeter


@lru_cache(maxsize=64)
def sides(gel: Gel, indenter: Indenter, press: Press) -> tuple[np.ndarray, np.ndarray]:
    """Sides [x_min, y_min, x_max, y_max], mm, of the undeformed surface inside the indenter, and of the likely contact.

    That is where it is inside from half of the press on, within the body's cross-section at SECTION of the depth. Under
    sharp edges both agree to a fraction of the edge radius.
    """
    points, _ = under_path(gel, indenter, press, TOUCH_STEP)
    points = points[touched(indenter, press, points)]
    if not len(points):
        return np.empty(0), np.empty(0)
    half = 0.5 + 0.5 * (first_touch(gel, indenter, press) or 0.0)
    depth = -float(gap(indenter, press, points, 1.0).min())
    rotation, translation = pose_at(press, 1.0)

    def contact(at: np.ndarray) -> np.ndarray:
        places = (at - translation) @ rotation
        places[:, 2] = SECTION * depth
        return touched(indenter, press, at, times=(half,)) & (indenter.distance(places)[0] < 0.0)

    def ends(within: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        found = []
        for way in np.vstack([-np.eye(3)[:2], np.eye(3)[:2]]):
            along = points @ way
            first = points[along > along.max() - 1e-9]
            low, high = np.full(len(first), -WITHIN), np.ones(len(first))
            for _ in range(SIDE_HALVINGS):
                middle = (low + high) / 2
                keep = within(first + TOUCH_STEP * middle[:, None] * way)
                low, high = np.where(keep, middle, low), np.where(keep, high, middle)
            found.append((first @ way + TOUCH_STEP * low).max())
        return np.array(found) * [-1, -1, 1, 1]

    return ends(lambda at: touched(indenter, press, at)), ends(contact)
