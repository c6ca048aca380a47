"""Newton's method on the tetrahedra: whatever way it takes, the equilibrium at its end is the same one."""

import os
import shlex
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import label

from gelforge.errors import SolveFailed
from gelforge.flow.schema import altered
from gelforge.geometry.gel import GELS
from gelforge.geometry.indenters import build
from gelforge.mechanics.hexsettings import HexSettings, Nested, quality
from gelforge.mechanics.material import Material
from gelforge.mechanics.path import equilibrium
from gelforge.mechanics.path.equilibrium import System
from gelforge.mechanics.path.loadpath import first_touch
from gelforge.mechanics.path.pathsettings import PathSettings
from gelforge.mechanics.path.scenepath import ScenePath
from gelforge.mechanics.scene import Interface, Scene
from gelforge.mechanics.solvers.ccx import CcxSettings, CcxSolver, mesh_of
from gelforge.mechanics.solvers.hex import HexSolver
from gelforge.records.press import Press
from gelforge.records.status import Status
from tests.support.blocks import symmetric_block
from tests.support.flat_pad import FlatPad
from tests.support.parameters import parameters

CCX = CcxSettings.of(parameters().fea)
PAD = FlatPad(name="pad", width=7.0, length=7.0, corner_radius=0.0, height=4.0)
USUAL = PathSettings(0.5, press_steps=4)
# every step solved to the end, so that only the way there differs
TIGHT = replace(USUAL, press_steps=3, shear_steps=2, tolerance=1e-9, final_tolerance=1e-9, max_iterations=60)


def scene(law="no_slip", depth=0.6, dx=0.2):
    ball = build("ball", {"kind": "sphere", "diameter": 8, "height": 10})
    return Scene(PAD, Material(), ball, Press(0, 0, 0, dx, 0, -depth), Interface(law, 0.4))


@pytest.fixture(scope="module")
def mesh():
    return symmetric_block(PAD, 1.2, 3)


def followed(scene, settings, system, mesh, **changed):
    """A path followed to its end; `changed`: of its attributes."""
    path = ScenePath(scene, settings, mesh, system)
    vars(path).update(changed)
    return path, path.follow(first_touch(scene))


@pytest.fixture(scope="module")
def run(mesh):
    system = System(mesh)

    def forces(scene, settings, **changed):
        path, status = followed(scene, settings, system, mesh, **changed)
        assert status is Status.OK, path.reason
        return path.contact_forces(), path

    return forces


def apart(one, other):
    return np.linalg.norm(one - other) / np.linalg.norm(other)


@pytest.mark.parametrize("noisy", [0.0, np.inf], ids=["without", "with"])
def test_every_tangent_ends_at_the_same_equilibrium(run, noisy):
    usual, _ = run(scene(), TIGHT)
    # residuals of 1e-9 of the force; the softest mode of the pad is a thousand times softer than the penalty
    assert apart(run(scene(), TIGHT, noisy=noisy)[0], usual) < 1e-6


def test_an_old_factorisation_ends_where_new_ones_do(run, monkeypatch):
    usual, _ = run(scene(), TIGHT)
    monkeypatch.setattr(equilibrium, "STALE", 1)  # none is quick enough: every step has a factorisation of its own
    assert apart(run(scene(), TIGHT)[0], usual) < 1e-6


def test_a_matrix_that_cannot_be_factorised_cuts_a_load_step(run, mesh, monkeypatch):
    """A step half as long has another matrix; where none helps, the path ends with the reason, not with an exception."""
    usual, _ = run(scene(), TIGHT)
    system, calls = System(mesh), []
    factorise = system.linear.factorise

    def singular(values):
        calls.append(len(calls))
        if len(calls) in failing:
            raise SolveFailed("PARDISO cannot factorise, error -4")
        factorise(values)

    monkeypatch.setattr(system.linear, "factorise", singular)
    failing = range(2, 5)  # of the second step: from its guess, from where the first one ended, and again
    found, status = followed(scene(), TIGHT, system, mesh)
    assert status is Status.OK and found.control.cuts
    assert apart(found.contact_forces().sum(axis=0), usual.sum(axis=0)) < 0.02  # load steps of other lengths
    failing = range(10**9)
    found, status = followed(scene(), TIGHT, system, mesh)
    assert status is Status.DIVERGED and "cannot factorise" in found.reason


def test_one_leap_without_friction_ends_where_many_steps_do(run):
    """Its state depends on the pose alone."""
    straight = scene("frictionless", depth=0.9, dx=0.0)
    leap, one = run(straight, replace(TIGHT, press_steps=1))
    many, steps = run(straight, replace(TIGHT, press_steps=6))
    assert one.steps < steps.steps
    # points that pull or penetrate by less than its limits may differ: 1e-3 of the force
    assert apart(leap.sum(axis=0), many.sum(axis=0)) < 1e-3


def test_no_step_of_the_press_is_longer_than_asked():
    pressed = scene(depth=0.6, dx=0.0)
    for longest, steps in ((np.inf, 2), (0.25, 3), (0.1, 6)):
        settings = replace(CCX, press_steps=2, step_mm=longest)
        assert settings.path(pressed, first_touch(pressed)).press_steps == steps


def test_where_conjugate_gradients_fail_a_factorisation_follows(mesh, ccx, tmp_path, monkeypatch):
    """The failed attempt stays on record, and the forces are those that the first solver would have found."""
    settings = CcxSettings.of(altered(parameters().fea, press_steps=2, shear_steps=1))
    whole = CcxSolver(mesh, tmp_path / "whole", settings).solve(scene())
    assert whole.status.valid and not whole.evidence["failed_attempts"]
    broken = tmp_path / "ccx"
    broken.write_text(
        f'#!/bin/sh\ngrep -q "SOLVER=ITERATIVE" "$1.inp" && echo CalculiX Version && exit 3\nexec {shlex.quote(ccx)} "$1"\n'
    )
    broken.chmod(0o755)
    monkeypatch.setitem(os.environ, "CCX", str(broken))
    result = CcxSolver(mesh, tmp_path / "broken", settings).solve(scene())
    assert result.status.valid
    assert ["ITERATIVE" in line for line in result.evidence["failed_attempts"]] == [True]
    # both stop at residuals of 1e-5 of the mean nodal force; where it is shared out softly, single forces differ by more
    assert apart(result.total, whole.total) < 1e-5
    assert apart(result.forces, whole.forces) < 1e-4


def test_a_path_followed_on_hexahedra_ends_on_the_tetrahedra_as_one_followed_there(mesh, run):
    """Only where points first touched differs, by what hexahedra and tetrahedra differ in: a few per cent at this size."""
    guide = HexSolver(HexSettings(size=0.6, layers=5, layer_ratio=2.0, gauss=2, nested=Nested(layers=3)))
    whole, _ = run(scene(), USUAL)
    path = ScenePath(scene(), USUAL, mesh, System(mesh))
    assert path.arrive(guide.coarse_path([scene()])[0].path) is Status.OK, path.reason
    ended = path.contact_forces()
    assert apart(ended.sum(axis=0), whole.sum(axis=0)) < 0.02
    assert apart(ended, whole) < 0.15
    assert path.iterations < 25


def test_the_guided_and_the_whole_path_agree_in_calculix(mesh, ccx, tmp_path):
    guide = HexSolver(HexSettings(size=0.6, layers=5, layer_ratio=2.0, gauss=2, nested=Nested(layers=3)))
    whole = CcxSolver(mesh, tmp_path / "whole", CCX).solve(scene())
    coarse_path = guide.coarse_path([scene()])[0].path
    guided = CcxSolver(mesh, tmp_path / "guided", CCX).solve(scene(), coarse_path=coarse_path)
    assert guided.status is whole.status is Status.OK
    assert apart(guided.total, whole.total) < 0.02
    assert guided.evidence["kinematics_iterations"] < whole.evidence["kinematics_iterations"]
    assert guided.evidence["load_steps"] == len(coarse_path.times) - 1  # those of the path that led there


def test_an_end_that_does_not_converge_is_followed_on_the_tetrahedra(mesh, ccx, tmp_path):
    """A coarse_path that leads elsewhere, twice as deep with every element folded: the press is solved all the same."""
    guide = HexSolver(HexSettings(size=0.6, layers=5, layer_ratio=2.0, gauss=2, nested=Nested(layers=3)))
    coarse_path = guide.coarse_path([scene()])[0].path
    folded = replace(coarse_path, states=[20.0 * u for u in coarse_path.states])
    result = CcxSolver(mesh, tmp_path / "press", CCX).solve(scene(), coarse_path=folded)
    alone = CcxSolver(mesh, tmp_path / "alone", CCX).solve(scene())
    assert result.status is Status.OK
    # the same solve; several threads sum in another order each time, and one component is nothing but rounding
    assert np.linalg.norm(result.total - alone.total) < 1e-6 * np.linalg.norm(alone.total)


def test_a_path_ends_after_the_newton_iterations_that_it_may_take(mesh):
    """A press that the gel cannot bear would be cut into ever shorter steps."""
    path, status = followed(scene(), replace(TIGHT, most_in_all=5), System(mesh), mesh)
    assert status is Status.DIVERGED and "more than 5 Newton iterations" in path.reason
    assert path.iterations <= 5 + TIGHT.max_iterations


@pytest.mark.parametrize(
    ("body", "depth", "contacts", "holes"),
    [
        ({"kind": "sphere", "diameter": 15, "height": 10}, 1.0, 1, 0),
        ({"kind": "pyramid", "size": [10, 10], "slope_deg": 30, "fillet": 1, "height": 7}, 1.2, 1, 0),
        pytest.param(
            {"kind": "cylinder", "diameter": 10, "fillet": 0.7, "height": 10, "hole": 7}, 0.3, 1, 1, marks=pytest.mark.slow
        ),
        ({"kind": "triple_triangle", "side": 12, "wall": 1, "first_corner_deg": -90, "fillet": 0.7, "height": 10}, 0.5, 1, 1),
    ],
    ids=lambda value: value["kind"] if isinstance(value, dict) else None,
)  # fmt: skip
def test_what_a_press_touches_has_the_bodys_holes_and_no_others(body, depth, contacts, holes):
    scene = Scene(GELS["gelsight_mini"], Material(), build("body", body), Press(0, 0, 0, 0, 0, -depth))
    path = HexSolver(quality("label")).coarse_path([scene])[0].path
    mask = mesh_of(scene, path, 0.5, 1.6).contact.mask
    assert label(mask)[1] == contacts
    assert label(np.pad(~mask, 1, constant_values=True))[1] - 1 == holes
