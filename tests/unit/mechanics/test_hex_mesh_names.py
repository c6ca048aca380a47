"""Names of hexahedral meshes: they hold all of the mesh, and what is no such name is refused."""

import re

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gelforge.mechanics.mesh.hexmesh import FineBox
from gelforge.mechanics.mesh.hexname import FORM, HexMeshName
from gelforge.mechanics.mesh.names import load_mesh
from tests.support.refused import refused

GOOD = "hex@gelsight_mini:-5.5:5.5:-10:0.25:0.45:5:3:1.8:3:3:1"
LENGTH = st.floats(0.2, 3.0)
NAMES = st.builds(
    HexMeshName, st.just("gelsight_mini"),
    st.builds(FineBox, st.floats(-10, -0.1), st.floats(0, 10), st.floats(-12, -0.1), st.floats(0, 12), LENGTH),
    st.just(9), st.floats(0.5, 5), st.floats(1, 3), LENGTH,
    st.lists(st.integers(1, 8), max_size=3).map(lambda w: tuple(sorted(w, reverse=True))),
)  # fmt: skip


@given(NAMES)
def test_a_name_holds_every_bit(name):
    assert HexMeshName.parse(name.name) == name


@given(NAMES)
def test_zero_has_one_name(name):
    low, high = (HexMeshName(name.gel, FineBox(-1.0, zero, -1.0, 1.0, 1.0), 2, 3.0, 1.5, 2.0) for zero in (0.0, -0.0))
    assert low.name == high.name


def test_a_mesh_of_a_name_is_the_same_wherever_it_is_built():
    one, other = load_mesh(GOOD), HexMeshName.parse(GOOD).mesh()
    assert np.array_equal(one.nodes, other.nodes) and np.array_equal(one.elements, other.elements)
    assert len(one.nodes) > 1000 and one.layers == 5


def test_a_name_that_is_none_is_refused():
    for old, new in (
        ("hex@gelsight_mini", "hex@teapot"), (":3:1.8:3:3:1", ""), (":5:", ":5:5.5:5:"), ("-5.5", "left"),
        (":3:1.8:3:3:1", ":3:1.8:3:1:3"), (":3:3:1", ":3:5"), (":3:3:1", ":3:3:0"), (":3:3:1", ":3:2.5"), (":5:", ":2.5:"),
        (":5:", ":0:"), (":5:", ":1e9:"), ("0.45", "0"), ("0.45", "nan"), ("5.5:-10", "inf:-10"), ("0.45", "1e-9"),
        ("1.8", "0.5"), ("-10:0.25", "0.25:-10"), ("0.45", "0.450"), (GOOD, "hex@"), (":-10", ":-10/../.."),
        ("-5.5:5.5", "10.375:12"), ("-10:0.25", "-15:-13"),
    ):  # fmt: skip
        name = GOOD.replace(old, new, 1)
        assert name != GOOD
        refused("gel 'teapot'" if "teapot" in new else re.escape(FORM), load_mesh, name)


def test_a_fine_part_as_narrow_as_a_hair_is_refused_before_it_is_built():
    """An element no wider than it, whatever its size, and others that do not grow from there: ten million lines."""
    for box in ("0:1e-06:0:1", "0:1:0:1e-06", "10.374999:12:0:1"):
        name = f"hex@gelsight_mini:{box}:1:2:3:1:1"
        refused("more than 2e\\+06 elements", HexMeshName.parse, name)


@given(st.floats(0.01, 0.1), st.floats(0.1, 2.0))
def test_small_hexahedra_under_a_small_contact_are_no_large_mesh(size, width):
    """They grow from there: a tip 0.1 mm wide takes some thousand elements, not as many as if all of the gel were so fine."""
    name = HexMeshName("gelsight_mini", FineBox(-width / 2, width / 2, 0.0, width, size), 6, 2.0, 2.2, 4.0)
    if 6 * (width / size) ** 2 < 2e5:
        assert HexMeshName.parse(name.name) == name
