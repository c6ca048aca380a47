"""Method `ccx-contact`: CalculiX' own contact between gel and posed indenter, both as tetrahedra by pytetwild.

The formulation is FEATS' (Helmut et al., IROS 2025): surface to surface, a linear penalty. Nothing of it comes from the
contact that is solved in process, so it checks that contact. With FEATS' penalty, 50 C10 per mm, the gel sinks in by
tenths of a millimetre; a hard one, as `stiffness` of [fea], is for checks. CalculiX counts motion before a point
touches as stick, so both are the same only without friction.
"""

import time
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.flow.tables import FeaTable
from gelforge.geometry import touch
from gelforge.geometry.stlfile import read_stl
from gelforge.geometry.triangles import cropped
from gelforge.mechanics.ccx.dat import DatError, last_table, read_dat
from gelforge.mechanics.ccx.deck import contact_deck
from gelforge.mechanics.ccx.program import OVERDUE, run_ccx
from gelforge.mechanics.elements.element import ELEMENTS
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.tetmesh import orient
from gelforge.mechanics.mesh.tetwild import tetrahedralise
from gelforge.mechanics.path.loadpath import first_touch
from gelforge.mechanics.result import Result
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solvers.ccx import status_of
from gelforge.records.status import Status

# Edges of the indenter's tetrahedra, and how far these may be from its surface, mm.
INDENTER_MM, APART_MM = 0.6, 0.005
ABOVE_MM = 0.5  # height of the indenter's surface above the gel's apex at its depth, where no file of it is given
INCREMENTS = 0.1, 0.02  # first load increment, and that of the second try
# Largest difference of the forces at the gel's top and at its base, as a fraction: a .dat has seven digits.
MOST_MISMATCH = 1e-5
STICKS = 1.0  # friction coefficient of the law without slip, as in FEATS' deck
# 90 % bounds on the error of the total force with a hard penalty, and summed over cells, as fractions of it.
ERROR, CELLS_ERROR = 0.02, 0.1


@dataclass(frozen=True)
class ContactSettings:
    """Settings of `ccx-contact`: its keys of [fea].

    contact_mm: longest edges of the gel's tetrahedra under the indenter. contact_stiffness: penalty, multiples of C10
    per mm. timeout_s: time limit of a run of CalculiX, s.
    """

    contact_mm: float
    contact_stiffness: float
    timeout_s: float

    @classmethod
    def of(cls, table: FeaTable) -> "ContactSettings":
        """The settings of a table [fea]."""
        return cls(**{field.name: getattr(table, field.name) for field in fields(cls)})


def surface_of(scene: Scene, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Closed triangles of the indenter at path parameter t: those of stage 10's file if the scene names one."""
    rotation, place = touch.pose_at(scene.press, t)
    if scene.posed is not None:
        vertices, faces = read_stl(scene.posed.path)
        return vertices + (place - scene.posed.press.pose(0.0, 0.0)[1]), faces
    vertices, faces = cropped(scene.indenter, -(scene.press.z0 + scene.press.dz) + ABOVE_MM)
    return vertices @ rotation.T + place, faces


def solve_contact(
    scene: Scene, mesh: GelMesh, folder: Path | str, settings: ContactSettings, increment: float = INCREMENTS[0]
) -> Result:
    """State at the end of a scene's path by CalculiX' own contact. Failure is a status, not an exception."""
    began = time.perf_counter()
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    zero = np.zeros_like(mesh.nodes)
    evidence: dict[str, Any] = dict.fromkeys(
        ("equilibrium_residual", "penetration_mm", "pulling_fraction", "base_mismatch"), 0.0
    )
    evidence |= {"rounds": 0, "load_steps": 0, "newton_iterations": 0, "peak_mib": 0.0, "reason": ""}
    at = first_touch(scene)
    if at is None:
        return Result(Status.NO_CONTACT, zero, zero.copy(), evidence, mesh)
    press = scene.press
    moves = [
        touch.pose_at(press, t)[1] - touch.pose_at(press, at)[1] for t in dict.fromkeys((1.0, press.end)) if t > at
    ]
    nodes, tets = tetrahedralise(f"indenter {scene.indenter.name}", *surface_of(scene, at), INDENTER_MM, APART_MM)
    law = scene.interface
    friction = {"no_slip": STICKS, "frictionless": None}.get(law.law, law.contact.coefficient)
    deck = contact_deck(
        mesh, (nodes, orient(nodes, tets)), moves, scene.material.nu, settings.contact_stiffness, friction, increment
    )  # fmt: skip
    (folder / "contact.inp").write_text(deck)
    job = run_ccx("contact", folder, settings.timeout_s)
    evidence |= {
        "newton_iterations": job.iterations, "peak_mib": job.peak_mib, "ccx_version": job.version,
        "seconds": time.perf_counter() - began, "load_steps": len(moves),
    }  # fmt: skip
    if job.returncode == OVERDUE:
        evidence["stopped_after_s"] = settings.timeout_s
    path = folder / "contact.dat"
    try:
        tables = read_dat(path.read_text(errors="replace") if path.exists() else "")
        every, end = np.arange(len(mesh.nodes)) + 1, float(len(moves))
        displacement = last_table(tables, "displacements", "NALL", every, end)
        base = last_table(tables, "forces", "NBASE", mesh.base + 1, end).sum(axis=0)
    except DatError as error:
        return Result(status_of(error), zero, zero.copy(), evidence | {"reason": f"{error}; {job.reason()}"}, mesh)
    forces = contact_forces(mesh, scene, displacement)
    total = forces.sum(axis=0)
    # however small: where contact was missed, forces are rounding alone, of which the base bears nothing
    size_n = max(float(np.linalg.norm(total)), float(np.finfo(float).tiny))
    mismatch = float(np.linalg.norm(total + base)) / size_n
    top = mesh.surface_nodes
    evidence |= {
        "base_mismatch": mismatch, "equilibrium_residual": mismatch,
        "penetration_mm": float(-touch.gap(scene.indenter, press, mesh.nodes[top] + displacement[top], press.end).min()),
        "pulling_fraction": 0.0,  # a linear penalty does not pull
    }  # fmt: skip
    # the indenter's flat triangles may miss a gel that the indenter itself touches
    status = (Status.OK if forces.any() else Status.TOO_COARSE) if mismatch <= MOST_MISMATCH else Status.UNBALANCED
    return Result(status, forces, displacement, evidence, mesh)


def contact_forces(mesh: GelMesh, scene: Scene, displacement: np.ndarray) -> np.ndarray:
    """Contact forces (n, 3) N at the top of a gel with displacement (n, 3) mm.

    Stock CalculiX prints no contact force of a node; what the elements bear at the top is what contact exerts.
    """
    inner, material = np.zeros_like(mesh.nodes), scene.material
    solid = ELEMENTS[mesh.kind].on(mesh.nodes, mesh.cells)
    solid.internal_forces(displacement, material.shear_modulus, material.bulk_modulus, inner)
    forces = np.zeros_like(inner)
    forces[mesh.surface_nodes] = inner[mesh.surface_nodes]
    return forces
