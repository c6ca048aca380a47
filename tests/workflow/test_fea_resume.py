"""Stages 30 and 40: lost and damaged solves are solved again, who solved a press is said, decks give the forces of stage 40."""

import json
import os
import shutil
import subprocess

import numpy as np
import pytest

from gelforge.commands import deck
from gelforge.errors import BadInput
from gelforge.flow.files import read_csv, read_json, write_csv, write_json, write_text
from gelforge.flow.layout import Layout
from gelforge.geometry.gel import GELS
from gelforge.mechanics.ccx.dat import last_table, read_dat
from gelforge.mechanics.material import REFERENCE_C10
from gelforge.records.forcefile import ForceFile
from gelforge.records.solvestore import SolveStore
from gelforge.records.solvetable import read_solves
from gelforge.stages import fea, forces
from gelforge.stages.report import failures_section
from tests.support.meshed import place_mesh
from tests.support.parameters import write_stage, write_used

GEL = GELS["gelsight_mini"]
HEADER = "sample_id,sensor_id,gel_id,indenter,x0_mm,y0_mm,z0_mm,dx_mm,dy_mm,dz_mm,rot_deg\n"
ROWS = [f"s{i},cam,g,ball,{i},0,0,0,0,-0.2,0\n" for i in range(3)]
STICKS = {"law": "no_slip"}
BY_CCX = {"method": "ccx", "tolerance": 0.03}


@pytest.fixture
def folder(tmp_path):
    """Inputs of stage 30: three presses that are solved by draft, and the base mesh that CalculiX needs."""
    of = Layout(tmp_path / "results/lab")
    set_fea(of.root, method="draft")
    write_stage(of.params, "forces", material={"c10": 0.145})
    ball = {"kind": "sphere", "diameter": 15, "height": 10}
    write_used(of, sensors={"cam": {"gel": GEL.name}}, indenters={"ball": ball})
    place_mesh(of)
    lay_presses(of.root, ROWS)
    return of.root


def set_fea(folder, **fea):
    write_stage(Layout(folder).params, "fea", fea=fea, interface=STICKS)


def lay_presses(folder, rows):
    """The pose table of a shard."""
    write_text(Layout(folder).poses("0000"), HEADER + "".join(rows))


def arguments(folder):
    return [str(folder), "0000"]


def test_corruption_is_found_and_solved_again(folder):
    out = folder.parent / "solves"
    assert fea.main(arguments(folder)) == 0
    rows = read_csv(folder / "30_fea" / "0000.csv")
    record = out / f"{rows[0]['key']}.json"
    first = record.stat().st_mtime_ns
    assert [r["status"] for r in rows] == ["OK"] * 3
    assert forces.main(arguments(folder)) == 0
    with ForceFile(folder / "40_forces/0000.npz") as found:
        assert found.c10 == 0.145
        # forces scale with C10; the table's are at 0.0725
        np.testing.assert_allclose(found.total[:, 2], [2 * float(r["fz_n"]) for r in rows], rtol=1e-4)

    # what lost bytes, or all of them, is named, and solved again with the next run; the rest is kept
    second, third = (out / f"{row['key']}.npz" for row in rows[1:])
    second.write_bytes(second.read_bytes()[:1000])
    third.unlink()
    table = folder / "30_fea" / "0000.csv"
    with pytest.raises(
        BadInput, match=rf"{rows[1]['key']} and 1 more: missing or changed since it was written.* run make again"
    ):
        forces.main(arguments(folder))
    assert not table.exists()
    assert fea.main(arguments(folder)) == 0
    assert record.stat().st_mtime_ns == first
    assert forces.main(arguments(folder)) == 0
    with ForceFile(folder / "40_forces/0000.npz") as found:
        assert found.status.tolist() == ["OK"] * 3
        np.testing.assert_allclose(found.total[:, 2], [2 * float(r["fz_n"]) for r in rows], rtol=1e-4)

    lay_presses(folder, ROWS[:1])
    params = json.loads((folder / "00_plan/params/fea.json").read_text())
    params["material"]["nu"] = 0.47
    write_json(folder / "00_plan/params/fea.json", params)
    assert fea.main(arguments(folder)) == 0
    again = {row["key"] for row in read_csv(table)}
    assert again.isdisjoint(row["key"] for row in rows), "another material must be solved again"


def test_missing_calculix_is_one_clear_error(folder, monkeypatch):
    set_fea(folder, **BY_CCX)
    monkeypatch.setitem(os.environ, "CCX", "no-such-ccx")
    with pytest.raises(fea.BadInput, match="solver program was not found"):
        fea.main(arguments(folder))


@pytest.mark.slow
def test_what_another_method_solved_says_so_and_is_solved_again_with_a_longer_limit(folder, ccx, capfd):
    """CalculiX is stopped: the label is of hexahedra, and nobody takes it for CalculiX'."""
    lay_presses(folder, ROWS[:1])
    set_fea(folder, **BY_CCX, timeout_s=1e-3)
    assert fea.main(arguments(folder)) == 0
    table = folder / "30_fea" / "0000.csv"
    (row,) = read_csv(table)
    assert (row["status"], row["method"]) == ("OK", "label") and row["mesh"].startswith("hex@")
    assert (
        row["reason"].startswith("solved by label, because ccx: DIVERGED") and row["reason"] in capfd.readouterr().out
    )
    assert "raise timeout_s in [fea]" in row["reason"] and row["attempt"] == "label"
    shown = failures_section(folder, {solve.sample_id: solve for solve in read_solves(table)}).items
    assert "Labels by another method than requested" in str(shown) and "DIVERGED" in str(shown)

    store = SolveStore(folder.parent / "solves")
    record = folder.parent / f"solves/{row['key']}.json"
    at_first = record.stat().st_mtime_ns
    set_fea(folder, **BY_CCX, timeout_s=1e-3)
    assert fea.main(arguments(folder)) == 0  # under the same limit
    assert read_csv(table) == [row] and record.stat().st_mtime_ns == at_first
    assert fea.finished(store, row["key"], 1e-3) and fea.finished(store, row["key"], 7200.0) is None
    found = read_json(record)
    del found["evidence"]["stopped_after_s"]
    write_json(record, found)
    assert fea.finished(store, row["key"], 7200.0), "what no limit stopped is good under every limit"


def forces_by_stock_ccx(ccx, folder, name, forces):
    """Nodal forces (s, 3) N that CalculiX itself prints for a deck, and those of stage 40 at the deck's C10."""
    subprocess.run([ccx, name], cwd=folder, check=True, stdout=subprocess.DEVNULL)
    with ForceFile(forces) as found:
        at = found.index(name)
        nodes = found.node[found.ptr[at] : found.ptr[at + 1]]
        force = found.force[found.ptr[at] : found.ptr[at + 1]] * (REFERENCE_C10 / found.c10)
    tables = read_dat((folder / f"{name}.dat").read_text())
    (top,) = (t.nodes for t in tables if (t.quantity, t.set_name) == ("forces", "NTOP"))
    printed = last_table(tables, "forces", "NTOP", np.sort(top))
    every = np.zeros_like(printed)
    every[np.searchsorted(np.sort(top), nodes + 1)] = force
    return printed, every


@pytest.mark.slow
def test_decks_run_by_stock_calculix_give_the_forces_of_stage_40(folder, ccx, tmp_path_factory):
    set_fea(folder, **BY_CCX)
    lay_presses(folder, ROWS[2:])
    assert fea.main(arguments(folder)) == 0
    assert forces.main(arguments(folder)) == 0
    store = folder.parent / "solves"
    kept = [path for path in store.iterdir() if path.is_file()]
    assert {path.suffix for path in kept} == {".npz", ".json"} and sum(p.stat().st_size for p in kept) < 3e5
    rows = read_csv(folder / "30_fea/0000.csv")
    version = json.loads((store / f"{rows[0]['key']}.json").read_text())["evidence"]["ccx_version"]
    assert version in subprocess.run([ccx, "-v"], capture_output=True, text=True).stdout

    rows = [{"sample_id": name, "shard": "0", "logged": "1"} for name in ("s2", "s3")]
    write_csv(folder / "00_plan" / "shards.csv", ["sample_id", "shard", "logged"], rows)
    assert deck.main([str(folder), "--id", "s2"]) == 0
    shutil.copytree(folder / "deck/s2", alone := tmp_path_factory.mktemp("alone") / "s2")
    printed, ours = forces_by_stock_ccx(ccx, alone, "s2", folder / "40_forces" / "0000.npz")
    assert np.abs(printed - ours).max() <= 1e-6 * np.abs(ours).max() and ours[:, 2].sum() < -0.1
    readme = (alone / "README").read_text().splitlines()
    assert len(readme) == 3 and "`ccx s2` in this folder" in readme[0]
    assert "times 2, because their C10 is 0.145 MPa (as given)" in readme[2]

    with pytest.raises(BadInput, match="s3 was not solved yet; run make sample ID=s3"):
        deck.main([str(folder), "--id", "s3"])
    # what a deck is made of again is gone
    gone = read_csv(folder / "30_fea/0000.csv")[0]["key"]
    (store / f"{gone}.npz").unlink()
    with pytest.raises(
        BadInput, match=rf"{gone}\.npz: missing or changed since it was written; remove .*0000\.csv and run make"
    ):
        deck.main([str(folder), "--id", "s2"])


def test_a_press_solved_in_process_has_no_deck(folder):
    lay_presses(folder, ROWS[:1])
    assert fea.main(arguments(folder)) == 0
    rows = [{"sample_id": "s0", "shard": "0", "logged": "1"}]
    write_csv(folder / "00_plan" / "shards.csv", ["sample_id", "shard", "logged"], rows)
    with pytest.raises(BadInput, match="s0 has no deck: it was solved by draft, without CalculiX"):
        deck.main([str(folder), "--id", "s0"])
