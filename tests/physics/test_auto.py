"""Fidelity "auto": the class of a contact, the cheapest way for it, and solves that follow the choice."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelforge.errors import BadInput
from gelforge.flow.params.tables import CLASSES, WAYS
from gelforge.geometry.gel import Gel
from gelforge.geometry.indenters import build
from gelforge.mechanics.material import Material
from gelforge.mechanics.mesh.family import MeshFamily
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solve import Solvers, charted_errors, cheapest
from gelforge.mechanics.solvers.contactclass import contact_class
from gelforge.records.press import Press
from tests.support.parameters import parameters

BODIES = {
    "curved": build("ball", {"kind": "sphere", "diameter": 15, "height": 10}),
    "flat": build("block", {"kind": "cuboid", "size": [7, 7], "fillet": 0.5, "height": 10}),
    "pointed": build("tip", {"kind": "pyramid", "size": [10, 10], "slope_deg": 30, "fillet": 0.2, "height": 10}),
}


def scene(shape: str, depth: float, x: float = 0.0, y: float = 0.0, turn: float = 0.0, lift: float = 0.0) -> Scene:
    return Scene(Gel(), Material(), BODIES[shape], Press(x, y, lift, 0.0, 0.0, -depth - lift, turn))


# Shapes with depths (mm) of one class: between 0.7 and 0.85 mm the dome decides whether it is deep, and a shallow block
# touches the dome as a ball would.
OF_CLASS = {
    "curved_shallow": (0.3, 0.7), "pointed_shallow": (0.3, 0.7), "flat_shallow": (0.6, 0.7),
    "curved_deep": (0.85, 1.4), "pointed_deep": (0.85, 1.4), "flat_deep": (0.85, 1.4),
}  # fmt: skip


@pytest.mark.parametrize("kind", OF_CLASS)
@given(st.data(), st.floats(-1, 1), st.floats(-1, 1), st.floats(0, 360), st.floats(0, 5))
@settings(max_examples=8)
def test_the_class_is_that_of_the_body_wherever_it_presses(kind, data, x, y, turn, lift):
    """Near the apex, at any turn and from any height."""
    depth = data.draw(st.floats(*OF_CLASS[kind]))
    assert kind in CLASSES
    assert contact_class(scene(kind.split("_")[0], depth, x, y, turn, lift)) == kind


def test_what_touches_nothing_has_no_class():
    assert contact_class(replace(scene("curved", 0.5), press=Press(0, 0, 3.0, 0, 0, -0.5))) is None


@given(st.sampled_from(CLASSES), st.floats(0.04, 0.2), st.floats(0.1, 0.5), st.floats(0.0, 0.5))
def test_the_choice_meets_what_was_asked_and_more_tolerance_never_costs_more(kind, total, cells, more):
    fea = replace(parameters().fea, tolerance=total, cell_tolerance=cells)
    way, looser = cheapest(kind, fea), cheapest(kind, replace(fea, tolerance=total + more))
    rows = [fea.charted[kind]] if kind in fea.charted else [fea.charted["pointed_deep"]]
    assert rows[0][way][0] <= total and rows[0][way][1] <= cells
    assert rows[0][looser][2] <= rows[0][way][2]


def test_a_class_that_was_charted_on_one_scene_counts_as_the_worst_of_its_shape():
    """A single ball at the apex says nothing of the spread of all shallow curved contacts."""
    fea = parameters().fea
    shallow, deep = (charted_errors(kind, fea) for kind in ("curved_shallow", "curved_deep"))
    assert all((shallow[way] == deep[way]).all() for way in WAYS)
    assert all((shallow[way] >= fea.charted["curved_shallow"][way]).all() for way in WAYS)


def test_a_class_of_a_shape_never_charted_counts_as_the_worst_there_is():
    fea = parameters().fea
    without = {name: rows for name, rows in fea.charted.items() if not name.startswith("pointed")}
    worst = {way: np.max([rows[way][:2] for rows in without.values()], axis=0) for way in WAYS}
    way = cheapest("pointed_shallow", replace(fea, charted=without))
    assert (worst[way] <= [fea.tolerance, fea.cell_tolerance]).all()


def test_more_than_any_way_can_do_is_refused():
    with pytest.raises(BadInput, match="no charted method .* tolerance = 0.0001 .* class flat_deep; raise them"):
        cheapest("flat_deep", replace(parameters().fea, tolerance=1e-4))


@pytest.mark.parametrize(
    ("shape", "way"), [pytest.param("pointed", "draft", marks=pytest.mark.slow), ("flat", "label")]
)
def test_each_press_is_solved_as_its_class_asks(tmp_path, shape, way):
    solvers = Solvers(MeshFamily(tmp_path, []), tmp_path, parameters().fea)
    press = scene(shape, 0.9)
    result = solvers.solve(press, "auto")
    assert result.status.valid and result.evidence["method"] == way and result.evidence["class"] == f"{shape}_deep"
    # the same solve, but for the order in which several threads add
    asked = solvers.solve(press, way).forces
    assert np.linalg.norm(asked - result.forces) < 1e-6 * np.linalg.norm(asked)
