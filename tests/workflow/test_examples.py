"""The examples run, and what they print is right."""

import json
import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

from gelforge.formats.featsfile import read_sample

NAMES = ["a_contact_law", "a_sweep", "export", "grip_by_force", "indenter_from_stl", "own_gel", "read_a_film"]


@pytest.fixture
def run(root, tmp_path, monkeypatch, capsys):
    """Run an example in an empty folder; the numbers that each line of what it prints holds."""
    monkeypatch.chdir(tmp_path)

    def run(name):
        monkeypatch.setattr(sys, "argv", [name])
        names = runpy.run_path(str(root / "workflow" / "examples" / f"{name}.py"), run_name="__main__")
        lines = capsys.readouterr().out.splitlines()
        return names, [[float(n) for n in re.findall(r"(?<![\w.])[-+]?\d+\.?\d*", line)] for line in lines]

    return run


def test_every_example_is_tried_and_short(root):
    scripts = sorted((root / "workflow" / "examples").glob("*.py"))
    assert [path.stem for path in scripts] == NAMES
    assert all(15 <= len(path.read_text().splitlines()) <= 40 for path in scripts)
    shown = (root / "workflow" / "examples" / "README.md").read_text()
    assert all(f"`{path.name}`" in shown for path in scripts)


@pytest.mark.slow
def test_the_notebook_runs_from_its_first_cell_to_its_last(root, monkeypatch):
    monkeypatch.chdir(root / "workflow" / "examples")
    monkeypatch.setenv("MPLBACKEND", "agg")
    notebook = json.loads(Path("first_steps.ipynb").read_text())
    names = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert not cell["outputs"]
            exec("".join(cell["source"]), names)
    press, found = names["press"], names["found"]
    assert press.total[2] < -1.0 and press.total[0] > 0.0
    assert names["middle"][:2] == pytest.approx([2.0, -3.0], abs=0.3)
    for cells in (*names["labels"].values(), names["wider"]):
        assert cells.sum((1, 2)) == pytest.approx(press.total, rel=1e-6, abs=1e-9)
    assert np.count_nonzero(names["wider"][2]) < np.count_nonzero(names["labels"]["24x32"][2])
    assert found.total[2] < -1.0 and not found.flag
    assert names["low"] < 0.0792 < names["high"]  # the paper's fit; its friction and touch are unknown


@pytest.mark.slow
def test_an_stl_is_pressed_and_turned(run):
    _, (straight, turned) = run("indenter_from_stl")
    assert straight[2:4] != turned[2:4]
    (_, force, wide, long), (_, force_too, wide_too, long_too) = straight, turned
    assert wide > long and wide_too < long_too  # the ridge lies along x, then along y
    assert force == pytest.approx(force_too, rel=0.15) and force < 0


@pytest.mark.slow
def test_gels_differ_as_they_should(run):
    names, lines = run("own_gel")
    thin, dome, thinner = (line[-1] for line in lines[1:4])
    assert thin > thinner > 1.0  # the rigid base is nearer
    assert 0.2 < dome < 1.0  # a curved top is touched less
    assert names["stiffer"] == pytest.approx(2 * names["usual"], rel=1e-9)


def test_a_film_is_read(run):
    _, lines = run("read_a_film")
    assert [int(line[0]) for line in lines] == list(range(len(lines))) and len(lines) > 50
    assert lines[0][5] == 0.0 and min(line[5] for line in lines) < -1.0


def test_a_press_is_written_for_others(run):
    names, _ = run("export")
    sample = read_sample("press.npy")
    assert np.allclose(sample.label, names["cells"]) and sample.image.shape == (240, 320, 3)
    import pyvista as pv

    mesh = pv.read("press.vtu")
    assert mesh.point_data["force"].sum(axis=0) == pytest.approx(names["press"].total, rel=1e-6, abs=1e-9)
    with np.load("press.npz") as kept:
        assert kept["cells"].sum() == pytest.approx(names["cells"].sum())


@pytest.mark.slow
def test_a_sweep_shows_the_law(run):
    names, _ = run("a_sweep")
    forces = np.array([row["force_n"] for row in names["rows"]]).reshape(2, 3)
    assert (np.diff(forces, axis=1) > 0).all() and (forces[1] > forces[0]).all()
    assert 1.3 < names["power"] < 2.2 and len(Path("sweep.csv").read_text().splitlines()) == 7


@pytest.mark.slow
def test_a_contact_law_of_ones_own_is_solved(run):
    """The weaker the law, the less of the drag reaches the gel."""
    names, _ = run("a_contact_law")
    dragged = {law: total[0] for law, total in names["totals"].items()}
    assert dragged["no_slip"] > dragged["coulomb"] > dragged["orowan"] > 0.0


def test_a_gripper_closes_until_the_force_is_reached(run):
    names, lines = run("grip_by_force")
    forces = [line[0] for line in lines]
    assert all(force > -names["GRIP_N"] for force in forces[:-1]) and forces[-1] <= -names["GRIP_N"]
    assert forces[0] == 0.0 and len(forces) > 10  # at rest first
