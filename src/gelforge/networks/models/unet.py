"""The paper's U-net."""

import torch
from torch import nn
from torch.nn import functional as F

COMPONENTS = 3


class DoubleConvolution(nn.Module):
    """Two unpadded 3 x 3 convolutions with ReLU: each takes one pixel off every side."""

    def __init__(self, before: int, after: int):
        super().__init__()
        self.first = nn.Conv2d(before, after, 3)
        self.second = nn.Conv2d(after, after, 3)

    def forward(self, x):
        return F.relu(self.second(F.relu(self.first(x))))


def crop_like(x, other):
    """Cut the centre of `x` (n, c, h, w) to the height and width of `other`."""
    top = (x.shape[-2] - other.shape[-2]) // 2
    left = (x.shape[-1] - other.shape[-1]) // 2
    return x[..., top : top + other.shape[-2], left : left + other.shape[-1]]


class UNet(nn.Module):
    """The paper's U-net (Helmut et al. 2025, section IV; Ronneberger et al. 2015).

    Unpadded convolutions, 2 x 2 up-convolutions, skips cropped at their centre, a 1 x 1 head and
    nearest-neighbour resize to `grid`. `widths` are the channels per level, (16, 32, 64, 128, 256)
    in the paper.
    """

    def __init__(self, grid, widths=(16, 32, 64, 128, 256), channels: int = 3):
        super().__init__()
        self.grid = tuple(grid)
        down = (channels, *widths)
        up = tuple(reversed(widths))
        self.down = nn.ModuleList(DoubleConvolution(a, b) for a, b in zip(down, down[1:]))
        self.lift = nn.ModuleList(nn.ConvTranspose2d(a, b, 2, 2) for a, b in zip(up, up[1:]))
        self.up = nn.ModuleList(DoubleConvolution(2 * b, b) for b in up[1:])
        self.head = nn.Conv2d(widths[0], COMPONENTS, 1)

    def forward(self, x):
        skips = []
        for level, block in enumerate(self.down):
            x = block(x if level == 0 else F.max_pool2d(x, 2))
            skips.append(x)
        for lift, block, skip in zip(self.lift, self.up, reversed(skips[:-1])):
            x = lift(x)
            x = block(torch.cat([x, crop_like(skip, x)], dim=1))
        return F.interpolate(self.head(x), self.grid)


def side_at_top(side: int, levels: int) -> int:
    """Pixels that a U-net of so many levels leaves of a side of an image, below 1 where it cannot read it."""
    for level in range(levels):
        side = (side // 2 if level else side) - 4
    for _ in range(levels - 1):
        side = 2 * side - 4
    return side
