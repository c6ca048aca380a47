"""A trained network as ONNX graphs, checked against torch before anything is made of them.

A network of two stages becomes two graphs (models.geometry), any other one. The graph takes `image` (n, height, width, 3) uint8 RGB and, where the network reads pairs, `nocontact`, both as
`networks.preprocess.pair` prepares them, and gives `forces` (n, 3, rows, cols), N per cell. Scales are inside, and so is
test-time augmentation, where the network learnt from mirrored pictures: the mean over a picture and the same rotated by 180
degrees, whose sideways force is reversed and whose cells trade places (Krizhevsky, Sutskever and Hinton 2012, NeurIPS 25,
section 4.1, average so over parts and mirror images of a picture). One that learnt from its sensor's light alone knows no other.
"""

import io
import warnings
from typing import Any

import numpy as np
import torch
from torch import nn

from gelforge.errors import GelforgeError
from gelforge.networks.checkpoint.graph import Graph
from gelforge.networks.checkpoint.modelfile import LAST
from gelforge.networks.models.geometry import GeometryNet
from gelforge.networks.models.inputs import needs_nocontact, network_input

OPSET = 17
SHAPE = ("slopes", "motion")  # what the first stage of a network of two returns; it is called as the first of them
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


class ExportedSlopes(nn.Module):
    """The first stage of a network of two, with the scales of its input."""

    def __init__(self, net: GeometryNet, metadata: dict[str, Any]) -> None:
        super().__init__()
        self.net, self.norm = net.slopes, metadata["normalisation"]

    def forward(self, *pictures: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        seen = torch.cat(pictures, 3).permute(0, 3, 1, 2).float() / 255
        slopes, motion = self.net(network_input(seen, self.norm))
        return slopes, motion


class ExportedForces(nn.Module):
    """The second stage of a network of two, with the scales of its output."""

    scale: torch.Tensor

    def __init__(self, net: GeometryNet, metadata: dict[str, Any]) -> None:
        super().__init__()
        self.net = net.forces
        self.register_buffer("scale", torch.tensor(metadata["normalisation"]["label"]).float().view(1, 3, 1, 1))

    def forward(self, slopes: torch.Tensor, motion: torch.Tensor) -> torch.Tensor:
        forces: torch.Tensor = self.net(slopes, motion) * self.scale
        return forces


def export(net: nn.Module, metadata: dict[str, Any]) -> dict[str, bytes]:
    """The ONNX graphs of a network in evaluation mode by their stages, by torch's tracing exporter, which needs no other package.

    metadata: its `normalisation`, `image` and `tta`. Raises GelforgeError where a graph differs from torch.
    """
    names = ["image", "nocontact"] if needs_nocontact(metadata["normalisation"]["reads"]) else ["image"]
    pictures = dict(zip(names, sample_pictures(metadata["image"], len(names)), strict=True))
    if not isinstance(net, GeometryNet):
        return {LAST: written(Exported(net, metadata), pictures, (LAST,), metadata["name"])}
    slopes = ExportedSlopes(net, metadata).eval()
    first = written(slopes, pictures, SHAPE, metadata["name"])
    with torch.inference_mode():
        found = slopes(*(torch.from_numpy(one) for one in pictures.values()))
    shape = {name: one.numpy() for name, one in zip(SHAPE, found, strict=True)}
    return {SHAPE[0]: first, LAST: written(ExportedForces(net, metadata), shape, (LAST,), metadata["name"])}


def written(module: nn.Module, given: dict[str, np.ndarray], outputs: tuple[str, ...], name: str) -> bytes:
    """The ONNX graph of a module in evaluation mode whose inputs are named as `given`, which it is compared with torch on."""
    module.eval()
    content = io.BytesIO()
    with warnings.catch_warnings():
        # torch prefers an exporter that needs onnx and onnxscript; these networks do not. Scales are constants.
        warnings.simplefilter("ignore", DeprecationWarning)
        warnings.simplefilter("ignore", torch.jit.TracerWarning)
        torch.onnx.export(
            module,
            tuple(torch.from_numpy(one[:1]) for one in given.values()),
            content,  # type: ignore[arg-type]
            dynamo=False,
            opset_version=OPSET,
            input_names=list(given),
            output_names=list(outputs),
            dynamic_axes={name: {0: "n"} for name in (*given, *outputs)},
        )
    graph = content.getvalue()
    off = largest_difference(module, graph, given, outputs)
    if not off <= TOLERANCE:  # NaN is no agreement
        raise GelforgeError(
            f"{name}: its ONNX form differs from torch by {off:.1e} of the range, allowed is {TOLERANCE}; report the"
            " versions of torch and onnxruntime"
        )
    return graph


def largest_difference(
    module: nn.Module, graph: bytes, given: dict[str, np.ndarray], outputs: tuple[str, ...] = (LAST,)
) -> float:
    """Largest difference between a graph and torch on arrays by input, as a fraction of the range of each output."""
    with torch.inference_mode():
        found = module(*(torch.from_numpy(one) for one in given.values()))
    required = dict(zip(outputs, [found] if len(outputs) == 1 else found, strict=True))
    made = Graph(graph, "exported")(given)
    return max(
        float(np.abs(made[name] - one.numpy()).max() / (float(np.ptp(one.numpy())) or 1.0))
        for name, one in required.items()
    )


def sample_pictures(size: tuple[int, int], count: int) -> list[np.ndarray]:
    """Pictures (SAMPLES, h, w, 3) uint8 of noise over a slope, `count` times: no symmetry that could hide a swapped axis."""
    rng = np.random.default_rng(0)
    slope = np.linspace(30, 200, size[1])[None, None, :, None]
    drawn = [slope + rng.normal(0, 30, (SAMPLES, *size, 3)) for _ in range(count)]
    return [np.clip(one, 0, 255).astype(np.uint8) for one in drawn]
