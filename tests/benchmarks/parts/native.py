"""FEATS' formulation, CalculiX' own contact pair between gel and indenter tetrahedra.

The deck follows FEATS' sim.inp (Helmut et al., IROS 2025): surface-to-surface contact, the penalty
that PRESSURE-OVERCLOSURE=TIED falls back to without a data line (50 C10 per mm), friction 1, the
indenter's top led by prescribed displacements. It is the baseline of the chart, not a good answer.
"""

import contextlib
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.geometry.solids import Indenter
from gelforge.geometry.triangles import cropped
from gelforge.mechanics.ccx.dat import DatError, last_table, read_dat
from gelforge.mechanics.ccx.deck import material_lines, mesh_lines
from gelforge.mechanics.ccx.program import OVERDUE, run_ccx
from gelforge.mechanics.elements.element import ELEMENTS
from gelforge.mechanics.mesh.basemesh import base_of
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.tetmesh import FACES, Sizes, bisected, from_flat, orient
from gelforge.mechanics.path.loadpath import first_touch
from gelforge.mechanics.result import Result
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solvers.ccx import CcxResult, status_of
from gelforge.records.status import Status
from tests.support.blocks import boundary_faces

MOST_MISMATCH = 1e-5  # of forces at the gel's top and at its base, as a share: the .dat holds seven digits
# Height of the indenter that is meshed, above its tip: as deep as [poses] deepest_share lets a press be on the nominal gel.
CROP_MM = 3.0
_FACE_OF = {tuple(sorted(f)): i + 1 for i, f in enumerate(([0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]))}  # S1 to S4


def indenter_tets(indenter: Indenter, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Linear tetrahedra of the indenter's lowest CROP_MM in its own frame: nodes (n, 3), elements (e, 4)."""
    import pymeshlab

    vertices, faces = cropped(indenter, CROP_MM)
    shapes = pymeshlab.MeshSet()
    shapes.add_mesh(pymeshlab.Mesh(vertices, faces))
    shapes.meshing_isotropic_explicit_remeshing(targetlen=pymeshlab.PureValue(size), iterations=5)
    surface = shapes.current_mesh()
    nodes, tets = tetrahedralise(
        surface.vertex_matrix(), surface.face_matrix(), edge_length_abs=size, epsilon=1e-3, num_threads=1
    )
    return nodes, orient(nodes, tets)


def tetrahedralise(vertices: np.ndarray, faces: np.ndarray, **options: Any) -> tuple[np.ndarray, np.ndarray]:
    """Linear tetrahedra inside closed triangles: the nodes (n, 3) in use and elements (e, 4)."""
    import pytetwild

    # It leaves a file in the folder it runs in.
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        nodes, tets = pytetwild.tetrahedralize(vertices, faces, **options)
    used, numbered = np.unique(tets, return_inverse=True)
    return nodes[used], numbered.reshape(-1, 4)


def element_faces(tets: np.ndarray, faces: np.ndarray) -> list[tuple[int, int]]:
    """(element, CalculiX' face number) of each boundary face (f, 3 corners), both counted from 1."""
    found = {}
    for element, corners in enumerate(tets.tolist(), 1):
        for local in FACES.tolist():
            found[tuple(sorted(corners[i] for i in local))] = element, _FACE_OF[tuple(sorted(local))]
    return [found[tuple(sorted(f))] for f in faces.tolist()]


def native_deck(scene: Scene, mesh: GelMesh, nodes: np.ndarray, tets: np.ndarray) -> str:
    """FEATS' deck for a scene: press in one step, then shear in another where there is one."""
    rotation, shift = scene.press.pose(0.0, 0.0)
    placed = nodes @ rotation.T + shift
    n, e = len(mesh.nodes), len(mesh.elements)
    lines = [*mesh_lines(mesh), "*NODE, NSET=NIND"]
    lines += [f"{n + i},{x:.9e},{y:.9e},{z:.9e}" for i, (x, y, z) in enumerate(placed.tolist(), 1)]
    lines.append("*ELEMENT, TYPE=C3D4, ELSET=EIND")
    lines += [f"{e + i}," + ",".join(str(n + c + 1) for c in tet) for i, tet in enumerate(tets.tolist(), 1)]
    # The gel comes first: the penalty that CalculiX falls back to is 50 times the first material's first constant.
    lines += material_lines(scene.material)
    lines += ["*MATERIAL, NAME=INDENTER", "*ELASTIC", "210000., 0.3", "*SOLID SECTION, ELSET=EIND, MATERIAL=INDENTER"]
    lines.append("*SURFACE, NAME=SGEL, TYPE=ELEMENT")
    lines += [f"{i},S{s}" for i, s in element_faces(mesh.elements[:, :4], mesh.faces[:, :3])]
    outer = boundary_faces(tets)
    top = nodes[:, 2] > nodes[:, 2].max() - 1e-3
    lower = outer[~top[outer].all(axis=1)]
    lines.append("*SURFACE, NAME=SIND, TYPE=ELEMENT")
    lines += [f"{e + i},S{s}" for i, s in element_faces(tets, lower)]
    lines.append("*NSET, NSET=NLED")
    lines += [str(n + i + 1) for i in np.flatnonzero(top)]
    lines += ["*CONTACT PAIR, INTERACTION=TOUCH, TYPE=SURFACE TO SURFACE", "SGEL,SIND",
              "*SURFACE INTERACTION, NAME=TOUCH",
              "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=TIED"]  # fmt: skip
    # 1 without slip, as in FEATS' deck: hardly anything slips
    friction = {"no_slip": 1.0, "frictionless": None}.get(scene.interface.law, scene.interface.contact.coefficient)
    if friction is not None:
        lines += ["*FRICTION", f"{friction:g}"]
    lines += ["*BOUNDARY", "NBASE,1,3"]
    p = scene.press
    for dx, dy in [(0.0, 0.0)] + ([(p.dx, p.dy)] if p.dx or p.dy else []):
        lines += ["*STEP, NLGEOM, INC=1000", "*STATIC, SOLVER=SPOOLES", "0.1,1.", "*BOUNDARY"]
        lines += [f"NLED,{a},{a},{v:.9e}" for a, v in enumerate((dx, dy, p.dz), 1)]
        for name, quantity in (("NALL", "U"), ("NBASE", "RF")):
            lines += [f"*NODE PRINT, NSET={name}, FREQUENCY=100000", quantity]
        lines.append("*END STEP")
    return "\n".join(lines) + "\n"


def solve_native(scene: Scene, mesh: GelMesh, folder: Path | str, timeout_s: float, size: float = 0.7) -> CcxResult:
    """Solve a scene with FEATS' formulation on a gel mesh; indenter elements of `size` mm. Failure is a status."""
    began = time.perf_counter()
    zero = np.zeros_like(mesh.nodes)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    evidence: dict[str, Any] = {"rounds": 1, "load_steps": 0, "penetration_mm": None, "pulling_fraction": None}
    if first_touch(scene) is None:
        return CcxResult(Status.NO_CONTACT, zero, zero.copy(), evidence)
    deck = native_deck(scene, mesh, *indenter_tets(scene.indenter, size))
    (folder / "native.inp").write_text(deck)
    job = run_ccx("native", folder, timeout_s)
    evidence |= {
        "newton_iterations": job.iterations,
        "seconds": time.perf_counter() - began,
        "peak_mib": job.peak_mib,
    }
    if job.returncode == OVERDUE:
        evidence["stopped_after_s"] = timeout_s
    try:
        path = folder / "native.dat"
        text = path.read_text(errors="replace") if path.exists() else ""
        tables, top = read_dat(text), mesh.surface_nodes
        end = scene.press.end
        every = np.arange(len(mesh.nodes)) + 1
        displacement = last_table(tables, "displacements", "NALL", every, end)
        base = last_table(tables, "forces", "NBASE", mesh.base + 1, end).sum(axis=0)
    except DatError as error:
        return CcxResult(status_of(error), zero, zero.copy(), evidence | {"reason": f"{error}; {job.reason()}"}, mesh)
    # Stock CalculiX prints no contact force per node; what the elements bear at the top is what contact exerts.
    inner, material = zero.copy(), scene.material
    solid = ELEMENTS[mesh.kind].on(mesh.nodes, mesh.cells)
    solid.internal_forces(displacement, material.shear_modulus, material.bulk_modulus, inner)
    forces = zero.copy()
    forces[top] = inner[top]
    total = forces.sum(axis=0)
    # however small: where contact was missed, forces are rounding alone, of which the base bears nothing
    size_n = max(float(np.linalg.norm(total)), float(np.finfo(float).tiny))
    evidence["base_mismatch"] = float(np.linalg.norm(total + base)) / size_n
    evidence["equilibrium_residual"] = evidence["base_mismatch"]
    balanced = evidence["base_mismatch"] <= MOST_MISMATCH
    # the indenter's flat triangles may miss a gel that the indenter itself touches
    status = (Status.OK if forces.any() else Status.TOO_COARSE) if balanced else Status.UNBALANCED
    return CcxResult(status, forces, displacement, evidence, mesh)


def prepared(scene: Scene, size: float, limit_s: float, work: Path) -> Callable[[], tuple[Result, GelMesh]]:
    """The solve of a scene on tetrahedra of `size` mm everywhere."""
    gel = scene.gel
    even = Sizes.at(
        gel, np.ones((1, 1), bool), max(gel.width, gel.length), (-gel.width / 2, -gel.length / 2), size, size
    )
    base = base_of(gel)
    mesh = from_flat(gel, *bisected(base.nodes, base.tets, even))
    return lambda: (solve_native(scene, mesh, work / "native", limit_s), mesh)
