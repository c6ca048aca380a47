"""The Neo-Hookean solid through CalculiX and through the in-process tetrahedra, against closed forms."""

import numpy as np
import pytest
from scipy.optimize import brentq

from gelforge.mechanics.ccx.dat import last_table, read_dat
from gelforge.mechanics.ccx.deck import material_lines, mesh_lines
from gelforge.mechanics.ccx.program import run_ccx
from gelforge.mechanics.elements.element import ELEMENTS
from gelforge.mechanics.material import REFERENCE_C10, Material
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.tetmesh import second_order
from tests.support.blocks import boundary_faces, kuhn_grid

MATERIAL = Material()
SIDE = np.linspace(0.0, 1.0, 3)


def cube() -> GelMesh:
    """The unit cube; every boundary node counts as top, the side z = 0 is the base."""
    corners, tets = kuhn_grid((SIDE, SIDE, SIDE))
    nodes, elements, middle = second_order(corners, tets)
    faces = boundary_faces(tets)
    middles = [middle(faces[:, [i, (i + 1) % 3]]) for i in range(3)]
    return GelMesh("tet10", nodes, elements, np.column_stack([faces, *middles]).astype(np.int32),
                   np.flatnonzero(nodes[:, 2] == 0).astype(np.int32))  # fmt: skip


def stress(f) -> np.ndarray:
    """First Piola-Kirchhoff stress dW/dF of W = C10 (I1bar - 3) + (J - 1)^2 / D1."""
    j, inv = np.linalg.det(f), np.linalg.inv(f).T
    isochoric = 2 * REFERENCE_C10 * j ** (-2 / 3) * (f - np.trace(f.T @ f) / 3 * inv)
    return isochoric + 2 / MATERIAL.d1 * (j - 1) * j * inv


def uniaxial(stretch) -> np.ndarray:
    """Deformation gradient of a bar stretched along x with free sides."""
    side = brentq(lambda s: stress(np.diag([stretch, s, s]))[1, 1], 0.5, 2.0, xtol=1e-14)
    return np.diag([stretch, side, side])


CASES = {
    "uniaxial compression": uniaxial(0.75), "uniaxial tension": uniaxial(1.3),
    "simple shear": np.array([[1.0, 0.0, 0.4], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    "confined compression": np.diag([1.0, 1.0, 0.95]),
}  # fmt: skip


def deck(mesh, displacement) -> str:
    lines = [*mesh_lines(mesh), *material_lines(MATERIAL), "*STEP, NLGEOM", "*STATIC", "1.,1.", "*BOUNDARY"]
    for n in mesh.surface_nodes:
        lines += [f"{n + 1},{a + 1},{a + 1},{displacement[n, a]:.12e}" for a in range(3)]
    return "\n".join([*lines, "*NODE PRINT, NSET=NTOP", "RF", "*END STEP"]) + "\n"


@pytest.mark.parametrize("case", CASES)
def test_forces_on_every_side_of_a_cube(case, ccx, tmp_path):
    mesh, f = cube(), CASES[case]
    (tmp_path / "cube.inp").write_text(deck(mesh, mesh.nodes @ (f - np.eye(3)).T))
    job = run_ccx("cube", tmp_path, 60)
    assert job.returncode == 0, job.reason()
    top = mesh.surface_nodes
    forces = np.zeros_like(mesh.nodes)
    forces[top] = last_table(read_dat((tmp_path / "cube.dat").read_text()), "forces", "NTOP", top + 1)
    own, u = np.zeros_like(mesh.nodes), mesh.nodes @ (f - np.eye(3)).T
    solid = ELEMENTS[mesh.kind].on(mesh.nodes, mesh.cells)
    solid.internal_forces(u, MATERIAL.shear_modulus, MATERIAL.bulk_modulus, own)
    # the .dat prints seven digits; forces are of the order of the modulus
    np.testing.assert_allclose(forces[top], own[top], atol=2e-6 * np.abs(own).max())
    # a quadratic element holds a linear field exactly: virtual work with x gives the mean stress
    np.testing.assert_allclose(forces.T @ mesh.nodes, stress(f), atol=2e-6 * np.abs(stress(f)).max())
