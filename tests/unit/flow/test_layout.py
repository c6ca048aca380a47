"""Where results lie is said in one place: flow.layout; make's rules spell folders of it and no others."""

import re
from pathlib import Path

import pytest

from gelforge.errors import BadInput
from gelforge.flow.layout import FOLDERS, Layout, command_for, dataset_folder


def test_every_folder_that_make_spells_is_one_of_the_layout(root):
    texts = [path.read_text(encoding="utf-8") for path in (*root.glob("rules/*.mk"), root / "Makefile")]
    found = {name for text in texts for name in re.findall(r"\$D/([A-Za-z0-9_-]+)", text)}
    assert len(found) > 10 and found <= set(FOLDERS)


def test_make_knows_every_file_of_rules(root):
    files = [root / "Makefile", *root.glob("rules/*.mk")]
    text = "\n".join(path.read_text(encoding="utf-8") for path in files)
    included = set(re.findall(r"^include rules/(\w+)\.mk$", text, re.M))
    assert included == {path.stem for path in root.glob("rules/*.mk")}


def test_a_command_that_is_reported_names_the_dataset_that_it_is_for():
    """Typed as it was printed it acted on the default dataset."""
    assert Layout(Path("results/mylab")).command("look ID=s1") == "make look ID=s1 DATASET=mylab"
    for path in ("results/mylab/30_fea/0000.csv", "/there/results/mylab/samples/s1/10_poses/0000.csv"):
        assert command_for("fea", path) == "make fea DATASET=mylab"
    assert command_for("train", "elsewhere/network.pt") == "make train"


def test_a_sample_is_found_in_the_planned_shards_alone(tmp_path):
    """The table of shards keeps samples that the log has lost."""
    of = Layout(tmp_path / "demo")
    of.shards.mkdir(parents=True)
    of.shard("0001").touch()
    of.shard_table.write_text("sample_id,shard,logged\na,1,1\nlost,1,0\n")
    assert of.shard_of("a") == "0001"
    for absent in ("lost", "never"):
        with pytest.raises(BadInput, match=f"'{absent}' is not in the log of demo"):
            of.shard_of(absent)


def test_a_results_folder_on_the_way_to_another_is_not_taken_for_it():
    for path, folder in (
        ("/srv/results/me/results/demo/10_poses/0000.csv", "/srv/results/me/results/demo"),
        ("results/results/10_poses/0000.csv", "results/results"),
        ("results/demo/logs/results/x.log", "results/demo"),
        ("results/demo/own/x", "results/demo"),
        ("results/demo", None),
        ("data/demo/log.csv", None),
    ):
        assert dataset_folder(Path(path)) == (Path(folder) if folder else None), path
