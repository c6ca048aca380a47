"""What the small networks that read motions of printed dots share: their layers, and how they learn and read."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TypeVar

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from gelforge.networks.batches import generator
from gelforge.networks.dots import COLS, ROWS
from gelforge.networks.halves import rounded

STRIDES = (1, 1, 2, 1)  # of the convolutions, one after the other
LEFT = ((ROWS + 1) // 2, (COLS + 1) // 2)  # rows and columns that they leave of the lattice of dots
BATCH, RATE = 64, 2e-3
HUBER = 0.05  # units of an answer below which errors count by their square, and above by themselves
PIECE = 1024  # pictures that are read at once
Net = TypeVar("Net", bound=nn.Module)


class Stack(nn.ModuleList):
    """Convolutions, each cut off at zero: (n, 3, ROWS, COLS) to (n, groups * widths[-1], *LEFT).

    widths: channels behind each of them. groups: networks that stand side by side: all see the same motion, and behind it
    each its own channels alone.
    """

    def __init__(self, widths: Sequence[int], groups: int = 1) -> None:
        first, *strides = STRIDES
        super().__init__([nn.Conv2d(3, groups * widths[0], 3, first, 1)])
        self.extend(
            nn.Conv2d(groups * a, groups * b, 3, stride, 1, groups=groups)
            for (a, b), stride in zip(pairwise(widths), strides, strict=True)
        )

    def forward(self, motion: torch.Tensor) -> torch.Tensor:
        for convolution in self:
            motion = F.relu(convolution(motion), inplace=True)
        return motion


class Whole(nn.Conv2d):
    """A convolution as large as what it sees, (n, channels, *LEFT) to (n, answers, 1, 1): a product of matrices.

    As a convolution it would bring its weights, which are many, into another order for every picture.
    """

    def __init__(self, channels: int, answers: int, groups: int = 1) -> None:
        super().__init__(channels, answers, LEFT, groups=groups)

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        weight = self.weight.view(self.groups, self.out_channels // self.groups, -1)
        parts = seen.reshape(len(seen), self.groups, weight.shape[2]).transpose(0, 1)
        told = torch.bmm(parts, weight.transpose(1, 2)).transpose(0, 1).reshape(len(seen), self.out_channels)
        return (told if self.bias is None else told + self.bias)[:, :, None, None]


def train_small(
    make: Callable[[], Net],
    lesson: Callable[[Net, torch.Tensor, torch.Generator], tuple[torch.Tensor, torch.Tensor]],
    name: str,
    count: int,
    epochs: int,
    seed: int,
) -> Net:
    """A small network trained on `count` presses, rounded as its file keeps it; the same seed gives the same one.

    make: the network with weights that torch's own generator draws. lesson: of the network, the numbers (k,) of some
    presses and a generator for whatever is varied, what the network tells of them and what it should, two tensors of
    one shape in units of about what an answer is. name: tells the network's draws from those of others of the same
    seed.
    """
    torch.manual_seed(seed)
    net = make()
    optimiser = torch.optim.Adam(net.parameters(), lr=RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, epochs)
    for epoch in range(epochs):
        draw = generator(seed, name, epoch)
        for rows in torch.randperm(count, generator=draw).split(BATCH):
            told, wanted = lesson(net, rows, draw)
            loss = F.smooth_l1_loss(told, wanted, beta=HUBER)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        schedule.step()
    return rounded(net).eval()


def in_pieces(net: nn.Module, motion: np.ndarray) -> np.ndarray:
    """What a small network tells of motions (n, 3, ROWS, COLS) float32, (n, answers) float64; n may be 0 or large."""
    with torch.no_grad():
        parts = [net(part) for part in torch.from_numpy(np.ascontiguousarray(motion)).split(PIECE)]
    return torch.cat(parts).double().numpy()


class OneByOne:
    """A small network that reads a few motions at a time: the same numbers as of many, with little done around them.

    Of one picture the work is so small that half of a processor's time goes into calls and into weights that are brought
    into another order: here they stand in the order in which they are used. The network is read as it is now; what
    becomes of its weights later is not seen.

    convolutions: what sees the motion. inner, outer: the layers behind, as `Whole` and as one more of 1 x 1 or a product
    of matrices, each of as many groups as the convolutions have.
    """

    def __init__(self, convolutions: Stack, inner: Whole, outer: nn.Conv2d | nn.Linear) -> None:
        self._groups = inner.groups
        self._convolutions = [
            (weight.contiguous(memory_format=torch.channels_last), bias, layer.stride, layer.groups)
            for layer in convolutions
            if isinstance(layer, nn.Conv2d)
            for weight, bias in [_constants(layer)]
        ]
        self._behind = list(zip(self._by_group(inner), self._by_group(outer), strict=True))

    def _by_group(self, layer: nn.Module) -> list[tuple[torch.Tensor, ...]]:
        """Matrix and constants of each group of a layer that sees all there is at once."""
        weight, bias = _constants(layer)
        return list(zip(weight.flatten(1).chunk(self._groups), bias.chunk(self._groups), strict=True))

    def __call__(self, motion: np.ndarray) -> np.ndarray:
        """Answers (groups, n, answers) float64 to motions (n, 3, ROWS, COLS) float32."""
        with torch.inference_mode():
            seen = torch.from_numpy(motion).contiguous(memory_format=torch.channels_last)
            for weight, bias, stride, groups in self._convolutions:
                seen = torch.conv2d(seen, weight, bias, stride, 1, 1, groups).relu_()
            parts = seen.reshape(len(motion), self._groups, -1).transpose(0, 1)
            told = [
                F.linear(F.linear(part, *inner).relu_(), *outer) for part, (inner, outer) in zip(parts, self._behind)
            ]
            return torch.stack(told).double().numpy()


def _constants(layer: nn.Module) -> tuple[torch.Tensor, torch.Tensor]:
    """Weights and constants of a layer that has both, as they are now."""
    weight, bias = (value.detach().clone() for value in layer.parameters())
    return weight, bias
