"""A small form of each benchmark: it runs as it stands, and what no clock measures meets its goal there, too."""

import re
import subprocess
import sys

import numpy as np
import pytest

from gelforge.flow.files import read_json
from tests.support.browser import needs_browser
from tests.support.cluster import NEEDS_SLURM
from tests.support.sandbox import clean_environment

# What is measured in these depends on the machine and its load.
CLOCK = {"s", "ms", "times", "images/s", "GiB", "MB"}
QUICK = {
    "dag": ["--samples", "20"],
    "face": ["--parts", "exports", "provenance", "--presses", "50"],
    # scenes where rounding decided once: which steps were cut, and which released points
    "machines": [
        "--ways",
        "draft",
        "--cases",
        "AVX2",
        "COMPATIBLE",
        "--scenes",
        "cylinder",
        "sloping_cuboid",
        "pyramid",
    ],
    "rig": ["--parts", "likeness"],  # an indenter's force factor alone takes 20 s
}
# What makes no small form worth its time, and where the same is tested.
LEFT_OUT = {
    "fea": "solves with CalculiX, FEATS' deck for hours: tests/physics/test_ccx_contact.py and test_ccx_closed_forms.py",
    "benches": "presses a rig and calibrates for many minutes: tests/physics/test_tilt.py and test_calibration_solves.py",
    "calibration": "an emulator takes minutes: tests/workflow/test_calibrate.py",
    "friction": "solves long paths for an hour: tests/physics/test_nested.py and test_laws.py",
    "edge_order": "solves every press of known force on hexahedra: tests/physics/test_laws.py",
    "faults": "plants 154 faults, for more than half an hour; make lint checks that they fit",
    "exact": "solves every press of known force by every method: tests/physics/test_axisymmetric.py",
    "first": "sets up a clone, runs its demo and all its tests: tests/workflow/test_benchmarks.py, a clone of one rule",
    "goodlogs": "fits thousands of simulated logs: tests/unit/evidence/test_forces.py",
    "troubles": "labels the demo: tests/unit/evidence and tests/unit/stages/test_images.py",
    "outside": "GetFEM takes minutes for a scene: tests/workflow/test_outside.py",
}
# What networks predict from so few images says nothing, so no goal is asked for.
WITHOUT_GOAL = {
    "unseen": ["--presses", "1", "--units", "2"],
    "real": ["--parts", "cuboid"],
    "torn": ["--count", "2"],
    "totals": ["--presses", "32"],
}


def run_small(name, words, folder):
    """Figures of a benchmark that was run as make runs it."""
    asked = [sys.executable, "-m", "tests.benchmarks", name, *words, "--out", str(folder / f"{name}.json")]
    done = subprocess.run(asked, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    assert done.returncode == 0, done.stdout[-3000:]
    return read_json(folder / f"{name}.json")["figures"]


def missed(figures):
    """Figures that are no numbers, or miss a goal that has nothing to do with time or memory."""
    assert figures
    return [
        f for f in figures
        if not np.isfinite(f["value"]) or not (f["met"] or f["unit"] in CLOCK)
    ]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(QUICK) - {"rig"}))
def test_a_benchmark_runs(name, tmp_path):
    assert missed(run_small(name, QUICK[name], tmp_path)) == []


@pytest.mark.slow
def test_a_benchmark_that_reads_published_data_runs(tmp_path, reference):
    assert missed(run_small("rig", QUICK["rig"], tmp_path)) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(WITHOUT_GOAL))
def test_a_benchmark_whose_small_form_has_no_goal_runs(name, tmp_path, request):
    if name == "real":
        request.getfixturevalue("reference")  # the others need no published data
    figures = run_small(name, WITHOUT_GOAL[name], tmp_path)
    assert figures and np.isfinite([figure["value"] for figure in figures]).all()


@pytest.mark.slow
@needs_browser
def test_the_page_is_measured(tmp_path):
    assert missed(run_small("face", ["--parts", "page", "--presses", "60"], tmp_path)) == []


class TestOfACluster:
    pytestmark = [*NEEDS_SLURM, pytest.mark.slow]

    def test_its_overhead_is_measured(self, tmp_path):
        assert missed(run_small("slurm", ["--only", "overhead", "--shards", "5"], tmp_path)) == []


def test_first_contact_is_timed_in_a_clone(root, tmp_path):
    source, out = tmp_path / "source", tmp_path / "first.json"
    source.mkdir()
    rule = "setup:\n\t@test ! -e made && head -c 1000000 /dev/zero > made && ln made again && ln -s / whole\n"
    (source / "Makefile").write_text(rule)
    who = ["-c", "user.name=a", "-c", "user.email=a@example.org"]
    for words in (["init", "-q"], ["add", "Makefile"], [*who, "commit", "-q", "-m", "rule"]):
        subprocess.run(["git", *words], cwd=source, check=True)
    (source / "made").touch()  # what is not committed is not in the clone
    environment = {**clean_environment(), "PYTHONPATH": f"{root}:{root / 'src'}"}

    def run(until):
        asked = [sys.executable, "-m", "tests.benchmarks", "first", "--until", until, "--out", str(out)]
        return subprocess.run(asked, cwd=source, env=environment, capture_output=True, text=True)

    done = run("setup")
    assert done.returncode == 0, done.stderr
    found = {f["name"]: f["value"] for f in read_json(out)["figures"]}
    assert set(found) == {"make setup", "disk after make setup"}
    assert 1e-3 < found["disk after make setup"] < 2e-3  # the linked file once, and nothing of /
    done = run("demo")
    assert done.returncode != 0
    assert "make demo failed" in done.stderr


def test_no_benchmark_is_forgotten(root):
    asked = ["make", "--no-print-directory", "-s", "benchmark-X"]
    said = subprocess.run(asked, cwd=root, env=clean_environment(), capture_output=True, text=True, check=True).stdout
    texts = {path.stem: path.read_text() for path in (root / "tests/benchmarks").glob("*.py")}
    measuring = {name for name, text in texts.items() if "main.exit()" in text and "publish_figures(" in text}
    assert set(re.findall(r"benchmark-(\w+)", said)) == measuring
    assert measuring == {*QUICK, *LEFT_OUT, *WITHOUT_GOAL, "slurm"}
