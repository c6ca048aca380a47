"""Tilt and touch of mountings: what determines them, and how the stages follow what was found."""

from dataclasses import replace

import numpy as np
import pytest

from gelforge.calibration.parameters import make_model
from gelforge.calibration.posterior import Posterior
from gelforge.calibration.readings import Readings, choose_presses, readings_of
from gelforge.calibration.summary import bench
from gelforge.calibration.tilts import (
    DEEPER,
    FEWEST,
    NODES,
    Tilts,
    centre_fault,
    response,
    solved_presses,
    tilted_mountings,
)
from gelforge.errors import BadInput
from gelforge.flow.calibration import found_in, read_values, write_values
from gelforge.geometry.indenters import build
from gelforge.records.press import POSE, RawRow
from tests.support.calibration_law import PARAMS, law_emulator, make_readings, true_values

BALL = build("ball", {"kind": "sphere", "diameter": 12.0, "height": 8.0}, "test")
BLOCK = build("block", {"kind": "cuboid", "size": [6.0, 6.0], "fillet": 0.5, "height": 8.0}, "test")
CATALOGUE = {"ball": BALL, "block": BLOCK}
C10 = 0.085


def session(names, moments=True, mountings=None) -> Readings:
    """Straight presses at the apex, whose moments are of forces at their tips."""
    n = len(names)
    found = replace(make_readings(np.linspace(0.4, 0.8, n), -np.linspace(2.0, 6.0, n)), indenters=np.array(names))
    moment = np.zeros((n, 2)) if moments else np.full((n, 2), np.nan)
    return replace(found, moment=moment, mountings=np.array(mountings or [""] * n))


def responses(n, flat=True) -> Tilts:
    """A flat body whose centre moves by 0.3 mm a degree and whose force grows by 1 % at 2 degrees; or a ball."""
    moved = np.tile([[0.0, 0.3], [-0.3, 0.0]], (n, 1, 1)) if flat else np.tile([[0.0, 0.1], [-0.1, 0.0]], (n, 1, 1))
    force = np.full((n, 2), 0.0025 if flat else 0.0)
    return Tilts(np.full(n, 0.6), np.full(n, flat), force, np.zeros((n, 2)), moved)


def test_responses_are_those_of_the_solves_and_follow_depth():
    """Deeper a flat body needs more tilt for the same, less than in proportion; a ball rolls aside as far at any depth."""
    ends = [{"end": [0.0, 0.0, -10.0], "centre": [0.1, 0.0]}, {"end": [0.0, 0.0, -10.2], "centre": [0.1, -0.6]},
            {"end": [0.0, 0.0, -10.1], "centre": [0.8, 0.0]}]  # fmt: skip
    force, centre, moved = response(ends)
    for flat, alike in ((True, 2.0**DEEPER), (False, 1.0)):
        tilts = Tilts(np.array([0.5]), np.array([flat]), force[None], centre[None], moved[None])
        for tilt, end in zip(NODES, ends, strict=True):
            at = np.array(tilt)[None, None]
            assert tilts.factor(at, np.array([[0.5]]))[0, 0] == pytest.approx(end["end"][2] / -10.0)
            assert tilts.centres(at, np.array([[0.5]]))[0, 0] == pytest.approx(end["centre"])
            assert tilts.centres(alike * at, np.array([[1.0]]))[0, 0] == pytest.approx(end["centre"])
    with pytest.raises(BadInput, match="does not touch the gel"):
        response([*ends[:2], {"end": [0.0, 0.0, 0.0], "centre": [0.0, 0.0]}])


def test_centres_of_flat_presses_find_the_tilt_and_balls_the_origin_of_the_moments():
    """The posterior is largest at the true tilt and origin; flat presses alone would leave one for the other."""
    true, origin = np.array([1.2, -2.0]), np.array([0.4, -0.2])
    depth = np.array([0.5, 0.6, 0.8, 0.6, 0.9])
    flat, ball = responses(3), responses(2, flat=False)
    tilts = Tilts(*(np.concatenate(pair) for pair in zip(vars(flat).values(), vars(ball).values(), strict=True)))
    emulator = replace(law_emulator([4.0] * 5), tilts=tilts)
    model = make_model(PARAMS, "no_slip", sideways=False, tilted=("",))
    values = {**true_values(c10=C10), "tilt": true[None, None]}
    forces, _, found = emulator.forces(depth, values)
    upright = emulator.forces(depth, {**values, "tilt": np.zeros((1, 1, 2))})[0]
    assert (np.abs(forces[0, :3, 2]) > np.abs(upright[0, :3, 2])).all() and (forces[0, 3:] == upright[0, 3:]).all()
    centre = emulator.centres(found, values)[0] + origin
    observed = np.full((5, 3), np.nan)
    observed[:, 2] = forces[0, :, 2]
    posterior = Posterior(emulator, model, depth, observed, 4.0, centre)

    def likelihood(tilt, beside):
        given = {**values, "tilt": np.array(tilt)[None, None]}
        given |= {f"origin_{axis}": np.array([by]) for axis, by in zip("xy", beside, strict=True)}
        return posterior._by_centre(given, emulator.forces(depth, given)[2]).sum()

    best = likelihood(true, origin)
    for off in ((0.3, 0.0), (-0.3, 0.0), (0.0, 0.3), (0.0, -0.3)):
        assert likelihood(true + off, origin) < best
        # what a flat press of middle depth would not notice
        assert likelihood(true + off, origin - [0.3 * off[1], -0.3 * off[0]]) < best
    without = replace(posterior, centre=np.full((5, 2), np.nan))
    assert without._by_centre(
        {**values, **{name: np.ones(1) for name in ("origin_x", "origin_y")}}, found
    ).tolist() == [[0.0] * 5]


def test_a_mounting_needs_flat_presses_with_moments_and_says_so():
    assert tilted_mountings(session(["block", "ball", "block"]), CATALOGUE) == (("",), [])
    assert tilted_mountings(session(["ball", "ball"]), CATALOGUE) == ((), [])  # nothing feels tilt
    for few, said in ((session(["block", "ball"]), "which has 1"), (session(["block"] * 3, False), "which has none")):
        found, (sentence,) = tilted_mountings(few, CATALOGUE)
        assert found == () and said in sentence and f"{FEWEST} straight presses" in sentence and "mx_nm" in sentence
    two = session(["block"] * 4, mountings=["a", "a", "b", "b"])
    assert tilted_mountings(two, CATALOGUE)[0] == ("a", "b")
    stated = replace(two, stated=np.array([True, True, False, False]))
    assert tilted_mountings(stated, CATALOGUE) == (("b",), [])


def test_moments_about_another_point_are_not_used():
    """One to this side and one to that: they are not about the apex. All to one side is the sensor's origin or a tilt."""
    pose = session(["ball"] * 4)
    pose.pose[:, 0] = [-3.0, -1.0, 1.0, 3.0]
    at = np.column_stack([0.0 * pose.pose[:, 0], -pose.pose[:, 0] * pose.force[:, 2]])
    assert centre_fault(replace(pose, moment=at)) == ""
    assert centre_fault(replace(pose, moment=at + [[0.0, 2.0]] * -pose.force[:, 2:])) == ""
    assert "about its apex" in centre_fault(replace(pose, moment=-at))


def test_the_firmest_presses_of_a_mounting_are_solved_at_tilts():
    found = session(["block", "ball"] * 10)
    flat = found.indenters == "block"
    chosen = solved_presses(found, flat)
    assert (flat[chosen].sum(), (~flat[chosen]).sum()) == (6, 2) and chosen.min() >= 8


def test_each_mounting_gives_presses():
    found = session(["block"] * 40, mountings=["a"] * 30 + ["b"] * 10)
    chosen = choose_presses(found, 8, "coulomb")
    assert [(found.mountings[chosen] == name).sum() for name in "ab"] == [8, 8]


def test_straight_presses_of_flat_bodies_are_among_the_chosen():
    """Blocks that are pressed sideways outnumber the two that are not, which alone show the tilt."""
    found = session(["ball"] * 6 + ["block"] * 12)
    found.pose[8:, 3] = 0.1
    for law in ("coulomb", "no_slip"):
        for most in (2, 5, 8, 17):
            chosen = choose_presses(found, most, law, CATALOGUE)
            assert len(set(chosen)) == most and {6, 7} <= set(chosen)
    assert not {6, 7} <= set(choose_presses(found, 2, "coulomb"))
    assert len(choose_presses(found, 99, "coulomb", CATALOGUE)) == 18


def test_readings_know_mounting_moments_and_whether_the_tilt_is_stated():
    cells = {"sample_id": "p", "indenter": "ball", **dict.fromkeys(POSE, "0"), "dz_mm": "-0.5", "fx_n": "0", "fy_n": "0",
             "fz_n": "-2", "mx_nm": "0.003", "my_nm": "-0.004", "mounting": "a"}  # fmt: skip
    rows = [RawRow(2, cells), RawRow(3, cells | {"dz_mm": "-0.6", "mounting": "b", "mx_nm": ""}),
            RawRow(4, cells | {"dz_mm": "-0.7", "mounting": "c", "tilt_x_deg": "0"})]  # fmt: skip
    found = readings_of(rows, "log.csv", mounting_tilt_deg={"b": (1.0, 2.0)})
    assert found.mountings.tolist() == ["a", "b", "c"] and found.stated.tolist() == [False, True, True]
    assert found.centre[0].tolist() == [-2.0, -1.5] and np.isnan(found.centre[1, 1])
    assert readings_of(rows, "log.csv", tilt_deg=(1.0, 0.0)).stated.all()


def summary_of(mountings, tilted, **found):
    model = make_model(PARAMS, "no_slip", sideways=False, mountings=mountings, tilted=tilted)
    parameters = {name: {"median": found.get(name, 0.0)} for name in model.free}
    whole = bench(parameters, model) | {"stated_tilt_deg": {"c": [0.5, 0.0]}}
    c10 = {"median": C10, "interval68": [0.08, 0.09], "interval95": [0.07, 0.1]}
    return {"c10": c10, "bench": whole, "law": "no_slip", "used": ["p"], "parameters": {}}


def test_what_was_found_of_one_mounting_is_the_benchs():
    poses = found_in("lab", summary_of(("",), ("",), offset=0.0312, tilt_x=-0.02, tilt_y=2.06)).params["poses"]
    assert poses["touch_offset_mm"] == 0.031 and poses["tilt_deg"] == [0.0, 2.1]
    assert "tilt_deg" not in found_in("lab", summary_of(("",), ())).params["poses"]


def test_what_was_found_of_several_is_each_ones_and_frozen(tmp_path):
    found = {"offset of a": 0.1, "offset of b": -0.05, "tilt_x of a": 1.26, "tilt_y of a": -3.0}
    values = found_in("lab", summary_of(("a", "b"), ("a",), **found))
    poses = values.params["poses"]
    assert poses["mounting_touch_offset_mm"] == {"a": 0.1, "b": -0.05}
    assert poses["mounting_tilt_deg"] == {"a": [1.3, -3.0], "c": [0.5, 0.0]}
    path = tmp_path / "data/lab/calibration.toml"
    path.parent.mkdir(parents=True)
    write_values(path, values)
    assert read_values(path) == values


def test_rows_that_name_no_mounting_follow_what_was_found_of_them():
    """Not the middle of all mountings; and a mounting whose tilt was not found does not take theirs."""
    found = {
        "offset": 0.012,
        "offset of a": -0.069,
        "offset of b": 0.2,
        "tilt_x": 0.1,
        "tilt_y": -0.4,
        "tilt_x of a": 1.3,
    }
    poses = found_in("lab", summary_of(("", "a", "b"), ("", "a"), **found)).params["poses"]
    assert poses["touch_offset_mm"] == 0.012 and poses["mounting_touch_offset_mm"] == {"a": -0.069, "b": 0.2}
    assert poses["tilt_deg"] == [0.1, -0.4]
    assert poses["mounting_tilt_deg"] == {"a": [1.3, 0.0], "b": [0.0, 0.0], "c": [0.5, 0.0]}
