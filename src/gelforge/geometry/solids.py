"""Rigid bodies of indenters: exact signed distances and watertight surfaces.

Every body has its own frame: its lowest point is on the plane z = 0, its highest at z = `height`.
"""

import hashlib
from abc import ABC, abstractmethod
from functools import cached_property
from typing import Protocol

import numpy as np

from gelforge.errors import BadInput
from gelforge.geometry.profiles import Annulus, Outline, Pieces, Pierced, arc_steps, mitred, unit
from gelforge.geometry.triangles import boolean, joined, stacked


def _with_flat_top(z, height, side, side_gradient, below, below_normal):
    """Signed distance and normal of a body of unlimited height that is cut flat at z = height.

    `side`: distance to its cross-section at the cut. `below`: distance to the uncut body.
    """
    up = z - height
    outside, over = side > 0.0, up > 0.0
    normal = np.array(below_normal)
    cap = (over & ~outside) | (~over & (up > below))
    normal[cap] = [0.0, 0.0, 1.0]
    value = np.where(cap, up, below)
    rim = over & outside
    value[rim] = np.hypot(side[rim], up[rim])
    normal[rim, :2] = side_gradient[rim] * (side[rim] / value[rim])[:, None]
    normal[rim, 2] = up[rim] / value[rim]
    return value, normal


class Indenter(Protocol):
    """A rigid body in its own frame: tip on the plane z = 0, body above it, mm."""

    name: str

    def distance(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distance (n,) (negative inside) and unit outward normal (n, 3) at points (n, 3)."""

    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        """Watertight triangles: vertices (v, 3) float64 and faces (f, 3) int, outward orientation."""

    def __hash__(self) -> int:
        """Bodies are keys of caches, such as that of `triangles.cropped`."""

    def radius(self) -> float:
        """Largest horizontal distance from the z axis of any point of the body, mm."""


class Body(ABC):
    """Base class of all indenters, implements `Indenter`.

    height: mm. seen: whether networks train on it. spare: left out of the standard set.
    """

    def __init__(self, name: str, height: float, seen: bool = True, spare: bool = False):
        self.name, self.height, self.seen, self.spare = name, float(height), seen, spare

    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        """Watertight triangles: vertices (v, 3) mm and faces (f, 3), outward; chord error at fillets 0.01 mm."""
        return self._surface

    @property
    @abstractmethod
    def _surface(self) -> tuple[np.ndarray, np.ndarray]:
        """What `surface` returns."""

    @abstractmethod
    def distance(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distance (n,) and unit outward normal (n, 3) at points (n, 3)."""

    @abstractmethod
    def radius(self) -> float:
        """Largest horizontal distance from the z axis, mm."""

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r})"


FELT_DEG, FELT_MM = 2.0, 0.03  # tilt, and how far it brings the lowest point of a body that feels it below its tip


def feels_tilt(indenter: Indenter) -> bool:
    """Whether tilt changes what an indenter presses: one with a flat side or an edge does, a ball does not."""
    slope, level = np.sin(np.deg2rad(FELT_DEG)), np.cos(np.deg2rad(FELT_DEG))
    vertices = indenter.surface()[0]
    aside = slope * np.abs(vertices[:, :2]).max(axis=1)
    return float((level * vertices[:, 2] - aside).min()) < -FELT_MM


def surface_digest(indenter: Indenter, prefix: bytes = b"") -> str:
    """SHA-256 of `prefix` and an indenter's surface (vertices rounded to 1e-6 mm), which changes with the shape."""
    vertices, faces = indenter.surface()
    places, corners = np.round(np.asarray(vertices, float), 6), np.asarray(faces, np.int64)
    return hashlib.sha256(prefix + places.tobytes() + corners.tobytes()).hexdigest()


class Extrusion(Body):
    """A plane figure extruded along z, its lower edge rounded with radius `fillet` (mm), at most `height`.

    A circle with a fillet of its own radius makes a sphere on a shank. The distance is exact where the figure's is.
    """

    def __init__(self, name, profile, fillet, height, **flags):
        super().__init__(name, height, **flags)
        if not 0.0 <= fillet <= height:
            raise BadInput(f"indenter {name}: fillet {fillet} mm must lie between 0 and the height {height} mm")
        self.profile, self.fillet = profile, float(fillet)

    def distance(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distance (n,) and unit outward normal (n, 3) at points (n, 3)."""
        points = np.asarray(points, float)
        side, gradient = self.profile.distance(points[:, :2])
        z, r = points[:, 2], self.fillet
        a, b = side + r, r - z
        corner = (a > 0.0) & (b > 0.0)
        length = np.hypot(a, b)
        safe = np.where(length > 0.0, length, 1.0)
        wall = ~corner & (a > b)
        below = np.where(corner, length, np.maximum(a, b)) - r
        normal = np.zeros_like(points)
        normal[:, :2] = gradient * np.where(corner, a / safe, wall)[:, None]
        normal[:, 2] = -np.where(corner, b / safe, ~wall)
        return _with_flat_top(z, self.height, side, gradient, below, normal)

    def radius(self) -> float:
        """Largest horizontal distance from the z axis, mm."""
        return self.profile.reach()

    @cached_property
    def _surface(self):
        return self._mesh(self.profile)

    def _mesh(self, profile):
        if isinstance(profile, Pieces):
            return joined([self._mesh(part) for part in profile.parts])
        if isinstance(profile, Pierced):
            return boolean(self._mesh(profile.outer), self._drill(profile), "difference")
        offset, z = self._fillet_curve()
        loops = profile.loops(np.append(offset, 0.0))
        return stacked(loops, np.append(z, self.height), annular=isinstance(profile, Annulus))

    def _fillet_curve(self):
        """Inset from the edge and height z of points along the fillet, from the bottom to the wall, mm."""
        angle = np.linspace(0.0, np.pi / 2.0, arc_steps(self.fillet, np.pi / 2.0) + 1)
        return self.fillet * (1.0 - np.sin(angle)), self.fillet * (1.0 - np.cos(angle))

    def _drill(self, profile: Pierced):
        """The body to subtract for a hole with a rounded mouth."""
        offset, z = self._fillet_curve()
        offset = np.concatenate([offset[:1], offset, [0.0]])
        loops = np.array([mitred(profile.hole, o) for o in offset])
        return stacked([loops], np.concatenate([[-1.0], z, [self.height + 1.0]]))


class SphericalCap(Body):
    """The part of a sphere of `radius` mm up to `height` mm (below the radius) above its lowest point: a lens."""

    def __init__(self, name, radius, height, **flags):
        super().__init__(name, height, **flags)
        self.sphere = float(radius)
        self.rim = float(np.sqrt(self.height * (2.0 * self.sphere - self.height)))

    def distance(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distance (n,) and unit outward normal (n, 3) at points (n, 3)."""
        points = np.asarray(points, float)
        rho = np.hypot(points[:, 0], points[:, 1])
        out = np.zeros_like(points)
        out[:, :2] = points[:, :2] / np.where(rho > 1e-12, rho, 1.0)[:, None]
        away = points - [0.0, 0.0, self.sphere]
        length = np.linalg.norm(away, axis=1)
        normal = np.where((length > 1e-12)[:, None], away / np.maximum(length, 1e-300)[:, None], [0.0, 0.0, -1.0])
        value, side, up = length - self.sphere, rho - self.rim, points[:, 2] - self.height
        cap = np.where(up > 0.0, side <= 0.0, up > value)
        normal[cap], value = [0.0, 0.0, 1.0], np.where(cap, up, value)
        # the rim is nearest beside the cut, and where the full sphere's nearest point lies above the cut
        past = (value > 0.0) & (normal[:, 2] > self.height / self.sphere - 1.0)
        rim = (side > 0.0) & ((up > 0.0) | past)
        value[rim] = np.hypot(side[rim], up[rim])
        normal[rim] = (out[rim] * side[rim, None] + np.outer(up[rim], [0.0, 0.0, 1.0])) / value[rim, None]
        return value, normal

    def radius(self) -> float:
        """Largest horizontal distance from the z axis, mm."""
        return self.rim

    @cached_property
    def _surface(self):
        widest = np.arccos(1.0 - self.height / self.sphere)
        angle = np.linspace(0.0, widest, arc_steps(self.sphere, widest) + 1)
        turn = 2.0 * np.pi * np.arange(4 * arc_steps(self.rim, np.pi / 2.0))
        turn = turn / len(turn)
        rho, z = self.sphere * np.sin(angle), self.sphere * (1.0 - np.cos(angle))
        z[-1] = self.height
        return stacked([rho[:, None, None] * np.column_stack([np.cos(turn), np.sin(turn)])], z)


class RoundedPolyhedron(Body):
    """A convex block with vertical walls and a lower side of planes; all edges except those at the top are rounded.

    outline: (k, 2) convex corners before rounding. planes: outward normals (m, 3) and levels (m,) of the lower side.
    Levels and `height` count from an arbitrary z = 0; the body is then moved until its lowest point is on z = 0.
    The distance is exact outside; inside it is the distance to the nearest plane.
    """

    def __init__(self, name, outline, planes, fillet, height, **flags):
        normals, levels = np.asarray(planes[0], float), np.asarray(planes[1], float)
        self.top = Outline(outline, fillet)
        self.fillet = float(fillet)
        core = self._core(normals, levels - self.fillet, height)
        lowest = core[:, 2].min() - self.fillet
        super().__init__(name, height - lowest, **flags)
        self.core = core - [0.0, 0.0, lowest]
        self._prepare()

    def _core(self, normals, levels, height):
        from scipy.spatial import HalfspaceIntersection, QhullError

        corners = self.top.core
        along = unit(np.roll(corners, -1, axis=0) - corners)
        walls = np.column_stack([along[:, 1], -along[:, 0], np.zeros(len(corners))])
        wall_levels = np.einsum("ij,ij->i", walls[:, :2], corners)
        n = np.vstack([walls, normals, [[0.0, 0.0, 1.0]]])
        c = np.concatenate([wall_levels, levels, [height]])
        inner = np.array([*corners.mean(axis=0), height - 1e-3])
        try:
            points = HalfspaceIntersection(np.column_stack([n, -c]), inner).intersections
        except QhullError:
            raise BadInput(
                f"the lower side rises above the height, {height:g} mm, in the middle of the body; make it higher or its slope less"
            ) from None
        return points[np.unique(np.round(points, 7), axis=0, return_index=True)[1]]

    def _prepare(self):
        from scipy.spatial import ConvexHull

        hull = ConvexHull(self.core)
        _, first, face_of = np.unique(np.round(hull.equations, 7), axis=0, return_index=True, return_inverse=True)
        self._normals, self._levels = hull.equations[first, :3], -hull.equations[first, 3]
        edges = {}
        for simplex, face in zip(hull.simplices, face_of.ravel(), strict=True):
            for i, j in ((0, 1), (1, 2), (2, 0)):
                edges.setdefault(tuple(sorted((simplex[i], simplex[j]))), set()).add(face)
        # `distance` moves points above the cut down to it, so edges of the cut itself are never needed
        level = self.core[:, 2] > self.height - 1e-7
        kept = np.array([e for e, faces in edges.items() if len(faces) == 2 and not level[list(e)].all()])
        self._starts, self._edges = self.core[kept[:, 0]], self.core[kept[:, 1]] - self.core[kept[:, 0]]

    def distance(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distance (n,) and unit outward normal (n, 3) at points (n, 3)."""
        points = np.asarray(points, float)
        heights = points @ self._normals.T - self._levels
        top = self._normals[:, 2] > 1.0 - 1e-9
        heights[:, top] = -np.inf
        face = heights.argmax(axis=1)
        value = heights[np.arange(len(points)), face]
        normal = self._normals[face]
        out = np.flatnonzero(value > 0.0)
        low = points[out]
        low[:, 2] = np.minimum(low[:, 2], self.height)
        to, length = self._off_core(low, value[out], normal[out])
        value[out], normal[out] = length, to
        side, gradient = self.top.distance(points[:, :2])
        return _with_flat_top(points[:, 2], self.height, side, gradient, value - self.fillet, normal)

    def _off_core(self, points, plane, normal):
        """Direction (n, 3) and length (n,) from the core to points outside it."""
        from gelforge.geometry import nearest

        foot = points - plane[:, None] * normal
        to, length = normal.copy(), plane.copy()
        rest = np.flatnonzero((foot @ self._normals.T - self._levels).max(axis=1) >= 1e-9)
        away, length[rest] = nearest.of_edges(points[rest], self._starts, self._edges)
        to[rest] = away / np.maximum(length[rest], 1e-300)[:, None]
        return to, length

    def radius(self) -> float:
        """Largest horizontal distance from the z axis, mm."""
        return self.top.reach()

    @cached_property
    def _surface(self):
        """Convex hull of spheres of radius `fillet` at the core's corners, sampled to the promised chord error."""
        from scipy.spatial import ConvexHull

        meeting = [np.abs(self._normals @ corner - self._levels) < 1e-7 for corner in self.core]
        rings = [_ring(self._normals[faces]) for faces in meeting]
        # all arcs get as many steps as the widest: normals at a sharp edge are more than 90 degrees apart
        steps = arc_steps(self.fillet, max(np.pi / 2.0, *(_widest(ring) for ring in rings)))
        fans = [corner + self.fillet * _fan(ring, steps) for corner, ring in zip(self.core, rings, strict=True)]
        points = np.unique(np.round(np.concatenate(fans), 9), axis=0)
        hull = ConvexHull(points)
        a, b, c = points[hull.simplices].transpose(1, 0, 2)
        flip = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
        faces = np.where(flip[:, None], hull.simplices[:, ::-1], hull.simplices)
        used, faces = np.unique(faces, return_inverse=True)
        return points[used], faces.reshape(-1, 3)


def _ring(normals):
    """Normals (n, 3) of the faces at a corner, in order around it; at the flat top only the two (2, 3) other ones."""
    level = normals[:, 2] > 1.0 - 1e-9
    if level.any():
        return normals[~level][:2]
    return normals[np.argsort(_angle_about(unit(normals.mean(axis=0)), normals))]


def _widest(ring):
    """Largest angle between consecutive normals of a ring, rad."""
    return float(np.arccos(np.clip(np.einsum("ij,ij->i", ring, np.roll(ring, -1, axis=0)), -1.0, 1.0)).max())


def _fan(ring, steps):
    """Directions (n, 3) from a corner of the core to the rounded surface around it."""
    if len(ring) == 2:
        return _arc(*ring, steps)
    centre = unit(ring.mean(axis=0))
    arcs = np.concatenate([_arc(a, b, steps) for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True)])
    weights = np.linspace(0.0, 1.0, steps + 1)[:, None, None]
    return unit(weights * arcs + (1.0 - weights) * centre).reshape(-1, 3)


def _arc(a, b, steps):
    """Directions (steps + 1, 3) on the great circle from a to b."""
    angle = np.arccos(np.clip(a @ b, -1.0, 1.0))
    t = np.linspace(0.0, 1.0, steps + 1)[:, None]
    return (np.sin((1.0 - t) * angle) * a + np.sin(t * angle) * b) / np.sin(angle)


def _angle_about(axis, directions):
    first = unit(directions[0] - (directions[0] @ axis) * axis)
    return np.arctan2(directions @ np.cross(axis, first), directions @ first)


class LyingCylinder(Body):
    """A cylinder along x whose side touches the gel, its end edges rounded with radius `fillet`; mm."""

    def __init__(self, name, diameter, length, fillet, **flags):
        super().__init__(name, diameter, **flags)
        if not 0.0 <= fillet <= min(diameter, length) / 2.0:
            raise BadInput(f"indenter {name}: fillet {fillet} mm is larger than half the diameter or length")
        self.length, self.fillet = float(length), float(fillet)

    def distance(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distance (n,) and unit outward normal (n, 3) at points (n, 3)."""
        points = np.asarray(points, float)
        radius, r = self.height / 2.0, self.fillet
        y, z = points[:, 1], points[:, 2] - radius
        rho = np.hypot(y, z)
        safe = np.where(rho > 1e-12, rho, 1.0)
        radial = np.column_stack([np.zeros_like(y), y / safe, np.where(rho > 1e-12, z / safe, -1.0)])
        axial = np.zeros_like(points)
        axial[:, 0] = np.copysign(1.0, points[:, 0])
        a, b = rho - (radius - r), np.abs(points[:, 0]) - (self.length / 2.0 - r)
        corner = (a > 0.0) & (b > 0.0)
        length = np.hypot(a, b)
        weight = np.where(corner, length, 1.0)
        wall = a > b
        value = np.where(corner, length, np.maximum(a, b)) - r
        normal = radial * np.where(corner, a / weight, wall)[:, None]
        return value, normal + axial * np.where(corner, b / weight, ~wall)[:, None]

    def radius(self) -> float:
        """Largest horizontal distance from the z axis, mm."""
        return float(np.hypot(self.length / 2.0, self.height / 2.0))

    @cached_property
    def _surface(self):
        radius, r, half = self.height / 2.0, self.fillet, self.length / 2.0
        angle = np.linspace(0.0, np.pi / 2.0, arc_steps(r, np.pi / 2.0) + 1)
        rho, x = radius - r * (1.0 - np.sin(angle)), -half + r * (1.0 - np.cos(angle))
        rho, x = np.concatenate([rho, rho[::-1]]), np.concatenate([x, -x[::-1]])
        turn = 2.0 * np.pi * np.arange(4 * arc_steps(radius, np.pi / 2.0))
        turn = turn / len(turn)
        circle = np.column_stack([np.cos(turn), np.sin(turn)])
        vertices, faces = stacked([rho[:, None, None] * circle], x)
        return vertices[:, [2, 0, 1]] + [0.0, 0.0, radius], faces
