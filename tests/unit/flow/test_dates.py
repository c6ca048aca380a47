"""What dates do not tell: files that another replaced, and results dated ahead of the clock."""

import os
import time

from gelforge.flow import dates
from gelforge.flow.dates import ahead, keep_states, refuse_ahead, states_of, unchanged
from gelforge.flow.files import write_text
from tests.support.refused import refused


def test_each_change_of_a_file_is_seen_and_none_where_there_is_none(tmp_path):
    """One that an older one replaced, with the same size and date, one that comes or goes, and what a link leads to."""
    log, linked, absent, folder = (tmp_path / name for name in ("log.csv", "linked.csv", "later.toml", "nocontact"))
    odd = tmp_path / "a\tb\nc.png"
    for path in (log, tmp_path / "behind.csv", odd):
        path.write_text("whole")
        os.utime(path, (1e9, 1e9))
    linked.symlink_to("behind.csv")
    folder.mkdir()

    def replace():
        (tmp_path / "copy").write_text("other")
        os.utime(tmp_path / "copy", (1e9, 1e9))
        (tmp_path / "copy").replace(log)

    changes = (
        replace,
        lambda: os.utime(log, (0, 0)),
        lambda: os.utime(log, (time.time() + 9e4,) * 2),
        lambda: (tmp_path / "behind.csv").write_text("x"),
        absent.touch,
        absent.unlink,
        (folder / "mini.png").touch,
        odd.unlink,
        log.unlink,
    )
    kept = tmp_path / "states"
    assert not unchanged(kept)
    for change in changes:
        keep_states(kept, states_of([log, linked, absent, folder, odd, "no\0name"]))
        assert unchanged(kept)
        change()
        assert not unchanged(kept)
    for text in ("", "no state", "1 2 3\t"):
        kept.write_text(text)
        assert not unchanged(kept)


def test_results_dated_ahead_are_refused_but_for_moments(tmp_path, monkeypatch):
    results = tmp_path / "results/tiny"
    refuse_ahead(results)  # of a dataset of which nothing was made
    now = time.time()
    late = ["00_plan/plan.mk", "10_poses/0000.csv", "50_labels/24x32/labels.json"]
    for name in late:
        write_text(results / name, "")
        os.utime(results / name, (now + 3600,) * 2)
    assert ahead(results, now) == [str(results / name) for name in late]
    refused(f"{late[0]} is dated .* make clean-ahead DATASET=tiny, which removes", refuse_ahead, results)
    for name in late:
        os.utime(results / name, (now - 5,) * 2)
    # no result that make judges by its date
    for name in ("30_fea/0000/s1.json", "logs/x.log", "metrics/30_fea/0000.json", ".slurm/x", "export/a.h5"):
        write_text(results / name, "")
        os.utime(results / name, (now + 3600,) * 2)
    assert ahead(results, time.time()) == []
    write_text(results / "10_poses/0001.csv", "")
    os.utime(results / "10_poses/0001.csv", (time.time() + 1.0,) * 2)
    refuse_ahead(results)  # clocks a moment apart are waited for


def test_what_is_dated_ahead_is_removed_but_for_the_table_of_shards_and_solves(tmp_path, monkeypatch):
    results, late = tmp_path / "results/tiny", time.time() + 9e4
    names = (
        "00_plan/shards.csv",
        "30_fea/0000/s1.json",
        "10_poses/0000.csv",
        "00_plan/plan.mk",
        "40_forces/0000.npz",
    )
    for name in names:
        write_text(results / name, "")
        os.utime(results / name, (late, late))
    os.utime(results / names[-1], (1e9, 1e9))
    monkeypatch.setattr("sys.argv", ["dates", str(results)])
    assert dates.main() == 0 and ahead(results, time.time()) == []
    assert [name for name in names if (results / name).exists()] == [*names[:2], names[-1]]
