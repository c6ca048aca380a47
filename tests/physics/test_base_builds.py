"""Two base meshes of one gel: pytetwild never makes the same one twice, and a press has the same force on both."""

from dataclasses import replace

import numpy as np
import pytest

from gelforge.geometry.gel import GELS
from gelforge.geometry.indenters import build
from gelforge.mechanics.hexsettings import quality
from gelforge.mechanics.material import Material
from gelforge.mechanics.mesh import basemesh
from gelforge.mechanics.mesh.basemesh import base_of, meshes_in
from gelforge.mechanics.mesh.tetmesh import orient
from gelforge.mechanics.path.equilibrium import System
from gelforge.mechanics.path.loadpath import first_touch
from gelforge.mechanics.path.scenepath import ScenePath
from gelforge.mechanics.scene import Interface, Scene
from gelforge.mechanics.solve import GUIDE
from gelforge.mechanics.solvers.ccx import ERROR, CcxSettings, mesh_of
from gelforge.mechanics.solvers.hex import HexSolver
from gelforge.records.press import Press
from gelforge.records.status import Status
from tests.support.parameters import parameters

GEL = GELS["gelsight_mini"]
CCX = CcxSettings.of(parameters().fea)
# A round and a flat, cornered body, off the centre.
BODIES = (
    ({"kind": "sphere", "diameter": 15, "height": 10}, -0.6),
    ({"kind": "cuboid", "size": [7, 7], "fillet": 0.5, "height": 10}, -0.4),
)
ALIKE = 0.005  # largest difference of the total force, as a fraction


@pytest.mark.slow
def test_two_builds_of_a_base_mesh_give_the_same_forces(tmp_path):
    """The second build is mirrored, so that it differs from the first one wherever pytetwild runs."""
    made, again = basemesh.build(GEL), basemesh.build(GEL)
    nodes = again.nodes * [-1.0, 1.0, 1.0]
    mirrored = replace(again, nodes=nodes, tets=orient(nodes, again.tets))
    hexahedra, forces, digests = HexSolver(quality(GUIDE)), {}, []
    for base in (made, mirrored):
        base.write(tmp_path / base.digest / f"{GEL.name}.npz")
        with meshes_in(tmp_path / base.digest):
            digests.append(base_of(GEL).digest)
            for number, (body, dz) in enumerate(BODIES):
                press = Press(0.7, -1.3, 0.0, 0.0, 0.0, dz, 20.0)
                scene = Scene(GEL, Material(), build("body", body), press, Interface("no_slip"))
                path = hexahedra.coarse_path([scene])[0].path
                mesh = mesh_of(scene, path, CCX.edge_mm, CCX.inside_mm).mesh()
                found = ScenePath(scene, CCX.path(scene, first_touch(scene)), mesh, System(mesh))
                assert found.arrive(path) is Status.OK, found.reason
                forces.setdefault(number, []).append(found.contact_forces().sum(axis=0))
    assert digests == [made.digest, mirrored.digest] and made.digest != mirrored.digest
    for one, other in forces.values():
        assert np.linalg.norm(one - other) <= min(ALIKE, ERROR) * np.linalg.norm(other)
