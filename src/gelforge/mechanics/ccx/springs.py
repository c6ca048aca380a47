"""Contact of the face points as CalculiX takes it: rows of springs, and loads of what slides."""

from typing import Any

import numpy as np

from gelforge.mechanics.ccx.deck import Rows
from gelforge.mechanics.tet.face import FacePoints
from gelforge.mechanics.tet.facecontact import SLIDE, STICK, Contact


def spring_rows(contact: Contact, points: FacePoints, stiffness: float) -> Rows:
    """Springs of `stiffness` (N/mm^3) times each held point's area, as few rows as the faces' shape allows.

    Springs at k points of a face have the energy K/2 |A u - b|^2 with A (k, unknowns of the face).
    With A = QR that is K/2 |R u - Q'b|^2 and a constant, so a face never needs more rows than it has
    unknowns: 6 per axis where points stick, 18 where they slide, however fine the rule.
    """
    row, node, axis, coefficient, target = [], [], [], [], []
    count = 0
    for face in np.flatnonzero(contact.held.any(axis=1)):
        nodes = points.faces[face]
        root = np.sqrt(points.weight[face])
        goal = contact.target[face] - points.position[face]
        for kind in (STICK, SLIDE):
            q = np.flatnonzero(contact.state[face] == kind)
            if not len(q):
                continue
            if kind == STICK:
                # three axes share R: their rows are kept together, three to a helper node
                basis, small = np.linalg.qr(root[q, None] * points.shape[q])
                aims = basis.T @ (root[q, None] * goal[q])
                full = np.einsum("ja,ik->jiak", small, np.eye(3)).reshape(-1, 18)
                aims = aims.reshape(-1)
            else:
                normal = contact.normal[face, q]
                full = (root[q, None] * points.shape[q])[:, :, None] * normal[:, None, :]
                basis, full = np.linalg.qr(full.reshape(len(q), 18))
                aims = basis.T @ (root[q] * np.einsum("qk,qk->q", normal, goal[q]))
            j, term = np.nonzero(full)
            row.append(count + j)
            node.append(nodes[term // 3])
            axis.append(term % 3)
            coefficient.append(full[j, term])
            target.append(aims)
            count += len(aims)
    join: list[Any] = [np.concatenate(x) if x else np.empty(0) for x in (row, node, axis, coefficient, target)]
    parts: Any = (*(x.astype(int) for x in join[:3]), join[3], join[4], stiffness)
    return Rows(*parts)


def drag_loads(contact: Contact, points: FacePoints, nodes: int) -> np.ndarray:
    """Nodal forces (nodes, 3) N of the tangential tractions of sliding points."""
    loads = np.zeros((nodes, 3))
    dragged = np.where((contact.state == SLIDE)[..., None], contact.drag, 0.0) * points.weight[..., None]
    np.add.at(loads, points.faces, np.einsum("qa,fqk->fak", points.shape, dragged))
    return loads
