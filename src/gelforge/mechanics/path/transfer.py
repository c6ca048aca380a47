"""Transfer of a load path on coarse hexahedra to a fine mesh: displacement, and places of first touch.

Nested iteration (Hackbusch, Multi-Grid Methods and Applications, 1985, section 5): the path is followed on a cheap
mesh, and only its end is solved on the fine mesh. The end depends on the path only through the place in the
indenter's frame where each point touched. It is interpolated from the point's own trajectory through the coarse
displacements, which is smooth before touch; the coarse contact points have only the resolution of the coarse mesh.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from gelforge.geometry.gel import Gel
from gelforge.mechanics.elements.element import ElementSet
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.hexmesh import HexMesh
from gelforge.mechanics.path.loadpath import earlier, gaps, path_length, path_pose
from gelforge.mechanics.pose import Pose, touch_fraction
from gelforge.mechanics.result import NoEquilibrium
from gelforge.mechanics.scene import Scene

FLAT = 0.2  # volume ratio below which Newton's first steps would invert a hexahedron
SMOOTHINGS = 40  # most smoothings of the nodes of flat hexahedra
STUCK = 10  # after every STUCK smoothings, one more ring of hexahedra is smoothed, too
# Fractions of a displacement carried to tetrahedra, tried until every volume ratio is above CREASED: below it,
# pressures are so high that Newton's method takes twice as many steps.
UNFOLDED = (1.0, 0.95, 0.9, 0.8, 0.6)
CREASED = 0.1
LEFT = 0.05  # additional gap, in widths of a coarse hexahedron, at which a point that touched counts as released
WALKED = 0.25  # most of a path with friction that is walked on a finer mesh
NEIGHBOURS = 4  # coarse points from which slip and multiplier of a point of the fine mesh are interpolated
ALL = 0.99  # weight of those that slip from which on the point slips, too


@dataclass(frozen=True)
class Anchors:
    """Points that stick or slip at one load step under a law with friction.

    reference: (k, 3) undeformed mm. place: (k, 3) mm of the indenter's frame to which each is bound. multiplier:
    (k, 3) MPa, its tangential traction there. slips: (k,) bool.
    """

    reference: np.ndarray
    place: np.ndarray
    multiplier: np.ndarray
    slips: np.ndarray


@dataclass(frozen=True)
class LoadPath:
    """States of a scene along its load path: mesh, path parameters (k,), displacements (k, n, 3) mm, the first zero.

    size: side of the mesh's hexahedra under the press, mm. anchors: of each state, for laws with friction.
    """

    scene: Scene
    mesh: HexMesh
    times: list[float]
    states: list[np.ndarray]
    size: float
    anchors: list[Anchors | None]

    def until(self, t: float) -> "LoadPath":
        """The path up to t, which must be exactly one of its times: a load step ends at each requested frame."""
        count = self.times.index(t) + 1
        return replace(self, times=self.times[:count], states=self.states[:count], anchors=self.anchors[:count])

    def walk(self, longest: float) -> "LoadPath":
        """The path up to the load step at which the walk on a finer mesh begins, `longest` mm or less before its end."""
        end = self.times[-1]
        begin = walk_start(self.scene, self.times[0], end, longest) + 1e-9
        early = [t for t in self.times[1:-1] if t <= begin]
        if not early:
            raise NoEquilibrium("the coarse path has no load step before its end")
        return self.until(early[-1])

    def pose(self, t: float) -> Pose:
        """The indenter's pose at path parameter t."""
        return path_pose(self.scene, t)


def walk_start(scene: Scene, start: float, end: float, longest: float) -> float:
    """Path parameter at which the walk to path parameter `end` begins; start: of the first touch."""
    return earlier(scene, end, min(longest, WALKED * path_length(scene, start, end)))


def line_weights(lines: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights (m, 2) and indices (m, 2) of linear interpolation on `lines` (n,) at coordinates `at` (m,)."""
    i = np.clip(np.searchsorted(lines, at, "right") - 1, 0, len(lines) - 2)
    s = np.clip((at - lines[i]) / (lines[i + 1] - lines[i]), 0.0, 1.0)
    return np.stack([1.0 - s, s], axis=1), np.stack([i, i + 1], axis=1)


def transferred(coarse: HexMesh, u: np.ndarray, fine: HexMesh) -> np.ndarray:
    """Displacement (n, 3) of the fine nodes, interpolated from u (m, 3): trilinear in x, y and relative height."""
    grid = u.reshape(coarse.layers + 1, len(coarse.ys), len(coarse.xs), 3)
    lines = ((coarse.heights, fine.heights), (coarse.ys, fine.ys), (coarse.xs, fine.xs))
    for axis, (old, new) in enumerate(lines):
        weights, index = line_weights(old, new)
        shape = [1] * grid.ndim
        shape[axis] = -1
        low, high = (np.take(grid, index[:, k], axis=axis) * weights[:, k].reshape(shape) for k in (0, 1))
        grid = low + high
    moved = np.ascontiguousarray(grid.reshape(-1, 3))
    fine.hanging.hang(moved)
    return moved


def untangled(mesh: HexMesh, hexahedra: ElementSet, u: np.ndarray) -> np.ndarray:
    """Displacement (n, 3) without (nearly) inverted hexahedra: their nodes move towards the mean of their neighbours.

    Where a wide hexahedron bends round an edge, small hexahedra within it may be inverted though the wide one is not.
    Raises NoEquilibrium if `SMOOTHINGS` are not enough.
    """
    fixed = np.ones(len(u), bool)
    fixed[mesh.unknown] = False
    for smoothing in range(SMOOTHINGS):
        flat = hexahedra.smallest_ratios(u) < FLAT
        if not flat.any():
            return u
        moved = hexahedra.elements[flat]
        for _ in range(smoothing // STUCK):
            moved = hexahedra.elements[np.isin(hexahedra.elements, moved).any(axis=1)]
        moved = np.unique(moved)
        moved = moved[~fixed[moved]]
        u = u.copy()
        u[moved] = 0.5 * (u[moved] + _mean_of_neighbours(mesh, u)[moved])
        mesh.hanging.hang(u)
    raise NoEquilibrium


def _mean_of_neighbours(mesh: HexMesh, u: np.ndarray) -> np.ndarray:
    """Mean (n, 3) of u (n, 3) over the six neighbours of each node; beyond the boundary the node itself counts."""
    grid = np.pad(u.reshape(mesh.layers + 1, len(mesh.ys), len(mesh.xs), 3), ((1, 1), (1, 1), (1, 1), (0, 0)), "edge")
    inner = slice(1, -1)
    sides = [
        grid[:-2, inner, inner], grid[2:, inner, inner], grid[inner, :-2, inner],
        grid[inner, 2:, inner], grid[inner, inner, :-2], grid[inner, inner, 2:],
    ]  # fmt: skip
    return np.mean(sides, axis=0).reshape(-1, 3)


def unfolded(elements: ElementSet, u: np.ndarray) -> np.ndarray:
    """The largest of UNFOLDED times u (n, 3) that keeps all volume ratios above CREASED; NoEquilibrium if none does.

    Tetrahedra may be inverted where hexahedra merely bend.
    """
    for share in UNFOLDED:
        if elements.smallest_ratios(share * u).min() > CREASED:
            return share * u
    raise NoEquilibrium("an element is inverted")


def carried(path: LoadPath, mesh: GelMesh, elements: ElementSet) -> np.ndarray:
    """Displacement (n, 3) mm of the nodes of a finer mesh at the path's end, without inverted elements."""
    if isinstance(mesh, HexMesh):
        return untangled(mesh, elements, transferred(path.mesh, path.states[-1], mesh))
    u = volume_motion(path.mesh, path.states[-1], mesh.nodes, path.scene.gel)
    u[mesh.base] = 0.0
    return unfolded(elements, u)


def surface_motion(coarse: HexMesh, u: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Displacement (p, 3) of points of the top surface, by their undeformed positions xy (p, 2)."""
    top = u.reshape(coarse.layers + 1, len(coarse.ys), len(coarse.xs), 3)[-1]
    (wx, ix), (wy, iy) = line_weights(coarse.xs, xy[:, 0]), line_weights(coarse.ys, xy[:, 1])
    return np.einsum("pa,pb,pabi->pi", wy, wx, top[iy[:, :, None], ix[:, None, :]])


def volume_motion(coarse: HexMesh, u: np.ndarray, points: np.ndarray, gel: Gel) -> np.ndarray:
    """Displacement (p, 3) of points (p, 3) of the undeformed gel, trilinear in x, y and relative height."""
    grid = u.reshape(coarse.layers + 1, len(coarse.ys), len(coarse.xs), 3)
    height = (points[:, 2] + gel.height) / (gel.top(points[:, 0], points[:, 1]) + gel.height)
    lines = (coarse.heights, height), (coarse.ys, points[:, 1]), (coarse.xs, points[:, 0])
    (wz, iz), (wy, iy), (wx, ix) = (line_weights(line, at) for line, at in lines)
    near = grid[iz[:, :, None, None], iy[:, None, :, None], ix[:, None, None, :]]
    return np.einsum("pc,pb,pa,pcbai->pi", wz, wy, wx, near, optimize=True)


def touches(path: LoadPath, points: np.ndarray, near: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Which surface points (m, 3) a path has brought into contact (m,) bool, and where each touched (m, 3).

    near: gap that counts as touching, in widths of a coarse hexahedron. Places are in the indenter's frame, at the
    fraction of a load step at which the motion of the step before, continued, would reach the indenter. Points that
    have not touched get the place to which the last step leads.
    """
    touched, places = np.zeros(len(points), bool), np.empty_like(points)
    before: tuple[float, np.ndarray, Pose, np.ndarray] | None = None
    earlier: tuple[float, np.ndarray, Pose, np.ndarray] | None = None
    for t, u in zip(path.times, path.states, strict=True):
        pose, x = path.pose(t), points + surface_motion(path.mesh, u, points[:, :2])
        gap = gaps(path.scene, x, pose)
        if before is not None:
            t1, x1, pose1, gap1 = before
            ahead = x1
            if earlier is not None and not t1 <= 1.0 < t:  # the path turns from press to shear at 1
                ahead = x1 + (t - t1) / (t1 - earlier[0]) * (x1 - earlier[1])
            free = np.flatnonzero(~touched)
            fraction = touch_fraction(gap1[free], gaps(path.scene, ahead[free], pose))[:, None]
            places[free] = (1.0 - fraction) * pose1.to_indenter(x1[free]) + fraction * pose.to_indenter(x[free])
            touched = (touched | (gap < near * path.size)) & (gap < (near + LEFT) * path.size)
            earlier = before
        before = (t, x, pose, gap)
    return touched, places


def interpolated(known: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Values (m, 3) at points `at` (m, 2) from values (k, 3) at the nearest of `known` (k, 2), by squared distance."""
    distance, index = cKDTree(known).query(at, k=range(1, min(NEIGHBOURS, len(known)) + 1))
    weights = 1.0 / np.maximum(distance, 1e-6) ** 2
    return np.einsum("pk,pki->pi", weights / weights.sum(axis=1, keepdims=True), values[index])


def anchored(
    path: LoadPath, points: np.ndarray, near: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Contact of surface points (m, 3) at the end of a path with friction on coarse hexahedra.

    Which have touched (m,) bool, the place (m, 3) of the indenter's frame to which each is bound, its tangential
    traction (m, 3) MPa, and which slip (m,) bool: those whose coarse neighbours all do. The place is that of first
    touch, from the point's own trajectory, plus the slip since then; slip and traction are interpolated between the
    coarse points. near: as in `touches`.
    """
    touched, places = touches(path, points, near)
    anchors = path.anchors[-1]
    if anchors is None or not len(anchors.place):
        return touched, places, np.zeros_like(places), np.zeros(len(places), bool)
    _, first = touches(path, anchors.reference, near)
    xy = anchors.reference[:, :2]
    values = np.column_stack([anchors.place - first, anchors.multiplier, anchors.slips])
    slip = interpolated(xy, values, points[:, :2])
    return touched, places + slip[:, :3], slip[:, 3:6], slip[:, 6] > ALL
