"""Training as make runs it: killed and resumed, refused, evaluated."""

import json
import signal
import subprocess
import sys
from importlib import import_module

import pytest

from gelforge.flow.files import read_json, write_json
from gelforge.flow.layout import Layout
from gelforge.flow.params import plain
from gelforge.reading.model import load_model
from tests.support.parameters import write_stage
from tests.support.synthetic_presses import SETTINGS, write_dataset
from tests.support.waiting import wait_until

pytestmark = pytest.mark.slow  # `whole` of the other tests trains by make
EPOCHS = 6


def command(module, *arguments) -> list[str]:
    return [sys.executable, "-m", f"gelforge.stages.{module}", *map(str, arguments)]


def run(asked: list[str]) -> None:
    """What a command does, in this process: each of its own would load torch for seconds."""
    _, _, module, *arguments = asked
    assert import_module(module).main(arguments) == 0


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    of = Layout(tmp_path_factory.mktemp("training") / "results/made")
    write_dataset(of.dataset("6x8"), 48, (48, 64), (6, 8))
    write_stage(of.params, "train", train={**plain(SETTINGS), "epochs": EPOCHS})
    write_stage(of.params, "evaluate", evaluate={"force_edges": [0.0, 10.0]})
    for name in ("whole", "killed"):
        write_json(of.parameters(f"models/{name}"), {name: {"kind": "grid", "width": 8, "blocks": 1}})
    return of


@pytest.fixture(scope="module")
def whole(place):
    # in a process of its own, as the killed one: the last bits of a sum depend on what a process did before
    subprocess.run(command("train", place.root, "6x8", "whole"), check=True, capture_output=True)
    return load_model(place.network("6x8", "whole")).metadata


def test_killed_training_ends_with_the_same_curve(place, whole):
    out, asked = place.network("6x8", "killed"), command("train", place.root, "6x8", "killed")
    checkpoint = out.with_name("killed.checkpoint.pt")
    killed = False
    while not killed:  # a machine that looks too late finds the training at its end
        out.unlink(missing_ok=True)
        running = subprocess.Popen(asked, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        wait_until(lambda child=running: checkpoint.exists() or child.poll() is not None)
        running.send_signal(signal.SIGKILL)
        killed = running.wait() == -signal.SIGKILL and checkpoint.exists()
    assert not out.exists()
    again = subprocess.run(asked, check=True, capture_output=True, text=True)
    assert "going on after epoch" in again.stdout and not checkpoint.exists()
    about = load_model(out).metadata
    assert about["curve"] == whole["curve"] and about["cost"]["resumed"] == 1


def test_command_writes_what_it_says(place, whole):
    assert len(whole["curve"]) == EPOCHS and whole["data"]["samples"]["train"] == 24
    trained = place.network("6x8", "whole")
    assert trained.with_name("whole.curve.csv").read_text().count("\n") == EPOCHS + 1
    assert place.curve("6x8", "whole").exists()
    run(command("evaluate", place.root, "6x8", "whole"))
    assert read_json(place.evaluation("6x8", "whole"))["splits"]["test"]["n"] == 6


def test_unusable_dataset_is_one_line_and_leaves_nothing(place):
    asked = command("train", place.root, "12x16", "whole")
    ran = subprocess.run(asked, capture_output=True, text=True, check=False)
    assert ran.returncode == 2 and ran.stderr.startswith("error: ") and ran.stderr.count("\n") == 1
    assert list(place.network("12x16", "whole").parent.iterdir()) == []


def test_description_is_plain_json(whole):
    assert json.loads(json.dumps(whole, allow_nan=False)) == whole
