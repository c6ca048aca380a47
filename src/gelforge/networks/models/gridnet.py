"""Light networks on the label grid, of residual blocks."""

import torch
from torch import nn
from torch.nn import functional as F

from gelforge.errors import BadInput
from gelforge.networks.models.inputs import cell_pixels, map_grid
from gelforge.networks.models.unet import COMPONENTS


class BasicBlock(nn.Module):
    """Residual block of two 3 x 3 convolutions with batch normalisation (He et al. 2016, figure 5)."""

    def __init__(self, before: int, after: int, stride: int = 1, dilation: int = 1):
        super().__init__()
        self.first = nn.Conv2d(before, after, 3, stride, dilation, dilation, bias=False)
        self.first_norm = nn.BatchNorm2d(after)
        self.second = nn.Conv2d(after, after, 3, 1, 1, bias=False)
        self.second_norm = nn.BatchNorm2d(after)
        same = stride == 1 and before == after
        self.shortcut = (
            nn.Identity() if same else nn.Sequential(nn.Conv2d(before, after, 1, bias=False), nn.BatchNorm2d(after))
        )
        # A convolution of 1 x 1 that strides corrupts memory when it is trained on fewer than 9 channels, in torch 2.13 on
        # processors with AVX-512 (oneDNN's brgconv_strided); on every second value it is the same convolution.
        self.every = stride

    def forward(self, x):
        # in place: what a normalisation or a convolution gave is needed by nothing else, and memory anew costs time
        y = F.relu(self.first_norm(self.first(x)), inplace=True)
        thinned = x if self.every == 1 else x[:, :, :: self.every, :: self.every]
        return F.relu(self.second_norm(self.second(y)).add_(self.shortcut(thinned)), inplace=True)


def strides(image, grid) -> list[int]:
    """Split the factor from an image (height, width) to a grid (rows, cols) into strides, the largest first."""
    factor = cell_pixels(image, grid, "a light net")
    if factor == 1:
        raise BadInput(f"a light net: its grid must be coarser than the image, both are {grid[0]} x {grid[1]}")
    found = next(s for s in (5, 4, 3, 2, factor) if factor % s == 0)
    result, factor = [found], factor // found
    prime = 2
    while factor > 1:
        while factor % prime == 0:
            result.append(prime)
            factor //= prime
        prime += 1
    return result


class GridNet(nn.Module):
    """A strided encoder that stops at the label grid and never decodes to full resolution.

    A wide first stride reads the image once; residual blocks at the label grid, dilated so that a
    cell sees its surroundings, do the rest. A vector of global means gives every cell the sensor's
    light and the whole contact, and two coordinates give its place. A grid of one cell gets the mean of such a map.

    :param image: height and width in pixels; the grid must divide both by the same factor, or be (1, 1).
    :param width: channels before the grid; twice as many at the grid.
    :param blocks: residual blocks at the grid.
    """

    def __init__(self, image, grid, width: int = 16, blocks: int = 3, channels: int = 6):
        super().__init__()
        self.total_only, grid = tuple(grid) == (1, 1), map_grid(image, grid)
        first, *rest = strides(image, grid)
        self.stem = nn.Conv2d(channels, width, first + 2, first, 1, bias=False)
        self.stem_norm = nn.BatchNorm2d(width)
        self.early = BasicBlock(width, width)
        self.down = nn.Sequential(
            *(BasicBlock(width if i == 0 else 2 * width, 2 * width, s) for i, s in enumerate(rest or [1]))
        )
        # One weight per channel and direction; a convolution of the constant coordinates would do the same,
        # but OpenCV cannot read it back from ONNX.
        self.place = nn.Parameter(torch.zeros(2, 2 * width, 1, 1))
        self.late = nn.ModuleList(BasicBlock(2 * width, 2 * width, 1, 2 ** (i % 3)) for i in range(blocks))
        self.context = nn.ModuleList(nn.Linear(2 * width, 2 * width) for _ in range(blocks))
        self.head = nn.Conv2d(2 * width, COMPONENTS, 1)
        v, u = torch.meshgrid(*(torch.linspace(-1, 1, count) for count in grid), indexing="ij")
        self.register_buffer("position", torch.stack([u, v])[:, None], persistent=False)

    def forward(self, x):
        x = self.early(F.relu(self.stem_norm(self.stem(x)), inplace=True))
        x = self.down(x) + self.place[0] * self.position[0] + self.place[1] * self.position[1]
        for block, context in zip(self.late, self.context):
            x = block(x + context(x.mean((2, 3)))[:, :, None, None])
        cells = self.head(x)
        return cells.mean((2, 3), keepdim=True) if self.total_only else cells
