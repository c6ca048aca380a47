"""The network families: the paper's U-net, ResNet-34 to total force, and light nets on the label grid.

Every network maps an input (n, channels, height, width), normalised, to (n, 3, rows, cols) in label units of
its training scale. A network that only knows total force has a grid of one cell.
"""

import torch
from torch import nn
from torch.nn import functional as F

from gelforge.errors import BadInput
from gelforge.networks import inputs
from gelforge.records.networkkind import sizes_of

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

    def __init__(self, grid, widths=(16, 32, 64, 128, 256), channels: int = 3, outputs: int = COMPONENTS):
        super().__init__()
        self.grid = tuple(grid)
        down = (channels, *widths)
        up = tuple(reversed(widths))
        self.down = nn.ModuleList(DoubleConvolution(a, b) for a, b in zip(down, down[1:]))
        self.lift = nn.ModuleList(nn.ConvTranspose2d(a, b, 2, 2) for a, b in zip(up, up[1:]))
        self.up = nn.ModuleList(DoubleConvolution(2 * b, b) for b in up[1:])
        self.head = nn.Conv2d(widths[0], outputs, 1)

    def entries(self) -> list[tuple[nn.Module, str]]:
        """Where the convolutions that read the input are: module and attribute. Every network says so."""
        return [(self.down[0], "first")]

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


class SingleChannelUNets(nn.Module):
    """Three U-nets, one per force component (the paper's ablation).

    They share no weight, so one optimiser trains them as it would train each alone; only the choice
    of the best epoch and the learning rate's schedule are common to the three.
    """

    def __init__(self, grid, widths=(16, 32, 64, 128, 256), channels: int = 3):
        super().__init__()
        self.nets = nn.ModuleList(UNet(grid, widths, channels, outputs=1) for _ in range(COMPONENTS))

    def entries(self) -> list[tuple[nn.Module, str]]:
        return [entry for net in self.nets if isinstance(net, UNet) for entry in net.entries()]

    def forward(self, x):
        return torch.cat([net(x) for net in self.nets], dim=1)


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


class ResNetTotal(nn.Module):
    """ResNet to total force, (n, 3, 1, 1); blocks (3, 4, 6, 3) make ResNet-34 (He et al. 2016, table 1)."""

    def __init__(self, blocks=(3, 4, 6, 3), widths=(64, 128, 256, 512), channels: int = 3):
        super().__init__()
        self.stem = nn.Conv2d(channels, widths[0], 7, 2, 3, bias=False)
        self.stem_norm = nn.BatchNorm2d(widths[0])
        layers, before = [], widths[0]
        for level, (count, width) in enumerate(zip(blocks, widths)):
            for i in range(count):
                layers.append(BasicBlock(before, width, 2 if level > 0 and i == 0 else 1))
                before = width
        self.blocks = nn.Sequential(*layers)
        self.head = nn.Linear(before, COMPONENTS)

    def entries(self) -> list[tuple[nn.Module, str]]:
        return [(self, "stem")]

    def forward(self, x):
        x = F.max_pool2d(F.relu(self.stem_norm(self.stem(x))), 3, 2, 1)
        return self.head(self.blocks(x).mean((2, 3)))[:, :, None, None]


class GridNet(nn.Module):
    """A strided encoder that stops at the label grid and never decodes to full resolution.

    A wide first stride reads the image once; residual blocks at the label grid, dilated so that a
    cell sees its surroundings, do the rest. A vector of global means tells every cell the sensor's
    light and the whole contact, and two coordinates tell it where it is.

    :param image: height and width in pixels; the grid must divide both by the same factor.
    :param width: channels before the grid; twice as many at the grid.
    :param blocks: residual blocks at the grid.
    """

    def __init__(self, image, grid, width: int = 16, blocks: int = 3, channels: int = 3):
        super().__init__()
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

    def entries(self) -> list[tuple[nn.Module, str]]:
        return [(self, "stem")]

    def forward(self, x):
        x = self.early(F.relu(self.stem_norm(self.stem(x)), inplace=True))
        x = self.down(x) + self.place[0] * self.position[0] + self.place[1] * self.position[1]
        for block, context in zip(self.late, self.context):
            x = block(x + context(x.mean((2, 3)))[:, :, None, None])
        return self.head(x)


def begin_as(net: nn.Module, weights: dict[str, torch.Tensor]) -> None:
    """Let a network begin with the weights of another one, which may be a light net of fewer blocks.

    Blocks of its own change nothing at first, so that it reads as the other did before it learns (Chen, Goodfellow and
    Shlens 2016, section 2.3).
    """
    added = {name: value for name, value in net.state_dict().items() if name not in weights}
    silent = {
        name: torch.zeros_like(value)
        for name, value in added.items()
        if name.startswith("context.") or name.endswith(".second_norm.weight")
    }
    net.load_state_dict(weights | added | silent)


def strides(image, grid) -> list[int]:
    """Split the factor from an image (height, width) to a grid (rows, cols) into strides, the largest first."""
    factor = inputs.cell_pixels(image, grid, "a light net")
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


def build(config: dict, image, grid) -> nn.Module:
    """Build the network that `config` describes, with fresh weights from torch's current seed.

    :param config: one table of workflow/models.toml: `kind`, the sizes of that kind, and what it `reads`.
    :param image: (height, width) in pixels. :param grid: (rows, cols) of the label.
    """
    sizes = sizes_of(config) | {"channels": inputs.channels(config.get("reads", "image"))}
    kinds = {
        "unet": lambda: UNet(grid, **sizes),
        "unet_single": lambda: SingleChannelUNets(grid, **sizes),
        "resnet": lambda: ResNetTotal(**sizes),
        "grid": lambda: GridNet(image, grid, **sizes),
    }
    net = kinds[config["kind"]]()
    levels = max((len(part.down) for part in net.modules() if isinstance(part, UNet)), default=0)
    if levels and side_at_top(min(image), levels) < 1:
        raise BadInput(
            f"a U-net of {levels} widths leaves nothing of an image of {image[1]} x {image[0]}; give it fewer widths or"
            " larger images"
        )
    return net


def parameter_count(net: nn.Module) -> int:
    """Number of trained values in a network."""
    return sum(p.numel() for p in net.parameters())
