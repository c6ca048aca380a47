"""Contact kinematics on the tetrahedra, in process: which face points touch, and what they stick to.

The path is followed in load steps. Within a step a point that is new feels only the normal; at the
step's end it sticks where it first touched, and what pulls is
released. So every step is a smooth problem but for new touches. CalculiX then solves the end of the path.
"""

from dataclasses import dataclass, replace

import numpy as np

from gelforge.errors import SolveFailed
from gelforge.mechanics.contact.facecontact import (
    FREE,
    SLIDE,
    STICK,
    Contact,
    contact_blocks,
    contact_forces,
    gaps,
    judge,
)
from gelforge.mechanics.contact.facepoints import FacePoints
from gelforge.mechanics.path.arrival import iterate_arrival
from gelforge.mechanics.path.stepcontrol import StepControl
from gelforge.mechanics.path.tetsolid import TetSolid
from gelforge.mechanics.path.transfer import LoadPath, touches
from gelforge.mechanics.pose import Pose, on_surface, touch_places
from gelforge.mechanics.result import NoEquilibrium
from gelforge.mechanics.scene import Scene

# Shares of a displacement carried from hexahedra that are tried until no element is inverted, or nearly: beside a volume
# ratio below FLAT pressures are such that Newton's method takes twice as many steps.
UNFOLDED = (1.0, 0.95, 0.9, 0.8, 0.6)
FLAT = 0.1

# Least and most of its residual that a linear solve leaves; between them, as much as that is of the contact force.
LEFT = 0.02, 0.2
# Tangents that are tried in turn, (geometric stiffness, regularisation): exact ones, then ones that are surely definite.
EXACT, DEFINITE = [(1.0, 0.0), (0.5, 0.0)], [(0.0, 0.0), (0.0, 1.0)]
# Residual above which no step is taken with an old factorisation: beside a crease half a direction leads nowhere.
FAR = 1.5


@dataclass(frozen=True)
class PathSettings:
    """How a path is followed; residuals are those of free nodes over the contact force.

    press_steps, shear_steps: load steps, at least. step_mm: no load step of the press is longer.
    stiffness: of the penalties that hold face points, N/mm^3.
    step_tolerance, final_tolerance: residual at the end of a load step and of the path. contact_tolerance: at which the end
    is judged first. arrival_tolerance: at which the end of a path followed on hexahedra shows what pulls and what presses; a third
    of that finds no other points and takes half as long again.
    geometric_stiffness_below: residual above which Newton leaves out the pressure's geometric stiffness: that halves the iterations of
    deep presses and needs no cut steps.
    pull_tolerance: share of the normal force that may pull at the end; where a path on hexahedra ends, of the largest pressure
    that one point may. penetration_mm: depth at which a free point counts as touching at the end.
    free_iterations: of Newton's method, after which no point that slides is released, so that a set that flickers comes to
    rest. most_iterations: at one pose. most_in_all: of a path. most_cuts: how often a load step may be halved.
    contact_iterations: in which the contact at the end may change. friction_rounds: in which a load step looks for what slips.
    """

    press_steps: int = 4
    shear_steps: int = 3
    step_mm: float = 0.35
    stiffness: float = 145.0
    step_tolerance: float = 0.2
    arrival_tolerance: float = 0.3
    contact_tolerance: float = 0.02
    final_tolerance: float = 1e-8
    geometric_stiffness_below: float = 0.5
    pull_tolerance: float = 1e-3
    penetration_mm: float = 1e-3
    free_iterations: int = 6
    most_iterations: int = 20
    most_cuts: int = 5
    most_in_all: int = 300
    contact_iterations: int = 8
    friction_rounds: int = 4


@dataclass
class Kinematics:
    """End of a path: contact, displacement (n, 3) mm, whether it converged, why not, and what it took.

    iterations: of Newton's method. steps: of the load. rounds: in which the contact at the end was judged.
    """

    contact: Contact
    displacement: np.ndarray
    converged: bool
    reason: str
    iterations: int
    steps: int
    rounds: int


@dataclass(frozen=True)
class _State:
    """Displacement u (n, 3) mm, contact there, and what is out of balance.

    changed: points that came or went. residual: (n, 3) N. size: its norm over that of the contact force. smallest: volume
    ratio J of the elements; not above 0, one is inverted, and residual and size mean nothing.
    """

    u: np.ndarray
    contact: Contact
    changed: int
    residual: np.ndarray
    size: float
    smallest: float


class TetPath:
    """State along a path: displacement u (n, 3), contact, stick points (f, q, 3) in the indenter's frame.

    at: (2,) fractions of press and shear that are done. velocity: (n, 3) mm per fraction, of the last load step.
    """

    def __init__(self, scene: Scene, solid: TetSolid, points: FacePoints, settings: PathSettings):
        self.law = scene.interface.contact
        self.shear, self.bulk = scene.material.shear_modulus, scene.material.bulk_modulus
        self.scene, self.solid, self.points, self.settings = scene, solid, points, settings
        self.u = np.zeros((len(solid.free), 3))
        self.velocity = np.zeros_like(self.u)
        self.at = np.zeros(2)
        zero = np.zeros_like(points.position)
        self.contact = Contact(np.zeros(points.weight.shape, int), zero, zero.copy(), zero.copy())
        self.stick_point, self.stick_normal = zero.copy(), zero.copy()
        self.iterations = self.steps = self.rounds = 0
        # The next step takes a factorisation of its own: one of another press would make this one depend on that.
        self.fresh = True

    def pose(self, at: np.ndarray) -> Pose:
        """Where the indenter stands at fractions (2,) of press and shear."""
        return Pose(*self.scene.press.pose(*at))

    def positions(self, u: np.ndarray) -> np.ndarray:
        """Deformed places (f, q, 3) mm of the face points."""
        return self.points.position + self.points.at(u)

    def press_steps(self) -> int:
        """Load steps from here to the end of the press."""
        travel = (1.0 - self.at[0]) * abs(self.scene.press.dz)
        return max(self.settings.press_steps, int(np.ceil(travel / self.settings.step_mm)))

    # -- one load step

    def advance(self, goal: np.ndarray) -> None:
        """Go to `goal` (press, shear fractions), in shorter steps where Newton asks for it."""
        origin = self.at

        def go(part: float, _: float) -> int:
            kept = self.u, self.contact, self.stick_point.copy(), self.stick_normal.copy()
            try:
                self._step(origin + part * (goal - origin))
            except NoEquilibrium:
                self.u, self.contact, self.stick_point, self.stick_normal = kept
                raise
            return 0

        StepControl(self.settings.most_cuts).follow(0.0, 1.0, 1.0, go)

    def _step(self, aim: np.ndarray) -> None:
        s, before, start = self.settings, self.at, self.u
        pose = self.pose(aim)
        gap0, _ = gaps(self.scene, self.pose(before), self.positions(start))
        contact = self._lead(pose)
        length = max(np.abs(aim - before).max(), 1e-12)
        self.u, self.contact = self.newton(self._ahead(start, length), contact, pose, s.step_tolerance)
        if self.law.frictional:
            self._slide(pose)
        elif self.law.sticks:
            self._stick_new(start, before, aim, gap0)
        self.velocity, self.at = (self.u - start) / length, aim
        self.steps += 1

    def _ahead(self, u: np.ndarray, length: float) -> np.ndarray:
        """Where the last step's motion would lead, if that inverts no element."""
        ahead = u + length * self.velocity
        return ahead if self.solid.forces(ahead, self.shear, self.bulk)[1] > 0.2 else u

    def _lead(self, pose: Pose) -> Contact:
        """The contact as the step begins: sticking points travel with the indenter."""
        stick = self.contact.state == STICK
        c = self.contact
        target = np.where(stick[..., None], pose.to_gel(self.stick_point), c.target)
        normal = np.where(stick[..., None], pose.turn(self.stick_normal), c.normal)
        return Contact(c.state, target, normal, c.drag)

    def newton(self, u: np.ndarray, contact: Contact, pose: Pose, tolerance: float) -> tuple[np.ndarray, Contact]:
        """Equilibrium at a fixed pose; points that do not stick touch where they would penetrate. Raises NoEquilibrium."""
        s = self.settings
        if self.iterations > s.most_in_all:
            raise NoEquilibrium(f"the path took more than {s.most_in_all} Newton iterations")
        state = self._evaluate(u, contact, pose, False)
        for iteration in range(s.most_iterations):
            if state.smallest <= 0.0 or not np.isfinite(state.size):
                raise NoEquilibrium("an element is inverted")
            # on the way a few points may still come and go; at the end none
            allowed = 0.05 * state.contact.touching.sum() if tolerance > s.final_tolerance else 0
            if state.size < tolerance and state.changed <= allowed:
                return state.u, state.contact
            keep = iteration + 1 >= s.free_iterations
            state = self._newton_step(state, pose, keep)
        raise NoEquilibrium(
            f"no equilibrium in {s.most_iterations} Newton iterations, residual {state.size:.1e} of the force"
        )

    def _evaluate(self, u: np.ndarray, contact: Contact, pose: Pose, keep: bool) -> "_State":
        """Contact and residual at displacement u."""
        inner, smallest = self.solid.forces(u, self.shear, self.bulk)
        if smallest <= 0.0:
            return _State(u, contact, 0, np.zeros_like(u), np.inf, smallest)
        contact, changed = self._touch(u, contact, pose, keep)
        outer = contact_forces(contact, self.points, u, self.settings.stiffness)
        residual = np.where(self.solid.free[:, None], outer - inner, 0.0)
        size = float(np.linalg.norm(residual)) / max(float(np.linalg.norm(outer)), 1e-12)
        return _State(u, contact, changed, residual, size, smallest)

    def _newton_step(self, state: "_State", pose: Pose, keep: bool) -> "_State":
        """State after one step, by the first tangent that leads somewhere: from the exact one to one that is surely definite."""
        blocks = contact_blocks(state.contact, self.points, self.settings.stiffness)
        close = state.size <= self.settings.geometric_stiffness_below
        for geometric, regularisation in (EXACT if close else []) + DEFINITE:
            self.iterations += 1
            self.solid.linearise(state.u, self.shear, self.bulk, *blocks, geometric, regularisation)
            anew = self.fresh or state.size > FAR
            self.fresh = True  # for the next step, where this one's matrix cannot be factorised
            try:
                step = self.solid.step(state.residual, 0.0 if anew else float(np.clip(state.size, *LEFT)))
            except SolveFailed as error:
                raise NoEquilibrium(str(error)) from error
            self.fresh = False
            # a full tangent that inverts elements is not worth following at a crawl
            found = self._search(state, step, pose, keep, 8 if geometric == 0.0 else 3)
            if found is not None:
                return found
        raise NoEquilibrium("an element is inverted")

    def _search(self, state: "_State", step: np.ndarray, pose: Pose, keep: bool, tries: int) -> "_State | None":
        """State along a step, where the energy does not rise more steeply than it fell at the start; None if none.

        An indefinite tangent's step may lead uphill: it is taken only where it shrinks the residual.
        """
        slope, length, found = (state.residual * step).sum(), 1.0, None
        for _ in range(tries):
            trial = self._evaluate(state.u + length * step, state.contact, pose, keep)
            if trial.smallest <= 0.0:
                length /= 2
                continue
            if slope <= 0.0:
                return trial if trial.size < state.size else None
            found = trial
            now = (trial.residual * step).sum()
            if now > -slope:
                break
            length *= max(0.2, slope / (slope - now))
        return found

    def _touch(self, u: np.ndarray, contact: Contact, pose: Pose, keep: bool) -> tuple[Contact, int]:
        """Set of touching points for the next iteration, and how many points came or went.

        keep: none goes, so that a set that flickers comes to rest; `_release` lets go what pulls.
        """
        position = self.positions(u)
        gap, normal = gaps(self.scene, pose, position)
        stick = contact.state == STICK
        # a sliding point under drag stays until it opens; a new one starts where it penetrates
        near = ~stick & ((gap < 0.0) | (keep & (contact.state == SLIDE)))
        state = np.where(stick, STICK, np.where(near, SLIDE, FREE))
        target = np.where(stick[..., None], contact.target, position - gap[..., None] * normal)
        normal = np.where(stick[..., None], contact.normal, normal)
        drag = np.where(near[..., None], contact.drag, 0.0)
        return Contact(state, target, normal, drag), int((state != contact.state).sum())

    # -- the end of a step

    def _push(self) -> np.ndarray:
        """Pressure of touching points, MPa: positive where the indenter presses."""
        stretch = self.contact.target - self.positions(self.u)
        return (
            self.settings.stiffness * np.einsum("fqk,fqk->fq", stretch, self.contact.normal) * self.contact.touching
        )

    def _release(self, least: float = 0.0) -> int:
        """Release the touching points that pull by more than a share `least` of the largest pressure; how many."""
        push = self._push()
        gone = self.contact.touching & (push < -least * push.max(initial=0.0))
        self.contact = replace(self.contact, state=np.where(gone, FREE, self.contact.state))
        return int(gone.sum())

    def _stick_new(self, start: np.ndarray, before: np.ndarray, aim: np.ndarray, gap0: np.ndarray) -> None:
        """Release what pulls; new points stick where they first touched."""
        self._release()
        length = np.abs(aim - before).max()
        ahead, _ = gaps(self.scene, self.pose(aim), self.positions(start + length * self.velocity))
        ends = self.pose(before), self.pose(aim), self.positions(start), self.positions(self.u)
        self.stick(self.touching(), touch_places(*ends, gap0, ahead), self.pose(aim))

    def stick(self, points: np.ndarray, places: np.ndarray, pose: Pose) -> None:
        """Let points (f, q) of bool stick at places (f, q, 3) of the indenter's frame, moved onto its surface."""
        if not points.any():
            return
        self.stick_point[points], self.stick_normal[points] = on_surface(self.scene.indenter, places[points])
        self.contact = replace(self.contact, state=np.where(points, STICK, self.contact.state))
        self.contact = self._lead(pose)

    def _slide(self, pose: Pose) -> None:
        """Friction at the end of a step: what exceeds the law's limit slides under that drag."""
        stiffness = self.settings.stiffness
        self.stick(self.touching(), pose.to_indenter(self._carried()), pose)
        for _ in range(self.settings.friction_rounds):
            self._release()
            push = self._push()
            stretch = stiffness * (self.contact.target - self.positions(self.u))
            tangent = (
                stretch - np.einsum("fqk,fqk->fq", stretch, self.contact.normal)[..., None] * self.contact.normal
            )
            size = np.linalg.norm(tangent, axis=-1)
            over = self.sticking & (size > 1.01 * self._limit(push))
            slide = self.touching()
            direction = np.where(slide[..., None], self.contact.drag, tangent)
            length = np.maximum(np.linalg.norm(direction, axis=-1), 1e-12)
            drag = (self._limit(np.maximum(push, 0.0)) / length)[..., None] * direction
            drag = np.where((over | slide)[..., None], drag, 0.0)
            moved = np.abs(drag - self.contact.drag).sum() / max(np.abs(drag).sum(), 1e-12)
            state = np.where(over, SLIDE, self.contact.state)
            self.contact = replace(self.contact, state=state, drag=drag)
            self.u, self.contact = self.newton(self.u, self.contact, pose, self.settings.step_tolerance)
            if not over.any() and moved < 0.02:
                break

    def _limit(self, pressure: np.ndarray) -> np.ndarray:
        """Tangential traction (f, q) MPa at which points slip under a pressure (f, q) MPa."""
        return self.law.slip_limit(pressure, 1.0)[0]

    def _carried(self) -> np.ndarray:
        """Where sliding points would stick with penalties that carry their drag."""
        return self.positions(self.u) + self.contact.drag / self.settings.stiffness

    # -- the end of the path

    def unfolded(self, u: np.ndarray) -> np.ndarray:
        """u (n, 3), or as much of it as leaves every element some volume: hexahedra bend in places where tetrahedra do not."""
        for share in UNFOLDED:
            if self.solid.forces(share * u, self.shear, self.bulk)[1] > FLAT:
                return share * u
        raise NoEquilibrium("an element is inverted")

    def arrive(self, coarse_path: LoadPath) -> bool:
        """Points that a path on hexahedra brought into contact stick; what pulls is released. Whether that comes to rest."""
        pose = self.pose(self.at)
        touched, places = touches(coarse_path, self.points.position.reshape(-1, 3))
        places = places.reshape(self.stick_point.shape)
        self.stick(touched.reshape(self.contact.state.shape), places, pose)
        return iterate_arrival(self, places, pose, self.settings.contact_iterations)

    @property
    def sticking(self) -> np.ndarray:
        """Points (f, q) that stick, bool."""
        return self.contact.state == STICK

    def equilibrate(self, pose: Pose) -> None:
        """Equilibrium at a pose, close enough to show what pulls and what presses."""
        self.u, self.contact = self.newton(self.u, self.contact, pose, self.settings.arrival_tolerance)

    def touching(self) -> np.ndarray:
        """Points (f, q) that press and do not stick, bool."""
        return self.contact.state == SLIDE

    def release(self, pose: Pose) -> int:  # noqa: ARG002 (of `Arrival`)
        """Release the points that pull clearly; how many."""
        return self._release(self.settings.pull_tolerance)

    def iterate_contact(self) -> bool:
        """Equilibrium at the end of the path in which nothing pulls and nothing new penetrates."""
        s, pose = self.settings, self.pose(self.at)
        self.fresh = True  # from here on the contact hardly changes, and one factorisation serves to the end
        for _ in range(s.contact_iterations):
            self.rounds += 1
            for tolerance in (s.contact_tolerance, s.final_tolerance):
                self.u, self.contact = self.newton(self.u, self.contact, pose, tolerance)
                verdict = judge(self.scene, self.contact, self.points, self.u, s.stiffness)
                if verdict.pulling_fraction > s.pull_tolerance or verdict.penetration > s.penetration_mm:
                    self._release()
                    break
            else:
                return True
        return False
