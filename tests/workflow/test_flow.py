"""The DAG on a tiny dataset through real tools: build, nothing to do, exact rebuilds, faults, resumption."""

import os
import re
import signal
import subprocess
import time

import pytest

from gelforge.flow.files import read_csv, write_csv
from tests.support.sandbox import clean_environment, lay_dataset, make
from tests.support.waiting import wait_until

BUILT = re.compile(r"^results/tiny/(\S+)  [\d.]+ s", re.MULTILINE)
LABELS = "labels", "RES=6x8"
PREDICTED = re.compile(r"gelforge\.flow\.step results/tiny/(\S+)", re.MULTILINE)


def build(project, *goals):
    """Make goals of the dataset; return what was built, in order."""
    done = make(project, "DATASET=tiny", *goals)
    assert done.returncode == 0, done.stdout
    return [name for name in BUILT.findall(done.stdout) if not name.startswith("00_plan")]


def predict(project, *goals):
    """What `make -n` says it would build."""
    done = make(project, "-n", "DATASET=tiny", *goals)
    assert done.returncode == 0, done.stdout
    return PREDICTED.findall(done.stdout)


def edit(project, old, new, name="workflow/params.toml"):
    """Replace text of a file, with a time stamp make cannot miss."""
    path = project / name
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    later = time.time() + 2
    os.utime(path, (later, later))


def stages(built):
    return sorted({name.split("/")[0] for name in built})


@pytest.mark.slow
def test_parameters_are_prerequisites_exactly(whole):
    assert predict(whole, *LABELS) == [] and build(whole, *LABELS) == []

    edit(whole, "\n[fea]\n", "\n# a comment\n[fea]\n")
    assert predict(whole, *LABELS) == [] and build(whole, *LABELS) == []

    expected = predict(whole, "labels", "RES=12x16")
    assert stages(expected) == ["50_labels"]
    assert sorted(build(whole, "labels", "RES=12x16")) == sorted(expected)
    assert build(whole, *LABELS) == []

    edit(whole, "tolerance = 0.2", "tolerance = 0.21", "data/tiny/dataset.toml")
    expected = predict(whole, *LABELS)
    assert stages(expected) == ["30_fea", "40_forces", "50_labels"]
    # a draft solve reads no tolerance, so the tables stay as they were and nothing after them is made again
    assert sorted(build(whole, *LABELS)) == sorted(name for name in expected if name.startswith("30_fea"))
    assert build(whole, *LABELS) == []


@pytest.mark.slow
def test_appending_to_the_log_solves_only_what_is_new(whole, root):
    before = {p: p.stat().st_mtime_ns for p in (whole / "results/tiny/30_fea").rglob("*") if p.is_file()}
    table = (whole / "data/tiny/dataset.toml").read_text(encoding="utf-8")
    lay_dataset(whole, root, "tiny", 7, table[table.index("[params") :])
    later = time.time() + 2
    os.utime(whole / "data/tiny/log.csv", (later, later))
    built = build(whole, *LABELS)
    assert set(built) == {
        "10_poses/0002.csv", "15_images/images.json", "30_fea/0002.csv", "40_forces/0002.npz", "50_labels/6x8/0002.npz",
    }  # fmt: skip
    assert all(p.stat().st_mtime_ns == stamp for p, stamp in before.items())


def test_a_truncated_artifact_is_refused_and_made_again_alone(whole):
    forces = whole / "results/tiny/40_forces/0000.npz"
    content = forces.read_bytes()
    forces.write_bytes(content[: len(content) // 2])
    done = make(whole, "DATASET=tiny", *LABELS)
    assert (
        done.returncode
        and "0000.npz: missing or changed since it was made; remove it (rm results/tiny/40_f" in done.stdout
    )
    forces.unlink()
    assert build(whole, *LABELS) == ["40_forces/0000.npz"]  # of the same content: labels are those of today
    assert forces.read_bytes() == content


@pytest.mark.slow
def test_killing_make_in_a_solve_loses_at_most_that_solve(project):
    build(project, "poses")
    child = subprocess.Popen(
        ["make", "-j1", "DATASET=tiny", "fea"], cwd=project, env=clean_environment(), start_new_session=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    store, first = project / "results/solves", project / "results/tiny/30_fea"
    wait_until(lambda: list(store.glob("[0-9a-f]*.json")), of=child)
    os.killpg(child.pid, signal.SIGKILL)
    child.wait()
    kept = {p: p.stat().st_mtime_ns for p in store.glob("[0-9a-f]*.json")}
    assert kept
    built = build(project, "fea")
    assert set(built) <= {"30_fea/0000.csv", "30_fea/0001.csv"}
    # one killed as it ended leaves its part, until then
    assert not list(first.glob("*.part"))
    assert all(p.stat().st_mtime_ns == stamp for p, stamp in kept.items())
    assert sum(len(read_csv(p)) for p in first.glob("*.csv")) == 4


def bad_row(row, **changes):
    return {**row, **changes}


def test_bad_rows_are_rejected_by_name_and_the_rest_goes_on(project, root):
    edit(project, "shard_size = 2", "shard_size = 8", "data/tiny/dataset.toml")
    path = project / "data/tiny/log.csv"
    rows = read_csv(path)
    good = rows[0]
    rows += [
        bad_row(good, sample_id="nan", x0_mm="nan"),
        bad_row(good, sample_id="text", dz_mm="deep"),
        bad_row(good),
        bad_row(good, sample_id="who", indenter="teapot"),
        bad_row(good, sample_id="sensor", sensor_id="nobody"),
        bad_row(good, sample_id="lost", image="images/none.png"),
        bad_row(good, sample_id="escape", image="../../../workflow/params.toml"),
        bad_row(good, sample_id="never", x0_mm="500"),
        bad_row(good, sample_id="through", dz_mm="-4.5"),
    ]
    (project / "data/tiny/images/broken.png").write_bytes((project / "data/tiny" / good["image"]).read_bytes()[:200])
    rows.append(bad_row(good, sample_id="broken", image="images/broken.png"))
    write_csv(path, list(good), rows)
    done = make(project, "DATASET=tiny", "poses")
    assert done.returncode == 0, done.stdout
    rejected = [r for p in sorted((project / "results/tiny/10_poses").glob("*.rejected.csv")) for r in read_csv(p)]
    named = {r["sample_id"]: r for r in rejected}
    assert {"nan", "text", "who", "sensor", "lost", "escape", "never", "through", "broken", good["sample_id"]} <= set(
        named
    )
    for row in rejected:
        assert row["row"] and row["column"] and row["reason"] and row["hint"]
        assert row["sample_id"] in done.stdout
    kept = [
        r["sample_id"]
        for p in sorted((project / "results/tiny/10_poses").glob("[0-9]*[0-9].csv"))
        for r in read_csv(p)
    ]
    assert len(kept) >= 3 and len(set(kept)) == len(kept)


def test_a_picture_of_two_presses_is_named(project):
    """Over shards."""
    first, *_, last = sorted((project / "data/tiny/images").iterdir())
    own = last.read_bytes()
    last.write_bytes(first.read_bytes())
    done = make(project, "DATASET=tiny", "poses")
    assert done.returncode == 0 and done.stdout.count("shows a picture of the same content") == 2
    assert "kept, in one split" in done.stdout and f"images/{last.name}" in done.stdout
    last.write_bytes(own)
    assert "same content" not in make(project, "DATASET=tiny", "poses").stdout


@pytest.mark.parametrize(("text", "named"), [("", "sample_id"), ("sample_id\n", "no rows")])
def test_an_empty_log_is_an_error(project, text, named):
    (project / "data/tiny/log.csv").write_text(text)
    done = make(project, "DATASET=tiny", "poses")
    assert done.returncode != 0 and named in done.stdout and "log.csv" in done.stdout


def test_an_unknown_dataset_is_an_error(project):
    done = make(project, "DATASET=nowhere", "poses")
    assert done.returncode != 0 and "data/nowhere/log.csv" in done.stdout


def test_a_full_disk_fails_and_the_next_make_resumes(project, tmp_path):
    small = tmp_path / "small"
    small.mkdir()
    if subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=200k", "tmpfs", str(small)], capture_output=True
    ).returncode:
        pytest.skip("a tmpfs cannot be mounted here")
    try:
        (project / "results").symlink_to(small)
        full = make(project, "DATASET=tiny", "poses")
        assert full.returncode != 0 and "No space left" in full.stdout, full.stdout
        subprocess.run(["mount", "-o", "remount,size=200m", str(small)], check=True)
        assert make(project, "DATASET=tiny", "poses").returncode == 0
        assert make(project, "-q", "DATASET=tiny", "poses").returncode == 0
    finally:
        subprocess.run(["umount", "-l", str(small)], check=True)
