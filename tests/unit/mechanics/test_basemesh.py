"""Base meshes of gels by pytetwild: what they fill, how they are kept, and what is refused."""

import os
import re
import shutil
import sys

import numpy as np
import pytest

from gelforge.geometry.gel import GELS, load_gel
from gelforge.mechanics.mesh import basemesh
from gelforge.mechanics.mesh.basemesh import LEAST_JACOBIAN, base_of, meshes_in, read, use_meshes_of
from gelforge.mechanics.mesh.tetmesh import mesh_report, signed_volumes
from gelforge.mechanics.mesh.tetwild import tetrahedralise
from tests.support.blocks import box
from tests.support.limited import small_disk
from tests.support.refused import refused

GEL = GELS["gelsight_mini"]
CUBE = box([0.0, 0.0, 0.0], [2.0, 2.0, 2.0])


@pytest.mark.processes
def test_a_base_mesh_fills_the_box_and_is_good_enough():
    base = base_of(GEL)
    own = signed_volumes(base.nodes, base.tets)
    assert own.min() > 0 and own.sum() == pytest.approx(GEL.width * GEL.length * GEL.height, rel=1e-9)
    report = mesh_report(base.bent(GEL), GEL)
    assert report["min_scaled_jacobian"] >= LEAST_JACOBIAN and abs(report["volume_error"]) < 0.005
    assert report.items() <= base.report.items() and base.report["cpu_seconds"] > 0


@pytest.mark.processes
def test_a_mesh_in_a_folder_is_made_once_and_nothing_is_written_elsewhere(tmp_path, monkeypatch):
    home, kept = tmp_path / "home", tmp_path / "meshes"
    home.mkdir()
    for name in ("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.setenv(name, str(home))
    monkeypatch.chdir(home)
    with meshes_in(kept):
        first = base_of(GEL)
        content = (kept / "gelsight_mini.npz").read_bytes()
        basemesh._known.clear()  # another process
        assert base_of(GEL).digest == first.digest
    first.write(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == content  # one build is the same to the byte
    assert os.listdir(kept) == ["gelsight_mini.npz"] and os.listdir(home) == []


@pytest.mark.processes
def test_files_that_are_no_mesh_of_the_gel_are_refused_with_a_cure(tmp_path):
    path, changed = tmp_path / "gelsight_mini.npz", tmp_path / "changed.npz"
    base_of(GEL).write(path)
    other, again = load_gel("gelsight_mini-5mm"), "make it again"
    refused("another gel than gelsight_mini-5mm.* make it again", read, path, other, again)
    with np.load(path) as whole:
        parts = dict(whole)
    np.savez(changed, **parts | {"nodes": parts["nodes"] + 1e-9})
    refused("was changed since it was written; make it again", read, changed, GEL, again)
    for content in (path.read_bytes()[:-100], path.read_bytes()[:1000], b"", b"text"):
        changed.write_bytes(content)
        refused("is no whole mesh file.*make it again", read, changed, GEL, again)
    np.savez(changed, nodes=parts["nodes"])
    refused("is no whole mesh file", read, changed, GEL, again)


def test_the_flow_makes_no_mesh_where_one_is_missing_or_cut(tmp_path):
    folder = tmp_path / "lab" / "20_meshes"
    use_meshes_of(folder)
    refused("run make meshes DATASET=lab$", base_of, GEL)
    assert not folder.exists()
    folder.mkdir(parents=True)
    (folder / "gelsight_mini.npz").write_bytes(b"PK")
    refused("remove it and run make meshes DATASET=lab$", base_of, GEL)


@pytest.mark.processes
def test_what_cannot_be_meshed_is_refused():
    vertices, faces = CUBE
    refused("lid: pytetwild .*closed.* draft, label or fine", tetrahedralise, "lid", vertices, faces[:2], 1.0, 0.01)
    tets = tetrahedralise("cube", vertices, faces, 1.0, 0.01)
    assert abs(signed_volumes(*tets)).sum() == pytest.approx(8.0, rel=0.05)


def test_without_pytetwild_the_methods_that_are_left_out_are_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pytetwild", None)
    said = r"leaves out the methods ccx, ccx-contact and auto.*pip install '\.\[mesh\]'"
    refused(said, tetrahedralise, "cube", *CUBE, 1.0, 0.01)


@pytest.mark.processes
def test_a_mesher_that_is_killed_or_has_no_room_leaves_a_sentence_and_no_file(tmp_path, monkeypatch):
    killed = tmp_path / "python"
    killed.write_text("#!/bin/sh\nkill -9 $$\n")
    killed.chmod(0o755)
    with monkeypatch.context() as patch:
        patch.setattr(sys, "executable", str(killed))
        refused("cube: pytetwild was stopped by SIGKILL.*memory.*again", tetrahedralise, "cube", *CUBE, 1.0, 0.01)
    with small_disk(tmp_path / "disk") as disk:
        (disk / "fill").write_bytes(b"0" * 60_000)
        with pytest.raises(OSError, match=re.escape(os.strerror(28))):
            base_of(GEL).write(disk / "gelsight_mini.npz")
        assert os.listdir(disk) == ["fill"]
    shutil.rmtree(tmp_path / "disk", ignore_errors=True)
