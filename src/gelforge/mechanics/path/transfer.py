"""From a load path on coarse hexahedra to the end on a fine mesh: displacement, and where each surface point first touched.

Nested iteration (Hackbusch, Multi-Grid Methods and Applications, 1985, section 5): the path is followed where that is
cheap, and only its end is solved on the fine mesh. What the end needs of the path is where in the indenter's frame
each point touched. That is read off the point's own way through the coarse path, which is smooth where points have
not touched yet; the coarse contact points have only the coarse mesh's resolution.
"""

from dataclasses import dataclass, replace

import numpy as np

from gelforge.geometry.gel import Gel
from gelforge.mechanics.elements.element import ElementSet
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.hexmesh import HexMesh
from gelforge.mechanics.path.loadpath import gaps, path_pose
from gelforge.mechanics.pose import Pose, touch_fraction
from gelforge.mechanics.result import NoEquilibrium
from gelforge.mechanics.scene import Scene

FLAT = 0.2  # volume ratio below which a hexahedron is nearly inverted: Newton's first steps would turn it over
SMOOTHINGS = 40  # of the nodes of flat hexahedra, at most
STUCK = 10  # smoothings after each of which the nodes of one more ring of hexahedra move, too
# Shares of a displacement carried to tetrahedra that are tried until no element is inverted, or nearly: beside a volume
# ratio below CREASED pressures are such that Newton's method takes twice as many steps.
UNFOLDED = (1.0, 0.95, 0.9, 0.8, 0.6)
CREASED = 0.1
LEFT = 0.05  # widths of a coarse hexahedron beyond touch at which a point has left again


@dataclass(frozen=True)
class LoadPath:
    """The states of a scene along its load path: mesh, path parameters (k,), displacements (k, n, 3) mm, the first at rest.

    size: side of the mesh's hexahedra under the press, mm.
    """

    scene: Scene
    mesh: HexMesh
    times: list[float]
    states: list[np.ndarray]
    size: float

    def until(self, t: float) -> "LoadPath":
        """The path up to t, which must be one of its times to the last bit: a load step ends at each frame asked for."""
        count = self.times.index(t) + 1
        return replace(self, times=self.times[:count], states=self.states[:count])

    def pose(self, t: float) -> Pose:
        """The indenter's pose at path parameter t."""
        return path_pose(self.scene, t)


def line_weights(lines: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights (m, 2) and indices (m, 2) of linear interpolation on `lines` (n,) at places `at` (m,)."""
    i = np.clip(np.searchsorted(lines, at, "right") - 1, 0, len(lines) - 2)
    s = np.clip((at - lines[i]) / (lines[i + 1] - lines[i]), 0.0, 1.0)
    return np.stack([1.0 - s, s], axis=1), np.stack([i, i + 1], axis=1)


def transferred(coarse: HexMesh, u: np.ndarray, fine: HexMesh) -> np.ndarray:
    """Displacement (n, 3) of the fine nodes: the coarse one (m, 3), trilinear in x, y and relative height."""
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
    """Displacement (n, 3) with no hexahedron (nearly) inverted: nodes of those that are move towards their neighbours' mean.

    What is carried over may turn small hexahedra over where a wide one, sound on the whole, is bent round an edge.
    NoEquilibrium where `SMOOTHINGS` are not enough.
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
    """Mean (n, 3) of u (n, 3) over the six neighbours of each node; past the rim a node stands for its own."""
    grid = np.pad(u.reshape(mesh.layers + 1, len(mesh.ys), len(mesh.xs), 3), ((1, 1), (1, 1), (1, 1), (0, 0)), "edge")
    inner = slice(1, -1)
    sides = [
        grid[:-2, inner, inner], grid[2:, inner, inner], grid[inner, :-2, inner],
        grid[inner, 2:, inner], grid[inner, inner, :-2], grid[inner, inner, 2:],
    ]  # fmt: skip
    return np.mean(sides, axis=0).reshape(-1, 3)


def unfolded(elements: ElementSet, u: np.ndarray) -> np.ndarray:
    """u (n, 3), or as much of it as leaves every element some volume: hexahedra bend in places where tetrahedra do not."""
    for share in UNFOLDED:
        if elements.smallest_ratios(share * u).min() > CREASED:
            return share * u
    raise NoEquilibrium("an element is inverted")


def carried(path: LoadPath, mesh: GelMesh, elements: ElementSet) -> np.ndarray:
    """Displacement (n, 3) mm of the nodes of a finer mesh at the path's end, with no element inverted."""
    if isinstance(mesh, HexMesh):
        return untangled(mesh, elements, transferred(path.mesh, path.states[-1], mesh))
    u = volume_motion(path.mesh, path.states[-1], mesh.nodes, path.scene.gel)
    u[mesh.base] = 0.0
    return unfolded(elements, u)


def surface_motion(coarse: HexMesh, u: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Displacement (p, 3) of points of the top surface, by their undeformed places xy (p, 2)."""
    top = u.reshape(coarse.layers + 1, len(coarse.ys), len(coarse.xs), 3)[-1]
    (wx, ix), (wy, iy) = line_weights(coarse.xs, xy[:, 0]), line_weights(coarse.ys, xy[:, 1])
    return np.einsum("pa,pb,pabi->pi", wy, wx, top[iy[:, :, None], ix[:, None, :]])


def volume_motion(coarse: HexMesh, u: np.ndarray, points: np.ndarray, gel: Gel) -> np.ndarray:
    """Displacement (p, 3) of points of the gel by their undeformed places (p, 3), trilinear in x, y and relative height."""
    grid = u.reshape(coarse.layers + 1, len(coarse.ys), len(coarse.xs), 3)
    height = (points[:, 2] + gel.height) / (gel.top(points[:, 0], points[:, 1]) + gel.height)
    lines = (coarse.heights, height), (coarse.ys, points[:, 1]), (coarse.xs, points[:, 0])
    (wz, iz), (wy, iy), (wx, ix) = (line_weights(line, at) for line, at in lines)
    near = grid[iz[:, :, None, None], iy[:, None, :, None], ix[:, None, None, :]]
    return np.einsum("pc,pb,pa,pcbai->pi", wz, wy, wx, near, optimize=True)


def touches(path: LoadPath, points: np.ndarray, near: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Which surface points (m, 3) a path has brought into contact (m,), and where each touched (m, 3).

    near: how close to the indenter counts as touching, widths of a coarse hexahedron. Places are in the indenter's frame.
    A point that goes on as in the step before crosses the surface at a fraction of the step: that place counts. Points
    that have not touched get the place to which the last step would lead them.
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
