"""Which part of the path and of the gel a press concerns, from undeformed geometry alone."""

from collections.abc import Callable

import numpy as np

from gelforge.mechanics.contact import Pose
from gelforge.mechanics.hex.hexmesh import FineBox, HexMesh
from gelforge.mechanics.scene import Scene

NARROW = 0.8  # of the bricks across a whole contact must lie across its parts
SMALLEST = 0.15  # mm, of bricks made smaller for a small contact
EDGE_STEP, MOST_ON_EDGE = 0.1, 200  # mm between points on an indenter's edges, and how many at most
SHEAR_SAMPLES = (1.0, 1.25, 1.5, 1.75, 2.0)


def path_pose(scene: Scene, t: float) -> Pose:
    """Pose at path parameter t: 0 to 1 press, 1 to 2 shear; below 0 the press goes on upwards."""
    return Pose(*scene.press.pose(min(t, 1.0), max(t - 1.0, 0.0)))


def end_of(scene: Scene) -> float:
    """Path parameter of the end: 2 where the press goes sideways, else 1."""
    return 2.0 if scene.press.dx or scene.press.dy else 1.0


def _surface_grid(scene: Scene, spacing: float) -> tuple[np.ndarray, tuple[int, int]]:
    """Points of the undeformed top surface around the press, (m, 3), and how many along x and y."""
    gel, reach = scene.gel, scene.indenter.radius() + spacing
    ends = np.array([path_pose(scene, t).translation[:2] for t in (0.0, 0.5, 1.0, 1.5, 2.0)])
    low = np.maximum(ends.min(axis=0) - reach, [-gel.width / 2, -gel.length / 2])
    high = np.minimum(ends.max(axis=0) + reach, [gel.width / 2, gel.length / 2])
    if np.any(high <= low):
        return np.empty((0, 3)), (0, 0)
    counts = np.maximum(2, np.ceil((high - low) / spacing).astype(int))
    x, y = np.meshgrid(*(np.linspace(low[i], high[i], counts[i]) for i in range(2)), indexing="ij")
    return np.stack([x.ravel(), y.ravel(), np.asarray(gel.top(x, y), float).ravel()], axis=1), (counts[0], counts[1])


def _gap(scene: Scene, points: np.ndarray, t: float) -> np.ndarray:
    return scene.indenter.distance(path_pose(scene, t).to_indenter(points))[0]


def first_touch(scene: Scene, spacing: float = 0.2) -> float | None:
    """Path parameter where the indenter first meets the undeformed gel, or None where it never does.

    Looked for at points of the gel's surface; a blade may pass between these, so where none is met the edges of the
    indenter's own surface are looked at too.
    """
    points, _ = _surface_grid(scene, spacing)
    if not len(points):
        return None
    met = _first_below(lambda t: float(_gap(scene, points, t).min()))
    if met is None:
        edges = _edge_points(scene)
        met = _first_below(lambda t: _height(scene, edges, t))
    return met


def _first_below(height: Callable[[float], float]) -> float | None:
    """Path parameter at which a height first falls below zero; None where it never does."""
    samples = np.concatenate([np.linspace(0.0, 1.0, 5), np.linspace(1.2, 2.0, 5)])
    inside = np.flatnonzero(np.array([height(t) for t in samples]) < 0.0)
    if not len(inside):
        return None
    high = samples[inside[0]]
    low = samples[inside[0] - 1] if inside[0] else -1.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        if height(middle) < 0.0:
            high = middle
        else:
            low = middle
    return float(low)


def _edge_points(scene: Scene) -> np.ndarray:
    """Points (m, 3) on the edges of the indenter's surface, in its frame, not farther up than the gel is high."""
    vertices, faces = scene.indenter.surface()
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
    begin, end = vertices[edges[:, 0]], vertices[edges[:, 1]]
    low = np.minimum(begin[:, 2], end[:, 2]) < scene.gel.height
    begin, end = begin[low], end[low]
    counts = np.clip(np.ceil(np.linalg.norm(end - begin, axis=1) / EDGE_STEP).astype(int), 1, MOST_ON_EDGE)
    which = np.repeat(np.arange(len(begin)), counts)
    share = (np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts) + 0.5) / counts[which]
    return np.concatenate([begin, end, begin[which] + share[:, None] * (end - begin)[which]])


def _height(scene: Scene, points: np.ndarray, t: float) -> float:
    """Least height, mm, of points of the indenter over the undeformed gel below them; 1e9 beside the gel."""
    gel, pose = scene.gel, path_pose(scene, t)
    x, y, z = pose.to_gel(points).T
    over = (np.abs(x) <= gel.width / 2) & (np.abs(y) <= gel.length / 2)
    return float(np.min(z[over] - gel.top(x[over], y[over]), initial=1e9))


def width_of(touched: np.ndarray, spacing: tuple[float, float]) -> float:
    """Width in mm of a figure on a grid, touched (nx, ny) bool, cells of spacing mm: four times area over perimeter.

    The diameter of a disc, the side of a square, twice the wall of a thin ring; perimeters of slanted edges count
    4 / pi times too long on average, which is taken back.
    """
    padded = np.pad(touched, 1)
    along = [np.count_nonzero(np.diff(padded.astype(np.int8), axis=axis)) for axis in (0, 1)]
    perimeter = (along[0] * spacing[1] + along[1] * spacing[0]) * np.pi / 4.0
    return 4.0 * np.count_nonzero(touched) * spacing[0] * spacing[1] / perimeter


def fine_box(scene: Scene, size: float, across: int = 0, margin: float = 0.5, grid: float = 0.5) -> FineBox:
    """Part of the gel that the press can touch, rounded outwards to `grid` so that presses share meshes.

    The undeformed surface inside the indenter anywhere on the path, and `margin` mm around it. Bricks
    are of `size`, or smaller where the shorter side of what is touched is under `across` bricks, or its parts are narrow.
    """
    points, shape = _surface_grid(scene, 0.2)
    spacing = tuple(np.ptp(points[:, k]) / (shape[k] - 1) for k in (0, 1))
    inside = np.zeros(len(points), bool)
    for t in SHEAR_SAMPLES:
        inside |= _gap(scene, points, t) < 0.0
    if not inside.any():
        inside |= _gap(scene, points, 1.0) <= _gap(scene, points, 1.0).min() + 1e-9
    touched = points[inside, :2]
    if across:
        shorter = float(np.ptp(touched, axis=0).min())
        narrow = min(shorter / across, width_of(inside.reshape(shape), spacing) / (NARROW * across))
        size = min(size, max(SMALLEST, np.round(narrow, 2)))
    gel = scene.gel
    half = np.array([gel.width / 2, gel.length / 2])
    low = np.maximum(np.floor((touched.min(axis=0) - margin) / grid) * grid, -half)
    high = np.minimum(np.ceil((touched.max(axis=0) + margin) / grid) * grid, half)
    return FineBox(float(low[0]), float(high[0]), float(low[1]), float(high[1]), size)


def reachable_faces(scene: Scene, mesh: HexMesh, margin: float = 1.0) -> np.ndarray:
    """Faces whose undeformed corners come within `margin` of the indenter somewhere on the path."""
    corners = mesh.nodes[mesh.faces]
    centre = corners.mean(axis=1)
    size = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    near = np.zeros(len(centre), bool)
    for t in SHEAR_SAMPLES:
        near |= _gap(scene, centre, t) < margin + size
    return np.flatnonzero(near)
