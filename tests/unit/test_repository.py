"""Figures and pictures know their sources; the guide is a site."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from gelforge.errors import BadInput
from gelforge.flow.files import read_json
from tests.lint import tables
from tests.lint.readme_pictures import outdated, publish_picture
from tests.support import figures
from tests.support.figures import Figure, digest_of_sources, publish_figures, sources

pytestmark = pytest.mark.processes


def test_a_figure_that_changes_changes_the_page(root, monkeypatch):
    text = (root / "README.md").read_text(encoding="utf-8")
    read = tables.read_figures
    monkeypatch.setattr(tables, "read_figures", lambda name: [f | {"value": f["value"] + 1.0} for f in read(name)])
    changed = tables.rendered(text)
    assert changed != text and re.sub(r"[\d.]+", "", changed) == re.sub(r"[\d.]+", "", text)


def test_a_part_that_is_measured_again_leaves_the_others(tmp_path):
    path = tmp_path / "dag.json"
    publish_figures(path, [Figure("one", 1.0, "<=", 2.0), Figure("two", 2.0, "<=", 1.0)], "net")
    publish_figures(path, [Figure("two", 0.5, "<=", 1.0)], "net")
    found = {figure["name"]: figure for figure in read_json(path)["figures"]}
    assert (found["one"]["value"], found["two"]["value"], found["two"]["met"]) == (1.0, 0.5, True)
    assert found["one"].keys() >= {"measured", "commit", "machine"}
    assert found["one"]["sources"] == digest_of_sources("dag")
    publish_figures(path, [Figure("two", 0.5, "<=", 1.0)], "another network")
    assert [figure["name"] for figure in read_json(path)["figures"]] == ["two"]


def test_figures_that_stay_are_those_of_a_commit(root, monkeypatch, tmp_path):
    monkeypatch.setattr(figures, "changed", lambda: ["Makefile"])
    for words in (
        ["--out", str(root / "results/benchmarks/dag.json")],
        [f"--out={root}/results/benchmarks/dag.json"],
    ):
        with pytest.raises(BadInput, match=r"differs from its commit \(Makefile\)"):
            figures.refuse_changes(words)
    figures.refuse_changes(["--out", str(tmp_path / "dag.json")])
    monkeypatch.setattr(figures, "changed", list)
    figures.refuse_changes(["--out", str(root / "results/benchmarks/dag.json")])


def test_a_tree_with_changes_is_seen_and_results_of_benchmarks_are_none(tmp_path, monkeypatch):
    def git(*words):
        subprocess.run(["git", "-c", "user.name=n", "-c", "user.email=e", *words], cwd=tmp_path, check=True)

    kept = tmp_path / "results/benchmarks/dag.json"
    kept.parent.mkdir(parents=True)
    for path in (kept, tmp_path / "code.py"):
        path.write_text("1")
    git("init", "-q")
    git("add", "-A")
    git("commit", "-qm", "all")
    monkeypatch.setattr(figures, "ROOT", tmp_path)
    kept.write_text("2")
    assert figures.changed() == [] and not figures.commit().endswith("+")
    (tmp_path / "code.py").write_text("2")
    assert figures.changed() == ["code.py"] and figures.commit().endswith("+")


def test_sources_are_what_is_imported_and_what_that_imports(root):
    found = {str(path.relative_to(root)) for path in sources(root / "tests/benchmarks/dag.py")}
    assert {"tests/benchmarks/dag.py", "tests/support/figures.py"} <= found
    assert "src/gelforge/flow/files.py" in found and not any("live/" in path for path in found)


def test_changed_data_make_a_picture_old(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    catalogue = Path("indenters.toml")
    catalogue.write_text('[ball]\nkind = "sphere"\n')
    Path("data.json").write_text("1")
    publish_picture(Path("readme/chart.png"), b"drawn", [Path("data.json"), f"{catalogue}#ball"])
    catalogue.write_text(
        '[mine]\nkind = "stl"\n\n[ball]  # another table leaves the picture as it is\nkind = "sphere"\n'
    )
    assert outdated(Path("readme/chart.png")) == []
    Path("data.json").write_text("2")
    catalogue.write_text('[ball]\nkind = "cone"\n')
    assert outdated(Path("readme/chart.png")) == ["data.json", f"{catalogue}#ball"]
    Path("data.json").unlink()
    assert outdated(Path("readme/chart.png")) == [f"{catalogue}#ball"]


@pytest.mark.slow
def test_the_guide_is_a_site_whose_links_hold(root, tmp_path):
    words = [
        "-m",
        "mkdocs",
        "build",
        "--strict",
        "--quiet",
        "--config-file",
        str(root / "mkdocs.yml"),
        "-d",
        str(tmp_path / "site"),
    ]
    done = subprocess.run([sys.executable, *words], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    for page in ("api", "limits"):
        assert "gel" in (tmp_path / f"site/{page}.html").read_text(encoding="utf-8")
    assert "of the tip below the gel's apex" in (tmp_path / "site/api.html").read_text(encoding="utf-8")


def test_scripts_keep_their_line_ends_in_every_clone(root):
    """With core.autocrlf they had those of Windows, and bash found no `\\r`."""
    for name in ("Makefile", "envs/venv.sh", "rules/flow.mk", "src/gelforge/api.py"):
        said = subprocess.run(
            ["git", "check-attr", "eol", "--", name], cwd=root, capture_output=True, text=True
        ).stdout
        assert said.strip().endswith("eol: lf"), said
