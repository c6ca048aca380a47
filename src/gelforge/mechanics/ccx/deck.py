"""Input decks for CalculiX: one press and its mesh in one file."""

import numpy as np

from gelforge.mechanics.material import REFERENCE_C10, Material
from gelforge.mechanics.mesh.gelmesh import GelMesh

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
