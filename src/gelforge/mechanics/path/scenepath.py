"""Load path of one scene on one mesh: load steps, and updates of the contact set between them."""

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from gelforge.errors import SolveFailed
from gelforge.mechanics.contact.penalty import FREE, STICK, TOUCHING
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.hexmesh import HexMesh
from gelforge.mechanics.path.equilibrium import NOISY, NOISY_INTERPOLATED, PARTS, SHORT, Aim, Equilibrium, System
from gelforge.mechanics.path.loadpath import gaps, path_length, path_pose, slides
from gelforge.mechanics.path.pathsettings import PathSettings
from gelforge.mechanics.path.transfer import Anchors, LoadPath, anchored, carried, touches
from gelforge.mechanics.pose import Pose, on_surface, touch_fraction, touch_places
from gelforge.mechanics.result import NoEquilibrium
from gelforge.mechanics.scene import Scene
from gelforge.records.status import Status

BETWEEN = 2  # fewest load steps between two requested frames of a press
EASY = 7  # Newton iterations up to which a shortened step may grow again
SMALLEST_PART = 0.1  # smallest fraction of the pending contact changes that one solve carries out
REST = 0.3  # of a load step: if less than this remains of the leg, the step is extended to its end
AT_LIMIT = 0.999  # share of its limit from which on a tangential traction counts as slipping
ROUGHEST = 5e-3  # residual accepted at the start of a walk if its Newton iterations do not get lower
BEYOND = 1.001  # a slipping point's multiplier over its traction; at 1, rounding would decide which points stick
SLACK = 0.25  # of a load step by which the steps of a walk may be longer than those of a path
HOLDS, SETTLED = (
    8,
    2e-3,
)  # most held solves at the end of a path, and tangential force above the limit at which they end
ACCEPTED = 1e-7  # residual over contact force that balances contact force and base reaction to 1e-6


class StepControl:
    """Load step control: a step is halved if no equilibrium is found, and doubled again after easy steps.

    most_cuts: how often a step may be halved. easy: most Newton iterations of an easy step.
    """

    def __init__(self, most_cuts: int, easy: int) -> None:
        self.most_cuts, self.easy = most_cuts, easy
        self.cuts = 0

    def follow(self, start: float, stop: float, largest: float, advance: Callable[[float, float], int]) -> None:
        """Go from path parameter `start` to exactly `stop` in steps of `largest` at most.

        advance: called with the path parameter at the end of a step and the fraction of pending contact changes to
        carry out; returns the step's Newton iterations, or raises NoEquilibrium and changes nothing. NoEquilibrium
        of the shortest step is raised.
        """
        at, step, pending = start, largest, largest
        while stop - at > 1e-9:
            ahead = min(step, stop - at)
            last = stop - at - ahead < REST * ahead
            if last:
                ahead = stop - at
            aim = stop if last else at + ahead  # exactly `stop`, because states are looked up by it
            try:
                used = advance(aim, min(1.0, ahead / pending))
            except NoEquilibrium:
                self.cuts += 1
                pending, step = max(pending, ahead), 0.5 * ahead
                if step < largest / 2**self.most_cuts:
                    raise
                continue
            at, pending = aim, step
            if used <= self.easy:
                step = min(2.0 * step, largest)


@dataclass(frozen=True)
class Verdict:
    """Contact violations of a solved state.

    pulling_fraction: tensile force of touching points as a fraction of the normal force. penetration: largest depth
    of a free point inside the indenter, mm.
    """

    pulling_fraction: float
    penetration: float


class ScenePath(Equilibrium):
    """State of one scene on one mesh along its load path.

    After `follow` or `arrive`, u (n, 3), state (ContactState), tractions (those of the last equilibrium) and the
    counters describe the end of the path, or the last equilibrium before a failure, which `reason` explains.
    """

    def __init__(self, scene: Scene, settings: PathSettings, mesh: GelMesh, system: System) -> None:
        super().__init__(scene, settings, mesh, system)
        self.t, self.rounds, self.steps, self.reason = 0.0, 0, 0, ""
        self.pose_at: Callable[[float], Pose] = partial(path_pose, scene)
        self.control = StepControl(settings.max_cuts, EASY)
        self.history: list[tuple[float, np.ndarray]] = []
        self.curve: list[list[float]] = []
        self._states = [(0.0, self.u)]
        self._anchors: list[Anchors | None] = [None]

    # -- the path

    def follow(
        self, start: float, stops: Sequence[float] = (), at_stop: Callable[["ScenePath", Status], None] | None = None
    ) -> Status:
        """Follow the path from path parameter `start` (first touch) to its end; a load step ends at each of `stops`.

        at_stop: called at each stop with a copy of this run whose contact was iterated as at the end of a path; this
        run continues without those iterations.
        """
        self.t = start
        self._states, self._anchors = [(start, self.u)], [None]
        try:
            for end, count in self._legs(start):
                step = (end - self.t) / count
                for stop in (*(t for t in sorted(stops) if self.t < t < end), end):
                    longest = min(step, (stop - self.t) / BETWEEN) if stops else step
                    self.control.follow(self.t, stop, longest, self._advance)
                    if at_stop and stop in stops and stop < self.scene.press.end:
                        ended = self._branch()
                        at_stop(ended, ended._end())
        except (NoEquilibrium, SolveFailed) as error:
            return self._diverged(error)
        return self._end()

    def _end(self) -> Status:
        """Contact iterations at the end of a path or at one of its frames."""
        try:
            return self._iterate_contact()
        except (NoEquilibrium, SolveFailed) as error:
            return self._diverged(error)

    def _diverged(self, error: Exception) -> Status:
        self.reason = f"no equilibrium at path parameter {self.t:.3g}" + (f": {error}" if str(error) else "")
        return Status.DIVERGED

    def arrive(self, path: LoadPath) -> Status:
        """Equilibrium at the end of a path followed on coarser hexahedra, which may be the first part of a longer one.

        With friction, the last `walk_mm` are walked on this mesh.
        """
        self.t, self.noisy, self.crawls = self.scene.press.end, NOISY_INTERPOLATED, True
        pose = path_pose(self.scene, self.t)
        try:
            if self.law.frictional:
                return self._walk(path)
            self.u = carried(path, self.mesh, self.elements)
            if self.law.sticks:
                touched, places = touches(path, self.state.reference, self.settings.touched)
                self.stick(touched, places, pose)
                self._iterate_arrival(places, pose)
            else:
                self.solve_here(pose, Aim(self.settings.rough))
        except (NoEquilibrium, SolveFailed) as error:
            return self._diverged(error)
        return self._end()

    def _walk(self, path: LoadPath) -> Status:
        """The end of a path with friction: contact is taken over `walk_mm` before it, then the rest is walked.

        Points that slip on the coarse path begin with its traction and without elastic slip (share 0): the displacements of
        the two meshes differ by more than the elastic slip at the limit, so the difference would take most of them off the
        limit, and the force of a press straight down at mu = 0.2 would be 0.8 % too small. Not so a press that slides: its
        longer walk brings them back to the limit.

        A step of the walk is a load step of a path, as short as there, because points that touch within a step get their
        friction late, and because its slip has one direction: on tetrahedra one step of 0.1 to 0.3 mm leaves the sideways
        force of a sliding press 3 to 15 % too small, two steps of 0.1 mm are right to 1 %.
        """
        part = path.walk(self.settings.walk_mm)
        t, end = part.times[-1], path.times[-1]
        begin, last = part.pose(t), path_pose(self.scene, self.t)
        self.u = carried(part, self.mesh, self.elements)
        ahead = carried(path, self.mesh, self.elements) - self.u
        met, places, traction, slips = anchored(part, self.state.reference, self.settings.touched)
        later, touch = touches(path, self.state.reference, self.settings.touched)
        places[~met] = touch[~met]
        bound = met | later
        self.stick(bound, places, begin)
        slips &= bound & (not slides(self.scene, path.times[0]))
        known = met | slips
        self.state.carried[known] = traction[known]
        self.state.go(1.0)
        self.state.share[slips] = 0.0
        self.rounds += 1
        self.solve_here(begin, Aim(self.settings.rough, enough=ROUGHEST))
        self._slide(begin)
        # points that lost contact in the transfer's noise, or touch within the walk, keep the place of their first touch
        self.stick((bound & (self.state.status == FREE)) | self.touching(), places, begin)
        self.noisy, self.crawls = NOISY, False
        self.pose_at = lambda at: last if at >= end else path.pose(at)
        # the coarse motion over the walk, as if the last load step had been as long
        self.history = [(2.0 * t - end, self.u - ahead), (t, self.u)]
        for stop in ([1.0] if t < 1.0 < end else []) + [end]:
            way = path_length(path.scene, t, stop)
            longest = self.settings.shear_mm if stop > 1.0 else self.settings.press_mm
            self.t = t
            steps = max(1, math.ceil(way / longest - SLACK))
            self.control.follow(t, stop, (stop - t) / steps, lambda at, part: self._advance(at, part, at < end))
            t = stop
        self.t = self.scene.press.end
        self._polish(last)
        self._let_go()
        self.state.status[self.touching()] = TOUCHING
        return Status.OK

    def _let_go(self) -> None:
        """Free sticking points that do not press, under a law with friction."""
        pressed = np.zeros(len(self.state.status), bool)
        pressed[self.tractions.point[self.tractions.gap < 0.0]] = True
        gone = np.flatnonzero((self.state.status == STICK) & ~pressed)
        self.state.release(gone, np.zeros((len(gone), 3)))

    def _iterate_arrival(self, places: np.ndarray, pose: Pose) -> None:
        """Let each point stick and be released at most once, until no point pulls and all pressing points stick.

        places: (m, 3) where points stick, in the indenter's frame. A released point that presses again does not stick
        again, because it could alternate for ever.
        """
        stuck = self.state.status == STICK
        for _ in range(self.settings.settle_rounds):
            self.rounds += 1
            self.state.go(1.0)
            self.solve_here(pose, Aim(self.settings.rough))
            new = self.touching() & ~stuck
            stuck |= new
            released = self.release(pose)
            self.stick(new, places, pose)
            if not released and not new.any():
                return

    def touching(self) -> np.ndarray:
        """Points (m,) that press in the last equilibrium and do not stick, bool."""
        found = np.zeros(len(self.state.status), bool)
        found[self.tractions.point[self.tractions.gap < 0.0]] = True
        return found & (self.state.status != STICK)

    def _branch(self) -> "ScenePath":
        """A copy of this run that continues independently; both share mesh and factorisation."""
        other = copy.copy(self)
        other.state, other._states = copy.deepcopy(self.state), list(self._states)
        other.curve = list(self.curve)
        return other

    def _legs(self, start: float) -> list[tuple[float, int]]:
        legs = [(1.0, self.settings.press_steps)] if start < 1.0 else []
        if self.scene.press.end > 1.0 or start >= 1.0:
            legs.append((2.0, self.settings.shear_steps))
        return legs

    def _advance(self, t: float, part: float, onward: bool = True) -> int:
        """One load step to t with `part` of the pending contact changes; raises NoEquilibrium, changing nothing.

        onward: a further step follows, for which points that slipped are bound to where they are.
        """
        before, after = self.pose_at(self.t), self.pose_at(t)
        x = self.points(self.u)
        gap = gaps(self.scene, x, before)
        reach = 1.5 * np.linalg.norm(after.translation - before.translation) + self.settings.size
        self.candidates = np.flatnonzero((self.state.status != STICK) & (gap < reach))
        guess = self._predict(t)
        expected = self.points(self.u if guess is None else guess)
        kept, previous = self.state.snapshot(), (self.t, self.u)
        try:
            self.state.go(part)
            if self.law.frictional:
                self._meet(before, after, x, gap, expected)
            self.u, used = self.newton_from([self.u] if guess is None else [guess, self.u], after)
            total = self.state.weights[self.tractions.point] @ self.tractions.traction
            if onward:
                self._end_step(after, (x, before, gap, expected))
        except NoEquilibrium:
            self.state.restore(kept)
            self.u = previous[1]
            raise
        self.t = t
        self.steps += 1
        self.curve.append([float(t), *total.tolist()])
        self.history = [previous, (t, self.u)]
        self._states.append((t, self.u))
        self._anchors.append(self._bound() if self.law.frictional else None)
        return used

    def _bound(self) -> Anchors:
        """Points that stick or slip now, and where."""
        on, state = self.state.status == STICK, self.state
        slips = np.isin(np.flatnonzero(on), self.tractions.slip.point)
        return Anchors(state.reference[on], state.goal[on], state.carried[on], slips)

    def _meet(self, before: Pose, after: Pose, x: np.ndarray, gap: np.ndarray, expected: np.ndarray) -> None:
        """Give friction to points that are expected to touch within this step: for the rest of the step that is left.

        x, gap: positions (m, 3) and gaps (m,) at its start, expected: positions at its end.
        """
        near = self.candidates
        left = 1.0 - touch_fraction(gap[near], gaps(self.scene, expected[near], after))
        new, state = near[left > 0.0], self.state
        state.status[new] = STICK
        state.share[new] = left[left > 0.0]
        state.stick_point[new] = state.goal[new] = before.to_indenter(x[new])
        self.candidates = near[left <= 0.0]

    def _predict(self, t: float) -> np.ndarray | None:
        """Displacement at t, extrapolated from the last step; None where the path turns from press to shear."""
        if not self.history:
            return None
        (t0, u0), (t1, u1) = self.history
        if t1 <= 1.0 < t:
            return None
        return u1 + (t - t1) / (t1 - t0) * (u1 - u0)

    # -- the contact set at the end of a step

    def _end_step(self, pose: Pose, start: tuple[np.ndarray, Pose, np.ndarray, np.ndarray]) -> None:
        """Release points that pull; points that first touched in this step stick where they touched."""
        if not self.law.sticks:
            return
        if self.law.slips:
            self._slide(pose)
        else:
            self.release(pose)
        new = self.touching()
        self.stick(new, self._touch_places(new, pose, *start), pose)

    def _touch_places(
        self, new: np.ndarray, pose: Pose, x: np.ndarray, before: Pose, gap: np.ndarray, expected: np.ndarray
    ) -> np.ndarray:
        """Where the points `new` (m,) bool first touched, in the indenter's frame (m, 3)."""
        places = np.zeros_like(x)
        ahead = gaps(self.scene, expected[new], pose)
        places[new] = touch_places(before, pose, x[new], self.points(self.u)[new], gap[new], ahead)
        return places

    def stick(self, points: np.ndarray, places: np.ndarray, pose: Pose) -> None:
        """Let points (m,) bool stick; goals are `places` (m, 3) of the indenter's frame, moved onto its surface."""
        if not points.any():
            return
        state = self.state
        state.status[points] = STICK
        here, _ = on_surface(self.scene.indenter, pose.to_indenter(self.points(self.u)[points]))
        goal, state.normal[points] = on_surface(self.scene.indenter, places[points])
        state.stick_point[points], state.goal[points] = here, goal

    def _pressing(self, pose: Pose) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Index (p,), traction (p, 3) and normal component (p,) of sticking points; a negative one pulls.

        Empty with Coulomb friction and without friction: there only points inside the indenter have a traction, and
        it presses. So nothing pulls at the end of such a path, and nothing has to be released.
        """
        tractions, state = self.tractions, self.state
        stuck = (state.status[tractions.point] == STICK) & np.isnan(tractions.gap)
        point = tractions.point[stuck]
        push = np.einsum("pi,pi->p", tractions.traction[stuck], pose.turn(state.normal[point]))
        return point, tractions.traction[stuck], push

    def release(self, pose: Pose) -> int:
        """Release points that pull; their traction fades with the next contact changes. Returns their number."""
        point, traction, push = self._pressing(pose)
        gone = push < -self.settings.pull_tolerance * push.max(initial=0.0)
        self.state.release(point[gone], traction[gone])
        return int(gone.sum())

    # -- friction

    def _slide(self, pose: Pose) -> None:
        """Move stick points along with slip, set multipliers to tractions, and release points that lost contact."""
        state, tractions = self.state, self.tractions
        self._let_go()
        at = np.flatnonzero((state.status[tractions.point] == STICK) & (tractions.gap < 0.0))
        point = tractions.point[at]
        places = pose.to_indenter(self.points(self.u)[point])
        _, normal = self.scene.indenter.distance(places)
        n = pose.turn(normal)
        traction = tractions.traction[at]
        state.carried[point] = traction - np.einsum("pi,pi->p", traction, n)[:, None] * n
        new = np.flatnonzero(state.share[point] < 1.0)
        begin = state.stick_point[point[new]]
        touch = begin + (1.0 - state.share[point[new], None]) * (places[new] - begin)
        touch, state.normal[point[new]] = on_surface(self.scene.indenter, touch)
        state.stick_point[point[new]] = state.goal[point[new]] = touch
        state.share[point] = 1.0
        slips = np.isin(point, tractions.slip.point)
        moved = point[slips]
        state.stick_point[moved], state.normal[moved] = on_surface(self.scene.indenter, places[slips])
        state.carried[moved] *= BEYOND
        state.goal[moved], state.multiplier[moved] = state.stick_point[moved], state.carried[moved]

    # -- the end of the path

    def _iterate_contact(self) -> Status:
        """Release points until none pulls at the end of the path, then solve to the final tolerance."""
        pose = path_pose(self.scene, self.t)
        status = Status.UNSETTLED
        for _ in range(self.settings.settle_rounds):
            self._carry_out(pose)
            self.rounds += 1
            if not self.release(pose):
                status = Status.OK
                break
        if self.law.frictional:
            self._slide(pose)
        self._carry_out(pose)
        self._polish(pose)
        if status is Status.OK:
            self._release_in_balance(pose)
        self.state.status[self.touching()] = TOUCHING
        return status

    def _release_in_balance(self, pose: Pose) -> None:
        """Release points that pull only in the tight equilibrium, as long as an equilibrium without them exists.

        A few points released at the edge of contact change the residual by less than the path's tolerance, so their
        neighbours start to pull only once it is solved tightly.
        """
        for _ in range(self.settings.settle_rounds):
            kept, u = self.state.snapshot(), self.u
            if not self.release(pose):
                return
            self.rounds += 1
            try:
                self._carry_out(pose)
                self._polish(pose)
            except NoEquilibrium:
                self.state.restore(kept)
                self.u = u
                self._polish(pose)
                return

    def _carry_out(self, pose: Pose) -> None:
        """Carry out all pending contact changes at a fixed pose, in smaller parts if one fails."""
        left, share = 1.0, 1.0
        while left > 0.0:
            share = min(share, left)
            kept = self.state.snapshot()
            try:
                self.state.go(share / left)
                self.solve_here(pose, self.within_path)
                left -= share
            except NoEquilibrium:
                self.state.restore(kept)
                share *= 0.5
                if share < SMALLEST_PART:
                    raise

    def _polish(self, pose: Pose) -> None:
        """Equilibrium to the final tolerance.

        Under a law with friction, points close to their limit may flip between slip and stick for ever. Then all points
        are held at the tractions that the law gives them here, which is a smooth problem, and the law is asked again,
        until the tractions found obey it to SETTLED.
        """
        final = self.settings.final_tolerance
        if not self.law.frictional:
            self._polish_still(pose, final)
            return
        try:
            self.solve_here(pose, Aim(final, still=True))
            return
        except NoEquilibrium:
            pass
        for _ in range(HOLDS):
            self.rounds += 1
            _, self.tractions = self._out_of_balance(self.u, pose, self.penalty)
            self._slide(pose)
            self.state.go(1.0)
            self.solve_here(pose, Aim(max(final, ACCEPTED), held=True))
            if self.friction()["beyond_cone"] <= SETTLED:
                break

    def _polish_still(self, pose: Pose, final: float) -> None:
        """Equilibrium to the final tolerance under a law without friction; larger residuals are a last resort."""
        for parts in (PARTS, SHORT):
            for tolerance, still in ((final, True), (max(final, ACCEPTED), False)):
                try:
                    return self.solve_here(pose, Aim(tolerance, still, parts=parts))
                except NoEquilibrium:
                    continue
        raise NoEquilibrium

    # -- diagnostics

    def path(self, size: float) -> LoadPath:
        """All load steps so far; the last one is the current state. size: of the hexahedra under the press, mm."""
        if not isinstance(self.mesh, HexMesh):
            raise TypeError("only a path on hexahedra is carried to another mesh")
        times, states = [t for t, _ in self._states], [*(u for _, u in self._states[:-1]), self.u]
        return LoadPath(self.scene, self.mesh, times, states, size, self._anchors)

    def checks(self, forces: np.ndarray) -> dict:
        """Penetration, tensile contact force and balance of the final state; forces: (n, 3) N, of the contact."""
        pose, total = path_pose(self.scene, self.t), forces.sum(axis=0)
        point, _, push = self._pressing(pose)
        size = max(float(np.linalg.norm(total)), 1e-300)
        base = self.internal(self.u)[self.mesh.base].sum(axis=0)
        gap = gaps(self.scene, self.points(self.u), pose)
        return {
            "penetration_mm": float(max(0.0, -gap.min(initial=0.0))),
            "below_base_mm": self._below_base(),
            "pulling_fraction": float(self.state.weights[point] @ np.maximum(-push, 0.0)) / size,
            "base_mismatch": float(np.linalg.norm(base + total)) / size,
        }

    def friction(self) -> dict:
        """Evidence of the final state under a law with friction; empty under others.

        slipping: share of the contact's normal force in points at the limit. beyond_cone: tangential force above the
        limit, over the normal force. friction_n: resultant of the tangential tractions of slipping points, N, which
        grows in proportion to the coefficient while the same points slip.
        """
        if not self.law.frictional:
            return {}
        pose, tractions = path_pose(self.scene, self.t), self.tractions
        bound = np.flatnonzero((self.state.status[tractions.point] == STICK) & (tractions.gap < 0.0))
        point, traction = tractions.point[bound], tractions.traction[bound]
        _, normal = self.scene.indenter.distance(pose.to_indenter(self.points(self.u)[point]))
        n, weight = pose.turn(normal), self.state.weights[point]
        along = traction - np.einsum("pi,pi->p", traction, n)[:, None] * n
        depth = -tractions.gap[bound]
        limit, _ = self.law.slip_limit(depth, self.penalty.normal)
        size, push = np.linalg.norm(along, axis=1), weight * depth * self.penalty.normal
        whole, slips = max(float(push.sum()), 1e-300), size > AT_LIMIT * limit
        return {
            "slipping": float(push[slips].sum()) / whole,
            "beyond_cone": float(weight @ np.maximum(size - limit, 0.0)) / whole,
            "friction_n": float(np.linalg.norm(weight[slips] @ along[slips])),
        }

    def judge(self, u: np.ndarray) -> Verdict:
        """Pulling force and penetration at displacements u (n, 3) mm that another solver found for this contact."""
        state, pose, x = self.state, path_pose(self.scene, self.t), self.points(u)
        gap = gaps(self.scene, x, pose)
        held = (state.status == STICK) & (not self.law.slips)
        push = np.where(state.status == FREE, 0.0, -self.penalty.normal * gap)
        stretch = pose.to_gel(state.stick_point[held]) - x[held]
        push[held] = self.penalty.normal * np.einsum("pi,pi->p", stretch, pose.turn(state.normal[held]))
        force = push * state.weights
        pull = float(-force[force < 0.0].sum())
        penetration = float(max(0.0, -gap[state.status == FREE].min(initial=0.0)))
        return Verdict(pull / max(float(abs(force.sum())), 1e-12), penetration)

    def _below_base(self) -> float:
        """Largest depth of a node below the bonded base, mm, within its outline: beside it, the flanks may sag."""
        gel, x = self.scene.gel, self.mesh.nodes + self.u
        over = (np.abs(x[:, 0]) < gel.width / 2) & (np.abs(x[:, 1]) < gel.length / 2)
        return float(max(0.0, -gel.height - x[over, 2].min(initial=np.inf)))

    def record(self) -> None:
        """Write final positions and tractions into the contact state."""
        self.state.position = self.points(self.u)
        self.state.traction = np.zeros_like(self.state.position)
        if self.tractions is not None:
            np.add.at(self.state.traction, self.tractions.point, self.tractions.traction)
