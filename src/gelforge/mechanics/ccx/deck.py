"""Input decks for CalculiX: one press and its mesh in one file, without contact or with CalculiX' own."""

from collections.abc import Sequence

import numpy as np

from gelforge.mechanics.material import REFERENCE_C10, Material
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.tetmesh import FACES

MATERIAL_NAME = "GEL"
# CalculiX' linear solvers. From the in-process state, which is near the solution, conjugate gradients cost a third of
# a factorisation with its ordering; from zero displacement only factorisation is reliable.
DIRECT, ITERATIVE = "SPOOLES", "ITERATIVE SCALING"
# Format of displacements. Conjugate gradients stop at a fraction of their initial residual. Rounding to eight digits
# makes it rough, and it vanishes in half the iterations of the smooth residual that Newton's method leaves.
PLACE = ".7e"
INCREMENT = 0.25  # first load increment if a start from the in-process state fails
# Attempts, in turn: whether to start from the in-process displacements, the first load increment, the linear solver.
ATTEMPTS = ((True, 1.0, ITERATIVE), (True, 1.0, DIRECT), (False, INCREMENT, DIRECT), (False, INCREMENT / 10, DIRECT))


def mesh_lines(mesh: GelMesh) -> list[str]:
    """Nodes, elements and node sets of a C3D10 mesh, one-based as in CalculiX."""
    lines = ["*NODE, NSET=NALL"]
    lines += [f"{i},{x:.9e},{y:.9e},{z:.9e}" for i, (x, y, z) in enumerate(mesh.nodes.tolist(), 1)]
    lines.append("*ELEMENT, TYPE=C3D10, ELSET=EGEL")
    lines += [",".join(map(str, [i, *e])) for i, e in enumerate((mesh.elements + 1).tolist(), 1)]
    lines.append("*NSET, NSET=NBASE")
    lines += [str(i + 1) for i in mesh.base.tolist()]
    lines.append("*NSET, NSET=NTOP")
    lines += [str(i + 1) for i in mesh.surface_nodes.tolist()]
    lines.append(f"*SOLID SECTION, ELSET=EGEL, MATERIAL={MATERIAL_NAME}")
    return lines


def material_lines(material: Material) -> list[str]:
    """Neo-Hookean material with REFERENCE_C10 and the given Poisson's ratio (CalculiX manual, *HYPERELASTIC)."""
    return [
        f"*MATERIAL, NAME={MATERIAL_NAME}",
        "*HYPERELASTIC, NEO HOOKE",
        f"{REFERENCE_C10:.12g},{material.d1:.12g}",
    ]


def start_lines(start: np.ndarray) -> list[str]:
    """The displacement (n, 3) mm from which Newton's method starts."""
    lines = ["*INITIAL CONDITIONS, TYPE=DISPLACEMENT"]
    for i, u in enumerate(start.tolist(), 1):
        lines += [f"{i},1,{u[0]:{PLACE}}", f"{i},2,{u[1]:{PLACE}}", f"{i},3,{u[2]:{PLACE}}"]
    return lines


def press_deck(
    mesh: GelMesh, prescribed: np.ndarray, start: np.ndarray, nu: float, attempt: int, residual: float
) -> str:
    """Deck of one equilibrium without contact.

    prescribed: (k,) nodes, zero-based, moved to their displacements in `start` (n, 3) mm. nu: Poisson's ratio.
    attempt: index into ATTEMPTS. residual: largest nodal residual over the mean nodal force. The deck prints U and RF
    of the top's nodes, RF of the base, and U of all nodes. RF of a prescribed node is the force that holds it.
    """
    from_start, increment, solver = ATTEMPTS[attempt]
    lines = [*mesh_lines(mesh), *material_lines(Material(nu)), "*BOUNDARY", "NBASE,1,3"]
    if from_start:
        lines += start_lines(start)
    lines += ["*STEP, NLGEOM, INC=200", f"*STATIC, SOLVER={solver}", f"{increment:.6g},1.,1e-4,1."]
    lines += ["*CONTROLS, PARAMETERS=TIME INCREMENTATION", "6,20,12,30,15,8,,20,,", "0.25,0.5,0.75,0.85,,,1.5,"]
    lines += ["*CONTROLS, PARAMETERS=FIELD", f"{residual:.3g},1.,,,{residual:.3g},,1e-12"]
    lines.append("*BOUNDARY")
    for i, u in zip((prescribed + 1).tolist(), start[prescribed].tolist(), strict=True):
        lines += [f"{i},1,1,{u[0]:{PLACE}}", f"{i},2,2,{u[1]:{PLACE}}", f"{i},3,3,{u[2]:{PLACE}}"]
    for nodes, quantity in (("NTOP", "U"), ("NTOP", "RF"), ("NBASE", "RF"), ("NALL", "U")):
        lines += [f"*NODE PRINT, NSET={nodes}, FREQUENCY=1000", quantity]
    lines += ["*END STEP"]
    return "\n".join(lines) + "\n"


# -- CalculiX' own contact

_FACE_OF = {tuple(sorted(f)): i + 1 for i, f in enumerate(([0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]))}  # S1 to S4
STEEL = "210000., 0.3"  # of the indenter, as in FEATS' deck; all of its nodes are moved, so that its stiffness does nothing
STUCK = 0.1  # tangential over normal stiffness of points that stick


def boundary_faces(tets: np.ndarray) -> np.ndarray:
    """Corner triples (f, 3) of the faces that belong to one tetrahedron (e, 4) only."""
    faces = tets[:, FACES].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[first[count == 1]]


def element_faces(tets: np.ndarray, faces: np.ndarray) -> list[tuple[int, int]]:
    """(element, CalculiX' face number) of each boundary face (f, 3 corners), both counted from 1."""
    found = {}
    for element, corners in enumerate(tets.tolist(), 1):
        for local in FACES.tolist():
            found[tuple(sorted(corners[i] for i in local))] = element, _FACE_OF[tuple(sorted(local))]
    return [found[tuple(sorted(f))] for f in faces.tolist()]


def contact_deck(
    mesh: GelMesh, indenter: tuple[np.ndarray, np.ndarray], moves: Sequence[np.ndarray], nu: float, stiffness: float,
    friction: float | None, increment: float,
) -> str:  # fmt: skip
    """Deck of a press with contact by CalculiX, as FEATS has it: surface to surface, a linear penalty.

    indenter: nodes (n, 3) mm where it touches the gel first, tetrahedra (e, 4). moves: its displacement (3,) mm at the
    end of each step. stiffness: penalty, multiples of C10 per mm; FEATS': 50, to which CalculiX falls back. friction:
    Coulomb's coefficient, None without. increment: the first of each step. The deck prints U of the gel's nodes and RF
    of its base.
    """
    nodes, tets = indenter
    n, e = len(mesh.nodes), len(mesh.elements)
    penalty = stiffness * REFERENCE_C10
    lines = [*mesh_lines(mesh), *material_lines(Material(nu)), "*NODE, NSET=NINDENTER"]
    lines += [f"{n + i},{x:.9e},{y:.9e},{z:.9e}" for i, (x, y, z) in enumerate(nodes.tolist(), 1)]
    lines.append("*ELEMENT, TYPE=C3D4, ELSET=EINDENTER")
    lines += [f"{e + i}," + ",".join(str(n + c + 1) for c in tet) for i, tet in enumerate(tets.tolist(), 1)]
    lines += ["*MATERIAL, NAME=STEEL", "*ELASTIC", STEEL, "*SOLID SECTION, ELSET=EINDENTER, MATERIAL=STEEL"]
    lines.append("*SURFACE, NAME=SGEL, TYPE=ELEMENT")
    lines += [f"{i},S{s}" for i, s in element_faces(mesh.elements[:, :4], mesh.faces[:, :3])]
    lines.append("*SURFACE, NAME=SINDENTER, TYPE=ELEMENT")
    lines += [f"{e + i},S{s}" for i, s in element_faces(tets, boundary_faces(tets))]
    lines += ["*CONTACT PAIR, INTERACTION=TOUCH, TYPE=SURFACE TO SURFACE", "SGEL,SINDENTER",
              "*SURFACE INTERACTION, NAME=TOUCH", "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR",
              f"{penalty:.9g}"]  # fmt: skip
    if friction is not None:
        lines += ["*FRICTION", f"{friction:.9g},{STUCK * penalty:.9g}"]
    lines += ["*BOUNDARY", "NBASE,1,3"]
    for move in moves:
        lines += ["*STEP, NLGEOM, INC=1000", f"*STATIC, SOLVER={DIRECT}", f"{increment:.6g},1.,1e-6,1.", "*BOUNDARY"]
        lines += [f"NINDENTER,{axis},{axis},{value:.9e}" for axis, value in enumerate(move.tolist(), 1)]
        for nodes_of, quantity in (("NALL", "U"), ("NBASE", "RF")):
            lines += [f"*NODE PRINT, NSET={nodes_of}, FREQUENCY=100000", quantity]
        lines.append("*END STEP")
    return "\n".join(lines) + "\n"
