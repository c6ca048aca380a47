"""A sphere on a small flat pad: CalculiX' forces against the in-process solver and against equilibrium."""

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest

from gelforge.flow.schema import altered
from gelforge.geometry.indenters import build
from gelforge.mechanics.ccx.deck import press_deck
from gelforge.mechanics.ccx.program import need_ccx, run_ccx
from gelforge.mechanics.contact.law import LAWS
from gelforge.mechanics.contact.penalty import FREE, STICK
from gelforge.mechanics.hexsettings import quality
from gelforge.mechanics.linear.factorisation import SuperLU
from gelforge.mechanics.material import Material
from gelforge.mechanics.path.equilibrium import System
from gelforge.mechanics.path.loadpath import first_touch, path_pose
from gelforge.mechanics.path.pathsettings import PathSettings
from gelforge.mechanics.path.scenepath import ACCEPTED, ScenePath
from gelforge.mechanics.scene import Interface, Scene
from gelforge.mechanics.solvers.ccx import EDGE_MM, ERROR, ORDER, CcxSettings, CcxSolver, read_answer
from gelforge.mechanics.solvers.hex import solve_hex
from gelforge.records.press import Press
from gelforge.records.status import Status
from tests.support.blocks import symmetric_block
from tests.support.flat_pad import FlatPad, SlideThenPress
from tests.support.parameters import parameters
from tests.support.surface_values import base_reactions


@dataclass(frozen=True)
class Ball:
    """A sphere standing on the plane z = 0 of its frame."""

    size: float
    name: str = "ball"

    def distance(self, points):
        way = points - np.array([0.0, 0.0, self.size])
        length = np.linalg.norm(way, axis=1)
        return length - self.size, way / length[:, None]

    def radius(self):
        return self.size


EDGES_MM = 1.0  # of the tetrahedra
PAD = FlatPad(name="pad", width=7.0, length=7.0, corner_radius=0.0, height=4.0)


def scene(law, dx=0.0, depth=0.5):
    return Scene(PAD, Material(), Ball(4.0), Press(0, 0, 0, dx, 0, -depth), Interface(law, 0.4))


@pytest.fixture(scope="module")
def solver(ccx, tmp_path_factory):
    return CcxSolver(
        symmetric_block(PAD, EDGES_MM, 3),
        tmp_path_factory.mktemp("ccx"),
        CcxSettings.of(altered(parameters().fea, press_steps=3, shear_steps=2)),
    )


@pytest.fixture(scope="module")
def mesh():
    return symmetric_block(PAD, 1.75, 2)


MIDDLE = np.array([0.2, 0.0, 4.0 - 0.6])  # the ball's middle at the end of the path


def test_a_state_is_judged_by_what_pulls_and_by_what_lies_in_the_indenter(mesh):
    """A flat gel under a ball: held points are pushed or pulled along its axis, free ones lie in it or do not."""
    rng, pressed = np.random.default_rng(9), scene("no_slip", dx=0.2, depth=0.6)
    path = ScenePath(pressed, PathSettings(0.5), mesh, System(mesh))
    path.t, state = pressed.press.end, path.state
    pose, down, push = path_pose(pressed, path.t), np.array([0.0, 0.0, -1.0]), rng.uniform(-1, 1, len(state.status))
    state.status[:] = rng.choice([FREE, STICK], size=len(push))
    state.stick_point[:] = pose.to_indenter(state.reference + push[:, None] / 145.0 * down)
    state.normal[:] = down  # the press turns nothing
    verdict = path.judge(np.zeros_like(mesh.nodes))
    held, force = state.status == STICK, push * state.weights
    assert verdict.pulling_fraction == pytest.approx(-force[held & (push < 0)].sum() / abs(force[held].sum()))
    depth = 4.0 - np.linalg.norm(state.reference - MIDDLE, axis=-1)
    assert verdict.penetration == pytest.approx(depth[~held].max()) and verdict.penetration > 0.5


@pytest.mark.parametrize("law", LAWS)
def test_calculix_needs_on_every_node_the_force_that_contact_gives_it(solver, law):
    """CalculiX is given where the touched nodes are, and no force: the in-process solver's must be the ones that hold them there."""
    pressed, s = scene(law, dx=0.1), solver.settings
    touch_at = first_touch(pressed)
    path = ScenePath(pressed, s.path(pressed, touch_at), solver.mesh, solver.system)
    assert path.follow(touch_at) is Status.OK, path.reason
    own = path.contact_forces()
    result = solver.solve(pressed)
    assert result.status is Status.OK, result.evidence
    # residuals of 1e-8 of the force; the .dat prints seven digits
    np.testing.assert_allclose(result.forces, own, atol=2e-6 * np.abs(own).max())


@pytest.mark.parametrize("law", ["no_slip", "frictionless"])
def test_forces_balance_and_agree_with_hex(solver, law):
    pressed = scene(law)
    result = solver.solve(pressed)
    assert result.status is Status.OK, result.evidence
    held = base_reactions(solver.mesh, result.displacement, pressed.material)
    # the .dat prints seven digits, and the forces of both ends are sums of many nodes'
    assert np.linalg.norm(result.total + held.sum(axis=0)) < 1e-5 * np.linalg.norm(result.total)
    assert result.evidence["engine_difference"] < 1e-7  # same elements, same contact
    label = solve_hex(scene(law), quality("label"))
    stated = ERROR * (EDGES_MM / EDGE_MM) ** ORDER * abs(label.total[2]) + label.error_n
    assert result.total[2] == pytest.approx(label.total[2], abs=stated)
    # the mesh is not symmetric: its diagonals all run one way
    assert np.abs(result.total[:2]).max() < 0.01 * abs(result.total[2])


def test_slide_in_air_leaves_no_shear(solver):
    press = SlideThenPress(-0.5, 0.0, 0.0, 0.5, 0.0, -0.5)
    total = solver.solve(replace(scene("no_slip"), press=press)).total
    assert total[2] < -0.5 and np.abs(total[:2]).max() < 1e-3 * abs(total[2])


@pytest.mark.slow
def test_coulomb_bounds_shear_and_no_slip_exceeds_it(solver):
    free, bound, stuck = (solver.solve(scene(law, dx=0.25)).total for law in ("frictionless", "coulomb", "no_slip"))
    assert abs(free[0]) < abs(bound[0]) < 1.02 * abs(stuck[0])
    assert abs(bound[0]) <= 0.42 * abs(bound[2])  # mu = 0.4, its rounds stop at 2 % of the drag


@pytest.mark.parametrize("law", ["no_slip", pytest.param("frictionless", marks=pytest.mark.slow)])
def test_without_mkl_a_press_is_the_same(solver, law):
    """Every step is solved as exactly as the end: where points hold follows the steps, a thousandth of the force off by default."""
    pressed, system = scene(law), System(solver.mesh)
    usual = solver.settings.path(pressed, first_touch(pressed))
    exact = replace(usual, tolerance=usual.final_tolerance, rough=usual.final_tolerance)
    found = []
    for linear in (system.linear, SuperLU(system.pattern.indptr, system.pattern.indices)):
        system.linear = linear
        path = ScenePath(pressed, exact, solver.mesh, system)
        assert path.follow(first_touch(pressed)) is Status.OK, path.reason
        found.append(path.contact_forces())
    # an end is taken with ACCEPTED of the force out of balance at most; what that changes in the force is no larger
    assert np.linalg.norm(found[0] - found[1], axis=1).sum() < 2.0 * ACCEPTED * np.linalg.norm(found[0].sum(axis=0))


# CalculiX whose forces are another one's by a factor, one of the top and one of the base.
WRONG = """#!/bin/sh
{program} "$1" || exit
awk '/^ *displacements/ {{ by = 1 }} /^ *forces.*NTOP/ {{ by = {top} }} /^ *forces.*NBASE/ {{ by = {base} }}
     NF == 4 {{ printf "%10d %13.6E %13.6E %13.6E\\n", $1, $2 * by, $3 * by, $4 * by; next }} 1' "$1.dat" > "$1.new"
mv "$1.new" "$1.dat"
"""


@pytest.mark.parametrize(
    ("top", "base", "status"),
    [(0.999, 0.999, "DISAGREES"), (-1.0, -1.0, "DISAGREES"), (1.0, 1.01, "UNBALANCED")],
)
def test_calculix_that_computes_otherwise_is_refused(solver, tmp_path, monkeypatch, top, base, status):
    program = tmp_path / "ccx"
    program.write_text(WRONG.format(program=need_ccx(), top=top, base=base))
    program.chmod(0o755)
    monkeypatch.setenv("CCX", str(program))
    result = solver.solve(scene("no_slip", dx=0.1))
    assert re.fullmatch(r"\d+\.\d+\S*", result.evidence["ccx_version"]), "its version stands in every record"
    assert result.status is Status[status]
    if result.status is Status.DISAGREES:
        assert "in process" in result.evidence["reason"] and f"{result.total[2]:.6g}" in result.evidence["reason"]


def test_what_is_kept_of_a_press_makes_its_deck_again(solver, tmp_path):
    result = solver.solve(scene("no_slip", dx=0.1), "kept")
    deck = press_deck(solver.mesh, result.prescribed, result.start, **result.deck)
    assert deck == (solver.folder / "kept.inp").read_text()
    (tmp_path / "again.inp").write_text(deck)
    run_ccx("again", tmp_path, 100.0)
    again = read_answer(tmp_path / "again.dat", solver.mesh).top.sum(axis=0)
    np.testing.assert_allclose(again, result.total, atol=1e-6 * abs(result.total[2]))


def test_a_press_that_touches_nothing_runs_nothing(solver):
    press = Press(0, 0, 1.0, 0, 0, -0.5)
    ball = build("ball", {"kind": "sphere", "diameter": 8, "height": 10})
    result = solver.solve(Scene(PAD, Material(), ball, press))
    assert result.status is Status.NO_CONTACT
    assert not result.forces.any()
    assert result.evidence["rounds"] == 0
