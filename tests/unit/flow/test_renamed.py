"""Names of earlier versions: what users have in files and scripts still works under them."""

import pytest

from gelforge.commands import gelforge
from gelforge.errors import BadInput
from gelforge.flow.files import read_csv, write_csv
from gelforge.flow.renamed import APPEARANCE, notice, with_names_of_today
from gelforge.records.solvetable import Solved, read_solves, write_solves
from gelforge.records.status import Status
from gelforge.stages.rig import contents_of, units_of
from gelforge.virtualrig.appearance import read_appearances
from gelforge.virtualrig.rigplan import read_plan
from gelforge.virtualrig.units import read_ranges


@pytest.mark.parametrize("name", ["hint", "remedy"])
def test_a_table_of_rejected_rows_is_read_by_both_names_of_its_column(tmp_path, name):
    write_csv(tmp_path / "0000.rejected.csv", ["row", name], [{"row": 2, name: "write a number"}])
    assert read_csv(tmp_path / "0000.rejected.csv") == [{"row": "2", "hint": "write a number"}]


@pytest.mark.parametrize("name", ["attempt", "rung"])
def test_a_table_of_solves_is_read_by_both_names_of_its_column(tmp_path, name):
    solve = Solved("a", Status.OK, "", "hex", "m", "f", (0.0, 0.1, -1.0), {"attempt": "hex, smaller load steps"})
    write_solves(tmp_path / "0000.csv", [solve])
    text = (tmp_path / "0000.csv").read_text(encoding="utf-8")
    (tmp_path / "0000.csv").write_text(text.replace("attempt", name, 1), encoding="utf-8")
    assert read_solves(tmp_path / "0000.csv")[0].evidence["attempt"] == "hex, smaller load steps"


@pytest.mark.parametrize("former, name, file, read", [
    ("jpeg_share", "jpeg_fraction", "units.toml", read_ranges),
    ("missing_dots", "missing_markers", "units.toml", read_ranges),
    ("print_turn_deg", "grid_turn_deg", "units.toml", read_ranges),
    ("[mini_a.dots]", "[mini_a.markers]", "sensors.toml", read_appearances),
])  # fmt: skip
def test_a_file_of_the_rig_is_read_by_both_names(tmp_path, capsys, root, former, name, file, read):
    text = (root / "workflow/rig" / file).read_text(encoding="utf-8")
    (tmp_path / file).write_text(text.replace(name, former), encoding="utf-8")
    found = [repr(read(folder / file)) for folder in (root / "workflow/rig", tmp_path)]
    assert found[0] == found[1]
    old, new = (word.strip("[]").split(".")[-1] for word in (former, name))
    assert capsys.readouterr().err.strip().endswith(notice(old, new))


def test_a_key_under_both_names_is_refused():
    with pytest.raises(BadInput, match="f.toml: dots and markers are the same; remove dots"):
        with_names_of_today({"dots": 1, "markers": 2}, APPEARANCE, "f.toml")


def test_folders_of_the_rig_keep_their_digests(root):
    """A folder that an earlier version wrote holds this digest; another one would have all its images drawn anew."""
    plan = read_plan(root / "workflow/rig/demo.toml")
    appearances, sensors = units_of(plan, root / "workflow")
    assert contents_of(plan, root / "workflow", appearances, sensors)[1]["mini_a"] == "6a43218bb3777cd6"


def test_a_command_runs_by_both_names(tmp_path, capsys):
    said = []
    for name in ("provenance", "lineage"):
        with pytest.raises(SystemExit) as ended:
            gelforge.main([name, "--results", str(tmp_path / "lab"), "--id", "s1", "--resolution", "24x32"])
        said.append((ended.value.code, capsys.readouterr().err))
    assert said[1] == (said[0][0], f"{notice('gelforge lineage', 'gelforge provenance')}\n{said[0][1]}")
