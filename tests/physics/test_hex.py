"""The contact solver against laws of contact mechanics. Meshes are coarse: the laws hold on any of them."""

from dataclasses import replace

import numpy as np
import pytest

from gelforge.flow.files import read_json
from gelforge.geometry.gel import Gel
from gelforge.geometry.indenters import build, load_catalogue
from gelforge.geometry.touch import first_touch
from gelforge.mechanics.contact.law import LAWS
from gelforge.mechanics.contact.penalty import FREE, STICK
from gelforge.mechanics.hexsettings import HexSettings, quality
from gelforge.mechanics.linear.factorisation import SuperLU
from gelforge.mechanics.material import Material
from gelforge.mechanics.mesh.hexmesh import FineBox, HexMesh, fine_box, mesh_on_lines
from gelforge.mechanics.path.equilibrium import CYCLING
from gelforge.mechanics.path.loadpath import path_pose
from gelforge.mechanics.result import friction_error_n
from gelforge.mechanics.scene import Interface, Scene
from gelforge.mechanics.solvers.hex import MOST_BELOW_MM, MOST_INSIDE_MM, HexSolver, solve_hex
from gelforge.records.press import Press
from gelforge.records.status import Status
from tests.support.flat_pad import FlatPad, SlideThenPress
from tests.support.known_scenes import scene_of

COARSE = HexSettings(size=1.2, layers=3, gauss=3, press_steps=3, shear_steps=2)


class Sphere:
    """A ball standing on the tip plane."""

    def __init__(self, diameter):
        self.name, self.r = f"ball_{diameter:g}", diameter / 2

    def distance(self, points):
        v = points - [0, 0, self.r]
        length = np.linalg.norm(v, axis=1)
        return length - self.r, v / np.maximum(length, 1e-300)[:, None]

    def radius(self):
        return self.r


class Plate:
    """A half space above the tip plane."""

    name = "plate"

    def distance(self, points):
        return -points[:, 2], np.tile([0, 0, -1.0], (len(points), 1))

    def radius(self):
        return 30.0


def ball(depth=1.0, dx=0.0, dy=0.0, x0=0.0, law="no_slip", mu=0.0, material=Material(), diameter=15.0):
    press = Press(x0, 0.0, 0.0, dx, dy, -depth)
    return Scene(Gel(), material, Sphere(diameter), press, Interface(law, mu))


@pytest.fixture(scope="module")
def solver():
    return HexSolver(COARSE)


@pytest.fixture(scope="module")
def straight(solver):
    return solver.solve(ball())


@pytest.fixture(scope="module")
def sheared(solver):
    return solver.solve(ball(dx=0.3, dy=0.1))


def test_a_step_whose_matrix_cannot_be_factorised_is_halved():
    """A gel without stiffness: scipy's factorisation, which serves where MKL is missing, finds no pivot."""
    solver, scene = HexSolver(COARSE), ball()
    box = fine_box(scene, COARSE.size, COARSE.across)
    run = solver._run(scene, solver.mesh(scene.gel, box), COARSE, box.size)
    run.system.linear = SuperLU(run.system.pattern.indptr, run.system.pattern.indices)
    run.moduli = 1e-60, 1e-60
    assert run.follow(0.0) is Status.DIVERGED
    assert run.control.cuts > COARSE.max_cuts


def test_evidence_of_a_good_solve(straight):
    e = straight.evidence
    assert straight.status is Status.OK
    assert e["pulling_fraction"] < 1e-3
    assert e["penetration_mm"] < 0.03  # pressure of some 0.3 MPa over the penalty of 60 N/mm^3, times a margin
    assert set(e) >= {"equilibrium_residual", "newton_iterations", "rounds", "seconds", "load_steps"}
    moment = np.einsum("m,mi->i", straight.contact.weights, straight.contact.traction)
    assert np.allclose(moment, straight.total, rtol=1e-9)
    off = np.setdiff1d(np.arange(len(straight.forces)), straight.mesh.surface_nodes)
    assert not straight.forces[off].any()


def test_straight_press_has_no_shear_and_is_symmetric(straight):
    assert np.abs(straight.total[:2]).max() < 1e-3 * abs(straight.total[2])
    nx, ny, nz = straight.mesh.shape
    fz = straight.forces[:, 2].reshape(nz + 1, ny + 1, nx + 1)[-1]
    # mesh and scene are symmetric; what is left is the load path's tolerance of 1e-4, magnified by touching points
    assert np.abs(fz - fz[::-1]).max() < 5e-3 * np.abs(fz).max()
    assert np.abs(fz - fz[:, ::-1]).max() < 5e-3 * np.abs(fz).max()


def test_mirrored_shear_mirrors_the_force(solver, sheared):
    mirrored = solver.solve(ball(dx=-0.3, dy=0.1)).total
    assert np.allclose(mirrored * [-1, 1, 1], sheared.total, rtol=5e-3, atol=5e-3)


def test_shear_pulls_the_gel_along(sheared):
    assert sheared.total[0] > 0.5 and sheared.total[2] < -4.0
    # the stiffness of a round contact in an isotropic layer is the same in all directions
    assert sheared.total[0] / sheared.total[1] == pytest.approx(3.0, rel=0.1)


def test_stick_is_held_where_it_touches(sheared):
    state = sheared.contact
    sticking = state.status == STICK
    pose = path_pose(ball(dx=0.3, dy=0.1), 2.0)
    drift = np.linalg.norm(pose.to_gel(state.stick_point[sticking]) - state.position[sticking], axis=1)
    # traction over penalty: 0.032 mm at most, on these coarse hexahedra with three points a side
    given = (
        np.linalg.norm(state.traction[sticking], axis=1) * COARSE.size / (COARSE.penalty * Material().shear_modulus)
    )
    assert sticking.sum() > 50 and drift == pytest.approx(given, rel=1e-6) and drift.max() < 0.035
    distance, _ = Sphere(15.0).distance(state.stick_point[sticking])
    assert np.abs(distance).max() < 1e-6


def test_first_touch_sticking_needs_few_steps():
    """Load steps hardly change the force: 2 steps are within 2 % of 12 (gluing where a step ends: 4 %)."""
    few, many = (solve_hex(ball(), replace(COARSE, press_steps=n)).total[2] for n in (2, 12))
    assert few == pytest.approx(many, rel=0.02)


def test_slide_in_air_leaves_no_shear():
    """Motion before touch is no stick, as it is in CalculiX' contact pairs."""
    press = SlideThenPress(-0.5, 0.0, 0.0, 0.5, 0.0, -0.5)
    for body, law in ((Plate(), Interface("no_slip")), (Sphere(15.0), Interface("coulomb", 0.4))):
        settings = replace(COARSE, box=FineBox(-3, 3, -3, 3, 1.5))
        total = solve_hex(Scene(FlatPad(), Material(), body, press, law), settings).total
        assert total[2] < -0.5 and np.abs(total[:2]).max() < 1e-3 * abs(total[2])


def test_frictionless_contact_has_normal_tractions(solver):
    result = solver.solve(ball(law="frictionless"))
    state = result.contact
    pressed = state.status != FREE
    _, normal = Sphere(15.0).distance(path_pose(ball(), 1.0).to_indenter(state.position[pressed]))
    traction = state.traction[pressed]
    assert np.abs(np.cross(traction, normal)).max() < 1e-9
    assert not (state.status == STICK).any()


@pytest.fixture(scope="module")
def rubbed():
    return solve_hex(ball(dx=0.5, law="coulomb", mu=0.2), COARSE)


@pytest.mark.parametrize("name", [name for name, law in LAWS.items() if law.slips])
def test_tangential_traction_stays_within_the_limit_of_the_law(name):
    scene = ball(0.8, dx=0.4, law=name, mu=0.2).direct
    result, law = solve_hex(scene, COARSE), scene.interface.contact
    assert result.status is Status.OK
    state, pose = result.contact, path_pose(scene, scene.press.end)
    pressed = np.linalg.norm(state.traction, axis=1) > 0
    _, normal = Sphere(15.0).distance(pose.to_indenter(state.position[pressed]))
    traction = state.traction[pressed]
    pressure = np.einsum("pi,pi->p", traction, normal)
    tangential = np.linalg.norm(traction - pressure[:, None] * normal, axis=1)
    weights = state.weights[pressed]
    assert pressure.min() > 0
    # the limit is that of the penalties; the indenter's curvature turns the normal a little between them and here
    beyond = np.maximum(tangential - law.slip_limit(pressure, 1.0)[0], 0.0)
    assert weights @ beyond < 0.02 * 0.2 * (weights @ pressure)


def test_coulomb_slip_is_along_the_travel(rubbed):
    """Sheared by half the depth, nearly all slips: the force is mu times the pressure, along x."""
    assert rubbed.total[0] / -rubbed.total[2] == pytest.approx(0.2, rel=0.1)
    assert abs(rubbed.total[1]) < 0.02 * rubbed.total[0]


def test_what_friction_is_off_by_changes_the_force_by_what_is_stated(rubbed):
    more = solve_hex(ball(dx=0.5, law="coulomb", mu=0.22), COARSE)
    stated = friction_error_n(rubbed.evidence, 0.2, 0.02)
    # an upper bound, and no wide one: a ball that is dragged further ploughs, which takes a part back
    assert 0.6 * stated < np.linalg.norm(more.total - rubbed.total) < 1.1 * stated


def dragged(law, mu=0.0, far=0.6, body=None, depth=0.4):
    """A flat-topped block under a plate or a body that goes down and then `far` mm sideways."""
    press = Press(0.0, 0.0, 0.0, far, 0.0, -depth)
    return Scene(FlatPad(width=14.0, length=14.0), Material(), body or Plate(), press, Interface(law, mu))


WHOLE = replace(COARSE, box=FineBox(-7, 7, -7, 7, 1.4))


@pytest.mark.parametrize("mu", [0.1, 0.3])
def test_gross_slip_on_a_plate(mu):
    """Every point slips: the force along the travel is mu times the normal one, and none is across."""
    result = solve_hex(dragged("coulomb", mu, far=1.5), WHOLE)
    total = result.total
    assert result.status is Status.OK
    # where the block bulges from under the plate, friction turns with the slip: 3 % of it points elsewhere
    assert total[0] / -total[2] == pytest.approx(mu, rel=0.03)
    # a path with friction takes states out of balance by CYCLING of the contact force
    assert abs(total[1]) < CYCLING * -total[2]


def test_friction_with_a_large_coefficient_is_no_slip():
    held, rough = solve_hex(dragged("no_slip", far=0.3), WHOLE), solve_hex(dragged("coulomb", 5.0, far=0.3), WHOLE)
    # friction's penalty is a tenth of the penalty; multipliers leave 1 % of what they give way
    assert np.allclose(rough.total, held.total, rtol=0.01, atol=0.01)
    state, pose = rough.contact, path_pose(dragged("coulomb", 5.0, far=0.3), 2.0)
    drift, sideways = (pose.to_gel(state.stick_point) - state.position)[:, :2], state.traction[:, :2]
    soft = COARSE.penalty * Material().shear_modulus / WHOLE.size / 10.0
    assert (state.status == STICK).all()
    assert np.linalg.norm(drift, axis=1).sum() < 0.02 * np.linalg.norm(sideways, axis=1).sum() / soft


@pytest.mark.parametrize(
    "body", [Sphere(15.0), build("bar", {"kind": "cuboid", "size": [30, 5], "fillet": 1, "height": 10})]
)
def test_without_friction_only_the_end_of_a_path_counts(body):
    """Dragged load step by load step and pressed straight down there, on the same hexahedra."""
    dragged = Scene(Gel(), Material(), body, Press(0.3, 0.2, 0.0, 0.16, 0.08, -0.6, 20.0), Interface("frictionless"))
    settings = replace(COARSE, box=fine_box(dragged, COARSE.size))
    slow, fast = HexSolver(settings).solve_frames([dragged])[0], solve_hex(dragged, settings)
    assert slow.status.valid and fast.status is Status.OK
    assert fast.evidence["path"][-1][0] == 1.0 and slow.evidence["path"][-1][0] == 2.0
    np.testing.assert_allclose(fast.total, slow.total, atol=1e-3 * np.linalg.norm(slow.total))
    apart = np.linalg.norm(fast.forces - slow.forces, axis=1).sum()
    assert apart < 0.02 * np.linalg.norm(slow.total)


def test_friction_without_a_coefficient_is_frictionless():
    smooth, slick = (solve_hex(ball(dx=0.3, law=law, mu=1e-6), COARSE) for law in ("frictionless", "coulomb"))
    assert np.allclose(slick.total, smooth.total, rtol=1e-4, atol=1e-4)


@pytest.mark.slow
def test_a_path_with_friction_goes_on_where_its_tolerance_cannot_be_met():
    """A point at the edge of slipping may go to and fro for ever; the end is held to its tolerance all the same."""
    never = replace(COARSE, tolerance=1e-30)
    settled = solve_hex(ball(0.8, dx=0.2, law="coulomb", mu=0.3), COARSE)
    uncut = solve_hex(ball(0.8, dx=0.2, law="coulomb", mu=0.3), never)
    assert uncut.status is Status.OK and uncut.evidence["cuts"] == 0
    assert uncut.evidence["equilibrium_residual"] <= 1e-7
    assert np.linalg.norm(uncut.total - settled.total) < 0.02 * np.linalg.norm(settled.total)
    stuck = solve_hex(ball(0.8, dx=0.2), never)  # without friction's kinks a step that fails is cut
    assert stuck.evidence["cuts"] > 0 and stuck.evidence["reached"] < 1.0


@pytest.mark.parametrize("mu", [0.7, pytest.param(0.9, marks=pytest.mark.slow)])
def test_a_block_that_is_dragged_finds_its_end(mu, root):
    """A few points at an edge change between sticking and slipping with every full step of Newton's method; shorter ones end it."""
    body = load_catalogue(root / "workflow" / "indenters.toml", ["cuboid_10"])["cuboid_10"]
    press = Press(-0.55, 0.92, -0.0176, -0.393, 0.009, -1.0322, 54.6)
    result = HexSolver(quality("draft")).solve(Scene(Gel(), Material(), body, press, Interface("coulomb", mu)))
    assert result.status is Status.OK


@pytest.mark.slow
def test_partial_slip_grows_into_gross_slip():
    """Cattaneo and Mindlin: the shear force of a ball starts as without slip, bends, and meets mu times the load."""
    settings, mu = replace(COARSE, shear_steps=8), 0.3
    curves = {}
    for law in ("no_slip", "coulomb"):
        path = np.array(solve_hex(ball(dx=1.2, law=law, mu=mu), settings).evidence["path"])
        curves[law] = path[path[:, 0] >= 1.0]
    # with friction the path has more load steps: compared where both laws have the same travel
    at, own = curves["no_slip"][:, 0], curves["coulomb"]
    curves["coulomb"] = np.column_stack([at, *(np.interp(at, own[:, 0], own[:, k]) for k in (1, 2, 3))])
    slope = {law: np.diff(curve[:, 1]) / np.diff(curve[:, 0]) for law, curve in curves.items()}
    # the press alone has slip at the rim, and the multipliers of a step are complete in the next
    assert slope["coulomb"][0] == pytest.approx(slope["no_slip"][0], rel=0.25)
    # once all slips, the ball runs up and down the gel between its Gauss points
    assert np.all(np.diff(slope["coulomb"]) < 0.1 * slope["coulomb"][0])
    assert np.all(curves["coulomb"][1:, 1] < curves["no_slip"][1:, 1] * 1.02)  # before the travel there is none
    # the ball ploughs: what it pushes up in front of it presses back by a tenth of the friction
    assert curves["coulomb"][-1, 1] / -curves["coulomb"][-1, 3] == pytest.approx(1.1 * mu, rel=0.07)


@pytest.mark.slow
def test_nothing_of_an_earlier_scene_stays_in_a_solver():
    """A used solver and a fresh one find the same forces, but for the order in which several threads add."""
    used, scene = HexSolver(COARSE), ball(dx=0.2, law="coulomb", mu=0.8)
    used.solve(ball(dx=-0.1, law="coulomb", mu=0.8))
    again, fresh = used.solve(scene).forces, HexSolver(COARSE).solve(scene).forces
    assert np.linalg.norm(again - fresh) < 1e-6 * np.linalg.norm(fresh)


def test_no_contact_is_known_from_geometry(solver):
    body = build("ball", {"kind": "sphere", "diameter": 8, "height": 10})
    scene = replace(ball(), indenter=body, press=Press(0, 0, 2.0, 0, 0, -1.0))
    result = solver.solve(scene)
    assert result.status is Status.NO_CONTACT and not result.forces.any()
    assert result.evidence["newton_iterations"] == 0
    # beside the apex the gel slopes; how far a press goes sideways afterwards changes nothing of its touch
    straight, aside = (first_touch(Gel(), body, Press(4.0, 0, 0.6, dx, 0, -1.0)) for dx in (0.0, 2.0))
    assert straight == pytest.approx(aside, abs=2e-3) and 0.6 < straight < 0.9  # of points 0.2 mm apart


@pytest.mark.parametrize("depth", [4.0, 4.5])
def test_a_press_through_the_gel_is_out_of_range(depth):
    """The tip would stand in or below the base: a status with its reason, no exception and no force."""
    result = solve_hex(ball(depth=depth, diameter=4.0), replace(COARSE, press_steps=6))
    assert result.status is Status.OUT_OF_RANGE and not result.forces.any()
    assert "base" in result.evidence["reason"]


@pytest.mark.parametrize(("depth", "steps", "cuts"), [(3.0, 6, 8), (3.5, 2, 1), (3.8, 6, 8), (3.95, 6, 8)])
def test_what_ends_ok_neither_penetrates_nor_leaves_the_base(depth, steps, cuts):
    """So deep, rounding decides whether Newton's method arrives; wherever it does, the state is a possible one."""
    result = solve_hex(ball(depth=depth, diameter=4.0), replace(COARSE, press_steps=steps, max_cuts=cuts))
    lowest = (result.mesh.nodes + result.displacement)[:, 2].min()
    possible = result.evidence["penetration_mm"] <= MOST_INSIDE_MM and lowest >= -Gel().height - MOST_BELOW_MM
    assert (result.status is Status.OK and possible) or not result.forces.any()
    assert result.status is Status.OK or depth > 3.0


def test_solver_reuses_what_it_made(solver):
    """Presses of one body to one place share a mesh, whatever the friction."""
    first = solver.solve(ball(x0=0.10, depth=0.3)).mesh
    assert solver.solve(ball(x0=0.10, depth=0.3, law="frictionless")).mesh is first


# ---- Hertz


def half_space(size):
    """A block of 20 mm pressed 0.05 mm at its middle: size of the hexahedra against a contact radius of 1 mm."""
    gel = FlatPad(width=40.0, length=40.0, corner_radius=0.0, height=20.0)

    def lines():
        inner = np.arange(0, 1.8 + 1e-9, size)
        outer = np.geomspace(inner[-1] + size * 1.3, 20.0, 9)
        half = np.concatenate([inner, outer])
        return np.concatenate([-half[:0:-1], half])

    depth = np.concatenate([np.arange(0, 1.2 + 1e-9, size), np.geomspace(1.2 + 1.3 * size, 20.0, 8)])
    return gel, mesh_on_lines(gel, lines(), lines(), 1 - depth[::-1] / 20.0)


class OnMesh(HexSolver):
    """A solver that uses one given mesh."""

    def __init__(self, settings, mesh: HexMesh):
        super().__init__(settings)
        self._given = mesh

    def mesh(self, gel, box):
        return self._given


@pytest.mark.slow
def test_hertz():
    """Frictionless ball, a / R = 0.05, contact radius 1 mm: F = 4/3 E / (1 - nu^2) sqrt(R) d^1.5, as hexahedra shrink.

    The finite height of the bonded block stiffens it: Dimitriadis et al. (2002), Biophys. J. 82, 2798-2810, eq. 12,
    to second order in sqrt(R d) / height = 0.05.
    """
    radius, depth, material = 20.0, 0.05, Material(nu=0.45)
    young = 2 * material.shear_modulus * (1 + material.nu)
    hertz = 4 / 3 * young / (1 - material.nu**2) * np.sqrt(radius) * depth**1.5
    alpha = -(1.2876 - 1.4678 * material.nu + 1.3442 * material.nu**2) / (1 - material.nu)
    thin = 2 * alpha / np.pi * np.sqrt(radius * depth) / 20.0
    hertz *= 1 - thin + thin**2
    errors = []
    for size in (1.2, 0.6, 0.4):
        gel, mesh = half_space(size)
        scene = Scene(gel, material, Sphere(2 * radius), Press(0, 0, 0, 0, 0, -depth), Interface("frictionless"))
        settings = HexSettings(size=size, press_steps=2, penalty=3000.0, box=FineBox(-2, 2, -2, 2, size))
        errors.append(-OnMesh(settings, mesh).solve(scene).total[2] / hertz - 1)
    # what is left as hexahedra shrink: the block's finite width, and 0.5 % for a / R
    assert abs(errors[1]) < 0.03 and abs(errors[2]) < 0.03
    assert abs(errors[2] - errors[1]) < 0.6 * abs(errors[2] - errors[0])  # smaller ones close in


def test_the_force_of_a_contact_half_a_millimetre_across_is_the_known_one(root):
    """An axisymmetric solution, right to 0.1 %, of a small ball; of a round tip: test_laws.py."""
    kept, name = read_json(root / "data/fea_challenge/exact.json")["paths"], "sphere-4-nu0.475-pad4-no_slip-0.05mm"
    press = next(press for path in kept for press in path["presses"] if press["name"] == name)
    for name_of, error in (("label", 0.01), ("draft", 0.025)):
        result = solve_hex(scene_of(press), quality(name_of))
        assert result.status is Status.OK
        assert -result.total[2] == pytest.approx(press["force_n"], rel=error)


def test_a_blade_between_the_points_of_contact_is_no_answer_of_zero():
    """0.2 mm wide, on hexahedra of 2 mm: it touches, and no contact point sees it. Smaller hexahedra do."""
    blade = build("blade", {"kind": "cuboid", "size": [0.2, 3.0], "fillet": 0.05, "height": 10})
    scene = Scene(Gel(), Material(), blade, Press(0.45, 0, 0, 0, 0, -0.3))
    wide = solve_hex(scene, HexSettings(size=2.0, layers=2, gauss=2, press_steps=2))
    assert wide.status is Status.TOO_COARSE and not wide.forces.any()
    small = solve_hex(scene, HexSettings(size=0.3, across=4, layers=3, press_steps=2))
    assert small.status is Status.OK and small.total[2] < 0.0


@pytest.mark.slow
def test_flanks_that_hang_beside_the_base_are_no_gel_pressed_through_it(root):
    """A wide bar across the gel squeezes its flanks out over the base's edge, where they hang lower: a sound press."""
    bar = load_catalogue(root / "workflow/indenters.toml", ["bar_15"])["bar_15"]
    scene = Scene(Gel(), Material(), bar, Press(1.7, -3.6, 0, 0.35, 0.1, -1.54, 249.0))
    result = solve_hex(scene, replace(quality("draft"), widened=()))  # lower layers of wide hexahedra do not hang
    x = result.mesh.nodes + result.displacement
    assert x[:, 2].min() < -Gel().height - 0.05  # they do hang lower
    assert result.status is Status.OK and result.evidence["below_base_mm"] == 0.0


def test_what_pulls_in_the_tight_equilibrium_alone_is_released():
    """Points released at the edge of contact leave less out of balance than a loose path's tolerance: nothing moved then."""
    scene = Scene(
        Gel(), Material(), build("ball", {"kind": "sphere", "diameter": 60, "height": 10}), Press(0, 0, 0, 0, 0, -0.3)
    )
    loose = HexSettings(size=0.7, layers=3, gauss=3, press_steps=3, tolerance=5e-2)
    result = solve_hex(scene, loose)
    assert result.status is Status.OK and result.evidence["pulling_fraction"] < loose.pull_tolerance
    tight = solve_hex(scene, replace(loose, tolerance=1e-4))
    assert result.total[2] == pytest.approx(tight.total[2], rel=0.01)
