"""The key of a solve: each parameter of [fea] and each input in turn, and what must and must not be solved again."""

from dataclasses import fields, replace
from typing import ClassVar, get_origin

import pytest

from gelforge.flow.schema import altered
from gelforge.flow.tables import METHODS, FeaTable
from gelforge.geometry.gel import load_gel
from gelforge.geometry.indenters import build
from gelforge.mechanics import solve
from gelforge.mechanics.hexsettings import quality
from gelforge.mechanics.material import Material
from gelforge.mechanics.scene import Interface, Scene
from gelforge.mechanics.solve import settings_of, solve_key
from gelforge.records.press import Press
from tests.support.parameters import parameters

# The methods of CalculiX count the base mesh, which pytetwild makes in a process.
pytestmark = pytest.mark.processes

FEA = parameters().fea
BALL = {"kind": "sphere", "diameter": 15, "height": 10}
SCENE = Scene(load_gel("gelsight_mini"), Material(), build("ball", BALL), Press(0.1, 0.2, 0.0, 0.1, 0.2, -1.0, 5.0))
# Another value of each parameter of [fea].
OTHER = {
    "method": None, "tolerance": 0.05,
    "press_steps": 5, "shear_steps": 4, "step_mm": 0.3, "stiffness": 1000.0, "rounds": 9,
    "pull_tolerance": 3e-3, "penetration_mm": 3e-3, "residual": 2e-5, "contact_mm": 0.8, "contact_stiffness": 100.0, "timeout_s": 3600.0,
}  # fmt: skip
CALCULIX = {
    "tolerance", "press_steps", "shear_steps", "step_mm", "stiffness", "rounds", "pull_tolerance", "penetration_mm", "residual"
}  # fmt: skip
READ = {"ccx": CALCULIX, "ccx-contact": {"contact_mm", "contact_stiffness"}, "auto": CALCULIX}


def key(scene=SCENE, fea=FEA, shape=BALL, version=1, frames=None):
    how = settings_of(fea.method, fea, (frames or [scene])[-1].gel)
    return solve_key(frames or [scene], shape, how, version, -1)


def test_a_parameter_of_fea_solves_again_only_where_the_method_reads_it():
    constants = {name for name, kind in FeaTable.__annotations__.items() if get_origin(kind) is ClassVar}
    known = {field.name for field in fields(FeaTable)} | constants
    assert known == OTHER.keys(), "say here what a new parameter of [fea] changes"
    alone = {method: key(fea=replace(FEA, method=method)) for method in METHODS}
    assert len({*alone.values()}) == len(METHODS)  # each is solved for itself
    for method, own in alone.items():
        fea = replace(FEA, method=method)
        others = {name: altered(fea, **{name: value}) for name, value in OTHER.items() if value is not None}
        assert {name for name, other in others.items() if key(fea=other) != own} == READ.get(method, set())


def test_every_number_of_a_press_counts():
    for field in fields(Press):
        press = replace(SCENE.press, **{field.name: getattr(SCENE.press, field.name) + 1e-9})
        assert key(replace(SCENE, press=press)) != key(), field.name


def test_inputs_count_by_what_they_are():
    thin = load_gel("gelsight_mini-3.6mm")
    others = [
        key(replace(SCENE, gel=thin)), key(replace(SCENE, material=Material(0.47))), key(shape=BALL | {"diameter": 14}),
        key(replace(SCENE, interface=Interface("frictionless"))), key(replace(SCENE, interface=Interface("coulomb", 0.5))),
        key(replace(SCENE, interface=Interface("coulomb", 0.6))), key(version=2),
    ]  # fmt: skip
    assert len({key(), *others}) == len(others) + 1
    # names, and a coefficient that no law reads, change nothing
    assert key(replace(SCENE, gel=replace(SCENE.gel, name="mine"), interface=Interface("no_slip", 0.7))) == key()


def test_a_frame_depends_on_the_path_and_a_press_alone_does_not():
    half = replace(SCENE, press=replace(SCENE.press, dx=0.0, dy=0.0, dz=-0.5))
    quarter = replace(half, press=replace(half.press, dz=-0.25))
    alone, film, other = key(), key(frames=[half, SCENE]), key(frames=[quarter, SCENE])
    assert len({alone, film, other}) == 3


def test_what_a_quality_means_counts_and_not_its_name(monkeypatch):
    hexahedra, tetrahedra = replace(FEA, method="draft"), FEA
    coulomb = replace(SCENE, interface=Interface("coulomb", 0.5))
    before = key(fea=hexahedra), key(fea=tetrahedra), key(coulomb, tetrahedra)
    monkeypatch.setattr(solve, "quality", lambda name: replace(quality(name), press_steps=99))
    after = key(fea=hexahedra), key(fea=tetrahedra), key(coulomb, tetrahedra)
    # the load path of `ccx` is found on hexahedra, which also solve what it does not
    assert all(a != b for a, b in zip(before, after, strict=True))
