"""The bench's hidden forces against an accurate solve of the same path."""

from dataclasses import replace

import numpy as np
import pytest

from gelforge.geometry.gel import Gel, load_gel
from gelforge.geometry.indenters import load_catalogue
from gelforge.mechanics.hexsettings import quality
from gelforge.mechanics.material import REFERENCE_C10, Material
from gelforge.mechanics.scene import Interface, Scene
from gelforge.mechanics.solvers.hex import HexSolver
from gelforge.records.press import Press
from gelforge.virtualrig.bench import SETTINGS, Bench, frames_along, load_cell_error
from gelforge.virtualrig.rigplan import orders, read_plan
from tests.support.surface_values import base_reactions


@pytest.fixture(scope="module")
def plan(root):
    """The demo's bench with a frame that does not give way and a tip that slides without friction."""
    demo = read_plan(root / "workflow" / "rig" / "demo.toml")
    return replace(demo, truth=replace(demo.truth, friction=0.0, compliance_mm_per_n=0.0, cnc_um=0.0))


def test_hidden_forces_are_those_of_fine_hexahedra(plan, root):
    """Within 1.5 % of label; they act below the tip, so that their moment about the gel's apex is known."""
    name = "triangle_10"  # a ball: below, on another gel
    catalogue = load_catalogue(root / "workflow" / "indenters.toml", [name])
    bench = Bench(plan, catalogue, Gel())
    order = replace(orders(plan)[0], indenter=name, x=1.3, y=-2.1, depth=1.0, rot_deg=70.0, shear=(0.0, 0.0))
    pressed = bench.press(order)[-1]
    scene = Scene(Gel(), Material(nu=plan.truth.nu), catalogue[name], pressed.real, Interface("frictionless"))
    exact = HexSolver(quality("label")).solve(scene).total[2] * plan.truth.c10_mpa / REFERENCE_C10
    assert pressed.force[2] == pytest.approx(exact, rel=0.015)
    (mx, my, _), (x, y) = 1e3 * pressed.moment / pressed.force[2], (order.x, order.y)
    assert np.hypot(mx - y, my + x) < 0.3


@pytest.mark.slow
def test_hidden_sideways_force_is_that_of_fine_hexahedra(plan, root):
    """Within 3 % under edges that are dragged, and along the normal within what both solves state."""
    catalogue = load_catalogue(root / "workflow" / "indenters.toml", ["triangle_10"])
    dragged = replace(plan, truth=replace(plan.truth, friction=0.7, shear_compliance_mm_per_n=0.0))
    bench = Bench(dragged, catalogue, Gel())
    order = replace(
        orders(plan)[0], indenter="triangle_10", x=1.0, y=-1.0, depth=0.9, rot_deg=65.0, shear=(-0.25, 0.1)
    )
    pressed = bench.press(order)[-1]
    scene = Scene(
        Gel(), Material(nu=plan.truth.nu), catalogue["triangle_10"], pressed.real, Interface("coulomb", 0.7)
    )
    # finer than the hexahedra that the bench is brought to, in both directions
    finer = replace(quality("label"), layers=8, widened=(5, 3))
    found, stiffer = HexSolver(finer).solve(scene), plan.truth.c10_mpa / REFERENCE_C10
    exact = found.total * stiffer
    assert np.hypot(*pressed.force[:2]) == pytest.approx(np.hypot(*exact[:2]), rel=0.03)
    assert abs(pressed.force[2] - exact[2]) < stiffer * (pressed.result.error_n + found.error_n)  # what both state


@pytest.mark.slow
def test_a_flat_body_with_friction_converges_at_every_frame(plan, root):
    """What the last step left pending is carried out where the body stands, with all points held at first.

    Where points may slip at once they drag others along: under flat bodies no equilibrium was found then.
    """
    body = load_catalogue(root / "workflow" / "indenters.toml", ["block_07"])["block_07"]
    press, law = Press(0.5, -1.0, 0.0, 0.15, 0.1, -1.2, 20.0), Interface("coulomb", 0.8)
    scenes = [Scene(Gel(), Material(), body, replace(press, **way), law) for way in frames_along(press, 3)]
    results = HexSolver(SETTINGS).solve_frames(scenes)
    assert all(result.status.valid for result in results)
    assert -results[0].total[2] < -results[1].total[2]


def test_hidden_forces_on_a_gel_of_other_thickness_are_those_of_fine_hexahedra(plan, root):
    """At one depth a thinner gel is stiffer."""
    catalogue, gel = (
        load_catalogue(root / "workflow" / "indenters.toml", ["sphere_15"]),
        load_gel("gelsight_mini-3.6mm"),
    )
    bench = Bench(plan, catalogue, Gel())
    order = replace(orders(plan)[0], indenter="sphere_15", x=1.3, y=-2.1, depth=1.0, rot_deg=70.0, shear=(0.0, 0.0))
    usual, pressed = bench.press(order)[-1], bench.press(replace(order, gel=gel.name))[-1]
    # at one depth a gel a tenth thinner is 16 % stiffer
    assert pressed.force[2] / usual.force[2] > 1.075
    scene = Scene(gel, Material(nu=plan.truth.nu), catalogue["sphere_15"], pressed.real, Interface("frictionless"))
    exact = HexSolver(quality("label")).solve(scene).total[2] * plan.truth.c10_mpa / REFERENCE_C10
    assert pressed.force[2] == pytest.approx(exact, rel=0.015)
    estimated = bench.estimate(replace(order, gel=gel.name), 0.0, 1.0) / bench.estimate(order, 0.0, 1.0)
    assert estimated == pytest.approx(pressed.force[2] / usual.force[2], rel=0.06)


def test_a_bench_that_does_not_give_way_keeps_its_load_limit(plan, root):
    bench = Bench(plan, load_catalogue(root / "workflow" / "indenters.toml", ["sphere_15"]), Gel())
    order = replace(orders(plan)[0], indenter="sphere_15", x=0.0, y=0.0, depth=2.0, max_force_n=5.0)
    reached = bench.reached(order, 0.0)
    assert bench.estimate(order, 0.0, reached) <= 5.0 < bench.estimate(order, 0.0, 1.1 * reached)


def test_the_frames_of_a_straight_press_are_all_of_its_way_down(plan, root):
    """The axes' play is an error of travel: what was not ordered to travel sideways has none.

    Each reading of the load cell has a noise of its own, whatever its frame, axis and press.
    """
    played = replace(plan, frames=4, truth=replace(plan.truth, cnc_um=0.25))
    bench = Bench(played, load_catalogue(root / "workflow" / "indenters.toml", ["sphere_15"]), Gel())
    order = replace(orders(plan)[0], indenter="sphere_15", x=0.0, y=0.0, depth=0.3, shear=(0.0, 0.0))
    first, second = (bench.press(replace(order, index=index)) for index in (0, 1))
    ends = [pressing.real.dz for pressing in first]
    assert len(ends) == 4 and (np.diff(ends) < -0.05).all()
    noise = [
        each.read_force - each.force - load_cell_error(played, index)
        for index, frames in enumerate((first, second)) for each in frames
    ]  # fmt: skip
    turning = [each.read_moment - each.moment for each in (*first, *second)]
    for drawn, scale in ((noise, played.truth.force_noise_n), (turning, played.truth.moment_noise_nm)):
        values = np.ravel(drawn) / scale
        assert len(np.unique(values.round(6))) == values.size == 24 and 0.5 < values.std() < 1.6


@pytest.fixture(scope="module")
def dragged(plan, root):
    """A bench that yields, without noise or play, whose press goes down and sideways; its order and what it reports."""
    truth = replace(
        plan.truth, friction=np.inf, compliance_mm_per_n=0.006, shear_compliance_mm_per_n=0.02, force_noise_n=0.0,
        moment_noise_nm=0.0, force_bias_n=(0.3, -0.2, 0.1), drift_n=0.0, touch_offset_mm=0.05, touch_scatter_mm=0.0,
    )  # fmt: skip
    bench = Bench(replace(plan, truth=truth), load_catalogue(root / "workflow/indenters.toml", ["sphere_15"]), Gel())
    order = replace(
        orders(plan)[0], indenter="sphere_15", x=2.0, y=-3.0, depth=1.0, rot_deg=20.0, shear=(-0.15, 0.25), max_force_n=100.0
    )  # fmt: skip
    return truth, order, bench.press(order)[-1]


def test_force_and_moment_of_the_bench_are_what_the_base_of_the_gel_bears(dragged):
    """About the apex, by the stresses in the bonded gel: no contact force and no arm of one goes into them."""
    truth, _, pressed = dragged
    result, scale = pressed.result, truth.c10_mpa / REFERENCE_C10 * pressed.result.evidence["extrapolated"]
    mesh = result.solved_mesh
    held = scale * base_reactions(mesh, result.displacement, Material(nu=truth.nu))
    np.testing.assert_allclose(pressed.force, -held.sum(axis=0), atol=1e-4 * np.linalg.norm(pressed.force))
    moment = -1e-3 * np.cross(mesh.nodes[mesh.base], held).sum(axis=0)
    np.testing.assert_allclose(pressed.moment, moment, atol=1e-4 * np.linalg.norm(moment))
    np.testing.assert_allclose(pressed.read_force - pressed.force, truth.force_bias_n, atol=1e-12)
    np.testing.assert_array_equal(pressed.read_moment, pressed.moment)
    # on a gel that is pressed down and dragged to -x and +y
    assert pressed.force[2] < 0.0 and pressed.force[0] < -0.2 and pressed.force[1] > 0.2


def test_the_frame_takes_of_each_axis_what_its_spring_gives_way(dragged):
    """The tip falls short of what is commanded by force times compliance: one along z, another along x and y."""
    truth, order, pressed = dragged
    log, real = pressed.log, pressed.real
    springs = np.array([truth.shear_compliance_mm_per_n] * 2 + [truth.compliance_mm_per_n])
    given_way = np.array([log.dx - real.dx, log.dy - real.dy, log.dz - real.dz])
    np.testing.assert_allclose(given_way, springs * pressed.force, atol=1e-12)
    assert (np.sign(given_way) == [-1, 1, -1]).all() and abs(given_way[1]) > 0.01
    assert (log.x0, log.y0, log.z0, real.z0) == (order.x, order.y, 0.0, truth.touch_offset_mm)


def test_a_stiff_bench_logs_at_every_frame_what_was_ordered(plan, root):
    """Whatever the play of its axes: a motor knows its own steps. No axis errs before it has moved."""
    stiff = replace(plan, frames=4, truth=replace(
        plan.truth, friction=np.inf, cnc_um=100.0, shear_compliance_mm_per_n=0.0, touch_scatter_mm=0.0))  # fmt: skip
    bench = Bench(stiff, load_catalogue(root / "workflow/indenters.toml", ["sphere_15"]), Gel())
    order = replace(
        orders(plan)[0], indenter="sphere_15", x=0.5, y=-1.0, depth=0.6, rot_deg=0.0, shear=(0.1, -0.3), max_force_n=100.0
    )  # fmt: skip
    frames = bench.press(order)
    ways = np.array([[each.log.dx, each.log.dy, each.log.dz] for each in frames])
    np.testing.assert_allclose(ways, [[0, 0, -0.3], [0, 0, -0.6], [0.05, -0.15, -0.6], [0.1, -0.3, -0.6]], atol=1e-12)
    real = np.array([[each.real.dx, each.real.dy, each.real.dz] for each in frames])
    assert not real[:2, :2].any() and 1e-3 < np.abs(real[-1] - ways[-1]).max() < 0.1
