"""Training as make runs it: killed and resumed, refused, evaluated."""

import json
import signal
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from gelforge.flow.files import read_json, write_json
from gelforge.flow.params import plain
from gelforge.networks.checkpoint.modelfile import load_model
from tests.support.parameters import write_stage
from tests.support.synthetic_presses import SETTINGS, write_dataset
from tests.support.waiting import wait_until

EPOCHS = 10


def command(module, *arguments) -> list[str]:
    return [sys.executable, "-m", f"gelforge.stages.{module}", *map(str, arguments)]


def run(asked: list[str]) -> None:
    """What a command does, in this process: each of its own would load torch for seconds."""
    _, _, module, *arguments = asked
    assert import_module(module).main(arguments) == 0


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("training")
    write_dataset(folder / "6x8", 48, (48, 64), (6, 8))
    write_stage(folder, "train", train={**plain(SETTINGS), "epochs": EPOCHS})
    write_stage(folder, "evaluate", evaluate={"force_edges": [0.0, 10.0], "bootstrap": 50})
    write_json(folder / "models.json", {"small": {"kind": "grid", "width": 8, "blocks": 1}})
    return folder


def train_command(place, out, dataset=None) -> list[str]:
    names = {"dataset": dataset or place / "6x8", "model": "small", "models": place / "models.json",
             "params": place / "train.json", "out": out}  # fmt: skip
    return command("train", *(word for name, value in names.items() for word in (f"--{name}", value)))


@pytest.fixture(scope="module")
def whole(place):
    run(train_command(place, place / "whole.onnx.part"))
    return load_model(place / "whole.onnx.part").metadata


def test_killed_training_ends_with_the_same_curve(place, whole):
    out, checkpoint = place / "killed.onnx.part", place / "killed.checkpoint.pt"
    killed = False
    while not killed:  # a machine that looks too late finds the training at its end
        out.unlink(missing_ok=True)
        running = subprocess.Popen(train_command(place, out), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        wait_until(lambda child=running: checkpoint.exists() or child.poll() is not None)
        running.send_signal(signal.SIGKILL)
        killed = running.wait() == -signal.SIGKILL and checkpoint.exists()
    assert not out.exists()
    again = subprocess.run(train_command(place, out), check=True, capture_output=True, text=True)
    assert "going on after epoch" in again.stdout and not checkpoint.exists()
    about = load_model(out).metadata
    assert about["curve"] == whole["curve"] and about["cost"]["resumed"] == 1


def test_command_writes_what_it_says(place, whole):
    assert len(whole["curve"]) == EPOCHS and whole["data"]["samples"]["train"] == 24
    assert (place / "whole.curve.csv").read_text().count("\n") == EPOCHS + 1
    assert (place / "whole.curve.png").exists()
    assert read_json(evaluated(place, place / "whole.onnx.part"))["splits"]["test"]["n"] == 6


def evaluated(place, model: Path) -> Path:
    """Where the evaluation of a model lies."""
    out = model.with_name(model.name.split(".")[0] + ".json")
    asked = command("evaluate", "--dataset", place / "6x8", "--model", model, "--params", place / "evaluate.json")
    run([*asked, "--out", str(out)])
    return out


def test_unusable_dataset_is_one_line_and_leaves_nothing(place, tmp_path):
    ran = subprocess.run(
        train_command(place, tmp_path / "x.onnx.part", tmp_path), capture_output=True, text=True, check=False
    )
    assert ran.returncode == 2 and ran.stderr.startswith("error: ") and ran.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_description_is_plain_json(whole):
    assert json.loads(json.dumps(whole, allow_nan=False)) == whole
