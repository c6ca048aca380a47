"""Pictures of the README show what their data say today."""

import re
from pathlib import Path

from gelforge.flow.files import read_json
from gelforge.stages.readme import outdated, publish_picture


def test_no_picture_is_older_than_its_data(root):
    made = sorted((root / "results" / "readme").glob("*.json"))
    old = {path.stem: names for path in made if (names := outdated(path.with_suffix(".png")))}
    # what was measured here in its own seconds is another chart, not a newer one
    old = {stem: kept for stem, names in old.items() if (kept := [n for n in names if not n.startswith("results/")])}
    assert not old, f"draw them again: make readme-pictures ({old})"


def test_data_of_pictures_are_named_from_the_project(root):
    """These records are tracked: a path of one machine names nothing on another."""
    named = [name for path in (root / "results" / "readme").glob("*.json") for name in read_json(path)["data"]]
    assert named
    assert not [name for name in named if Path(name).is_absolute()]


def test_changed_data_make_a_picture_old(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("data.json").write_text("1")
    publish_picture(Path("readme/chart.png"), b"drawn", [Path("data.json")])
    assert outdated(Path("readme/chart.png")) == []
    Path("data.json").write_text("2")
    assert outdated(Path("readme/chart.png")) == ["data.json"]
    Path("data.json").unlink()
    assert outdated(Path("readme/chart.png")) == []


def test_another_table_of_a_file_leaves_the_picture_of_one_as_it_is(tmp_path):
    catalogue = tmp_path / "indenters.toml"
    catalogue.write_text('[ball]\nkind = "sphere"\n')
    publish_picture(tmp_path / "press.png", b"drawn", [f"{catalogue}#ball"])
    catalogue.write_text('[mine]\nkind = "stl"\n\n[ball]  # round\nkind = "sphere"\n')
    assert outdated(tmp_path / "press.png") == []
    catalogue.write_text('[ball]\nkind = "cone"\n')
    assert outdated(tmp_path / "press.png") == [f"{catalogue}#ball"]


def test_every_picture_of_the_readme_knows_what_it_was_made_from(root):
    shown = re.findall(r"!\[[^\]]*\]\((results/readme/[^)]+)\)", (root / "README.md").read_text(encoding="utf-8"))
    assert len(shown) >= 4
    assert [name for name in shown if not (root / name).with_suffix(".json").exists()] == []
