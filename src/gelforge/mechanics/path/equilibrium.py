"""Equilibrium of one scene on one mesh at a fixed pose: Newton's method that reuses a factorisation while it pays.

The displacement u of the nodes is sought at which the forces of the deformed gel balance those of the contact:

    R(u) = F_gel(u) - F_contact(u) = 0,    u = 0 at the bonded base.

Contact acts at integration points of the surface. At the position x of one, the indenter has the signed distance g
(negative inside) and the outward normal n. The pressure is p = k_n max(0, -g), and the traction on the gel is
t = p n + q, with a tangential part q by the contact law (`contact/penalty.py`):

- frictionless: q = 0.
- no slip: a point that has touched is bound to the place s of the indenter where it first touched, in all directions:
  t = k_n (s - x). It may pull; such points are released between solves (`scenepath.py`).
- Coulomb: q' = l + k_t (1 - n n^T) (s - x), with a multiplier l; q = q' while |q'| <= mu p, else q = mu p q' / |q'|
  (return mapping: Wriggers, Computational Contact Mechanics, 2006, section 6.3.2). After each load step l becomes q,
  and s of a point that slipped becomes its position on the indenter (augmented Lagrangian: Simo, Laursen 1992, Comput.
  Struct. 42, 97-116), so the elastic slip |q| / k_t of a penalty does not add up along a path.

Newton's step solves K du = R for u - du. The dependence of mu p on p makes K unsymmetric. So its symmetric part is
factorised, seldom, and GMRES solves with the whole K, with the factorisation as preconditioner (inexact Newton:
Dembo, Eisenstat, Steihaug 1982, SIAM J. Numer. Anal. 19, 400-408). Steps are shortened where they invert elements or
raise the residual (Deuflhard, Newton Methods for Nonlinear Problems, 2004, section 3).

The end of a path depends on what came before only through s and l. That is why a path is followed on coarse hexahedra
and only its end on a fine mesh: `transfer.py` carries u, s and l over, and `ScenePath.arrive` walks the rest.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gelforge.errors import SolveFailed
from gelforge.mechanics.contact.law import Holding
from gelforge.mechanics.contact.penalty import (
    STICK,
    FacePlaces,
    Penalty,
    Skew,
    Tractions,
    contact_points,
    curved,
    penalty_tractions,
    positions,
)
from gelforge.mechanics.elements.element import ELEMENTS
from gelforge.mechanics.linear.factorisation import symmetric_solver
from gelforge.mechanics.linear.gmres import gmres, length_of
from gelforge.mechanics.linear.pattern import block_places, build_pattern, symmetric_product
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.hexmesh import HexMesh, elimination_order
from gelforge.mechanics.path.loadpath import gaps, reachable
from gelforge.mechanics.path.pathsettings import PathSettings
from gelforge.mechanics.pose import Pose
from gelforge.mechanics.result import NoEquilibrium
from gelforge.mechanics.scene import Scene

# Iterations after which each step must lower the residual; good first steps may raise it.
WARY = 3
# Step fractions of the line search, tried in turn. SHORT stops the flipping of points that every longer step carries
# between slip and stick, but Newton's method then gets stuck sooner where a longer step would lead out.
PARTS = (1.0, 0.5, 0.25)
SHORT = (*PARTS, 0.125, 0.06, 0.03, 0.015)
# Relative residual of the linear solves (inexact Newton): it costs hardly any Newton iterations.
FORCING = 3e-2
# Residual below which the tangent is exact; above it, the curvature of fillets misleads Newton's method.
CLOSE = 1e-3
# Residual above which the tangent leaves out the pressure's geometric stiffness: along a path, and from an
# interpolated state, whose noisy volume ratios give large pressures of both signs and an indefinite tangent.
NOISY, NOISY_INTERPOLATED = 5e-3, 1e-3
# Residual accepted within a path with friction: below it a point close to slipping may flip between slip and stick
# for ever, and no shorter load step would help.
CYCLING = 1e-3
# Most matrix products per linear solve, with an old factorisation (a new one costs about a dozen) and with a new one.
STALE, FRESH = 12, 60


@dataclass(frozen=True)
class Aim:
    """Goal and options of one Newton solve.

    tolerance: residual over the contact force. still: indenter and contact are unchanged since the last equilibrium.
    enough: residual accepted if the iteration limit is reached before the tolerance. parts: step fractions of the
    line search. held: no sticking point may slip in any step.
    """

    tolerance: float
    still: bool = False
    enough: float = 0.0
    parts: Sequence[float] = PARTS
    held: bool = False


class System:
    """Sparsity pattern, block positions and symbolic factorisation: everything that depends on connectivity alone.

    values: upper triangle of the current matrix; scenes that share the system overwrite it.
    """

    def __init__(self, mesh: GelMesh):
        elements = mesh.cells.nodes
        self.pattern = build_pattern(elements, len(mesh.nodes), np.concatenate([mesh.base, mesh.hanging.nodes]))
        self.base, self.width = block_places(self.pattern, elements)
        self.faces = FacePlaces(mesh, self.pattern)
        order = elimination_order(mesh) if isinstance(mesh, HexMesh) else None
        self.linear = symmetric_solver(self.pattern.indptr, self.pattern.indices, order)
        self.free = mesh.unknown
        self.values = np.zeros(len(self.pattern.indices), np.float32)


class Equilibrium:
    """One scene on one mesh and its current state.

    u: (n, 3) mm. state: ContactState. tractions: those of the last equilibrium. candidates: points that do not stick
    and may come to touch. residual: out-of-balance force over contact force. noisy: residual above which the tangent
    leaves out the pressure's geometric stiffness. crawls: whether SHORT step fractions are tried when the usual ones
    all invert elements, for solves without a load step to shorten instead. The counters sum over all solves.
    """

    def __init__(self, scene: Scene, settings: PathSettings, mesh: GelMesh, system: System) -> None:
        self.scene, self.settings, self.mesh, self.system = scene, settings, mesh, system
        self.law = scene.interface.contact
        self.penalty = Penalty(settings.stiffness, settings.friction_stiffness, self.law)
        self.holding = replace(self.penalty, law=Holding())
        self.moduli = scene.material.shear_modulus, scene.material.bulk_modulus
        self.elements = ELEMENTS[mesh.kind].on(mesh.nodes, mesh.cells)
        self.state = contact_points(mesh, settings.gauss, np.flatnonzero(reachable(scene, mesh.nodes[mesh.faces])))
        self.nodes = np.ascontiguousarray(mesh.faces[self.state.face])
        self.u, self.candidates = np.zeros_like(mesh.nodes), np.empty(0, np.int64)
        self.tractions: Any = None  # Tractions of the last equilibrium
        self.iterations = 0
        self.residual, self.factored = np.inf, False
        self.noisy, self.crawls = NOISY, False

    @property
    def within_path(self) -> Aim:
        """Goal of the solves between the ends of a path."""
        return Aim(self.settings.tolerance, enough=CYCLING if self.law.frictional else 0.0)

    def points(self, u: np.ndarray) -> np.ndarray:
        """Deformed positions (m, 3) mm of the contact points."""
        return positions(self.state.shape, self.nodes, self.mesh.nodes + u)

    def newton_from(self, guesses: list[np.ndarray], pose: Pose) -> tuple[np.ndarray, int]:
        """`newton` from the first guess (n, 3) that leads to an equilibrium, to the tolerance within a path."""
        failed = NoEquilibrium()
        for guess in guesses:
            try:
                return self.newton(guess, pose, self.within_path)
            except NoEquilibrium as error:
                failed = error
        raise failed

    def newton(self, u: np.ndarray, pose: Pose, aim: Aim) -> tuple[np.ndarray, int]:
        """Newton's method from u until `aim` is met: u (n, 3) and the number of steps; raises NoEquilibrium.

        With friction the first step holds every sticking point: from a poor guess, slipping points drag others along
        and Newton's method goes astray.
        """
        if self.iterations > self.settings.most_in_all:
            raise NoEquilibrium(f"the path took more than {self.settings.most_in_all:g} Newton iterations")
        penalties = [self.holding, self.penalty] if self.law.frictional and not aim.still else [self.penalty]
        penalties = [self.holding] if aim.held else penalties
        state = self._out_of_balance(u, pose, penalties[0])
        best: tuple[float, np.ndarray, Any] = np.inf, u, None
        for iteration in range(self.settings.max_iterations + 1):
            if len(penalties) == 1 and self.residual <= aim.tolerance:
                self.tractions = state[1]
                return u, iteration
            if len(penalties) == 1 and self.residual < best[0]:
                best = self.residual, u, state[1]
            if iteration < self.settings.max_iterations:
                step = self._direction(u, pose, penalties[0], *state)
                penalties = penalties[-1:]
                before = self.residual if iteration >= WARY else np.inf
                u, state = self._step(u, step, pose, penalties[0], before, aim.parts)
        if best[0] > aim.enough:
            raise NoEquilibrium
        self.residual, u, self.tractions = best
        return u, self.settings.max_iterations

    def _step(
        self, u: np.ndarray, step: np.ndarray, pose: Pose, penalty: Penalty, before: float, parts: Sequence[float]
    ) -> tuple[np.ndarray, tuple[np.ndarray, Tractions]]:
        """Subtract the step from u, or a fraction if it inverts elements or leaves the residual above `before`."""
        free, best = self.system.free, None
        for part in SHORT if self.crawls else parts:
            if part < parts[-1] and best is not None:
                break
            trial = u.copy()
            trial[free] -= part * step
            self.mesh.hanging.hang(trial)
            try:
                state = self._out_of_balance(trial, pose, penalty)
            except NoEquilibrium:
                continue
            if best is None or self.residual < best[0]:
                best = self.residual, trial, state
            if self.residual < before:
                break
        if best is None:
            raise NoEquilibrium
        self.residual = best[0]
        return best[1:]

    def _out_of_balance(self, u: np.ndarray, pose: Pose, penalty: Penalty) -> tuple[np.ndarray, Tractions]:
        """Nodal residual (n, 3) and contact tractions; sets `residual` relative to the contact force."""
        forces = self.internal(u)
        x, indenter = self.points(u), self.scene.indenter
        tractions = penalty_tractions(self.state, x, pose, indenter, penalty, self.candidates)
        self.system.faces.add_forces(self.state, tractions, forces)
        scale = float(self.state.weights[tractions.point] @ np.linalg.norm(tractions.traction, axis=1))
        self.residual = length_of(forces[self.system.free].ravel()) / max(scale, 1e-9 * self.moduli[0])
        if not np.isfinite(self.residual):
            raise NoEquilibrium
        return forces, tractions

    def internal(self, u: np.ndarray) -> np.ndarray:
        """Nodal forces (n, 3) N of the deformed gel; raises NoEquilibrium if an element is inverted."""
        forces = np.zeros_like(u)
        smallest = self.elements.internal_forces(u, *self.moduli, forces)
        if not smallest > 0.0:
            raise NoEquilibrium
        return forces

    def _direction(
        self, u: np.ndarray, pose: Pose, penalty: Penalty, forces: np.ndarray, tractions: Tractions
    ) -> np.ndarray:
        """Newton step (free nodes, 3) mm, solved to FORCING; reuses a factorisation while GMRES is fast with it."""
        system = self.system
        system.values[:] = 0.0
        geometric_stiffness = float(self.residual <= self.noisy)
        self.elements.tangent(u, *self.moduli, geometric_stiffness, system.base, system.width, system.values)
        system.faces.add_stiffness(self.state, tractions, system.values)
        self.iterations += 1
        apply = self._product(self._skew(u, pose, penalty, tractions))
        right = forces[system.free].ravel()
        if self.factored:
            step = gmres(apply, system.linear.solve, right, FORCING, STALE)
            if step is not None:
                return step.reshape(-1, 3)
        self.factored = False
        try:
            system.linear.factorise(system.values)
        except SolveFailed as error:
            raise NoEquilibrium(str(error)) from error
        self.factored = True
        step = gmres(apply, system.linear.solve, right, FORCING, FRESH)
        if step is None:
            raise NoEquilibrium
        return step.reshape(-1, 3)

    def _skew(self, u: np.ndarray, pose: Pose, penalty: Penalty, tractions: Tractions) -> Skew:
        """Non-symmetric stiffness; exact close to equilibrium, for quadratic convergence of Newton's method."""
        if self.residual > CLOSE:
            return tractions.slip
        x = self.points(u)
        return curved(tractions, self.state, x, pose, self.scene.indenter, penalty, self.candidates)

    def _product(self, skew: Skew) -> Callable[[np.ndarray], np.ndarray]:
        system = self.system
        pattern, values = system.pattern, system.values
        add = system.faces.skew_product(self.state, skew)

        def apply(x: np.ndarray) -> np.ndarray:
            y = symmetric_product(pattern, values, x)
            add(x, y)
            return y

        return apply

    def solve_here(self, pose: Pose, aim: Aim) -> None:
        """Equilibrium with the indenter at a pose."""
        gap = gaps(self.scene, self.points(self.u), pose)
        self.candidates = np.flatnonzero((self.state.status != STICK) & (gap < self.settings.size))
        self.u, _ = self.newton(self.u, pose, aim)

    def contact_forces(self) -> np.ndarray:
        """Nodal contact forces on the gel (n, 3) of the last equilibrium, N."""
        forces = np.zeros_like(self.u)
        self.system.faces.add_forces(self.state, self.tractions, forces)
        return -forces
