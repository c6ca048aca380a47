"""A network of two stages: the pair of pictures to the gel's shape, and its shape to forces.

The first stage undoes a sensor's light and finds the slopes of the surface and the motion of its markers; the second one
does mechanics and knows no light at all. So each stage can be judged, and replaced, by itself: a sensor's own table from colours
to slopes can take the place of the first one (networks.inference.predictor, `replaced`).
"""

import torch
from torch import nn
from torch.nn import functional as F

from gelforge.errors import BadInput
from gelforge.networks.models.gridnet import strides
from gelforge.networks.models.unet import COMPONENTS

STEM = 16  # channels at half the image's size
MOTION_PX = 3.0  # px of apparent motion that counts as one
SLOPE = 0.25  # slope that counts as one


class ContextBlock(nn.Module):
    """Residual block of two 3 x 3 convolutions, the first dilated, which adds a vector of the image's means to its input.

    It begins as the identity (He et al. 2016; zero-initialised residuals: Goyal et al. 2017, section 5.1).
    """

    def __init__(self, width: int, dilation: int):
        super().__init__()
        self.context = nn.Linear(width, width)
        self.first = nn.Conv2d(width, width, 3, 1, dilation, dilation, bias=False)
        self.first_norm = nn.BatchNorm2d(width)
        self.second = nn.Conv2d(width, width, 3, 1, 1, bias=False)
        self.second_norm = nn.BatchNorm2d(width)
        nn.init.zeros_(self.second_norm.weight)

    def forward(self, x):
        x = x + self.context(x.mean((2, 3)))[:, :, None, None]
        y = F.relu(self.first_norm(self.first(x)), inplace=True)
        return F.relu(x + self.second_norm(self.second(y)))


def dilations(blocks: int) -> list[int]:
    """Dilations of so many blocks: each sees twice as far as the one before, up to 8 cells."""
    return [2 ** (k % 4) for k in range(blocks)]


class SlopeNet(nn.Module):
    """A pair of pictures (n, 6, h, w), normalised, to slopes (n, 2, h / 2, w / 2) and apparent motion (n, 2, h / 8, w / 8) px.

    Slopes are those of the surface against the unloaded one along u and v, mm per mm. Motion is how far gel points appear moved
    along u and v, in px of the picture. Pictures are read at half their size.
    """

    def __init__(self, image, width: int, blocks: int):
        super().__init__()
        self.stem = nn.Conv2d(8, STEM, 5, 2, 2, bias=False)
        self.stem_norm = nn.BatchNorm2d(STEM)
        self.down = nn.Conv2d(STEM, width, 3, 2, 1, bias=False)
        self.down_norm = nn.BatchNorm2d(width)
        self.blocks = nn.Sequential(*(ContextBlock(width, one) for one in dilations(blocks)))
        self.motion = nn.Conv2d(width, 2, 1)
        self.merge = nn.Conv2d(width, 48, 1)
        self.head = nn.Conv2d(48 // 4 + STEM, 8, 3, 1, 1)
        v, u = torch.meshgrid(*(torch.linspace(-1, 1, side // 2) for side in image), indexing="ij")
        self.register_buffer("position", torch.stack([u, v])[None], persistent=False)

    def forward(self, pair):
        pair = F.avg_pool2d(pair, 2)
        changed, nocontact = pair[:, 3:], pair[:, :3] - pair[:, 3:]
        place = (
            torch.zeros_like(pair[:, :2]) + self.position
        )  # `expand` would write the batch of the export into the graph
        early = F.relu(self.stem_norm(self.stem(torch.cat([changed, nocontact, place], 1))), inplace=True)
        x = self.blocks(F.relu(self.down_norm(self.down(early)), inplace=True))
        fine = torch.cat([F.relu(F.pixel_shuffle(self.merge(x), 2)), early], 1)
        return SLOPE * F.pixel_shuffle(self.head(fine), 2), MOTION_PX * self.motion(x)


class ForceNet(nn.Module):
    """Slopes and apparent motion, as `SlopeNet` gives them, to forces (n, 3, rows, cols) in label units.

    Normal force cannot pull.
    """

    def __init__(self, image, grid, width: int, blocks: int):
        super().__init__()
        half = tuple(side // 2 for side in image)
        first, *rest = strides(half, grid)
        self.grid = tuple(grid)
        self.stem = nn.Conv2d(2, width, first + 4, first, 2, bias=False)
        self.stem_norm = nn.BatchNorm2d(width)
        self.down = nn.Sequential(*(nn.Conv2d(width, width, 3, stride, 1) for stride in rest))
        self.moved = nn.Conv2d(2, width, 3, 1, 1)
        self.place = nn.Parameter(torch.zeros(2, width, 1, 1))
        self.blocks = nn.Sequential(*(ContextBlock(width, one) for one in dilations(blocks)))
        self.head = nn.Conv2d(width, COMPONENTS, 1)
        v, u = torch.meshgrid(*(torch.linspace(-1, 1, count) for count in grid), indexing="ij")
        self.register_buffer("position", torch.stack([u, v])[:, None], persistent=False)

    def forward(self, slopes, motion):
        moved = F.interpolate(motion / MOTION_PX, self.grid, mode="bilinear", align_corners=False)
        x = self.down(self.stem(slopes / SLOPE)) + self.moved(moved)
        x = F.relu(self.stem_norm(x)) + self.place[0] * self.position[0] + self.place[1] * self.position[1]
        sideways, normal = self.head(self.blocks(x)).split((2, 1), 1)
        return torch.cat([sideways, -F.softplus(normal - 2.0)], 1)


class GeometryNet(nn.Module):
    """A pair of pictures (n, 6, h, w), normalised, to forces (n, 3, rows, cols) in label units, by way of the gel's shape."""

    def __init__(self, image, grid, width: int = 40, blocks: int = 4, channels: int = 6):
        super().__init__()
        if channels != 6:
            raise BadInput(
                'a network of kind geometry compares a picture with a no-contact image: give reads = "pair"'
            )
        if any(side % 8 for side in image):
            raise BadInput(
                f"a network of kind geometry halves images three times: {image[1]} x {image[0]} are no multiples of 8"
            )
        self.slopes = SlopeNet(image, width, blocks)
        self.forces = ForceNet(image, grid, width, blocks)

    def forward(self, pair):
        return self.forces(*self.slopes(pair))
