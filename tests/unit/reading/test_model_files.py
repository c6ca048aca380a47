"""Files of models: read back as written, refused where corrupt, foreign or hostile; the graph is the network."""

import json
import os
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch

from gelforge.learning.data import open_data
from gelforge.learning.export import Exported, export, load_weights, sample_pictures
from gelforge.learning.nets import build
from gelforge.learning.predictions import require_fit
from gelforge.learning.train import Training, save_trained
from gelforge.reading.frame import Learnt
from gelforge.reading.model import FORMAT, Graph, load_model, provider_of, save_model
from gelforge.reading.pair import NoContact
from gelforge.reading.reader import Reader
from gelforge.stages.train import train
from tests.support.limited import limited_python
from tests.support.parameters import with_values
from tests.support.refused import refused
from tests.support.small_networks import IMAGE, MODELS, SMALL
from tests.support.synthetic_presses import SETTINGS


def test_a_model_and_its_weights_come_back_from_their_files(trained, tmp_path):
    save_trained(tmp_path / "m.onnx", trained)
    again = load_model(tmp_path / "m.onnx")
    assert again.metadata == json.loads(json.dumps(trained.metadata)) and again.metadata["format"] == FORMAT
    assert again.graph.content == trained.model.graph.content
    net, metadata = load_weights(tmp_path / "m.safetensors")
    assert metadata["name"] == trained.metadata["name"]
    x = torch.rand(2, 6, *IMAGE, generator=torch.Generator().manual_seed(0))
    with torch.inference_mode():
        assert torch.equal(net(x), trained.net(x))


def test_the_documented_lines_around_a_graph_give_what_predict_gives(models, data):
    """Scale and light before it, tare and factor behind: what someone with onnxruntime alone would write."""
    model, rest = models["pair"].model, data.nocontact["mini0"]
    image = np.clip(np.rint(0.93 * np.asarray(data.images[3]).astype(float) + 3), 0, 255).astype(np.uint8)
    nocontact = NoContact(rest, model.size, Learnt.of(model.metadata["frame"]))
    session = onnxruntime.InferenceSession(model.graph.content, providers=["CPUExecutionProvider"])

    def run(pair):
        return session.run(["forces"], pair.features())[0][0]

    expected = Reader(rest, model=model)(image).cells
    np.testing.assert_allclose(
        run(nocontact.compare(nocontact.frame(image))) - run(nocontact.itself()),
        expected,
        atol=2e-5 * np.abs(expected).max(),
    )


def test_a_graph_predicts_what_its_network_does(models):
    for name, trained in models.items():
        names = ["image", "nocontact"] if trained.model.needs_nocontact else ["image"]
        pictures = dict(zip(names, sample_pictures(IMAGE, len(names)), strict=True))
        found = trained.model.graph(pictures)
        seen = [torch.from_numpy(one) for one in pictures.values()]
        with torch.inference_mode():
            expected = Exported(trained.net.eval(), trained.metadata)(*seen)
        np.testing.assert_allclose(found, expected.numpy(), atol=1e-5 * float(expected.abs().max()), err_msg=name)


def test_a_picture_rotated_by_180_degrees_has_the_rotated_force(models):
    """Where the graph takes the mean over both: whatever the weights."""
    metadata = models["pair"].metadata | {"tta": True}
    graph = Graph(export(models["pair"].net.eval(), metadata), "m")
    image, nocontact = sample_pictures(IMAGE, 2)
    found = graph({"image": image, "nocontact": nocontact})
    rotated = graph({"image": image[:, ::-1, ::-1].copy(), "nocontact": nocontact[:, ::-1, ::-1].copy()})
    signs = np.array([-1.0, -1.0, 1.0])[:, None, None]
    np.testing.assert_allclose(rotated[:, :, ::-1, ::-1] * signs, found, atol=1e-5 * np.abs(found).max())


def test_every_family_is_exported_for_maps_and_totals():
    """The export itself compares graph and network."""
    torch.manual_seed(1)
    for model in MODELS.values():
        for grid in ((6, 8), (1, 1)):
            net = build(model, IMAGE, grid).eval()
            norm = {"image_mean": [0.3, 0.4, 0.5], "image_std": [0.2, 0.2, 0.2], "label": [0.1, 0.1, 0.4]}
            metadata = {"name": "m", "model": model, "normalisation": norm, "image": IMAGE, "tta": False}
            assert export(net, metadata), (model, grid)


WRITES_A_MODEL = """
import sys
from pathlib import Path
import torch
from gelforge.learning.export import save_weights

save_weights(Path(sys.argv[1]), torch.nn.Linear(400, 250), {})
"""


@pytest.mark.processes
def test_weights_for_which_there_is_no_room_are_an_error_of_the_disk(tmp_path):
    ran = limited_python(100, "-c", WRITES_A_MODEL, tmp_path / "m.safetensors")
    assert ran.returncode and ran.stderr.splitlines()[-1].startswith("OSError"), ran.stderr


def test_corrupt_and_foreign_model_files_are_refused(trained, tmp_path):
    path, other = tmp_path / "m.onnx", r"m.onnx: not (a gelforge model|an ONNX graph that can be loaded)"
    save_model(path, trained.model)
    whole = path.read_bytes()
    one_bit = bytearray(whole)
    one_bit[len(trained.model.graph.content) // 2] ^= (
        1  # of one weight: still a graph that runs, but not the one that was trained
    )
    for content, said in (
        (whole[: len(whole) // 2], other),
        (b"", other),
        (b"no model", other),
        (trained.model.graph.content, other),
        (bytes(one_bit), "the file is corrupt: copy it"),
    ):
        path.write_bytes(content)
        refused(said, load_model, path)
    refused("not found; train one", load_model, tmp_path / "absent.onnx")
    refused(r"holds weights for further training; name .*m.onnx", load_model, tmp_path / "m.safetensors")
    refused("not an ONNX graph that can be loaded", Graph, b"no graph", "none")


def test_a_device_that_is_not_there_is_refused(folder):
    assert provider_of("cpu") == "CPUExecutionProvider"
    there = onnxruntime.get_available_providers()
    for name, provider in (("cuda", "CUDAExecutionProvider"), ("coreml", "CoreMLExecutionProvider")):
        if provider not in there:
            refused(f"--device {name}: this onnxruntime runs on cpu", provider_of, name)
    refused("--device tpu", provider_of, "tpu")
    if not torch.cuda.is_available():
        settings = with_values(SETTINGS, epochs=1, device="cuda")
        said = 'device = "cuda": torch finds no graphics card here'
        refused(said, train, open_data(folder), "small", SMALL, settings)


class WritesWhenLoaded:
    """A pickle of this object writes a file as it is loaded."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.write_text, (self.path, "executed")


def test_code_in_a_file_is_never_run(trained, tmp_path):
    mark = tmp_path / "mark"
    pickle.loads(pickle.dumps(WritesWhenLoaded(mark)))
    assert mark.exists(), "the trap must work for the test to mean something"
    mark.unlink()
    for name in ("m.onnx", "m.safetensors", "checkpoint"):
        torch.save(WritesWhenLoaded(mark), tmp_path / name)
    norm = trained.metadata["normalisation"]
    assert not Training(SMALL, SETTINGS, norm, IMAGE, (6, 8), "cpu").resume(tmp_path / "checkpoint", "one")
    refused("m.onnx: ", load_model, tmp_path / "m.onnx")
    refused("m.safetensors: ", load_weights, tmp_path / "m.safetensors")
    assert not mark.exists()


def test_model_of_another_sensor_grid_or_size_is_refused(folder, trained):
    data, model = open_data(folder), trained.model
    require_fit(model, data)
    for key, value, word in (
        ("grid", [5, 5], f"model {model.metadata['name']} writes a grid of 5x5"),
        ("image", [10, 20], f"model {model.metadata['name']} reads images of 20 x 10, the dataset has"),
    ):
        other = replace(model, metadata=model.metadata | {key: value})
        refused(word, require_fit, other, data)
    refused("the shipped network reads images of 20 x 10", require_fit, other, data, "the shipped network")
    alone = replace(model, metadata=model.metadata | {"model": MODELS["unet"], "known_sensors": ["digit"]})
    refused("digit", require_fit, alone, data)  # a network of pairs reads any sensor


@pytest.mark.parametrize("factor, refused_", [(1.3, True), (0.0, True), (1.02, True), (1.0005, False), (1.0, False)])
def test_a_runtime_that_computes_otherwise_than_the_file_says_is_refused(shipped, tmp_path, factor, refused_):
    """Whatever it gets wrong shows in the forces of the picture that the model file carries."""
    answer = [value / factor if factor else 0.0 for value in shipped.metadata["answer"]]
    other = replace(shipped, metadata=shipped.metadata | {"answer": answer})
    save_model(tmp_path / "m.onnx", other)
    if refused_:
        refused("does not reproduce the model's forces for its test image", load_model, tmp_path / "m.onnx")
    else:
        load_model(tmp_path / "m.onnx")


@pytest.mark.processes
def test_an_opencv_that_is_not_whole_is_refused_in_a_sentence(tmp_path):
    """Two of its packages in one environment, of which one was removed; one that lacks a library of the desktop."""
    for content, said in (
        ("", "it lacks resize"),
        ("raise ImportError('libGL.so.1: cannot open shared object file')", "libGL"),
    ):
        (tmp_path / "cv2.py").write_text(content)
        program = (
            "from gelforge.reading.reader import Reader\ntry: Reader()\nexcept Exception as error: print(repr(error))"
        )
        paths = os.pathsep.join([str(tmp_path), *sys.path])
        done = subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, env=os.environ | {"PYTHONPATH": paths}
        )
        assert (
            "BadInput" in done.stdout
            and said in done.stdout
            and "pip install opencv-contrib-python-headless" in done.stdout
        ), done
