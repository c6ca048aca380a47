"""Make is interrupted, one of its shards fails, or it may not write: what is there stays whole, and the same make goes on."""

import os
import re
import signal
import subprocess
from contextlib import contextmanager

import pytest

from tests.support.sandbox import clean_environment, make
from tests.support.waiting import heed_interrupts, wait_until

LABELS = "labels", "DATASET=tiny", "RES=6x8"
OF_LABELS, LOGS = "results/tiny/50_labels/6x8", "results/tiny/logs/50_labels/6x8"
SHARDS = "0000.npz", "0001.npz"


def contents(project) -> dict[str, bytes]:
    """Label files that are there."""
    return {
        name: (project / OF_LABELS / name).read_bytes() for name in SHARDS if (project / OF_LABELS / name).exists()
    }


def test_an_interrupted_make_leaves_whole_files_alone_and_the_next_one_goes_on(whole):
    """As Ctrl-C does: make and all that it started are interrupted."""
    expected, interrupted = contents(whole), False
    while not interrupted:  # a machine that looks too late finds both shards made
        for name in SHARDS:
            (whole / OF_LABELS / name).unlink()
            (whole / LOGS / name).with_suffix(".log").unlink()
        process = subprocess.Popen(
            ["make", "-j1", *LABELS], cwd=whole, env=clean_environment(), start_new_session=True,
            preexec_fn=heed_interrupts, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        wait_until(lambda: list((whole / LOGS).glob("*.log")), of=process)
        os.killpg(process.pid, signal.SIGINT)
        said, _ = process.communicate()
        interrupted = process.returncode != 0
    assert "Traceback" not in said, said
    left = {path.name for path in (whole / OF_LABELS).iterdir() if path.suffix != ".lock"}
    assert contents(whole).items() < expected.items() and left == set(contents(whole))
    done = make(whole, *LABELS)
    assert done.returncode == 0 and contents(whole) == expected, done.stdout


def test_with_k_the_other_shards_are_made_though_one_fails(whole):
    expected, forces = contents(whole), whole / "results/tiny/40_forces/0000.npz"
    for name in SHARDS:
        (whole / OF_LABELS / name).unlink()
    kept = forces.read_bytes()
    forces.write_bytes(kept[: len(kept) // 2])
    done = make(whole, "-k", "-j1", *LABELS)
    assert done.returncode and "40_forces/0000.npz: missing or changed since it was made" in done.stdout
    assert contents(whole) == {"0001.npz": expected["0001.npz"]}
    forces.write_bytes(kept)
    done = make(whole, *LABELS)
    assert done.returncode == 0 and contents(whole) == expected, done.stdout


@contextmanager
def read_only(folder):
    """The folder, in which nobody may write; root heeds no permissions, but a mount."""
    if os.geteuid():
        folder.chmod(0o555)
        yield
        folder.chmod(0o755)
        return
    if subprocess.run(["mount", "--bind", folder, folder], capture_output=True).returncode:
        pytest.skip("a folder cannot be mounted here")
    try:
        subprocess.run(["mount", "-o", "remount,ro,bind", folder], check=True)
        yield
    finally:
        subprocess.run(["umount", "-l", folder], check=True)


def test_results_that_may_only_be_read_are_refused_in_one_sentence(whole):
    """Nothing is to be done for what is there."""
    with read_only(whole / "results"):
        assert make(whole, *LABELS).returncode == 0
        done = make(whole, "-j1", "labels", "DATASET=tiny", "RES=3x4")
    assert done.returncode and "Traceback" not in done.stdout
    assert "50_labels/3x4" in done.stdout, done.stdout
    assert len(re.findall("Read-only file system|Permission denied", done.stdout)) == 1, done.stdout
