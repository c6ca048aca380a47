"""A `GridNet` that reads one image after another, as the plain calls of torch that its modules come to.

With one image at a time a tenth of the time goes into modules that call modules, and into what is the same for every
image. "Folded" means that a batch normalisation is multiplied into the convolution before it (`networks.modelfile`).
"""

from typing import Any, NamedTuple

import torch
from torch import nn
from torch.nn import functional as F

from gelforge.networks.models import BasicBlock, GridNet

Layer = tuple[torch.Tensor, torch.Tensor | None]  # weights and constants


class Block(NamedTuple):
    """What a `BasicBlock` with folded normalisations does: its convolutions, and stride and dilation of the first one."""

    first: Layer
    second: Layer
    shortcut: Layer | None
    stride: int
    dilation: int

    def of(self, x: torch.Tensor) -> torch.Tensor:
        """As the block's `forward`, (n, channels, h, w)."""
        y = torch.conv2d(x, *self.first, self.stride, self.dilation, self.dilation).relu_()
        y = torch.conv2d(y, *self.second, 1, 1)
        if self.shortcut is not None:
            x = torch.conv2d(x[:, :, :: self.stride, :: self.stride], *self.shortcut)
        return y.add_(x).relu_()


class Unrolled(nn.Module):
    """A `GridNet` that is trained no more, its normalisations folded and its entry one that reads images.

    It reads by the net's own weights, so what changes these in place changes it; `place` alone is read once.
    """

    net: Any  # a GridNet: torch's types know that it has parts, and not which
    where: torch.Tensor  # (1, channels, rows, cols), what tells each cell where it is

    def __init__(self, net: Any) -> None:
        super().__init__()
        self.net = net
        self._before = [unrolled(block) for block in (net.early, *net.down)]
        self._late = [
            (unrolled(block), _layer(context)) for block, context in zip(net.late, net.context, strict=True)
        ]
        where = (net.place * net.position).sum(0, keepdim=True).detach()
        self.register_buffer("where", where.contiguous(memory_format=torch.channels_last))

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Images (n, 3, h, w) in 0..255 to (n, 3, rows, cols), as the net's own `forward`."""
        return self._told(self._cells(images)[0])

    def with_pooled(self, images: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """As `forward`, and what the net sees in each image as a whole, (n, pooled_count).

        Its values at the cells are taken together: their means before each late block and behind the last, means weighted
        by the normal force that is told there, and the largest.
        """
        x, means = self._cells(images)
        told = self._told(x)
        pressed = told[:, 2:].clamp(max=0)
        pressed = pressed / (pressed.sum((2, 3), keepdim=True) - 1e-6)
        return told, torch.cat([*means, x.mean((2, 3)), (x * pressed).sum((2, 3)), x.amax((2, 3))], dim=1)

    def _cells(self, images: torch.Tensor) -> tuple[torch.Tensor, list[torch.Tensor]]:
        """The net's values (n, channels, rows, cols) that its head reads, and their means before each late block."""
        x = self.net.stem(images).relu_()
        for block in self._before:
            x = block.of(x)
        x.add_(self.where)
        means = []
        for block, context in self._late:
            means.append(x.mean((2, 3)))
            x = block.of(x + F.linear(means[-1], *context)[:, :, None, None])
        return x, means

    def _told(self, x: torch.Tensor) -> torch.Tensor:
        """What the net's head makes of its values at the cells."""
        # channels lie behind each cell: a product of matrices then makes whole planes, and a convolution copies first
        weight, bias = self.net.head.weight.flatten(1), self.net.head.bias[:, None]
        told = torch.addmm(bias, weight, x.permute(0, 2, 3, 1).flatten(0, 2).t())
        return told.unflatten(1, (len(x), *x.shape[2:])).transpose(0, 1)


def pooled_count(net: nn.Module) -> int:
    """How many values `Unrolled.with_pooled` tells of an image beside its forces; none of another network."""
    return (len(net.late) + 3) * net.head.in_channels if isinstance(net, GridNet) else 0


def unrolled(block: BasicBlock) -> Block:
    """What a block with folded normalisations does."""
    shortcut = _layer(block.shortcut[0]) if isinstance(block.shortcut, nn.Sequential) else None
    return Block(_layer(block.first), _layer(block.second), shortcut, block.every, int(block.first.dilation[0]))


def _layer(module: Any) -> Layer:
    """Weights and constants of a convolution or a product of matrices."""
    return module.weight, module.bias
