"""Presses whose force is known: axisymmetric ones, solved by scikit-fem alone.

python axisymmetric.py [exact.json] solves the presses of SERIES that the file does not hold yet, and adds them to it.
It needs numpy, scipy, scikit-fem and pypardiso.

A rigid body of revolution is pressed straight down into a layer bonded at its base, neo-Hookean at finite strain,
W = C10 (I1bar - 3) + K/2 (J - 1)^2. Elements are second-order quadrilaterals, small where the edge of contact passes.
Contact acts at Gauss points of the surface by a penalty that lets them penetrate by less than a micrometre. With
friction a point sticks where it first touched, where its gap closes within a load step; under Coulomb's law it slips
along the body once the tangential traction would exceed the coefficient times the pressure (return mapping, implicit
in each load step: Wriggers, Computational Contact Mechanics, 2006, section 6.3.2). No code is shared with gelforge.
"""

import json
import os
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from pypardiso import PyPardisoSolver
from skfem import Basis, ElementQuad2, ElementVector, FacetBasis, MeshQuad

PENALTY = 2e5  # MPa/mm over the shear modulus
DEEPEST = 1e-4  # mm, largest penetration of a point in equilibrium
RING = 0.5  # mm, width of the rings whose forces are reported
KEPT = Path(__file__).with_name("exact.json")
# Rows and columns of the non-zero components of F: rr, rz, zr, zz, and the hoop component.
ROW, COLUMN = np.array([0, 0, 1, 1, 2]), np.array([0, 1, 0, 1, 2])


class Unsolved(Exception):
    """Newton's method found no equilibrium, however short the load step."""


@dataclass(frozen=True)
class Body:
    """All points within `radius` of a polyline `core` (k, 2), r and z in mm, turned about the axis; tip at z = 0."""

    core: tuple[tuple[float, float], ...]
    radius: float

    def distance(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Signed distance (n,) of places (n, 2), mm, negative inside, outward normal (n, 2), curvature (n,), 1/mm."""
        best, away, round_ = np.full(len(places), np.inf), np.zeros_like(places), np.zeros(len(places), bool)
        ends = np.array(self.core)
        for a, b in zip(ends, ends[1:] if len(ends) > 1 else ends, strict=False):
            along = b - a
            s = np.clip((places - a) @ along / max(along @ along, 1e-300), 0.0, 1.0)
            off = places - a - s[:, None] * along
            length = np.linalg.norm(off, axis=1)
            nearer = length < best
            best, away = np.where(nearer, length, best), np.where(nearer[:, None], off, away)
            round_ = np.where(nearer, (s <= 0.0) | (s >= 1.0), round_)
        return best - self.radius, away / np.maximum(best, 1e-300)[:, None], round_ / np.maximum(best, 1e-300)


def sphere(diameter: float) -> Body:
    """A sphere."""
    return Body(((0.0, diameter / 2),), diameter / 2)


def punch(diameter: float, fillet: float) -> Body:
    """A flat-ended cylinder whose edge is rounded."""
    flat = diameter / 2 - fillet
    return Body(((0.0, fillet), (flat, fillet), (flat, 20.0)), fillet)


def tube(diameter: float, hole: float, fillet: float) -> Body:
    """A flat-ended tube whose edges are rounded; if its wall is twice the fillet, it ends in half a torus."""
    inner, outer = hole / 2 + fillet, diameter / 2 - fillet
    return Body(((inner, 20.0), (inner, fillet), (outer, fillet), (outer, 20.0)), fillet)


def cone(degrees: float, tip: float) -> Body:
    """A cone whose flank rises by `degrees` from the plane, its tip rounded."""
    slope = np.tan(np.deg2rad(degrees))
    return Body(((0.0, tip), (20.0, tip + 20.0 * slope)), tip)


@dataclass(frozen=True)
class Layer:
    """A disc of gel. thickness, radius: mm. c10: MPa. nu: Poisson's ratio at small strain."""

    thickness: float = 4.0
    nu: float = 0.475
    c10: float = 0.0725
    radius: float = 20.0

    @property
    def bulk(self) -> float:
        """Bulk modulus K, MPa."""
        return 4.0 * self.c10 * (1.0 + self.nu) / (3.0 * (1.0 - 2.0 * self.nu))

    def stress(self, f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First Piola-Kirchhoff stress (5, n) and its derivative (5, 5, n) by F (5, n)."""
        grad = np.zeros((3, 3, f.shape[1]))
        grad[ROW, COLUMN] = f
        plane = f[0] * f[3] - f[1] * f[2]
        ratio = plane * f[4]
        if not ratio.min() > 0.0:
            raise Unsolved("an element is inverted")
        inverse = np.zeros_like(grad)  # transposed
        inverse[ROW, COLUMN] = f[3] / plane, -f[2] / plane, -f[1] / plane, f[0] / plane, 1.0 / f[4]
        t, squares, c = inverse[ROW, COLUMN], (f**2).sum(axis=0), 2.0 * self.c10 * ratio ** (-2.0 / 3.0)
        p = c * (f - squares / 3.0 * t) + self.bulk * (ratio - 1.0) * ratio * t
        tt, tf = t[:, None] * t[None], t[:, None] * f[None]
        turned = inverse[ROW[:, None], COLUMN[None]] * inverse[ROW[None], COLUMN[:, None]]
        shape = (
            np.eye(5)[:, :, None] - 2.0 / 3.0 * (tf + tf.swapaxes(0, 1)) + squares * (2.0 / 9.0 * tt + turned / 3.0)
        )
        return p, c * shape + self.bulk * ratio * ((2.0 * ratio - 1.0) * tt - (ratio - 1.0) * turned)


def graded(ends: list[float], size: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Mesh lines through all of `ends` (sorted), with spacing close to `size` (mm), a function of position."""
    lines = [np.array(ends[:1])]
    for low, high in zip(ends, ends[1:], strict=False):
        at = np.linspace(low, high, 2001)
        count = np.concatenate([[0.0], np.cumsum(np.diff(at) / size((at[1:] + at[:-1]) / 2))])
        cells = max(1, int(np.ceil(count[-1] - 1e-9)))
        lines.append(np.interp(np.linspace(0.0, count[-1], cells + 1), count, at)[1:])
    return np.concatenate(lines)


@dataclass(frozen=True)
class Fineness:
    """Element sizes and load steps of a press. edge: radii in mm between which the edge of contact moves.

    Element size, mm, is `fine` between them and grows by `growth` times the distance, up to `coarse`. steps: load
    steps to the deepest depth, shortest at first: the i-th ends at (i / steps)^2 of it.
    """

    edge: tuple[float, float]
    fine: float = 0.05
    coarse: float = 0.4
    growth: float = 0.3
    steps: int = 12

    def halved(self) -> "Fineness":
        """The same with elements of half the size and as many load steps."""
        return Fineness(self.edge, self.fine / 2, self.coarse / 2, self.growth, self.steps)

    def mesh(self, layer: Layer) -> MeshQuad:
        """Quadrilaterals whose lines pass through the limits of all rings under contact."""
        low, high = self.edge

        def size(off: np.ndarray, most: float) -> np.ndarray:
            return np.minimum(self.fine + self.growth * off, most)

        rings = [float(r) for r in np.arange(0.0, high + RING, RING) if r < layer.radius]
        r = graded([*rings, layer.radius], lambda x: np.where(
            x < high, size(np.maximum(low - x, 0.0), self.coarse), size(np.maximum(x - high, 0.0), 5.0 * self.coarse)
        ))  # fmt: skip
        z = graded([0.0, layer.thickness], lambda x: size(x, self.coarse))
        return MeshQuad.init_tensor(r, np.sort(-z))


@dataclass(frozen=True)
class Pressed:
    """A press at one depth: total force N, force N per ring of RING mm of the undeformed gel, contact radius mm.

    pulling: tensile force of stick points over total force. base: relative difference of the base's reaction.
    slipping: fraction of the force at points that slip. excess: largest tangential traction beyond the limit, MPa.
    """

    depth: float
    force: float
    rings: np.ndarray
    contact_radius: float
    pulling: float
    base: float
    slipping: float
    excess: float


class Press:
    """One body on one layer along its path: u (dofs,), and stick points `held` (m, 2) on the body, nan if free."""

    def __init__(self, body: Body, layer: Layer, fineness: Fineness, mu: float):
        self.body, self.layer, self.fineness, self.mu = body, layer, fineness, mu
        self.coulomb = 0.0 < mu < np.inf
        mesh = fineness.mesh(layer)
        basis = Basis(mesh, ElementVector(ElementQuad2()), intorder=4)
        facets = mesh.facets_satisfying(lambda x: np.abs(x[1]) < 1e-9)
        top = FacetBasis(mesh, ElementVector(ElementQuad2()), intorder=3, facets=facets)
        self.weight, self.solid, self.solid_dofs = self._rows(basis, lambda v, r: [*v.grad[0], *v.grad[1], v[0] / r])
        self.area, self.surface, self.surface_dofs = self._rows(top, lambda v, _: [v[0], v[1]])
        self.reference = np.asarray(top.global_coordinates()).reshape(2, -1).T
        base = basis.get_dofs(lambda x: np.abs(x[1] + layer.thickness) < 1e-9).all()
        axis = basis.get_dofs(lambda x: np.abs(x[0]) < 1e-9).all(["u^1"])
        self.base = base
        self.free = np.setdiff1d(np.arange(basis.N), np.concatenate([base, axis]))
        self.dof_places, self.axial = basis.doflocs, np.zeros(basis.N)
        self.axial[basis.get_dofs(elements=True).all(["u^2"])] = 1.0
        self.u, self.held = np.zeros(basis.N), np.full((len(self.reference), 2), np.nan)
        self.depth, self.hardness = 0.0, 1.0
        self.analysed = False
        self.way = np.zeros(len(self.reference))  # of stick points that slip: 1 or -1 along the tangent
        self.linear = PyPardisoSolver(mtype=11 if self.coulomb else -2)  # unsymmetric, or symmetric and indefinite

    @staticmethod
    def _rows(basis: Basis, rows: Callable) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Weights (e, q) of integration points with 2 pi r, values (e, q, k, a) of `rows` by dof, and dofs (e, a)."""
        r = basis.global_coordinates()[0]
        values = np.array([np.broadcast_arrays(*rows(basis.basis[a][0], r)) for a in range(basis.Nbfun)])
        return 2.0 * np.pi * basis.dx * r, np.ascontiguousarray(values.transpose(2, 3, 1, 0)), basis.element_dofs.T

    def deformation(self, u: np.ndarray) -> np.ndarray:
        """F (5, n) at the integration points of the solid, element by element."""
        f = np.einsum("eqka,ea->keq", self.solid, u[self.solid_dofs], optimize=True).reshape(5, -1)
        return f + np.array([1.0, 0.0, 0.0, 1.0, 1.0])[:, None]

    def places(self, u: np.ndarray) -> np.ndarray:
        """Deformed points of the surface (m, 2)."""
        return self.reference + np.einsum("eqka,ea->eqk", self.surface, u[self.surface_dofs]).reshape(-1, 2)

    def gap(self, places: np.ndarray, depth: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distance (m,) of places (m, 2) to the body at a depth, its normal (m, 2) and its curvature (m,)."""
        return self.body.distance(places + [0.0, depth])

    def tractions(self, u: np.ndarray, depth: float) -> tuple[np.ndarray, np.ndarray]:
        """Tractions (m, 2) on the undeformed surface, MPa, and their stiffness (m, 2, 2)."""
        k, x = self.stiffness, self.places(u)
        gap, normal, curvature = self.gap(x, depth)
        inside, holds = gap < 0.0, ~np.isnan(self.held[:, 0])
        traction = np.where(inside[:, None], -k * gap[:, None] * normal, 0.0)
        across = normal[:, :, None] * normal[:, None, :]
        # far from equilibrium points lie deep inside, where the full curvature term would mislead Newton's method
        bend = curvature * np.minimum(1.0, DEEPEST / np.maximum(-gap, 1e-300))
        along = (gap * bend)[:, None, None] * (np.eye(2) - across)
        stiffness = np.where(inside[:, None, None], k * (across + along), 0.0)
        if self.mu == np.inf:
            traction[holds] = k * (self.held[holds] - [0.0, depth] - x[holds])
            stiffness[holds] = k * np.eye(2)
            return traction, stiffness
        rubs = np.flatnonzero(holds & inside)
        pull, limit, t = self.friction(rubs, x, depth)
        way, n = self.way[rubs], normal[rubs]
        shear = np.where(way == 0, pull, way * limit)
        traction[rubs] += shear[:, None] * t
        rate = np.where((way == 0)[:, None], t, (way * self.mu)[:, None] * n)[:, None, :]
        turn = (shear * bend[rubs])[:, None, None] * n[:, :, None] * t[:, None, :]
        stiffness[rubs] += k * t[:, :, None] * rate + turn
        return traction, stiffness

    def friction(self, rubs: np.ndarray, x: np.ndarray, depth: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of stick points (k,) that lie inside: shear traction without slip (k,), its limit (k,), MPa, tangent (k, 2)."""
        gap, normal, _ = self.gap(x[rubs], depth)
        tangent = np.column_stack([normal[:, 1], -normal[:, 0]])
        pull = self.stiffness * ((self.held[rubs] - [0.0, depth] - x[rubs]) * tangent).sum(axis=1)
        return pull, -self.mu * self.stiffness * gap, tangent

    @property
    def stiffness(self) -> float:
        """Penalty, MPa/mm, of the gap and of the elastic slip."""
        return self.hardness * PENALTY * 2.0 * self.layer.c10

    def turned(self, u: np.ndarray, depth: float) -> bool:
        """Let points slip that pull beyond their limit, and stick again that slip against their pull; whether one changed.

        A point that turns round sticks in between, without which Newton's method would throw it to and fro for ever.
        """
        x = self.places(u)
        inside = self.gap(x, depth)[0] < 0.0
        rubs = np.flatnonzero(inside & ~np.isnan(self.held[:, 0]))
        pull, limit, _ = self.friction(rubs, x, depth)
        way = np.zeros_like(self.way)
        beyond = np.where(np.abs(pull) > limit, np.sign(pull), 0.0)
        way[rubs] = np.where(self.way[rubs] * beyond < 0.0, 0.0, beyond)
        changed = bool((way[inside] != self.way[inside]).any())
        self.way = way
        return changed

    def slip(self) -> None:
        """Move the stick points of points that slip, so that their traction is at the limit, and free those that left."""
        x = self.places(self.u)
        holds = np.flatnonzero(~np.isnan(self.held[:, 0]))
        self.held[holds[self.gap(x[holds], self.depth)[0] >= 0.0]] = np.nan
        rubs = np.flatnonzero(~np.isnan(self.held[:, 0]))
        pull, limit, tangent = self.friction(rubs, x, self.depth)
        beyond = (pull - np.clip(pull, -limit, limit)) / self.stiffness
        self.held[rubs] -= beyond[:, None] * tangent

    def residual(self, u: np.ndarray, depth: float) -> tuple[np.ndarray, sp.csr_matrix]:
        """Residual force (dofs,) N and its derivative."""
        stress, stiff = self.layer.stress(self.deformation(u))
        traction, hard = self.tractions(u, depth)
        parts = (
            (self.solid, self.solid_dofs, self.weight, stress.T, np.moveaxis(stiff, 2, 0)),
            (self.surface, self.surface_dofs, self.area, -traction, hard),
        )
        out, values, rows, columns = np.zeros(len(u)), [], [], []
        for shape, dofs, weight, force, stiffness in parts:
            e, q, k, a = shape.shape
            weighted = (shape * weight[:, :, None, None]).reshape(e, q * k, a).swapaxes(1, 2)
            out += np.bincount(dofs.ravel(), (weighted @ force.reshape(e, q * k, 1)).ravel(), len(u))
            values.append((weighted @ (stiffness.reshape(e, q, k, k) @ shape).reshape(e, q * k, a)).ravel())
            rows.append(np.repeat(dofs, a, axis=1).ravel())
            columns.append(np.tile(dofs, (1, a)).ravel())
        places = np.concatenate(rows), np.concatenate(columns)
        return out, sp.csr_matrix((np.concatenate(values), places), (len(u), len(u)))

    def equilibrium(self, u: np.ndarray, depth: float, small: float = 1e-9) -> np.ndarray:
        """Newton's method from u (dofs,) until a step is below `small` times the depth; raises Unsolved.

        Without friction, points would touch and release for ever on a stiff penalty, so it is raised in four stages;
        so it is under Coulomb's law where Newton's method fails.
        """
        if self.mu > 0.0:
            self.hardness = 1.0
            try:
                return self.newton(u, depth, small, 8 if self.coulomb else 15)
            except Unsolved:
                if not self.coulomb:
                    raise
        for self.hardness in (1e-3, 1e-2, 1e-1):
            u = self.newton(u, depth, 1e-3)
        self.hardness = 1.0
        return self.newton(u, depth, small)

    def newton(self, u: np.ndarray, depth: float, small: float, most: int = 15) -> np.ndarray:
        """`equilibrium` at the current penalty stiffness."""
        u, free = u.copy(), self.free
        for _ in range(most):
            out, tangent = self.residual(u, depth)
            matrix = tangent[free][:, free]
            step = self.solve(matrix if self.coulomb else sp.triu(matrix, format="csr"), out[free])
            part = 1.0
            while part > 0.01:
                trial = u.copy()
                trial[free] -= part * step
                try:
                    self.layer.stress(self.deformation(trial))
                    break
                except Unsolved:
                    part /= 2.0
            u = trial
            turned = self.coulomb and self.turned(u, depth)
            if part == 1.0 and not turned and np.abs(step).max() < small * depth:
                return u
        raise Unsolved(f"no equilibrium at a depth of {depth:.4g} mm")

    def solve(self, matrix: sp.csr_matrix, right: np.ndarray) -> np.ndarray:
        """Solution of a linear system whose non-zero places are the same every time: they are analysed once."""
        self.linear.set_phase(23 if self.analysed else 13)
        self.analysed = True
        return self.linear._call_pardiso(matrix, right)

    def advance(self, depth: float, before: tuple[np.ndarray, float] | None) -> None:
        """One load step. before: u and depth one step earlier, from which the motion is extrapolated."""
        start, gap = self.places(self.u), self.gap(self.places(self.u), self.depth)[0]
        ahead = self.u
        if before is not None:
            ahead = self.u + (depth - self.depth) / (self.depth - before[1]) * (self.u - before[0])
        closing = gap - self.gap(self.places(ahead), depth)[0]
        share = np.where(closing > 0.0, np.maximum(gap, 0.0) / np.maximum(closing, 1e-300), 1.0)
        # a rough tolerance with stick, because points that touch first still move to their stick points
        small = 1e-4 if self.mu > 0.0 else 1e-9
        try:
            u = self.equilibrium(ahead, depth, small)
        except Unsolved:
            u = self.equilibrium(self.u, depth, small)
        if self.mu > 0.0:
            u = self.hold(u, depth, start, np.clip(share, 0.0, 1.0)[:, None])
        self.u, self.depth = u, depth
        if self.coulomb:
            self.slip()

    def hold(self, u: np.ndarray, depth: float, start: np.ndarray, share: np.ndarray) -> np.ndarray:
        """Let new contact points stick at `share` (m, 1) of their way from `start` (m, 2) to u, until none is new."""
        kept, small, up = self.held.copy(), 1e-4, np.array([0.0, 1.0])
        while True:
            end = self.places(u)
            new = np.isnan(self.held[:, 0]) & (self.gap(end, depth)[0] < 0.0)
            if not new.any():
                if small < 1e-4:
                    return u
                small = 1e-9
            met = (1.0 - share) * (start + self.depth * up) + share * (end + depth * up)
            distance, normal, _ = self.body.distance(met)
            self.held[new] = (met - distance[:, None] * normal)[new]
            try:
                u = self.equilibrium(u, depth, small)
            except Unsolved:
                self.held = kept
                raise

    def follow(self, depths: list[float]) -> list[Pressed]:
        """The press at each of the depths (mm, rising)."""
        found, before = [], None
        steps = self.fineness.steps
        for depth in sorted({*(max(depths) * (np.arange(1, steps + 1) / steps) ** 2), *depths}):
            if depth - self.depth < 1e-9:
                continue
            last = self.u, self.depth
            self._reach(depth, before)
            before = last
            if depth in depths:
                found.append(self.pressed())
        return found

    def _reach(self, depth: float, before: tuple[np.ndarray, float] | None, cuts: int = 5) -> None:
        """`advance`, in half load steps if it fails."""
        try:
            self.advance(depth, before)
        except Unsolved:
            if not cuts:
                raise
            last = self.u, self.depth
            self._reach((self.depth + depth) / 2, before, cuts - 1)
            self._reach(depth, last, cuts - 1)

    def pressed(self) -> Pressed:
        """Forces and checks of the current state."""
        traction, _ = self.tractions(self.u, self.depth)
        push = -traction[:, 1] * self.area.ravel()
        force, touched = float(push.sum()), np.abs(traction).max(axis=1) > 0.0
        r = self.reference[:, 0]
        rings = np.bincount((r / RING).astype(int)[touched], push[touched])
        _, normal, _ = self.gap(self.places(self.u), self.depth)
        pressure = (traction * normal).sum(axis=1)
        pull = np.minimum(pressure, 0.0) @ self.area.ravel()
        out, _ = self.residual(self.u, self.depth)
        held = out[self.base] @ self.axial[self.base]
        mismatch, radius = float(abs(held / force) - 1.0), float(r[touched].max())
        limit = self.mu * pressure[touched]
        shear = np.linalg.norm(traction - pressure[:, None] * normal, axis=1)[touched]
        slips = shear >= limit * (1.0 - 1e-6) if self.coulomb else np.zeros(len(shear), bool)
        slipping = float(push[touched][slips].sum() / force)
        excess = float((shear - limit).max()) if self.coulomb else 0.0
        return Pressed(self.depth, force, rings, radius, float(-pull / force), mismatch, slipping, excess)


def press(body: Body, layer: Layer, depths: list[float], fineness: Fineness, mu: float = np.inf) -> list[Pressed]:
    """The forces at each of the depths; mu: coefficient of friction, infinite without slip from first touch on."""
    return Press(body, layer, fineness, mu).follow(depths)


BODIES = {"sphere": sphere, "punch": punch, "tube": tube, "cone": cone}


@dataclass(frozen=True)
class Series:
    """One body pressed to several depths. shape: kind and arguments in BODIES. edge: radii where contact ends, mm.

    mu: coefficient of friction; None: no slip.
    """

    shape: tuple
    depths: tuple[float, ...]
    edge: tuple[float, float]
    fine: float
    nu: float = 0.475
    thickness: float = 4.0
    mu: float | None = None

    @property
    def interface(self) -> str:
        """The contact law."""
        return {None: "no_slip", 0.0: "frictionless"}.get(self.mu, "coulomb")

    @property
    def name(self) -> str:
        """A unique name, to which a press adds its depth."""
        kind, *sizes = self.shape
        parts = [kind, *(f"{size:g}" for size in sizes), f"nu{self.nu:g}", f"pad{self.thickness:g}"]
        return "-".join([*parts, self.interface + (f"{self.mu:g}" if self.interface == "coulomb" else "")])

    @property
    def body(self) -> Body:
        """The body in the (r, z) half-plane."""
        return BODIES[self.shape[0]](*self.shape[1:])


def _punch(diameter: float, fillet: float, *depths: float, **other) -> Series:
    return Series(
        ("punch", diameter, fillet),
        depths,
        (diameter / 2 - 1.1 * fillet, diameter / 2),
        max(0.12 * fillet, 0.024),
        **other,
    )


def _sphere(diameter: float, most: float, *depths: float, **other) -> Series:
    return Series(("sphere", diameter), depths, (0.0, most), max(0.05, most / 25), **other)


# The largest depth is a third of the gel's thickness, or less if elements invert in the sharp fold at a small fillet.
SERIES = (
    _sphere(15, 4.0, 0.05, 0.2, 0.4, 1.0, 1.333),
    _punch(10, 0.3, 0.05, 0.1, 0.3, 0.5),
    _punch(10, 1.0, 0.05, 0.1, 0.3, 0.8, 1.333),
    _sphere(200, 7.0, 0.05, 0.1, 0.3),
    Series(("tube", 10, 7, 0.7), (0.05, 0.2, 0.5, 1.0), (3.5, 5.0), 0.07),
    _sphere(200, 7.0, 0.1, 0.3, nu=0.49),
    _punch(6, 1.0, 0.1, 0.5, 1.333),
    _punch(6, 0.3, 0.1, 0.5, 0.8),
    _sphere(4, 1.9, 0.05, 0.3, 1.0, 1.333),
    _sphere(60, 7.0, 0.05, 0.3, 1.0),
    Series(("cone", 30, 0.5), (0.1, 0.5, 1.0, 1.333), (0.0, 2.2), 0.1),
    _punch(10, 1.0, 0.1, 0.3, mu=0.0),
    _sphere(15, 4.0, 0.2, 1.0, mu=0.0),
    _punch(10, 0.3, 0.1, 0.3, nu=0.49),
    _punch(6, 0.3, 0.05, 0.2, 0.4, thickness=2.0),
    _sphere(15, 3.3, 0.05, 0.2, 0.66, thickness=2.0),
    _punch(10, 0.1, 0.05, 0.1, 0.3),
    _punch(6, 0.1, 0.1, 0.3),
    _punch(10, 1.0, 0.1, 0.5, nu=0.45),
    _sphere(15, 4.0, 0.1, 1.0, nu=0.49),
    Series(("cone", 30, 0.5), (0.5,), (0.0, 1.2), 0.06, nu=0.45),
    _sphere(60, 6.0, 0.3, nu=0.45, mu=0.0),
    Series(("tube", 10, 7, 0.7), (0.2, 0.5), (3.5, 5.0), 0.07, nu=0.49, mu=0.0),
    _sphere(200, 5.5, 0.1, thickness=2.0),
    _punch(6, 1.0, 0.2, 0.66, thickness=2.0, nu=0.49),
    Series(("sphere", 15), (0.4, 1.0), (0.0, 4.0), 0.32, mu=0.2),
    Series(("punch", 10, 1.0), (0.1, 0.3, 0.8), (3.9, 5.0), 0.24, mu=0.2),
    Series(("punch", 10, 0.3), (0.1, 0.3), (4.67, 5.0), 0.072, mu=0.2),
    Series(("punch", 10, 0.3), (0.1, 0.3), (4.67, 5.0), 0.072, mu=0.7),
    Series(("punch", 10, 1.0), (0.3, 0.8), (3.9, 5.0), 0.24, mu=0.4),
    Series(("sphere", 6), (0.4, 1.0), (0.0, 2.2), 0.16, mu=0.2),
    Series(("sphere", 6), (1.0,), (0.0, 2.2), 0.16, mu=0.7),
    Series(("sphere", 15), (0.4, 1.0), (0.0, 4.0), 0.32, mu=0.4),
    Series(("tube", 10, 7, 0.7), (0.2, 0.5), (3.5, 5.0), 0.14, mu=0.4),
    Series(("cone", 30, 0.5), (0.5, 1.0), (0.0, 2.2), 0.16, mu=0.4),
    Series(("punch", 10, 1.0), (0.8,), (3.9, 5.0), 0.24, mu=0.9),
    Series(("punch", 6, 0.3), (0.1, 0.5), (2.67, 3.0), 0.072, mu=0.4),
    _punch(8, 0.2, 0.2, 0.5),
    _punch(8, 0.2, 0.2, 0.5, mu=0.7),
    _punch(5, 0.1, 0.2, 0.4),
    _punch(5, 0.1, 0.2, 0.4, mu=0.7),
    _punch(12, 0.15, 0.15, 0.3),
    Series(("tube", 10, 6, 0.2), (0.2, 0.4), (3.0, 5.0), 0.05),
    Series(("tube", 10, 6, 0.2), (0.2, 0.4), (3.0, 5.0), 0.05, mu=0.3),
)  # fmt: skip


def solved(path: Series) -> list[dict]:
    """The presses of one series, with the differences between their three solves."""
    layer, plain = Layer(path.thickness, path.nu), Fineness(path.edge, path.fine)
    ways = (plain, plain.halved(), replace(plain, steps=24))
    mu = np.inf if path.mu is None else path.mu
    found = [press(path.body, layer, list(path.depths), way, mu) for way in ways]
    return [_record(path, *row) for row in zip(*found, strict=True)]


def _record(path: Series, coarse: Pressed, fine: Pressed, slow: Pressed) -> dict:
    def apart(other: Pressed) -> dict:
        rings = np.zeros((2, max(len(other.rings), len(coarse.rings))))
        rings[0, : len(other.rings)], rings[1, : len(coarse.rings)] = other.rings, coarse.rings
        return {
            "total": float(f"{abs(other.force / coarse.force - 1.0):.2g}"),
            "rings": float(f"{np.abs(rings[0] - rings[1]).sum() / coarse.force:.2g}"),
        }

    return {
        "name": f"{path.name}-{fine.depth:g}mm", "kind": path.shape[0], "sizes_mm": list(path.shape[1:]), "depth_mm": fine.depth,
        "thickness_mm": path.thickness, "nu": path.nu, "interface": path.interface, "mu": path.mu,
        "force_n": float(f"{fine.force:.6g}"), "rings_n": [float(f"{ring:.5g}") for ring in fine.rings],
        "contact_radius_mm": float(f"{fine.contact_radius:.3f}"), "pulling": float(f"{fine.pulling:.1e}"),
        "slipping": float(f"{fine.slipping:.3f}"),
        "elements_halved": apart(fine), "steps_doubled": apart(slow),
    }  # fmt: skip


def key(path: Series) -> dict:
    """The numbers on which the presses of a series depend."""
    return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(path).items()}


def body_of(path: Series) -> dict:
    """The body in numbers: all points within a radius of a polyline of (r, z), its tip at z = 0."""
    core = [[float(f"{value:.6g}") for value in point] for point in path.body.core]
    return {"core_mm": core, "radius_mm": path.body.radius}


def main() -> None:
    """Solve the series that are not stored yet; presses that are stored for the same numbers are not solved again."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    file = Path(sys.argv[1]) if len(sys.argv) > 1 else KEPT
    kept = {group["path"]["name"]: group for group in json.loads(file.read_text())["paths"]} if file.exists() else {}
    for path in SERIES:
        if kept.get(path.name, {}).get("path") == key(path) | {"name": path.name}:
            continue
        records = solved(path)
        kept[path.name] = {"path": key(path) | {"name": path.name}, "body": body_of(path), "presses": records}
        groups = [kept[each.name] for each in SERIES if each.name in kept]
        found = {"c10_mpa": 0.0725, "pad_mm": [40.0, 40.0], "ring_mm": RING, "paths": groups}
        part = file.with_suffix(".part")
        part.write_text(json.dumps(found, indent=1, sort_keys=True) + "\n")
        part.replace(file)
        for record in records:
            print(record["name"], record["force_n"], record["elements_halved"], record["steps_doubled"], flush=True)


if __name__ == "__main__":
    main()
