"""Networks by table of workflow/models.toml, and their inputs: the paper's U-net of one image, and light networks of pairs.

Shear moves the markers by fractions of a pixel. From one image alone, a network must know where each marker was at
rest. Next to a no-contact image of the same sensor it sees the displacement, also on a sensor that it never saw.
Tactile images are commonly compared with such a first frame (GelSight: Yuan, Dong and Adelson 2017, Sensors 17(12)
2762).

Every network maps an input (n, channels, height, width), normalised, to (n, 3, rows, cols) in label units of its training
scale. A new family is a class here, one line in `build`, and one in `records/networkkind.py`.
"""

import math
from collections.abc import Callable

import torch
from torch import nn
from torch.nn import functional as F

from gelforge.errors import BadInput
from gelforge.records.networkkind import kind_of, sizes_of

CELL_PX = 10  # largest cell of the internal map whose mean is the total force, for networks of totals only


def map_grid(image, grid) -> tuple[int, int]:
    """Rows and columns that a network works on: `grid`, or for totals (1, 1) cells of at most CELL_PX px."""
    if tuple(grid) != (1, 1):
        return tuple(grid)
    height, width = image
    cell = max(size for size in range(1, CELL_PX + 1) if math.gcd(height, width) % size == 0)
    return height // cell, width // cell


def cell_pixels(image, grid, who: str) -> int:
    """Side in pixels of a cell of grid (rows, cols) on an image (height, width); BadInput, for `who`, if not whole."""
    (height, width), (rows, cols) = image, grid
    if height % rows or width % cols or height // rows != width // cols:
        raise BadInput(
            f"{who}: cells of {rows} x {cols} on an image of {width} x {height} are no squares of whole pixels; choose "
            "a grid that divides the image, or 1x1 for total force"
        )
    return height // rows


def inner_part(fraction: float, image, grid, who: str) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Slices (rows, columns) of the pixels and the cells that remain if a border hides `fraction` of both sides."""
    cell = cell_pixels(image, grid, who)
    rows, cols = (slice(margin, count - margin) for margin, count in ((round(fraction * n / 2), n) for n in grid))
    return (slice(cell * rows.start, cell * rows.stop), slice(cell * cols.start, cell * cols.stop)), (rows, cols)


def network_input(pictures: torch.Tensor, norm: dict) -> torch.Tensor:
    """Input (n, 3 or 6, h, w) of a network in its own units.

    :param pictures: (n, 3, h, w) images in 0..1, or (n, 6, h, w) with the no-contact image behind each.
    :param norm: what learning.data.scales returns.
    """
    mean, std = (
        torch.tensor(norm[key], device=pictures.device).float().view(1, 3, 1, 1)
        for key in ("image_mean", "image_std")
    )
    image = (pictures[:, :3] - mean) / std
    if pictures.shape[1] == 3:
        return image
    return torch.cat([image, (pictures[:, :3] - pictures[:, 3:]) / std], 1)


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

    pair: bool  # whether it reads the no-contact image, too

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
    """Pixels that remain of an image's side at the output of a U-net; below 1 where the image is too small for it."""
    for level in range(levels):
        side = (side // 2 if level else side) - 4
    for _ in range(levels - 1):
        side = 2 * side - 4
    return side


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
        # Training a strided 1 x 1 convolution on fewer than 9 channels corrupts memory in torch 2.13 on processors
        # with AVX-512 (oneDNN's brgconv_strided). Subsampling before a convolution without stride gives the same
        # result.
        self.every = stride

    def forward(self, x):
        # in place: nothing else needs the intermediate results, and new memory costs time
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

    A large first stride reduces the image; residual blocks at the label grid, dilated so that a cell sees its
    surroundings, do the rest. Global means inform every cell of the illumination and the whole contact, and two
    coordinates of its position. A grid of one cell gets the mean of the map of `map_grid`.

    :param image: height and width in pixels; the grid must divide both by the same factor, or be (1, 1).
    :param width: channels before the grid; twice as many at the grid.
    :param blocks: residual blocks at the grid.
    """

    pair: bool  # whether it reads the no-contact image, too

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
        # but OpenCV cannot import it from ONNX.
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


def build(config: dict, image, grid) -> nn.Module:
    """Build the network that `config` describes, with fresh weights from torch's current seed.

    :param config: one table of workflow/models.toml: `kind` and the sizes of that kind.
    :param image: (height, width) in pixels. :param grid: (rows, cols) of the label.
    """
    sizes = sizes_of(config) | {"channels": 6 if kind_of(config).pair else 3}
    kinds: dict[str, Callable[[], UNet | GridNet]] = {
        "unet": lambda: UNet(grid, **sizes),
        "grid": lambda: GridNet(image, grid, **sizes),
    }
    net = kinds[config["kind"]]()
    net.pair = kind_of(config).pair
    if isinstance(net, UNet) and side_at_top(min(image), len(net.down)) < 1:
        raise BadInput(
            f"a U-net of {len(net.down)} widths leaves nothing of an image of {image[1]} x {image[0]}; give it fewer widths or"
            " larger images"
        )
    return net


def parameter_count(net: nn.Module) -> int:
    """Number of trained values in a network."""
    return sum(p.numel() for p in net.parameters())


def begin_as(net: nn.Module, weights: dict[str, torch.Tensor]) -> None:
    """Initialise a network with the weights of another one, which may be a light net of fewer blocks.

    Added blocks start as the identity, so that before training the network predicts as the other one did (Chen,
    Goodfellow and Shlens 2016, section 2.3).
    """
    added = {name: value for name, value in net.state_dict().items() if name not in weights}
    silent = {
        name: torch.zeros_like(value)
        for name, value in added.items()
        if name.startswith("context.") or name.endswith(".second_norm.weight")
    }
    net.load_state_dict(weights | added | silent)
