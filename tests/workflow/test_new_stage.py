"""The stage that CONTRIBUTING adds, word for word, in a copy of the project."""

import re
import shutil
import textwrap

import pytest

from gelforge.flow.files import read_json
from tests.support.sandbox import lay_dataset, link_project, make


@pytest.mark.slow
def test_a_stage_is_a_line_of_the_table_a_module_and_a_rule(root, tmp_path):
    text = (root / "CONTRIBUTING.md").read_text(encoding="utf-8")
    section = text[text.index("## Add a stage") : text.index("## Add a quantity per cell")]
    blocks = [textwrap.dedent(block) for _, block in re.findall(r"```(python|make)\n(.*?)```", section, re.DOTALL)]
    line, entry, module, rule = blocks
    project = link_project(root, tmp_path / "project")
    for name in ("src", "rules"):
        (project / name).unlink()
        # with what numba compiled, which goes by the dates of sources
        shutil.copytree(root / name, project / name, ignore=shutil.ignore_patterns("*.pyc"))
    layout = project / "src/gelforge/flow/layout.py"
    source = layout.read_text(encoding="utf-8")
    table = re.search(r"^STAGES = \{\n", source, re.MULTILINE)
    source = source[: table.end()] + textwrap.indent(textwrap.dedent(entry), "    ") + source[table.end() :]
    first = source.index("    plan = File(")
    source = source[:first] + textwrap.indent(textwrap.dedent(line), "    ") + source[first:]
    layout.write_text(source, encoding="utf-8")
    (project / "src/gelforge/stages/count.py").write_text(module, encoding="utf-8")
    flow = project / "rules/flow.mk"
    flow.write_text(flow.read_text(encoding="utf-8") + "\n" + rule, encoding="utf-8")
    lay_dataset(project, root, "tiny", 2)
    done = make(project, "count", "DATASET=tiny")
    assert done.returncode == 0, done.stdout
    counts = read_json(project / "results/tiny/95_count/count.json")
    assert sum(counts.values()) == 2
    assert "Nothing to be done" in make(project, "count", "DATASET=tiny").stdout
    assert "how many presses each indenter has" in make(project, "help").stdout
    assert make(project, "clean-count", "DATASET=tiny").returncode == 0
    assert not (project / "results/tiny/95_count").exists()
