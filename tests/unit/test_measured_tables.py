"""README and guide carry the figures of the benchmarks' JSON, and nothing else in tables."""

import re

import pytest

from gelforge.flow.files import read_json
from tests.benchmarks import tables
from tests.benchmarks.figures import Figure, digest_of_sources, publish_figures, sources
from tests.benchmarks.tables import BLOCK, KEPT, PAGES, rendered

RUN = {"measured", "commit", "machine", "sources"}


@pytest.mark.parametrize("page", PAGES)
def test_tables_are_what_the_json_says(root, page):
    text = (root / page).read_text(encoding="utf-8")
    assert text == rendered(text), "run `make benchmark-tables`"
    assert len(BLOCK.findall(text)) == text.count("<!-- figures: ") > 0


def test_the_page_of_measurements_has_no_table_of_its_own(root):
    """Its sections are of benchmarks, README's tables of chosen figures."""
    text = (root / "workflow/guide/benchmarks.md").read_text(encoding="utf-8")
    assert "|" not in BLOCK.sub("", text)
    assert not {found[1] for found in BLOCK.findall(text)} & tables.CHOSEN.keys()
    assert {found[1] for found in BLOCK.findall(text)} >= {path.stem for path in KEPT.glob("*.json")}


def test_a_figure_that_changes_changes_the_page(root, monkeypatch):
    text = (root / "README.md").read_text(encoding="utf-8")
    read = tables.read_figures
    monkeypatch.setattr(tables, "read_figures", lambda name: [f | {"value": f["value"] + 1.0} for f in read(name)])
    assert rendered(text) != text and re.sub(r"[\d.]+", "", rendered(text)) == re.sub(r"[\d.]+", "", text)


def test_every_figure_says_when_on_what_and_of_what_it_was_measured():
    for path in KEPT.glob("*.json"):
        for figure in read_json(path)["figures"]:
            assert figure.keys() >= RUN and figure["measured"] and figure["commit"] and figure["machine"], path


def test_a_part_that_is_measured_again_leaves_the_others(tmp_path):
    path = tmp_path / "dag.json"
    publish_figures(path, [Figure("one", 1.0, "<=", 2.0), Figure("two", 2.0, "<=", 1.0)], "net")
    publish_figures(path, [Figure("two", 0.5, "<=", 1.0)], "net")
    found = {figure["name"]: figure for figure in read_json(path)["figures"]}
    assert (found["one"]["value"], found["two"]["value"], found["two"]["met"]) == (1.0, 0.5, True)
    assert found["one"].keys() >= RUN and found["one"]["sources"] == digest_of_sources("dag")
    publish_figures(path, [Figure("two", 0.5, "<=", 1.0)], "another network")
    assert [figure["name"] for figure in read_json(path)["figures"]] == ["two"]


def test_sources_are_what_is_imported_and_what_that_imports(root):
    found = {str(path.relative_to(root)) for path in sources(root / "tests/benchmarks/labels.py")}
    assert {"tests/benchmarks/labels.py", "tests/benchmarks/figures.py", "src/gelforge/labelling/grid.py"} <= found
    assert "src/gelforge/flow/files.py" in found and not any("live/" in path for path in found)
