"""A shell inside another one changes no force: the body is rigid, and the gel meets its outer surface."""

import numpy as np
import pytest

import gelforge
from gelforge.flow.schema import altered
from gelforge.geometry.indenters import build
from gelforge.geometry.triangles import joined, write_stl
from gelforge.mechanics.material import Material
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solvers.ccx import CcxSettings, CcxSolver
from gelforge.records.press import Press
from tests.support.blocks import symmetric_block
from tests.support.flat_pad import FlatPad
from tests.support.parameters import parameters

PAD = FlatPad(name="pad", width=7.0, length=7.0, corner_radius=0.0, height=4.0)


@pytest.fixture(scope="module")
def bodies(tmp_path_factory):
    """One ball, as a full body and with a wall of 0.3 mm at its tip, as three programs would write that."""
    folder = tmp_path_factory.mktemp("stl")
    vertices, faces = build("ball", {"kind": "sphere", "diameter": 8, "height": 6}).surface()
    cavity = vertices * [0.9, 0.9, 0.9] + [0.0, 0.0, 0.3]
    kernel = vertices * 0.5 + [0.0, 0.0, 1.0]
    shells = {
        "full": [(vertices, faces)],
        "hollow": [(vertices, faces), (cavity, faces[:, ::-1])],
        "cavity oriented outwards, a core in it": [(cavity, faces), (kernel, faces), (vertices, faces)],
        "all inverted": [(vertices, faces[:, ::-1]), (cavity, faces)],
    }
    for name, each in shells.items():
        write_stl(folder / f"{name}.stl", *joined(each))
    return {name: build(name, {"kind": "stl", "file": f"{name}.stl"}, folder=folder) for name in shells}


def on_hexahedra(body):
    return gelforge.solve(body, 0.6).total


def with_calculix(body, ccx, folder):
    settings = CcxSettings.of(altered(parameters().fea, press_steps=3, shear_steps=2))
    result = CcxSolver(symmetric_block(PAD, 1.0, 3), folder, settings).solve(
        Scene(PAD, Material(), body, Press(0, 0, 0, 0, 0, -0.6))
    )
    assert result.status.valid, result.evidence
    return result.total


@pytest.mark.slow
@pytest.mark.parametrize("method", ["draft", "ccx"])
def test_shells_inside_change_no_force(bodies, method, request, tmp_path):
    def force(name):
        if method == "draft":
            return on_hexahedra(bodies[name])
        return with_calculix(bodies[name], request.getfixturevalue("ccx"), tmp_path / name.replace(" ", "-"))

    full = force("full")
    assert full[2] < -1.0
    # CalculiX gets the same distances: the worst of them alone
    for name in list(bodies)[1:] if method == "draft" else ["cavity oriented outwards, a core in it"]:
        np.testing.assert_allclose(force(name), full, rtol=1e-3, atol=1e-3 * np.abs(full).max(), err_msg=name)
