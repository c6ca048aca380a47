"""A trained network as an ONNX graph, checked against torch before anything is made of it.

The graph takes `image` (n, height, width, 3) uint8 RGB and, where the network reads pairs, `nocontact`, both as
`reading.pair` prepares them, and gives `forces` (n, 3, rows, cols), N per cell. Scales are inside, and so is
test-time augmentation, where the network learnt from mirrored pictures: the mean over a picture and the same rotated by 180
degrees, whose sideways force is reversed and whose cells trade places (Krizhevsky, Sutskever and Hinton 2012, NeurIPS 25,
section 4.1, average so over parts and mirror images of a picture). One that learnt from its sensor's light alone knows no other.

Weights that a network is fine-tuned from, as safetensors: tensors and metadata, of which nothing is ever executed.
"""

import io
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from gelforge.errors import BadInput, GelforgeError
from gelforge.learning.nets import build, network_input
from gelforge.reading.model import KEY, Graph
from gelforge.records.networkkind import kind_of
from gelforge.records.regular import file_fault

OPSET = 17
OUTPUT = "forces"
SAMPLES = 3  # images that a graph is compared with torch on
# The most that a force per cell may differ from torch's on the images that are checked, as a fraction of the range from the
# least to the largest of all their forces per cell. Engines add up in other orders, which alone makes some 3e-6 of it.
TOLERANCE = 1e-5


class Exported(nn.Module):
    """A network with its scales and, where `rotates`, test-time augmentation: the mean over an image and the same rotated by 180 degrees."""

    scale: torch.Tensor
    reversed_force: torch.Tensor

    def __init__(self, net: nn.Module, metadata: dict[str, Any]) -> None:
        super().__init__()
        self.net, self.norm, self.rotates = net, metadata["normalisation"], metadata["tta"]
        self.register_buffer("scale", torch.tensor(self.norm["label"]).float().view(1, 3, 1, 1))
        self.register_buffer("reversed_force", torch.tensor([-1.0, -1.0, 1.0]).view(1, 3, 1, 1))

    def forward(self, *pictures: torch.Tensor) -> torch.Tensor:
        seen = torch.cat(pictures, 3).permute(0, 3, 1, 2).float() / 255
        forces = self.net(network_input(seen, self.norm))
        if self.rotates:
            rotated = self.net(network_input(seen.flip(2, 3), self.norm)).flip(2, 3)
            forces = 0.5 * (forces + self.reversed_force * rotated)
        return forces * self.scale


def export(net: nn.Module, metadata: dict[str, Any]) -> bytes:
    """The ONNX graph of a network, by torch's tracing exporter, which needs no other package.

    metadata: its `model`, `normalisation`, `image` and `tta`. Raises GelforgeError where the graph differs from torch.
    """
    names = ["image", "nocontact"] if kind_of(metadata["model"]).pair else ["image"]
    pictures = dict(zip(names, sample_pictures(metadata["image"], len(names)), strict=True))
    module, content = Exported(net, metadata).eval(), io.BytesIO()
    with warnings.catch_warnings():
        # torch prefers an exporter that needs onnx and onnxscript; these networks do not. Scales are constants.
        warnings.simplefilter("ignore", DeprecationWarning)
        warnings.simplefilter("ignore", torch.jit.TracerWarning)
        torch.onnx.export(
            module,
            tuple(torch.from_numpy(one[:1]) for one in pictures.values()),
            content,  # type: ignore[arg-type]
            dynamo=False,
            opset_version=OPSET,
            input_names=names,
            output_names=[OUTPUT],
            dynamic_axes={name: {0: "n"} for name in (*names, OUTPUT)},
        )
    graph = content.getvalue()
    off = largest_difference(module, graph, pictures)
    if not off <= TOLERANCE:  # NaN is no agreement
        raise GelforgeError(
            f"{metadata['name']}: its ONNX form differs from torch by {off:.1e} of the range, allowed is {TOLERANCE}; report the"
            " versions of torch and onnxruntime"
        )
    return graph


def largest_difference(module: nn.Module, graph: bytes, pictures: dict[str, np.ndarray]) -> float:
    """Largest difference between a graph and torch on pictures (n, h, w, 3) by input, as a fraction of the range of forces."""
    with torch.inference_mode():
        required = module(*(torch.from_numpy(one) for one in pictures.values())).numpy()
    found = Graph(graph, "exported")(pictures)[OUTPUT]
    return float(np.abs(found - required).max() / (float(np.ptp(required)) or 1.0))


def sample_pictures(size: tuple[int, int], count: int) -> list[np.ndarray]:
    """Pictures (SAMPLES, h, w, 3) uint8 of noise over a slope, `count` times: no symmetry that could hide a swapped axis."""
    rng = np.random.default_rng(0)
    slope = np.linspace(30, 200, size[1])[None, None, :, None]
    drawn = [slope + rng.normal(0, 30, (SAMPLES, *size, 3)) for _ in range(count)]
    return [np.clip(one, 0, 255).astype(np.uint8) for one in drawn]


def save_weights(path: Path, net: nn.Module, metadata: dict[str, Any]) -> None:
    """Write a network's weights and what is known about it to exactly `path`; OSError where it cannot be."""
    from safetensors.torch import save

    tensors = {name: value.detach().cpu().contiguous() for name, value in net.state_dict().items()}
    Path(path).write_bytes(save(tensors, {KEY: json.dumps(metadata, sort_keys=True, allow_nan=False)}))


def load_weights(path: Path) -> tuple[nn.Module, dict[str, Any]]:
    """A network in evaluation mode and what is known about it; BadInput for another file, or tensors that do not fit it."""
    from safetensors import safe_open

    path = Path(path)
    fault = file_fault(path)
    if fault:
        raise BadInput(f"{path}: holds no weights of gelforge ({fault}); train the model again")
    try:
        with safe_open(path, "pt") as stored:
            tensors = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118, it is no dictionary
            metadata = json.loads(stored.metadata()[KEY])
        net = build(metadata["model"], metadata["image"], metadata["grid"])
        net.load_state_dict(tensors)
    except (
        Exception
    ) as error:  # safetensors and torch raise kinds of their own, KeyError and TypeError for a corrupt file
        raise BadInput(
            f"{path}: holds no weights of gelforge that fit the network it describes ({type(error).__name__}); train it again"
        ) from None
    return net.eval(), metadata
