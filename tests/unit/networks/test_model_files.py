"""Files of models: read back as written, refused where corrupt, foreign or hostile; the graph is the network."""

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch

from gelforge.commands import convert
from gelforge.errors import BadInput
from gelforge.networks.checkpoint.graph import Graph, provider_of
from gelforge.networks.checkpoint.modelfile import (
    FORMAT,
    ForceModel,
    load_model,
    save_model,
    split_metadata,
    with_digests,
)
from gelforge.networks.checkpoint.onnxexport import Exported, export, sample_pictures
from gelforge.networks.checkpoint.weights import load_weights, read_tree, write_tree
from gelforge.networks.data.arrays import open_data
from gelforge.networks.evaluation.predicted import require_fit
from gelforge.networks.inference.height import height_of
from gelforge.networks.inference.predictor import Predictor
from gelforge.networks.models.registry import build
from gelforge.networks.pipeline import save_trained
from gelforge.networks.preprocess.pair import Preprocessor
from gelforge.networks.preprocess.slopetable import COLOUR_TERMS, PLACE_TERMS, SlopeTable
from gelforge.stages.train import train
from tests.support.limited import limited_python
from tests.support.parameters import with_values
from tests.support.small_networks import IMAGE, MODELS, SMALL
from tests.support.synthetic_presses import SETTINGS


def test_a_model_and_its_weights_come_back_from_their_files(trained, tmp_path):
    save_trained(tmp_path / "m.onnx", trained)
    again = load_model(tmp_path / "m.onnx")
    assert again.metadata == json.loads(json.dumps(trained.metadata)) and again.metadata["format"] == FORMAT
    assert again.stages == trained.model.stages
    net, metadata = load_weights(tmp_path / "m.safetensors")
    assert metadata["name"] == trained.metadata["name"]
    x = torch.rand(2, 3, *IMAGE, generator=torch.Generator().manual_seed(0))
    with torch.inference_mode():
        assert torch.equal(net(x), trained.net(x))


def test_the_file_is_an_onnx_graph_that_any_program_opens(models, tmp_path):
    """With its metadata among ONNX' own, and no more to do than what one page of numpy does."""
    save_model(tmp_path / "m.onnx", models["pair"].model)
    session = onnxruntime.InferenceSession(tmp_path / "m.onnx", providers=["CPUExecutionProvider"])
    metadata = json.loads(session.get_modelmeta().custom_metadata_map["gelforge"])
    assert metadata["name"] == "pair" and [one.name for one in session.get_inputs()] == ["image", "nocontact"]


def test_the_documented_lines_around_a_graph_give_what_predict_gives(models, data):
    """Scale and light before it, tare and factor behind: what someone with onnxruntime alone would write."""
    model, rest = models["pair"].model, data.nocontact["mini0"]
    image = np.clip(np.rint(0.93 * np.asarray(data.images[3]).astype(float) + 3), 0, 255).astype(np.uint8)
    prepare = Preprocessor(model.metadata, rest)
    session = onnxruntime.InferenceSession(model.stages["forces"], providers=["CPUExecutionProvider"])

    def run(seen):
        return session.run(["forces"], {one.name: seen.feature(one.name) for one in session.get_inputs()})[0][0]

    expected = Predictor(model, rest).predict(image).cells
    np.testing.assert_allclose(
        run(prepare(image)) - run(prepare.at_rest()), expected, atol=2e-5 * np.abs(expected).max()
    )


@pytest.mark.parametrize("name", MODELS)
def test_a_graph_predicts_what_its_network_does(models, name, data):
    trained = models[name]
    names = ["image", "nocontact"] if trained.model.needs_nocontact else ["image"]
    pictures = dict(zip(names, sample_pictures(IMAGE, len(names)), strict=True))
    found = Graph(trained.model.stages["forces"], name)(pictures)["forces"]
    with torch.inference_mode():
        expected = Exported(trained.net.eval(), trained.metadata)(
            *(torch.from_numpy(one) for one in pictures.values())
        )
    np.testing.assert_allclose(found, expected.numpy(), atol=1e-5 * float(expected.abs().max()))


def test_a_picture_rotated_by_180_degrees_has_the_rotated_force(models):
    """Where the graph takes the mean over both: whatever the weights."""
    metadata = models["pair"].metadata | {"tta": True}
    graph = Graph(export(models["pair"].net.eval(), metadata)["forces"], "m")
    image, nocontact = sample_pictures(IMAGE, 2)
    found = graph({"image": image, "nocontact": nocontact})["forces"]
    rotated = graph({"image": image[:, ::-1, ::-1].copy(), "nocontact": nocontact[:, ::-1, ::-1].copy()})["forces"]
    signs = np.array([-1.0, -1.0, 1.0])[:, None, None]
    np.testing.assert_allclose(rotated[:, :, ::-1, ::-1] * signs, found, atol=1e-5 * np.abs(found).max())


def test_a_chain_of_graphs_gives_each_stage_what_those_before_it_made(models, data, tmp_path):
    """And slopes of a sensor's own table take the place of those that the first stage estimates."""

    class Difference(torch.nn.Module):
        def forward(self, image, nocontact):
            apart = (image.float() - nocontact.float()).permute(0, 3, 1, 2)[:, :2]
            return torch.nn.functional.avg_pool2d(apart, 2)

    class Sum(torch.nn.Module):
        def forward(self, slopes):
            normal = slopes.mean((2, 3))
            return torch.cat([normal, normal[:, :1]], 1).view(-1, 3, 1, 1)

    def graph(module, inputs, output, example):
        path = tmp_path / f"{output}.onnx"
        torch.onnx.export(
            module, example, str(path), dynamo=False, opset_version=17, input_names=inputs, output_names=[output]
        )
        return path.read_bytes()

    picture = torch.zeros(1, *IMAGE, 3, dtype=torch.uint8)
    stages = {
        "slopes": graph(Difference(), ["image", "nocontact"], "slopes", (picture, picture)),
        "forces": graph(Sum(), ["slopes"], "forces", (torch.zeros(1, 2, IMAGE[0] // 2, IMAGE[1] // 2),)),
    }
    model = ForceModel(with_digests(models["pair"].metadata | {"grid": [1, 1]}, stages), stages)
    save_model(tmp_path / "chain.onnx", model)
    again = load_model(tmp_path / "chain.onnx")
    assert list(again.stages) == ["slopes", "forces"] and (tmp_path / "chain.slopes.onnx").exists()
    rest, image = data.nocontact["mini0"], np.ascontiguousarray(data.images[0])
    plain = Predictor(again, rest)
    seen = plain.prepare(image)
    target = (seen.lit.astype(np.float32) - seen.nocontact.picture).mean((0, 1))[[0, 1, 0]]
    np.testing.assert_allclose(plain.predict(image).total, target, atol=1e-3)
    table = SlopeTable(np.random.default_rng(0).normal(size=(COLOUR_TERMS, PLACE_TERMS, 2)), 16.0)
    own = table.slopes(seen.lit, seen.nocontact.picture)
    assert np.abs(own).max() > 0
    found = Predictor(again, rest, table=table)
    np.testing.assert_allclose(found.predict(image).total, own.mean((1, 2))[[0, 1, 0]], rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(found.height(image), height_of(own, 2 / 16.0), atol=1e-6)
    (tmp_path / "chain.slopes.onnx").write_bytes(stages["forces"])
    with pytest.raises(BadInput, match="its graph `slopes` is not the one that was trained"):
        load_model(tmp_path / "chain.onnx")


@pytest.mark.parametrize("reads", ["image", "difference", "pair"])
@pytest.mark.parametrize(
    "model",
    [SMALL, {"kind": "unet", "widths": [4, 8]}, {"kind": "unet_single", "widths": [2, 4]},
     {"kind": "resnet", "blocks": [1, 1], "widths": [4, 8]}],
    ids=lambda model: model["kind"],
)  # fmt: skip
def test_every_family_is_exported_whatever_it_reads(model, reads):
    """The export itself compares graph and network."""
    torch.manual_seed(1)
    net = build({**model, "reads": reads}, IMAGE, (6, 8)).eval()
    norm = {"reads": reads, "image_mean": [0.3, 0.4, 0.5], "image_std": [0.2, 0.2, 0.2], "label": [0.1, 0.1, 0.4]}
    assert export(net, {"name": "m", "normalisation": norm, "image": IMAGE, "tta": False})


WRITES_A_MODEL = """
import sys
from pathlib import Path
import torch
from gelforge.networks.checkpoint.weights import write_tree

write_tree({"weights": torch.zeros(100_000)}, Path(sys.argv[1]))
"""


def test_weights_for_which_there_is_no_room_are_an_error_of_the_disk(tmp_path):
    ran = limited_python(100, "-c", WRITES_A_MODEL, tmp_path / "m.safetensors")
    assert ran.returncode and ran.stderr.splitlines()[-1].startswith("OSError"), ran.stderr


def test_a_tree_of_tensors_and_values_comes_back(tmp_path):
    tree = {"a": {3: torch.arange(4), "b": [1.5, None, "x", {"c": torch.ones(2, 2)}]}, "inf": float("inf"), "d": {}}
    write_tree(tree, tmp_path / "t.safetensors")
    again = read_tree(tmp_path / "t.safetensors")
    assert torch.equal(again["a"][3], tree["a"][3]) and torch.equal(again["a"]["b"][3]["c"], torch.ones(2, 2))
    assert again["a"]["b"][:3] == [1.5, None, "x"] and again["inf"] == float("inf") and again["d"] == {}
    (tmp_path / "t.safetensors").write_bytes((tmp_path / "t.safetensors").read_bytes()[:40])
    with pytest.raises(BadInput, match="holds no weights of gelforge"):
        read_tree(tmp_path / "t.safetensors")


def test_corrupt_and_foreign_model_files_are_refused(trained, tmp_path):
    path = tmp_path / "m.onnx"
    save_model(path, trained.model)
    whole = path.read_bytes()
    for content in (whole[: len(whole) // 2], b"", b"no model", trained.model.stages["forces"]):
        path.write_bytes(content)
        with pytest.raises(BadInput, match=r"m.onnx: not a gelforge model"):
            load_model(path)
    with pytest.raises(BadInput, match="not found; train one"):
        load_model(tmp_path / "absent.onnx")
    with pytest.raises(BadInput, match=r"holds weights for further training; name .*m.onnx"):
        load_model(tmp_path / "m.safetensors")


def test_a_changed_weight_is_noticed(trained, tmp_path):
    """One bit of one weight: still a graph that runs, but not the one that was trained."""
    path = tmp_path / "m.onnx"
    save_model(path, trained.model)
    content = bytearray(path.read_bytes())
    graph, _ = split_metadata(bytes(content), "m")
    content[len(graph) // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(BadInput, match="the file is corrupt: copy it again"):
        load_model(path)


def test_a_graph_that_is_none_is_refused_where_it_is_used(trained):
    model = replace(trained.model, stages={"forces": b"no graph"})
    with pytest.raises(BadInput, match="its graph cannot be loaded"):
        Predictor(model)


def test_a_device_that_is_not_there_is_refused():
    assert provider_of("cpu") == "CPUExecutionProvider"
    there = onnxruntime.get_available_providers()
    for name, provider in (("cuda", "CUDAExecutionProvider"), ("coreml", "CoreMLExecutionProvider")):
        if provider not in there:
            with pytest.raises(BadInput, match=f"--device {name}: this onnxruntime runs on cpu"):
                provider_of(name)
    with pytest.raises(BadInput, match="--device tpu"):
        provider_of("tpu")


def old_file(path: Path, trained) -> None:
    """A model as the version before wrote it, without what stood beside its network."""
    metadata = {
        name: value
        for name, value in trained.metadata.items()
        if name not in ("stages", "sha256", "tta", "intervals")
    }
    about = metadata | {
        "format": 4,
        "both_ways": True,
        "sha256": 64 * "0",
        "start": {},
        "dots": None,
        "places": None,
        "stacking": None,
    }
    torch.save({"about": json.dumps(about), "tensors": trained.net.state_dict(), "untouched": {}}, path)


def test_a_model_of_an_earlier_version_says_how_it_is_converted_and_then_predicts(models, data, tmp_path):
    path = tmp_path / "old.pt"
    old_file(path, models["pair"])
    with pytest.raises(BadInput, match=f"convert it once with `gelforge convert {path}`"):
        load_model(path)
    assert convert.main([str(path)]) == 0
    found, rest = load_model(tmp_path / "old.onnx"), data.nocontact["mini0"]
    both = ForceModel(
        models["pair"].metadata,
        export(models["pair"].net.eval(), models["pair"].metadata | {"tta": True}),
    )
    expected = Predictor(both, rest).predict(data.images[0])
    np.testing.assert_allclose(Predictor(found, rest).predict(data.images[0]).cells, expected.cells, atol=1e-6)
    assert Predictor(found, rest).predict(data.images[0]).half_width is None


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
    with pytest.raises(BadInput, match="not a gelforge model of format 4"):
        convert.main([str(tmp_path / "m.pt")])
    assert not mark.exists() and not (tmp_path / "m.onnx").exists()


def test_model_of_another_sensor_grid_or_size_is_refused(folder, trained):
    data, model = open_data(folder), trained.model
    require_fit(model, data)
    for key, value, word in (
        ("known_sensors", ["digit"], "digit"),
        ("grid", [5, 5], f"model {model.metadata['name']} writes a grid of 5x5"),
        ("image", [10, 20], f"model {model.metadata['name']} reads images of 20 x 10, the dataset has"),
    ):
        other = replace(model, metadata=model.metadata | {key: value})
        with pytest.raises(BadInput, match=word):
            require_fit(other, data)
    with pytest.raises(BadInput, match="the shipped network reads images of 20 x 10"):
        require_fit(other, data, "the shipped network")


def test_training_takes_the_device_that_is_asked_for(folder):
    data = open_data(folder)
    found = train(data, "small", SMALL, with_values(SETTINGS, epochs=1, device="cpu"))
    assert found.metadata["device"] == "cpu"
    if not torch.cuda.is_available():
        with pytest.raises(BadInput, match='device = "cuda": torch finds no graphics card here'):
            train(data, "small", SMALL, with_values(SETTINGS, epochs=1, device="cuda"))
