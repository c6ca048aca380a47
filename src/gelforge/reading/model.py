"""Model files: an ONNX graph with its metadata as JSON in `metadata_props`. Loading one executes no code from it.

The graph's inputs are named after the pictures of `reading.pair`, its output is `forces`.
"""

import hashlib
import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.layout import command_for
from gelforge.reading.metadata import check_metadata
from gelforge.records.networkkind import kind_of
from gelforge.records.regular import read_bytes

FORMAT = 7
KEY = "gelforge"  # of the metadata in `metadata_props`
PROPERTY, BYTES = 14, 2  # protobuf: number of this field in ONNX' ModelProto, and type of a length-delimited field
MOST_BYTES = 2**31
PROVIDERS = {"cpu": "CPUExecutionProvider", "cuda": "CUDAExecutionProvider", "coreml": "CoreMLExecutionProvider"}
DEVICES = tuple(PROVIDERS)
# Parts of the answer to the test image, along rows and columns; devices and orders of summation change it by less
# than this fraction of its largest value.
ANSWERED, AGREES = 3, 0.01
INPUTS, OUTPUT = ("image", "nocontact"), "forces"  # allowed names of a graph's inputs, and its output
COLOURED = 3.0 / 255  # least range of the mean colours (0 to 1) of colour images
SHIPPED = Path(__file__).with_name("weights") / "default.onnx"
QUIET = 3  # least severity that onnxruntime prints: errors


def onnxruntime() -> Any:
    """The package onnxruntime, imported without its telemetry, which writes an id to the home folder and looks up a host."""
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    import onnxruntime

    return onnxruntime


class Graph:
    """A graph that is ready to run, by several threads at once; a pickle of it loads it anew.

    content: of an ONNX file, BadInput if it cannot be loaded. where: its name in errors. device: one of DEVICES;
    BadInput where this computer's onnxruntime lacks it. threads: per image.
    """

    def __init__(self, content: bytes, where: str, device: str = "cpu", threads: int = 1) -> None:
        engine = onnxruntime()
        options = engine.SessionOptions()
        options.intra_op_num_threads, options.log_severity_level = threads, QUIET
        provider = provider_of(device)
        try:
            self._session = engine.InferenceSession(content, options, providers=[provider])
        except Exception as error:  # onnxruntime raises a dozen exception types for an invalid graph
            raise BadInput(
                f"{where}: not an ONNX graph that can be loaded ({type(error).__name__}); the file is corrupt, of another kind, or"
                f" newer than this onnxruntime ({engine.__version__}): copy or train it again, or update onnxruntime"
            ) from None
        self.content, self._how = content, (where, device, threads)
        self.inputs = tuple(one.name for one in self._session.get_inputs())

    def __call__(self, given: Mapping[str, np.ndarray]) -> np.ndarray:
        """Forces (n, 3, rows, cols) N per cell from images (n, h, w, 3) uint8 by input name; other images are ignored."""
        (forces,) = self._session.run([OUTPUT], {name: given[name] for name in self.inputs})
        return np.asarray(forces)

    def __reduce__(self) -> tuple[Any, ...]:
        return Graph, (self.content, *self._how)

    @property
    def properties(self) -> dict[str, str]:
        """The `metadata_props` of the file."""
        return dict(self._session.get_modelmeta().custom_metadata_map)


def provider_of(device: str) -> str:
    """onnxruntime's name of a device; BadInput where the device is unknown or not available."""
    available = onnxruntime().get_available_providers()
    there = [name for name, provider in PROVIDERS.items() if provider in available]
    if device not in there:
        raise BadInput(
            f"--device {device}: this onnxruntime runs on {', '.join(there)}; name one of these, or install a build of"
            " onnxruntime for your device (onnxruntime-gpu)"
        )
    return PROVIDERS[device]


@dataclass(frozen=True)
class ForceModel:
    """A network that is ready to run, shared by the readers of all sensors: its metadata and its graph."""

    metadata: dict[str, Any]
    graph: Graph

    @property
    def needs_nocontact(self) -> bool:
        """Whether it compares an image with a no-contact image of the same sensor."""
        return kind_of(self.metadata["model"]).pair

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns of the images that it reads."""
        rows, cols = self.metadata["image"]
        return rows, cols

    @property
    def coloured(self) -> bool:
        """Whether it learnt from images with colour."""
        return bool(np.ptp(self.metadata["normalisation"]["image_mean"]) > COLOURED)


def on_device(model: ForceModel, device: str, threads: int) -> ForceModel:
    """The same model on another device, or with another number of threads per image."""
    return ForceModel(model.metadata, Graph(model.graph.content, f"model {model.metadata['name']}", device, threads))


def model_of(metadata: dict[str, Any], graph: bytes) -> ForceModel:
    """Make a model of a graph; its metadata get the graph's digest and its answer to a test image (`answer_of`)."""
    running = Graph(graph, "the graph")
    answer = answer_of(running, metadata["image"])
    return ForceModel(metadata | {"format": FORMAT, "sha256": digest_of_graph(graph), "answer": answer}, running)


def answer_of(graph: Graph, size: Sequence[int]) -> list[float]:
    """Forces in N that a graph predicts from a test image of a size (h, w), summed over ANSWERED x ANSWERED parts.

    The test image consists of waves of integers, which are the same on every computer and differ between the inputs.
    """
    v, u, colour = np.indices((*size, 3))
    given = {
        name: (90 + (u * (3 + at) + v * (5 - at) + 37 * colour) % 97).astype(np.uint8)[None]
        for at, name in enumerate(graph.inputs)
    }
    (forces,) = graph(given)
    parts = [
        part for rows in np.array_split(forces, ANSWERED, axis=1) for part in np.array_split(rows, ANSWERED, axis=2)
    ]
    return [float(f"{value:.6g}") for part in parts for value in part.sum(axis=(1, 2), dtype=float)]


def check_runtime(graph: Graph, metadata: Mapping[str, Any]) -> None:
    """Raise BadInput where this computer's onnxruntime does not reproduce the answer in the metadata."""
    found, known = np.array(answer_of(graph, metadata["image"])), np.array(metadata["answer"], float)
    off = float(np.abs(found - known).max() / np.abs(known).max()) if found.shape == known.shape else math.inf
    if not off <= AGREES:  # NaN is no agreement
        raise BadInput(
            f"model {metadata['name']}: this computer's onnxruntime ({onnxruntime().__version__}) does not reproduce the model's forces for its test"
            f" image, they differ by up to {off:.0%} of the largest: install another version of onnxruntime, or choose --device cpu"
        )


def digest_of_graph(graph: bytes) -> str:
    """SHA-256 of a graph without metadata."""
    return hashlib.sha256(graph).hexdigest()


def save_model(path: Path, model: ForceModel) -> None:
    """Write a model to exactly `path`; the caller publishes it."""
    text = json.dumps(model.metadata, sort_keys=True, allow_nan=False)
    Path(path).write_bytes(model.graph.content + property_of(text))


def load_model(path: Path | str | None, device: str = "cpu", threads: int = 1) -> ForceModel:
    """Read a model, None: the shipped one; check its metadata, the digest of its graph, and that the graph runs here.

    Raises BadInput for a file that is missing, cut short, changed, or of another kind or format.
    """
    if path is None and not SHIPPED.exists():
        raise BadInput(
            "no model came with this copy of gelforge: train one with `make train` and name it with --model"
        )
    path = Path(path or SHIPPED)
    if path.suffix == ".safetensors":
        raise BadInput(f"{path}: holds weights for further training; name {path.with_suffix('.onnx')} beside it")
    content = read_bytes(path, f"train one with `{command_for('train MODEL=…', path)}`", MOST_BYTES)
    graph = Graph(content, str(path), device, threads)
    text = graph.properties.get(KEY, "")
    try:
        metadata = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path}: not a gelforge model ({error}); name the file that make train wrote") from None
    if not isinstance(metadata, dict) or metadata.get("format") != FORMAT:
        seen = metadata.get("format") if isinstance(metadata, dict) else type(metadata).__name__
        raise BadInput(f"{path}: not a gelforge model of format {FORMAT} (its format is {seen}); train it again")
    check_metadata(metadata, str(path))
    graph.content = content.removesuffix(property_of(text))
    if metadata["sha256"] != digest_of_graph(graph.content):
        raise BadInput(
            f"{path}: its graph is not the one that was trained, the file is corrupt: copy it or train it again"
        )
    if not set(graph.inputs) <= set(INPUTS):
        raise BadInput(
            f"{path}: the graph has the inputs {', '.join(graph.inputs)}, but only {' and '.join(INPUTS)} are known; train it again"
        )
    check_runtime(graph, metadata)
    return ForceModel(metadata, graph)


def property_of(text: str) -> bytes:
    """Metadata as an entry of metadata_props; protobuf allows fields in any order, so it is appended to the graph."""
    return _field(PROPERTY, _field(1, KEY.encode()) + _field(2, text.encode()))


def _field(number: int, content: bytes) -> bytes:
    return _varint(number << 3 | BYTES) + _varint(len(content)) + content


def _varint(value: int) -> bytes:
    found = bytearray()
    while value > 0x7F:
        found.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*found, value])


def datasets_of(metadata: dict[str, Any]) -> list[dict[str, Any]]:
    """The metadata of each dataset that a model learnt from, its own first, those of the network that it began as last."""
    return [metadata["data"], *metadata["also"], *metadata.get("start", {}).get("learnt", [])]


def fingerprint(metadata: dict[str, Any]) -> str:
    """Identity of a model: the first 16 digits of its graph's digest."""
    digest: str = metadata["sha256"][:16]
    return digest


def require_sensor(model: ForceModel, *required: str | None) -> None:
    """Raise BadInput if a single-image model is for none of the sensors `required`; None asks for nothing."""
    known, named = model.metadata["known_sensors"], {name for name in required if name}
    if named and not model.needs_nocontact and named.isdisjoint(known):
        raise BadInput(
            f"model {model.metadata['name']} was made for sensors {', '.join(known)}, not for "
            f"{', '.join(sorted(named))}: use a model trained on a dataset with that sensor"
        )
