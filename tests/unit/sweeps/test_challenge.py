"""The open benchmark of scenes: what it holds, and that its script scores as the chart does, without gelforge."""

import csv
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest

from gelforge.errors import BadInput
from gelforge.flow.files import read_json
from gelforge.flow.params import parameters_of
from gelforge.geometry.stlfile import read_stl
from gelforge.labelling.sensor import load_sensors
from gelforge.stages import challenge as stage
from gelforge.stages import pareto
from gelforge.sweeps.challenge import write_challenge
from gelforge.sweeps.deviation import errors
from gelforge.sweeps.keptreferences import (
    COLUMNS,
    KEYS,
    elements_doubled,
    image_of,
    images_of,
    keep_references,
    kept_reference,
    reference_rows,
)
from gelforge.sweeps.methods import DOUBLED, LARGE_REFERENCE, REFERENCE
from gelforge.sweeps.scenes import parse_scene, read_tables
from gelforge.sweeps.trial import GRID, load_bench, measure
from tests.support.parameters import parameters, place_workflow

pytestmark = pytest.mark.processes


@pytest.fixture(scope="module")
def folder(root, tmp_path_factory):
    out = place_workflow(tmp_path_factory.mktemp("challenge")) / "results/out"
    assert stage.main(["write", str(out)]) == 0
    return out


def score(folder, submission):
    """The script in an interpreter that sees neither gelforge nor this test's folders."""
    done = subprocess.run(
        [sys.executable, "-I", str(folder / "score.py"), str(submission), "--out", str(submission / "score.json")],
        capture_output=True, text=True, check=False, cwd=folder,
    )  # fmt: skip
    return done, (read_json(submission / "score.json") if done.returncode == 0 else None)


def record(folder, name) -> dict:
    """The reference of a scene as a record of the chart."""
    cells, outside = np.zeros((3, 24, 32)), np.zeros(3)
    for row in csv.DictReader((folder / "references" / f"{name}.csv").open()):
        at, force = (int(row["row"]), int(row["column"])), [float(row[key]) for key in COLUMNS[2:]]
        if at == (-1, -1):
            outside[:] = force
        else:
            cells[:, *at] = force
    total = cells.sum(axis=(1, 2)) + outside
    return {"cells": cells, "outside": outside, "total": total, "status": "OK", "scene": name}


def charted_scene(name: str, found: dict) -> dict:
    """A scene of the chart with nothing but its reference."""
    return {"scene": name, "table": read_tables("workflow")[name], "methods": {REFERENCE: found}}


def submit(folder, rows, columns=COLUMNS):
    folder.mkdir(exist_ok=True)
    with (folder / "bar.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows([columns, *rows])
    return folder


def test_the_folder_holds_every_scene_and_reads_back(folder, root):
    challenge = read_json(folder / "challenge.json")
    tables = read_tables(root / "workflow")
    assert challenge["scenes"] == sorted(tables)
    assert challenge["d1_per_mpa"] == pytest.approx(2 / (4 * 0.0725 * 1.475 / (3 * 0.05)))
    assert (challenge["gel"]["width"], challenge["gel"]["length"]) == (20.75, 25.25)
    assert {path.stem for path in (folder / "references").glob("*.csv")} == set(tables)
    for name, table in tables.items():
        press = parse_scene(name, table, 0.475).scene.press
        reported = read_json(folder / "scenes" / name / "scene.json")
        assert np.sum(reported["legs_mm"], axis=0) == pytest.approx([press.dx, press.dy, press.dz])
        vertices, _ = read_stl(folder / "scenes" / name / "indenter.stl")
        assert vertices[:, 2].min() == pytest.approx(press.z0, abs=0.02)  # the tip is where the path starts


def test_references_score_nothing_against_themselves(folder, tmp_path):
    found, reported = score(folder, folder / "references")
    assert (
        found.returncode == 0
        and reported["total_worst"] == reported["cells_worst"] == 0.0
        and reported["missing"] == [path.stem for path in sorted((folder / "exact" / "rings").glob("*.csv"))]
    )


def test_the_script_gives_the_errors_of_the_chart(folder, tmp_path):
    right = record(folder, "bar")
    rng = np.random.default_rng(3)
    cells = right["cells"] * rng.uniform(0.9, 1.1, right["cells"].shape)
    wrong = right | {"cells": cells, "total": cells.sum(axis=(1, 2)) + right["outside"]}
    done, reported = score(folder, submit(tmp_path / "mine", [[*row.values()] for row in reference_rows(wrong)]))
    assert done.returncode == 0, done.stderr
    expected = errors(wrong, right)
    assert reported["scenes"]["bar"]["total"] == pytest.approx(expected["total"], abs=1e-6)
    assert reported["scenes"]["bar"]["cells"] == pytest.approx(expected["cells"], abs=1e-5)
    larger = (cells - right["cells"]).reshape(3, 12, 2, 16, 2).sum(axis=(2, 4))
    wide = np.linalg.norm(larger, axis=0).sum() / np.linalg.norm(right["total"])
    assert reported["scenes"]["bar"]["cells_2x2"] == pytest.approx(wide, abs=1e-5)


def test_exact_presses_are_scored_by_rings_and_by_points(folder, root, tmp_path):
    """Their own rings have no error; a tenth too much in one is that ring's share of the force; points count by their radius."""
    known = read_json(root / "data" / "fea_challenge" / "exact.json")
    kept = {press["name"]: press for path in known["paths"] for press in path["presses"]}
    presses = {press["name"]: press for press in read_json(folder / "exact" / "presses.json")}
    assert presses.keys() == kept.keys()
    body = presses["tube-10-7-0.7-nu0.475-pad4-no_slip-0.5mm"]["body"]
    assert min(r for r, _ in body["core_mm"]) - body["radius_mm"] == pytest.approx(3.5)  # of its hole
    assert max(r for r, _ in body["core_mm"]) + body["radius_mm"] == pytest.approx(5.0)
    done, reported = score(folder, shutil.copytree(folder / "exact" / "rings", tmp_path / "same"))
    assert done.returncode == 0 and reported["exact"].keys() == kept.keys() and not reported["scenes"]
    assert reported["exact_total_worst"] == reported["exact_rings_worst"] == 0.0
    for press in kept.values():
        assert sum(press["rings_n"]) == pytest.approx(press["force_n"], rel=2e-4)
    name = "punch-10-1-nu0.475-pad4-no_slip-0.3mm"
    rings = -np.array(kept[name]["rings_n"])
    wrong, share = rings.copy(), 0.1 * rings[3] / rings.sum()
    wrong[3] *= 1.1
    for form, rows in (
        (("ring", "fz_n"), enumerate(wrong)),
        (("x_mm", "y_mm", *COLUMNS[2:]), [[0.3 * (k + 0.5), 0.4 * (k + 0.5), 0, 0, f] for k, f in enumerate(wrong)]),
    ):
        (tmp_path / name).mkdir(exist_ok=True)
        with (tmp_path / name / f"{name}.csv").open("w", newline="") as stream:
            csv.writer(stream).writerows([form, *rows])
        done, reported = score(folder, tmp_path / name)
        assert done.returncode == 0, done.stderr
        assert reported["exact"][name]["total"] == pytest.approx(share)
        assert reported["exact"][name]["rings"] == pytest.approx(share)
        assert name in done.stdout and name not in reported["missing"]


def test_points_count_for_the_cell_they_lie_in(folder, root, tmp_path):
    """Points in the middles of the cells, and one outside of the picture, are the cells themselves."""
    right = record(folder, "bar")
    sensor = load_sensors(root / "workflow" / "sensors.toml")["feats_mini"]
    held = np.argwhere(np.abs(right["cells"]).max(axis=0) > 0)
    points = sensor.unproject(10.0 * (held[:, ::-1] + 0.5))
    rows = [[*at, *right["cells"][:, *cell]] for at, cell in zip(points, held, strict=True)]
    rows.append([0.0, 12.6, *right["outside"]])
    done, reported = score(folder, submit(tmp_path / "points", rows, ("x_mm", "y_mm", *COLUMNS[2:])))
    assert done.returncode == 0, done.stderr
    assert reported["scenes"]["bar"]["cells"] == pytest.approx(0.0, abs=1e-9)


def test_what_cannot_be_scored_is_named(folder, tmp_path):
    header = ",".join(COLUMNS)
    for content, says in (
        ("x,y\n", "columns are"),
        (f"{header}\n1,2,0.1,0.2,much\n", "line 2: not 5 numbers"),
        (f"{header}\n1,2,0.1,0.2,nan\n", "NaN or infinity"),
        (f"{header}\n1.5,2,0.1,0.2,0.3\n", "whole numbers"),
        (f"{header}\n24,0,0.1,0.2,0.3\n", "outside of 24 x 32"),
        (f"{header}\n{'1' * 200_000}", "bar.csv: "),
        (header.encode("utf-16"), "bar.csv: "),  # as a spreadsheet saves it for Unicode
        (None, "no NAME.csv"),
    ):
        (tmp_path / "bar.csv").unlink(missing_ok=True)
        if content is not None:
            (tmp_path / "bar.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
        done, _ = score(folder, tmp_path)
        assert done.returncode == 2 and says in done.stderr and "Traceback" not in done.stderr, says
    shutil.copy(folder / "references" / "bar.csv", tmp_path / "bar.csv")
    (tmp_path / "seconds.csv").write_text("scene,seconds\nbar,3.0\nscene,seconds\ncross,2.0\n")
    done, _ = score(folder, tmp_path)
    assert done.returncode == 2 and "seconds.csv" in done.stderr and "Traceback" not in done.stderr


def test_scenes_without_reference_are_refused(root, tmp_path):
    tables = read_tables(root / "workflow")
    scenes = [parse_scene(name, tables[name], 0.475) for name in ("bar", "punch")]
    sensor = load_sensors(root / "workflow" / "sensors.toml")["feats_mini"]
    (tmp_path / "bar.csv").touch()
    with pytest.raises(BadInput, match="references of bar and the scenes are bar, punch; run make fea-references"):
        write_challenge(scenes, sensor, tmp_path, tmp_path / "out")
    assert not (tmp_path / "out" / "challenge.json").exists()


def test_a_symmetric_scene_has_a_symmetric_reference_and_beside_it_what_halving_moved(folder, root, tmp_path):
    """A press that moves sideways has no image, a turned block that of half a turn alone, a ball at the apex all three."""
    tables = read_tables(root / "workflow")
    images = {name: images_of(parse_scene(name, table, 0.475).scene) for name, table in tables.items()}
    assert images["cuboid_shear"] == images["sphere_off_centre"] == [] and images["cuboid_round"] == [(-1, -1)]
    assert images["triangle"] == [(-1, 1)] and len(images["sphere_1mm"]) == len(images["punch"]) == 3
    reported = read_json(folder / "challenge.json")["elements_doubled"]
    for name, signs in images.items():
        one = record(folder, name)
        for image in signs:
            np.testing.assert_allclose(image_of(one["cells"], image), one["cells"], atol=2e-7)
        assert 0.0 < reported[name]["total"] < reported[name]["cells"] < 0.1
    noisy = record(folder, "cross")
    noisy["cells"] = noisy["cells"] * np.random.default_rng(1).uniform(0.9, 1.1, noisy["cells"].shape)
    charted = charted_scene("cross", {**noisy, "key": "k"})
    charted["methods"][DOUBLED] = record(folder, "cross")
    keep_references([charted], tmp_path, 0.475)
    kept = kept_reference(tmp_path, "cross", "k", GRID.shape)
    np.testing.assert_allclose(image_of(np.array(kept["cells"]), (-1, 1)), kept["cells"], atol=2e-7)
    found = elements_doubled(tmp_path)["cross"]
    assert found["cells"] == pytest.approx(errors(charted["methods"][DOUBLED], kept)["cells"], rel=1e-2)


@pytest.fixture
def bench(root, tmp_path):
    """A bench that has no mesh to solve a reference on, only those that are kept."""
    sensors, kept = load_sensors(root / "workflow" / "sensors.toml"), root / "data" / "fea_challenge"
    params = parameters_of(parameters(), "pareto", pareto.VERSION)
    return load_bench(params, sensors, tmp_path / "records", kept)


def test_the_references_that_are_kept_are_those_of_todays_scenes_and_settings(bench, root):
    """Where this fails, `make fea-references` solves them anew, or what changed did not mean to change them."""
    keys = read_json(bench.references / KEYS)
    for name, table in read_tables(root / "workflow").items():
        scene = parse_scene(name, table, bench.params.material.nu)
        assert keys[name]["key"] == bench.key(scene, LARGE_REFERENCE), name


def test_a_kept_reference_is_not_solved_again_and_is_none_under_other_settings(bench, root):
    scene = parse_scene("bar", read_tables(root / "workflow")["bar"], bench.params.material.nu)
    found = measure(bench, scene, LARGE_REFERENCE)
    assert found["status"] == "OK" and found["total"] == pytest.approx([0.0, 0.0, -16.917], abs=0.005)
    assert np.array(found["cells"]).sum(axis=(1, 2)) + found["outside"] == pytest.approx(found["total"])
    assert measure(bench, scene, LARGE_REFERENCE) == found
    assert kept_reference(bench.references, "bar", "another key", GRID.shape) is None
    assert kept_reference(bench.references, "nothing", "", GRID.shape) is None


def test_references_come_back_as_they_were_kept(folder, tmp_path):
    one = {**record(folder, "cross"), "key": "k"}
    plain = {**one, "cells": one["cells"].tolist(), "outside": one["outside"].tolist()}
    keep_references([charted_scene("cross", plain)], tmp_path, 0.475)
    again = kept_reference(tmp_path, "cross", "k", GRID.shape)
    np.testing.assert_allclose(again["cells"], one["cells"], atol=1e-7)
    np.testing.assert_allclose(again["total"], one["total"], atol=1e-5)


def test_a_corrupt_reference_is_none_and_a_failed_one_is_refused(folder, tmp_path):
    one = {**record(folder, "cross"), "key": "k"}
    for name, text in (
        ("cross.csv", "row,column,fx_n,fy_n,fz_n\n99,1,0,0,-1\n"), ("keys.json", "{"), ("keys.json", "[]"),
    ):  # fmt: skip
        keep_references([charted_scene("cross", one)], tmp_path, 0.475)
        (tmp_path / name).write_text(text)
        assert kept_reference(tmp_path, "cross", "k", GRID.shape) is None
    with pytest.raises(BadInput, match="reference of bar is DIVERGED"):
        reference_rows({"scene": "bar", "status": "DIVERGED", "reason": "no equilibrium"})


def test_the_folder_is_not_written_with_forces_of_other_scenes(root, tmp_path, capsys):
    workflow = shutil.copytree(root / "workflow", tmp_path / "workflow")
    scenes = workflow / "scenes.toml"
    text = scenes.read_text(encoding="utf-8")
    changed = re.sub(r"^depth = .*$", "depth = 0.77", text, count=1, flags=re.MULTILINE)
    assert changed != text
    scenes.write_text(changed, encoding="utf-8")
    (tmp_path / "data").symlink_to(root / "data")
    with pytest.raises(BadInput, match="run make fea-references"):
        stage.main(["write", str(tmp_path / "results/out")])


def test_references_of_scenes_that_are_gone_go(folder, tmp_path):
    def charted(*names):
        return [charted_scene(n, {**record(folder, n), "key": "k"}) for n in names]

    keep_references(charted("cross", "bar"), tmp_path, 0.475)
    keep_references(charted("cross"), tmp_path, 0.475)
    assert {path.name for path in tmp_path.iterdir()} == {"cross.csv", KEYS}
