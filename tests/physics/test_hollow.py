"""A shell inside another one changes no force: the body is rigid, and the gel meets its outer surface."""

import numpy as np
import pytest

import gelforge
from gelforge.geometry.indenters import build
from gelforge.geometry.triangles import joined, write_stl


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
        "all inside out": [(vertices, faces[:, ::-1]), (cavity, faces)],
    }
    for name, each in shells.items():
        write_stl(folder / f"{name}.stl", *joined(each))
    return {name: build(name, {"kind": "stl", "file": f"{name}.stl"}, folder=folder) for name in shells}


def on_hexahedra(body):
    return gelforge.solve(body, 0.6, quality="demo").total


def test_shells_inside_change_no_force(bodies):
    full = on_hexahedra(bodies["full"])
    assert full[2] < -1.0
    for name in set(bodies) - {"full"}:
        np.testing.assert_allclose(
            on_hexahedra(bodies[name]), full, rtol=1e-3, atol=1e-3 * np.abs(full).max(), err_msg=name
        )
