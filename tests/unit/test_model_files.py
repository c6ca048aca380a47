"""Files of trained networks: read back as written, refused where damaged, foreign or hostile."""

import json
import pickle
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from parameters import with_values
from small_networks import GRID, IMAGE, SMALL
from synthetic_presses import SETTINGS

from gelforge.errors import BadInput
from gelforge.networks.data import open_data
from gelforge.networks.modelfile import (
    FORMAT,
    SensorNet,
    Trained,
    load_model,
    predict_images,
    require_fit,
    save_model,
)
from gelforge.networks.models import build
from gelforge.networks.training import normalisations, predict_rows
from gelforge.stages.train import train
from tests.limited import limited_python


def test_model_file_round_trip(trained, tmp_path):
    save_model(tmp_path / "m.pt", trained)
    again = load_model(tmp_path / "m.pt")
    digest = again.about.pop("sha256")
    assert len(digest) == 64 and again.about == json.loads(json.dumps({"format": FORMAT} | trained.about))
    x = torch.rand(2, 3, *IMAGE, generator=torch.Generator().manual_seed(0)) * 255
    with torch.inference_mode():
        assert torch.equal(SensorNet(again)(x), SensorNet(trained)(x))


WRITES_A_MODEL = """
import sys
from pathlib import Path
import torch
from gelforge.networks.modelfile import write_tensors

write_tensors({"weights": torch.zeros(100_000)}, Path(sys.argv[1]))
"""


def test_a_model_for_which_there_is_no_room_is_an_error_of_the_disk(tmp_path):
    ran = limited_python(100, "-c", WRITES_A_MODEL, tmp_path / "m.pt")
    assert ran.returncode and ran.stderr.splitlines()[-1].startswith("OSError"), ran.stderr


def test_model_file_keeps_the_untouched_sensors(folder, tmp_path):
    data = open_data(folder)
    pair = train(data, "pair", {**SMALL, "reads": "pair"}, with_values(SETTINGS, epochs=1))
    save_model(tmp_path / "m.pt", pair)
    again = load_model(tmp_path / "m.pt")
    assert again.untouched.keys() == {"mini0"}
    np.testing.assert_array_equal(again.untouched["mini0"], data.nocontact["mini0"])
    content = torch.load(tmp_path / "m.pt", weights_only=True)
    torch.save(content | {"untouched": {"mini0": torch.zeros(9, dtype=torch.uint8)}}, tmp_path / "m.pt")
    with pytest.raises(BadInput, match="untouched mini0: cannot be read as an image"):
        load_model(tmp_path / "m.pt")


@pytest.mark.parametrize("reads", ["image", "difference", "pair"])
@pytest.mark.parametrize(
    "model",
    [
        SMALL,
        {"kind": "unet", "widths": [4, 8]},
        {"kind": "unet_single", "widths": [2, 4]},
        {"kind": "resnet", "blocks": [1, 1], "widths": [4, 8]},
    ],
    ids=lambda model: model["kind"],
)
def test_a_reader_is_the_network_it_was_trained_as(folder, model, reads):
    data = open_data(folder)
    rows = data.splits["test"]
    trained = train(data, reads, {**model, "reads": reads}, with_values(SETTINGS, epochs=1))
    wanted = predict_rows(trained.net, data, rows, trained.about["normalisation"])
    reader = SensorNet(trained, data.nocontact["mini0"]).eval()
    assert not normalisations(reader)  # in the convolutions before them
    got = predict_images(reader, data.seen(rows, reads)[..., :3])  # under the light of the untouched picture
    np.testing.assert_allclose(got, wanted, atol=1e-5 * np.abs(wanted).max())


def test_damaged_and_foreign_model_files_are_refused(trained, tmp_path):
    path = tmp_path / "m.pt"
    save_model(path, trained)
    whole = path.read_bytes()
    for content in (whole[: len(whole) // 2], b"", b"no model"):
        path.write_bytes(content)
        with pytest.raises(BadInput, match="m.pt"):
            load_model(path)
    torch.save({"weights": torch.zeros(2)}, path)
    with pytest.raises(BadInput, match="not a gelforge model"):
        load_model(path)
    about = json.dumps({"format": FORMAT, "sha256": 64 * "0"} | trained.about)
    torch.save({"about": about, "tensors": {"a": torch.zeros(2)}, "untouched": {}}, path)
    with pytest.raises(BadInput, match="do not fit"):
        load_model(path)
    with pytest.raises(BadInput, match="no such model"):
        load_model(tmp_path / "absent.pt")


@pytest.mark.parametrize(
    ("described", "told"),
    [
        (
            {"model": {"kind": "resnet", "blocks": [1], "widths": [4]}},
            r"grid is \[6, 8\], but its network knows totals only",
        ),
        (
            {"model": {"kind": "unet", "widths": [4, 8, 16]}, "image": [24, 32]},
            "its network cannot be built .*32 x 24",
        ),
    ],
)
def test_a_network_that_cannot_do_what_its_file_says_is_refused(trained, tmp_path, described, told):
    about = trained.about | described
    save_model(tmp_path / "m.pt", Trained(build(about["model"], IMAGE, GRID), about))
    with pytest.raises(BadInput, match=f"m.pt: {told}"):
        load_model(tmp_path / "m.pt")


class WritesWhenLoaded:
    """A pickle of this object writes a file as it is loaded."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.write_text, (self.path, "executed")


def test_code_in_a_model_file_is_never_run(tmp_path):
    mark = tmp_path / "mark"
    pickle.loads(pickle.dumps(WritesWhenLoaded(mark)))
    assert mark.exists(), "the trap must work for the test to mean something"
    mark.unlink()
    torch.save(WritesWhenLoaded(mark), tmp_path / "m.pt")
    with pytest.raises(BadInput, match="never run"):
        load_model(tmp_path / "m.pt")
    assert not mark.exists()


def test_model_of_another_sensor_grid_or_size_is_refused(folder, trained):
    data = open_data(folder)
    require_fit(trained, data)
    for key, value, word in (
        ("known_sensors", ["digit"], "digit"),
        ("grid", [5, 5], f"model {trained.about['name']} writes a grid of 5x5"),
        ("image", [10, 20], f"model {trained.about['name']} reads images of 20 x 10, the dataset has"),
    ):
        other = type(trained)(trained.net, trained.about | {key: value})
        with pytest.raises(BadInput, match=word):
            require_fit(other, data)
    with pytest.raises(BadInput, match="the network that ships reads images of 20 x 10"):
        require_fit(other, data, "the network that ships")


def test_a_changed_weight_is_noticed(trained, tmp_path):
    """One bit of one weight: still a file of tensors that fit, but not the network that was trained."""
    path = tmp_path / "m.pt"
    save_model(path, trained)
    content = torch.load(path, weights_only=True)
    name = max(content["tensors"], key=lambda name: content["tensors"][name].numel())
    content["tensors"][name].view(-1)[0] += 1e-3
    torch.save(content, path)
    with pytest.raises(BadInput, match="weights are not those that were trained"):
        load_model(path)
