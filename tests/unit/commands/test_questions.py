"""`make provenance` says what is true of a flow on disk."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from gelforge.commands.look import shard_paths
from gelforge.commands.provenance import lines, provenance
from gelforge.flow.files import write_csv
from tests.support.recorded_flow import lay
from tests.support.refused import refused


def test_provenance_names_only_what_made_the_sample(tmp_path):
    results = tmp_path / "results/d"
    lay(results, 300)
    found = provenance(results, "s00123", "24x32")
    assert [step["target"].split("/")[-2] + "/" + step["target"].split("/")[-1] for step in found["steps"]] == [
        "10_poses/0001.csv", "30_fea/0001.csv", "40_forces/0001.npz", "24x32/0001.npz",
    ]  # fmt: skip
    assert found["steps"][0]["parameters"] == {"poses": {"version": 1}, "indenters": {"ball": {"radius": 3}}}
    text = "\n".join(lines(found, results))
    assert (
        "this sample: OK, label on mesh hex@a, 3.2 s, 77 MiB" in text
        and "0002" not in text
        and "key-of-s00123.npz" in text
    )
    assert text.count("    by numpy 2.4.6") == 4
    json.dumps(found)


def test_provenance_of_a_rejected_row_is_its_rejection(tmp_path):
    results = tmp_path / "results/d"
    lay(results, 300)
    why = {
        "sample_id": "s00123",
        "row": 125,
        "column": "dz_mm",
        "value": "x",
        "reason": "no number",
        "hint": "give mm",
    }
    write_csv(results / "10_poses/0001.rejected.csv", list(why), [why])
    # a row that has the name of an earlier one is rejected, and the earlier one has its label
    assert len(provenance(results, "s00123", "24x32")["steps"]) == 4
    write_csv(results / "10_poses/0001.csv", ["sample_id", "indenter"], [{"sample_id": "s00124", "indenter": "ball"}])
    found = provenance(results, "s00123", "24x32")
    assert [step["target"] for step in found["steps"]] == [str(results / "10_poses/0001.csv")] and not found["solve"]
    assert "row 125 of the log: dz_mm = 'x': no number; give mm" in lines(found, results)[2]


def test_of_an_imported_label_nothing_is_reported_but_where_it_came_from(tmp_path, monkeypatch):
    """Its row has no pose, and stage 10 rejects it; whoever filled that in would invent one."""
    monkeypatch.chdir(tmp_path)
    results = Path("results/d")
    lay(results, 100)
    write_csv(results / "10_poses/0000.rejected.csv", ["sample_id", "row"], [{"sample_id": "s00012", "row": 14}])
    (tmp_path / "data/d/labels").mkdir(parents=True)
    found = provenance(results, "s00012", "1x1")
    assert not found["steps"] and not found["rejected"]
    assert lines(found, results)[-1] == "its label came with the dataset: data/d/labels/1x1.npz"
    refused(r"came with the dataset, in data/d/labels/1x1\.npz", shard_paths, results, "s00012", "1x1")


def test_a_sample_that_is_not_in_the_log_is_one_sentence(tmp_path):
    results = tmp_path / "results/d"
    refused("nothing was planned", provenance, results, "s00123", "24x32")
    lay(results, 100)
    refused("not in the log", provenance, results, "../../x", "24x32")


@pytest.mark.processes
def test_provenance_of_a_sample_is_there_at_once(tmp_path):
    """It imports no numerical library, which takes a second."""
    results = tmp_path / "results/d"
    lay(results, 300)
    words = ["-m", "gelforge.commands.provenance", str(results), "--id", "s00299"]
    command = [sys.executable, "-X", "importtime", *words]
    ran = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "0002.csv" in ran.stdout
    assert not any(f" {heavy}\n" in ran.stderr for heavy in ("numpy", "scipy", "torch"))
