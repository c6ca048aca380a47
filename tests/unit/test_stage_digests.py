"""Who changes code that a stage's results are made by says whether they change: by its VERSION, or by `make stage-digests`."""

import json

import pytest

from tests.support.stage_digests import PYTHON, STAGES, TABLE, closure, imports, today

HINT = (
    "where results change, raise VERSION in src/gelforge/stages/STAGE.py; where none do, leave it; then run make"
    " stage-digests and commit tests/stage_digests.json"
)


def test_code_of_stages_changed_with_a_word_on_their_results():
    kept = json.loads(TABLE.read_text())
    if kept["python"] != PYTHON:
        pytest.skip(f"the digests are of Python {kept['python']}")
    now = today()
    changed = {
        name for name in now["modules"] | kept["modules"] if now["modules"].get(name) != kept["modules"].get(name)
    }
    same = {stage for stage in STAGES if now["versions"][stage] == kept["versions"].get(stage)}
    unsaid = {stage: sorted(changed & closure(stage)) for stage in sorted(same) if changed & closure(stage)}
    assert not unsaid, f"changed since the table was written, VERSION as before: {unsaid}; {HINT}"
    assert now == kept, f"the table is of before; {HINT}"


def test_a_closure_reaches_what_is_imported_inside_functions():
    assert "gelforge.mechanics.solvekey" in closure("fea") and "gelforge.errors" in closure("poses")
    assert "gelforge.networks.pipeline" in imports("gelforge.stages.train")
    assert "gelforge.networks.pipeline" not in closure("fea")
