"""A trained network as an ONNX graph, checked against torch, and its weights as safetensors.

The graph takes `image` (n, height, width, 3) uint8 RGB and, for a network of pairs, `nocontact`, both as
`reading.pair` prepares them, and gives `forces` (n, 3, rows, cols), N per cell. It includes the scales, and test-time
augmentation for a network that was trained on mirrored images: the mean of the forces for an image and for the image
rotated by 180 degrees, these rotated back with shear reversed (Krizhevsky, Sutskever and Hinton 2012, NeurIPS 25,
section 4.1, average over crops and mirror images likewise). A network that saw light from one direction only gets
none.

The safetensors file, from which another network can be fine-tuned, holds tensors and metadata; no code in it is run.
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
from gelforge.reading.model import KEY, OUTPUT, Graph
from gelforge.records.networkkind import kind_of
from gelforge.records.regular import file_fault

OPSET = 17
SAMPLES = 3  # images on which a graph is compared with torch
# Largest difference of a force per cell from torch's, as a fraction of the range of all forces per cell of these
# images. The order of summation, which differs between engines, alone causes some 3e-6.
TOLERANCE = 1e-5


class Exported(nn.Module):
    """A network with its scales and, if `rotates`, test-time augmentation by the image rotated by 180 degrees."""

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

    metadata: its `model`, `normalisation`, `image` and `tta` are read. Raises GelforgeError if the graph's forces
    differ from torch's.
    """
    names = ["image", "nocontact"] if kind_of(metadata["model"]).pair else ["image"]
    pictures = dict(zip(names, sample_pictures(metadata["image"], len(names)), strict=True))
    module, content = Exported(net, metadata).eval(), io.BytesIO()
    with warnings.catch_warnings():
        # torch's other exporter needs onnx and onnxscript. The tracer warns of scales that become constants, as
        # intended.
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
            f"{metadata['name']}: its ONNX graph differs from torch by {off:.1e} of the force range (at most {TOLERANCE} is"
            " allowed); report the versions of torch and onnxruntime"
        )
    return graph


def largest_difference(module: nn.Module, graph: bytes, pictures: dict[str, np.ndarray]) -> float:
    """Largest difference between graph and torch on images (n, h, w, 3) by input, as fraction of the force range."""
    with torch.inference_mode():
        required = module(*(torch.from_numpy(one) for one in pictures.values())).numpy()
    found = Graph(graph, "exported")(pictures)
    return float(np.abs(found - required).max() / (float(np.ptp(required)) or 1.0))


def sample_pictures(size: tuple[int, int], count: int) -> list[np.ndarray]:
    """`count` times images (SAMPLES, h, w, 3) uint8: noise on a slope, so that no symmetry hides a swapped axis."""
    rng = np.random.default_rng(0)
    slope = np.linspace(30, 200, size[1])[None, None, :, None]
    drawn = [slope + rng.normal(0, 30, (SAMPLES, *size, 3)) for _ in range(count)]
    return [np.clip(one, 0, 255).astype(np.uint8) for one in drawn]


def save_weights(path: Path, net: nn.Module, metadata: dict[str, Any]) -> None:
    """Write a network's weights and metadata to exactly `path`; OSError if that fails."""
    from safetensors.torch import save

    tensors = {name: value.detach().cpu().contiguous() for name, value in net.state_dict().items()}
    Path(path).write_bytes(save(tensors, {KEY: json.dumps(metadata, sort_keys=True, allow_nan=False)}))


def load_weights(path: Path) -> tuple[nn.Module, dict[str, Any]]:
    """A network in evaluation mode and its metadata; BadInput for another file, or tensors that do not fit."""
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
