"""Contact at the face points of a tetrahedral gel: what touches, what sticks where, and how a state is judged."""

from dataclasses import dataclass

import numpy as np

from gelforge.mechanics.contact.facepoints import FacePoints
from gelforge.mechanics.pose import Pose
from gelforge.mechanics.scene import Scene

FREE, SLIDE, STICK = 0, 1, 2
_A, _B = np.triu_indices(6)


@dataclass
class Contact:
    """Contact state of q points on each of f faces.

    state: FREE, SLIDE (on the surface, dragged by `drag`) or STICK (bound to `target`).
    target: (f, q, 3) mm, on the indenter. normal: (f, q, 3) the indenter's outward normal there.
    drag: (f, q, 3) MPa of undeformed area, tangential traction on a sliding point.
    """

    state: np.ndarray
    target: np.ndarray
    normal: np.ndarray
    drag: np.ndarray

    @property
    def touching(self) -> np.ndarray:
        """(f, q) bool, the points in contact."""
        return self.state != FREE


def end_pose(scene: Scene) -> Pose:
    """Where the indenter stands at the end of the path."""
    return Pose(*scene.press.pose(1.0, 1.0))


def gaps(scene: Scene, pose: Pose, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signed distance (f, q) mm to the indenter and its outward normal (f, q, 3) at points (f, q, 3)."""
    distance, normal = scene.indenter.distance(pose.to_indenter(points.reshape(-1, 3)))
    return distance.reshape(points.shape[:2]), pose.turn(normal).reshape(points.shape)


@dataclass(frozen=True)
class Verdict:
    """What is wrong with a solved state.

    pulling_fraction: what touching points pull, as a share of the normal force. penetration: how deep a free point lies in the
    indenter, mm.
    """

    pulling_fraction: float
    penetration: float


def judge(scene: Scene, contact: Contact, points: FacePoints, displacement: np.ndarray, stiffness: float) -> Verdict:
    """Read the pressure of every touching point and the gap of every free one off a displacement field (n, 3) mm.

    stiffness: contact penalty, N/mm^3.
    """
    position = points.position + points.at(displacement)
    gap, _ = gaps(scene, end_pose(scene), position)
    push = stiffness * np.einsum("fqk,fqk->fq", contact.target - position, contact.normal) * contact.touching
    force = np.abs((push * points.weight).sum())
    pull = float(-(push * points.weight)[contact.touching & (push < 0)].sum())
    return Verdict(float(pull / max(force, 1e-12)), float(max(0.0, -gap[~contact.touching].min(initial=0.0))))


def contact_forces(contact: Contact, points: FacePoints, u: np.ndarray, stiffness: float) -> np.ndarray:
    """Nodal forces (n, 3) N of the penalties and drags of touching points on the gel."""
    faces = np.flatnonzero(contact.touching.any(axis=1))
    nodes, state, normal = points.faces[faces], contact.state[faces], contact.normal[faces]
    position = points.position[faces] + np.einsum("qa,fak->fqk", points.shape, u[nodes])
    stretch = contact.target[faces] - position
    along = np.einsum("fqk,fqk->fq", stretch, normal)[..., None] * normal
    stick, slide = (state == STICK)[..., None], (state == SLIDE)[..., None]
    traction = stiffness * (stick * stretch + slide * along) + slide * contact.drag[faces]
    forces = np.zeros_like(u)
    np.add.at(forces, nodes, np.einsum("qa,fqk->fak", points.shape, traction * points.weight[faces][..., None]))
    return forces


def contact_blocks(contact: Contact, points: FacePoints, stiffness: float) -> tuple[np.ndarray, np.ndarray]:
    """Touched faces (f,) of the mesh and their stiffness on node pairs a <= b, (f, 21, 3, 3) N/mm."""
    faces = np.flatnonzero(contact.touching.any(axis=1))
    state, weight = contact.state[faces], points.weight[faces] * stiffness
    pairs = points.shape[:, _A] * points.shape[:, _B]
    blocks = np.einsum("fq,qp->fp", weight * (state == STICK), pairs)[..., None, None] * np.eye(3)
    n = contact.normal[faces]
    outer = n[..., :, None] * n[..., None, :] * (weight * (state == SLIDE))[..., None, None]
    return points.index[faces], blocks + np.einsum("qp,fqij->fpij", pairs, outer)
