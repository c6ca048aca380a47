"""Pictures of the README name what they were made from; those drawn of tracked data show what these say today."""

import re
from pathlib import Path

import pytest

from gelforge.flow.files import read_json
from gelforge.stages.readme import digest, outdated, publish_picture

# The others are copies of charts below results/: what another machine measures in its own seconds is another chart, not a
# newer one, so it is unknown whether they are old.
DRAWN = ("press", "real")


@pytest.mark.parametrize("name", DRAWN)
def test_no_picture_that_is_drawn_of_tracked_data_is_older_than_them(root, name):
    picture = root / "results" / "readme" / f"{name}.png"
    data = read_json(picture.with_suffix(".json"))["data"]
    assert any(digest(source) for source in data)  # something of it is here to be held against
    assert outdated(picture) == [], f"draw it again: make {picture.relative_to(root)}"


def test_pictures_of_unknown_age_are_copies_of_measured_charts(root):
    made = (root / "results" / "readme").glob("*.json")
    others = {path.stem: list(read_json(path)["data"]) for path in made if path.stem not in DRAWN}
    assert not [name for names in others.values() for name in names if not name.startswith("results/")], others


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
    pages = [root / "README.md", *sorted((root / "workflow/guide").glob("*.md"))]
    text = "".join(page.read_text(encoding="utf-8") for page in pages)
    shown = re.findall(r"!\[[^\]]*\]\((?:\.\./\.\./)?(results/readme/[^)]+)\)", text)
    assert len(set(shown)) >= 4
    assert [name for name in shown if not (root / name).with_suffix(".json").exists()] == []
