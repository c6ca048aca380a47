"""Penalty contact between a rigid indenter and a gel surface, at integration points of the surface faces.

Within a load step, points that touch for the first time feel a normal penalty only; points that touched
earlier stick to a point that travels with the indenter. A step is thus a smooth problem apart from new
touches. A law with friction limits the tangential traction of sticking points by the pressure of the
same iterate (return mapping).
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import njit

from gelforge.geometry.solids import Indenter
from gelforge.mechanics.contact.facerule import face_rule
from gelforge.mechanics.contact.law import ContactLaw
from gelforge.mechanics.linear.pattern import Pattern, add_block, block_places
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.pose import Pose

FREE, TOUCHING, STICK = 0, 1, 2
STEP = 1e-6  # mm, finite-difference step of `curved`
_CHANGING = ("status", "stick_point", "normal", "goal", "fading", "multiplier", "carried", "share")


@dataclass
class ContactState:
    """Contact at m points of the surface; positions in mm, tractions in MPa of undeformed area.

    face: (m,) index into mesh.faces. shape: (m, k) weights of the face's nodes. reference: (m, 3)
    undeformed position. weights: (m,) mm^2. status: (m,) FREE, TOUCHING or STICK.
    stick_point: (m, 3) point of the indenter's frame that a sticking point is bound to (nan elsewhere).
    normal: (m, 3) the indenter's outward normal there, in its frame.
    position: (m, 3) deformed. traction: (m, 3) on the gel.
    multiplier: (m, 3) tangential traction of sticking points at zero elastic slip (laws with friction only).
    goal, carried: (m, 3) values that stick_point and multiplier approach as pending changes are carried out;
    fading: (m, 3) remaining traction of released points (at the end of a path nothing is pending).
    share: (m,) part of a load step that is left after a point first touched in it; 1 for points that touched before, 0
    for points that slip where a walk begins: their tangential traction is the multiplier (laws with friction only).
    """

    face: np.ndarray
    shape: np.ndarray
    reference: np.ndarray
    weights: np.ndarray
    status: np.ndarray
    stick_point: np.ndarray
    normal: np.ndarray
    goal: np.ndarray
    fading: np.ndarray
    multiplier: np.ndarray
    carried: np.ndarray
    share: np.ndarray
    position: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    traction: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))

    def snapshot(self) -> dict:
        """Copies of all arrays that change along a path, for `restore`."""
        return {name: getattr(self, name).copy() for name in _CHANGING}

    def restore(self, kept: dict) -> None:
        """Return to a snapshot."""
        for name, array in kept.items():
            setattr(self, name, array.copy())

    def go(self, part: float) -> None:
        """Carry out `part` (0 to 1) of the pending changes."""
        moving = self.status == STICK
        self.stick_point[moving] += part * (self.goal[moving] - self.stick_point[moving])
        self.multiplier += part * (self.carried - self.multiplier)
        self.fading *= 1.0 - part

    def release(self, points: np.ndarray, traction: np.ndarray) -> None:
        """Free sticking points; their traction fades as changes are carried out."""
        self.status[points] = FREE
        self.stick_point[points] = self.goal[points] = np.nan
        self.multiplier[points] = self.carried[points] = 0.0
        self.share[points] = 1.0
        self.fading[points] = traction


def contact_points(mesh: GelMesh, order: int, faces: np.ndarray | None = None) -> ContactState:
    """Integration points of `face_rule`, all FREE, on the chosen faces of a mesh (all by default)."""
    faces = np.arange(len(mesh.faces)) if faces is None else faces
    shape, slope, weight = face_rule(mesh.faces.shape[1], order)
    corners = mesh.nodes[mesh.faces[faces]]
    reference = np.einsum("ga,fai->fgi", shape, corners)
    tangents = np.einsum("gas,fai->fgsi", slope, corners)
    area = np.linalg.norm(np.cross(tangents[:, :, 0], tangents[:, :, 1]), axis=2) * weight
    m = area.size
    return ContactState(
        face=np.repeat(faces, len(weight)),
        shape=np.tile(shape, (len(faces), 1)),
        reference=reference.reshape(-1, 3),
        weights=area.ravel(),
        status=np.zeros(m, np.int8),
        stick_point=np.full((m, 3), np.nan),
        normal=np.full((m, 3), np.nan),
        goal=np.full((m, 3), np.nan),
        fading=np.zeros((m, 3)),
        multiplier=np.zeros((m, 3)),
        carried=np.zeros((m, 3)),
        share=np.ones(m),
    )


@dataclass(frozen=True)
class Skew:
    """Non-symmetric part of the contact stiffness: point (s,) index, block (s, 3, 3) MPa/mm."""

    point: np.ndarray
    block: np.ndarray


@dataclass(frozen=True)
class Tractions:
    """Tractions of the points in contact, linearised: point (p,) index, traction (p, 3), stiffness (p, 3, 3).

    gap: (p,) signed distance where known (nan for points of a law without slip that stick). stiffness is
    symmetric; the dependence of friction on pressure is in `slip`.
    """

    point: np.ndarray
    traction: np.ndarray
    stiffness: np.ndarray
    gap: np.ndarray
    slip: Skew


@dataclass(frozen=True)
class Penalty:
    """A contact law with its stiffness, MPa per mm of gap (normal) and of elastic slip (tangential)."""

    normal: float
    tangential: float
    law: ContactLaw


# Tractions of some points: index (p,), traction (p, 3), stiffness (p, 3, 3), gap (p,).
_Parts = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def penalty_tractions(
    state: ContactState, x: np.ndarray, pose: Pose, indenter: Indenter, penalty: Penalty, candidates: np.ndarray
) -> Tractions:
    """Penalty tractions at deformed positions x (m, 3); `candidates` (c,) are the free points within reach."""
    sticking = np.flatnonzero(state.status == STICK)
    stuck, sliding = (sticking[:0], sticking) if penalty.law.slips else (sticking, sticking[:0])
    parts = [_stuck(state, x, pose, penalty.normal, stuck), _faded(state)]
    probe, slip = np.concatenate([sliding, candidates]), Skew(sticking[:0], np.empty((0, 3, 3)))
    if len(probe):
        distance, normal = indenter.distance(pose.to_indenter(x[probe]))
        inside = distance < 0.0
        pressed, slip = _pressed(state, x, pose, penalty, probe[inside], distance[inside], normal[inside])
        parts.append(pressed)
    joined: Any = (*(np.concatenate(arrays) for arrays in zip(*parts)), slip)
    return Tractions(*joined)


def curved(
    tractions: Tractions,
    state: ContactState,
    x: np.ndarray,
    pose: Pose,
    indenter: Indenter,
    penalty: Penalty,
    candidates: np.ndarray,
) -> Skew:
    """Exact stiffness less that of `tractions`: friction and indenter curvature, by differences over STEP mm."""
    point = tractions.point
    here = _scattered(tractions, len(x))
    block = np.empty((len(x), 3, 3))
    for k in range(3):
        ahead = penalty_tractions(state, x + STEP * np.eye(3)[k], pose, indenter, penalty, candidates)
        block[:, :, k] = (here - _scattered(ahead, len(x))) / STEP
    known = np.zeros_like(block)
    np.add.at(known, point, tractions.stiffness)
    point = np.unique(point)
    return Skew(point, (block - known)[point])


def _scattered(tractions: Tractions, count: int) -> np.ndarray:
    traction = np.zeros((count, 3))
    np.add.at(traction, tractions.point, tractions.traction)
    return traction


def _stuck(state: ContactState, x: np.ndarray, pose: Pose, stiffness: float, points: np.ndarray) -> _Parts:
    """Penalty in all directions towards the stick points."""
    traction = stiffness * (pose.to_gel(state.stick_point[points]) - x[points])
    block = np.broadcast_to(stiffness * np.eye(3), (len(points), 3, 3))
    return points, traction, block, np.full(len(points), np.nan)


def _faded(state: ContactState) -> _Parts:
    """Dead loads: the fading tractions of released points."""
    points = np.flatnonzero(np.any(state.fading, axis=1))
    return points, state.fading[points], np.zeros((len(points), 3, 3)), np.full(len(points), np.nan)


def _pressed(
    state: ContactState,
    x: np.ndarray,
    pose: Pose,
    penalty: Penalty,
    points: np.ndarray,
    distance: np.ndarray,
    normal: np.ndarray,
) -> tuple[_Parts, Skew]:
    """Normal penalty, and for sticking points a tangential one that yields at the law's limit.

    The stiffness leaves out the indenter's curvature (see `curved`): far from equilibrium it costs more
    iterations than it saves, because curvature jumps at filleted edges.
    """
    n = pose.turn(normal)
    stiffness = penalty.normal * n[:, :, None] * n[:, None, :]
    traction = -penalty.normal * distance[:, None] * n
    sticking = np.flatnonzero(state.status[points] == STICK)
    friction, slope, slip = _friction(state, x, pose, penalty, points[sticking], distance[sticking], n[sticking])
    traction[sticking] += friction
    stiffness[sticking] += slope
    return (points, traction, stiffness, distance), slip


def _friction(
    state: ContactState,
    x: np.ndarray,
    pose: Pose,
    penalty: Penalty,
    points: np.ndarray,
    distance: np.ndarray,
    n: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, Skew]:
    """Tangential traction of a penalty that yields at the law's limit, its symmetric tangent, and its slip part.

    Augmented Lagrangian (Simo, Laursen 1992, Comput. Struct. 42, 97-116): multipliers take over the traction of
    the penalties, so sticking points end where they touched, however soft the penalties are. Return mapping:
    Wriggers, Computational Contact Mechanics (2006), section 6.3.2; its tangent, section 9.2: along the slip
    the traction follows the limit.
    """
    elastic = penalty.tangential * state.share[points]
    trial = state.multiplier[points] + elastic[:, None] * (pose.to_gel(state.stick_point[points]) - x[points])
    trial -= np.einsum("pi,pi->p", trial, n)[:, None] * n
    length = np.maximum(np.linalg.norm(trial, axis=1), 1e-12 * penalty.tangential)
    limit, rise = penalty.law.slip_limit(-distance, penalty.normal)
    slips = length > limit
    scale = np.where(slips, limit / length, 1.0)
    along = trial / length[:, None]
    slope = np.eye(3) - n[:, :, None] * n[:, None, :]
    slope -= slips[:, None, None] * along[:, :, None] * along[:, None, :]
    slip = Skew(points[slips], rise[slips, None, None] * along[slips, :, None] * n[slips, None, :])
    return scale[:, None] * trial, (elastic * scale)[:, None, None] * slope, slip


class FacePlaces:
    """Positions in the matrix of the contact stiffness of every surface face."""

    def __init__(self, mesh: GelMesh, pattern: Pattern):
        self.nodes = np.ascontiguousarray(mesh.faces, np.int32)
        self.rows = np.ascontiguousarray(pattern.first_row[mesh.faces], np.int64)
        self.base, self.width = block_places(pattern, mesh.faces)

    def add_forces(self, state: ContactState, tractions: Tractions, forces: np.ndarray) -> None:
        """Subtract contact forces from `forces` (n, 3)."""
        points = tractions.point
        nodes = self.nodes[state.face[points]]
        _add_forces(nodes, state.shape[points], state.weights[points], tractions.traction, forces)

    def add_stiffness(self, state: ContactState, tractions: Tractions, values: np.ndarray) -> None:
        """Add the contact stiffness to the matrix values."""
        points = tractions.point
        face = state.face[points]
        stiffness = np.ascontiguousarray(tractions.stiffness)
        _add_stiffness(
            self.base[face], self.width[face], state.shape[points], state.weights[points], stiffness, values
        )

    def skew_product(self, state: ContactState, skew: Skew) -> Callable[[np.ndarray, np.ndarray], None]:
        """Return a function that adds the matrix of `skew` times x (unknowns,) to y (unknowns,)."""
        rows = self.rows[state.face[skew.point]]
        shape, block = state.shape[skew.point], skew.block * state.weights[skew.point, None, None]
        return lambda x, y: _add_skew(rows, shape, block, x, y)


@njit(cache=True, nogil=True)
def _add_skew(rows: np.ndarray, shape: np.ndarray, block: np.ndarray, x: np.ndarray, y: np.ndarray) -> None:
    moved = np.empty(3)
    for p in range(len(shape)):
        moved[:] = 0.0
        for a in range(shape.shape[1]):
            if rows[p, a] >= 0:
                for i in range(3):
                    moved[i] += shape[p, a] * x[rows[p, a] + i]
        for a in range(shape.shape[1]):
            if rows[p, a] >= 0:
                for i in range(3):
                    for k in range(3):
                        y[rows[p, a] + i] += shape[p, a] * block[p, i, k] * moved[k]


@njit(cache=True, nogil=True)
def _add_forces(
    nodes: np.ndarray, shape: np.ndarray, weights: np.ndarray, traction: np.ndarray, forces: np.ndarray
) -> None:
    for p in range(len(weights)):
        for a in range(shape.shape[1]):
            factor = shape[p, a] * weights[p]
            for i in range(3):
                forces[nodes[p, a], i] -= factor * traction[p, i]


@njit(cache=True, nogil=True)
def _add_stiffness(
    base: np.ndarray,
    width: np.ndarray,
    shape: np.ndarray,
    weights: np.ndarray,
    stiffness: np.ndarray,
    values: np.ndarray,
) -> None:
    block = np.empty((3, 3))
    for p in range(len(weights)):
        pair = 0
        for a in range(shape.shape[1]):
            for b in range(a, shape.shape[1]):
                factor = shape[p, a] * shape[p, b] * weights[p]
                for i in range(3):
                    for k in range(3):
                        block[i, k] = factor * stiffness[p, i, k]
                add_block(values, base[p, pair], width[p, pair], block, a == b)
                pair += 1


@njit(cache=True, nogil=True)
def positions(shape: np.ndarray, nodes: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Interpolated points (m, 3) from shape (m, k), nodes (m, k) and nodal positions x (n, 3)."""
    out = np.empty((len(shape), 3))
    for p in range(len(shape)):
        for i in range(3):
            total = 0.0
            for a in range(shape.shape[1]):
                total += shape[p, a] * x[nodes[p, a], i]
            out[p, i] = total
    return out
