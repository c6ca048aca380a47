"""Stage 20: the mesh of a gel is made once, kept, and named by the solves that stand on it."""

import shutil

import pytest

from gelforge.flow.files import digest_of, read_json
from gelforge.flow.layout import metrics_of
from gelforge.geometry.gel import load_gel
from gelforge.mechanics.mesh.basemesh import LEAST_JACOBIAN, read
from tests.support.sandbox import lay_dataset, link_project, make

BY_CCX = """
[params.interface]
law = "no_slip"

[params.fea]
method = "ccx"
tolerance = 0.04
"""


@pytest.fixture(scope="module")
def project(root, tmp_path_factory):
    folder = link_project(root, tmp_path_factory.mktemp("project") / "lab")
    lay_dataset(folder, root, "mine", 1, BY_CCX)
    return folder


@pytest.mark.slow
def test_a_mesh_is_made_once_with_its_quality_in_the_record(project):
    mesh = project / "results/mine/20_meshes/gelsight_mini.npz"
    made = make(project, "meshes", "DATASET=mine")
    assert made.returncode == 0, made.stdout
    report = read_json(metrics_of(mesh))["counts"]["mesh"]
    assert report["min_scaled_jacobian"] >= LEAST_JACOBIAN and abs(report["volume_error"]) < 0.005
    assert mesh.with_suffix(".vtu").stat().st_size > 1000
    before = digest_of(mesh)
    assert "20_meshes" not in make(project, "meshes", "DATASET=mine").stdout
    # its record is gone, so the stage runs: the mesh of the same shape is kept
    metrics_of(mesh).unlink()
    (project / "results/mine/00_plan/params/meshes.json").touch()
    assert "20_meshes/gelsight_mini.npz" in make(project, "meshes", "DATASET=mine").stdout
    assert digest_of(mesh) == before


@pytest.mark.slow
def test_a_solve_names_its_mesh_and_follows_it(project, ccx):
    made = make(project, "forces", "DATASET=mine")
    assert made.returncode == 0, made.stdout
    results = project / "results/mine"
    mesh = results / "20_meshes/gelsight_mini.npz"
    table = (results / "30_fea/0000.csv").read_text(encoding="utf-8")
    assert read(mesh, load_gel("gelsight_mini"), "").digest in table
    assert make(project, "-q", "forces", "DATASET=mine").returncode == 0
    sample = table.splitlines()[1].split(",")[0]
    assert make(project, "deck", "DATASET=mine", f"ID={sample}").returncode == 0
    # cut: the stages that read it say what to do, and leave what is there
    whole = mesh.read_bytes()
    mesh.write_bytes(whole[:1000])
    said = make(project, "forces", "DATASET=mine")
    assert said.returncode != 0 and "gelsight_mini.npz" in said.stdout and "rm " in said.stdout
    said = make(project, "deck", "DATASET=mine", f"ID={sample}")
    assert said.returncode != 0 and "remove it and run make meshes DATASET=mine" in said.stdout
    # removed: the mesh beside the solves is the same to the byte, and nothing is solved again
    shutil.rmtree(mesh.parent)
    made = make(project, "forces", "DATASET=mine")
    assert made.returncode == 0, made.stdout
    assert mesh.read_bytes() == whole and (results / "30_fea/0000.csv").read_text(encoding="utf-8") == table
    # another mesh: its solves are others
    shutil.rmtree(mesh.parent)
    (shared,) = (project / "results/solves").glob("mesh-*.npz")
    shared.unlink()
    assert make(project, "meshes", "DATASET=mine").returncode == 0
    assert read(mesh, load_gel("gelsight_mini"), "").digest not in table
    assert "30_fea/0000.csv" in make(project, "-n", "forces", "DATASET=mine").stdout
