"""Input decks for CalculiX: the mesh as a shared include, one press as a small deck."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gelforge.flow.files import write_if_changed
from gelforge.mechanics.mesh import GelMesh
from gelforge.mechanics.scene import REFERENCE_C10, Material

MATERIAL_NAME = "GEL"
# CalculiX' solvers of linear systems. Near the solution, where the kinematics leave it, conjugate gradients cost
# a third of a factorisation, ordering included; from rest only the latter is sure.
DIRECT, ITERATIVE = "SPOOLES", "ITERATIVE SCALING"


@dataclass(frozen=True)
class Rows:
    """Springs on linear combinations of nodal displacements.

    Row r says: the length sum_t coefficient[t] * u[node[t], axis[t]] over its terms t (those with
    row[t] == r) is drawn to `target[r]` (mm) by a spring of `stiffness` (N/mm). Energy per row is
    stiffness / 2 * (length - target)^2.
    """

    row: np.ndarray
    node: np.ndarray
    axis: np.ndarray
    coefficient: np.ndarray
    target: np.ndarray
    stiffness: float


def mesh_include(mesh: GelMesh) -> str:
    """Nodes, elements and node sets of a C3D10 mesh; CalculiX counts from 1."""
    lines = ["*NODE, NSET=NALL"]
    lines += [f"{i},{x:.9e},{y:.9e},{z:.9e}" for i, (x, y, z) in enumerate(mesh.nodes.tolist(), 1)]
    lines.append("*ELEMENT, TYPE=C3D10, ELSET=EGEL")
    lines += [",".join(map(str, [i, *e])) for i, e in enumerate((mesh.elements + 1).tolist(), 1)]
    lines.append("*NSET, NSET=NBASE")
    lines += [str(i + 1) for i in mesh.base.tolist()]
    lines.append("*NSET, NSET=NTOP")
    lines += [str(i + 1) for i in mesh.surface_nodes.tolist()]
    lines.append(f"*SOLID SECTION, ELSET=EGEL, MATERIAL={MATERIAL_NAME}")
    return "\n".join(lines) + "\n"


def write_include(mesh: GelMesh, path: Path | str) -> Path:
    """Write `mesh_include` to `path`; a file of another mesh that lies there is replaced."""
    write_if_changed(path, mesh_include(mesh))
    return Path(path)


def material_lines(material: Material) -> list[str]:
    """Neo-Hooke at REFERENCE_C10 and the material's Poisson's ratio (CalculiX manual, *HYPERELASTIC)."""
    return [
        f"*MATERIAL, NAME={MATERIAL_NAME}",
        "*HYPERELASTIC, NEO HOOKE",
        f"{REFERENCE_C10:.12g},{material.d1:.12g}",
    ]


def spring_lines(rows: Rows, first_node: int, first_element: int) -> tuple[list[str], list[str]]:
    """Model lines and step lines of the springs.

    Three rows share a pair of helper nodes, one axis each: the near one is tied to the gel by
    *EQUATION, the far one is prescribed, a SPRING2 per axis joins them.
    """
    count = len(rows.target)
    pairs = -(-count // 3)
    near, far = first_node, first_node + pairs
    model = ["*NODE, NSET=NNEAR", *[f"{near + i},0.,0.,0." for i in range(pairs)]]
    model += ["*NODE, NSET=NFAR", *[f"{far + i},0.,0.,0." for i in range(pairs)]]
    order = np.argsort(rows.row, kind="stable")
    bounds = np.searchsorted(rows.row[order], np.arange(count + 1))
    node, axis, coefficient = rows.node[order] + 1, rows.axis[order] + 1, rows.coefficient[order]
    terms = [f"{n},{a},{c:.10e}" for n, a, c in zip(node.tolist(), axis.tolist(), coefficient.tolist(), strict=True)]
    model.append("*EQUATION")
    for r in range(count):
        own = [f"{near + r // 3},{r % 3 + 1},-1.", *terms[bounds[r] : bounds[r + 1]]]
        model.append(str(len(own)))
        model += [",".join(own[i : i + 4]) for i in range(0, len(own), 4)]
    for a in range(3):
        model.append(f"*ELEMENT, TYPE=SPRING2, ELSET=ESPRING{a + 1}")
        model += [f"{first_element + r},{near + r // 3},{far + r // 3}" for r in range(a, count, 3)]
        model += [f"*SPRING, ELSET=ESPRING{a + 1}", f"{a + 1},{a + 1}", f"{rows.stiffness:.9e}"]
    spare = [(r // 3, r % 3) for r in range(count, 3 * pairs)]
    step = ["*BOUNDARY"]
    step += [f"{far + r // 3},{r % 3 + 1},{r % 3 + 1},{t:.12e}" for r, t in enumerate(rows.target.tolist())]
    step += [f"{n + p},{a + 1},{a + 1},0." for p, a in spare for n in (near, far)]
    return model, step


def start_lines(start: np.ndarray) -> list[str]:
    """The displacement (n, 3) mm that Newton's method starts from."""
    lines = ["*INITIAL CONDITIONS, TYPE=DISPLACEMENT"]
    for i, u in enumerate(start.tolist(), 1):
        lines += [f"{i},1,{u[0]:.8e}", f"{i},2,{u[1]:.8e}", f"{i},3,{u[2]:.8e}"]
    return lines


def press_deck(
    mesh: GelMesh, include: str, material: Material, rows: Rows, loads: np.ndarray | None = None,
    start: np.ndarray | None = None, increment: float = 1.0, residual: float = 1e-6, solver: str = DIRECT,
) -> str:  # fmt: skip
    """Deck of one equilibrium without contact.

    include: file name of the mesh. rows: springs that hold the touching points. loads: (n, 3) N
    nodal forces, or None. start: (n, 3) mm. increment: first load increment, 1 for all at once.
    residual: largest nodal residual over the mean nodal force. Prints U and RF of the top's nodes,
    RF of the base, U of all.
    RF of a node that springs or loads act on is the force they exert on the gel there.
    """
    lines = [f"*INCLUDE, INPUT={include}", *material_lines(material)]
    model, bounds = spring_lines(rows, len(mesh.nodes) + 1, len(mesh.elements) + 1)
    lines += model
    lines += ["*BOUNDARY", "NBASE,1,3"]
    if start is not None:
        lines += start_lines(start)
    lines += ["*STEP, NLGEOM, INC=200", f"*STATIC, SOLVER={solver}", f"{increment:.6g},1.,1e-4,1."]
    lines += ["*CONTROLS, PARAMETERS=TIME INCREMENTATION", "6,20,12,30,15,8,,20,,", "0.25,0.5,0.75,0.85,,,1.5,"]
    lines += ["*CONTROLS, PARAMETERS=FIELD", f"{residual:.3g},1.,,,{residual:.3g},,1e-12"]
    lines += bounds
    if loads is not None and np.any(loads):
        lines.append("*CLOAD")
        where = np.argwhere(loads != 0)
        lines += [f"{n + 1},{a + 1},{loads[n, a]:.12e}" for n, a in where.tolist()]
    for nodes, quantity in (("NTOP", "U"), ("NTOP", "RF"), ("NBASE", "RF"), ("NALL", "U")):
        lines += [f"*NODE PRINT, NSET={nodes}, FREQUENCY=1000", quantity]
    lines += ["*END STEP"]
    return "\n".join(line for line in lines if line) + "\n"
