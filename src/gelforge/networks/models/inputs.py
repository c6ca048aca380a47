"""What a network reads: the image alone (the paper's U-net), or the pair of it and the no-contact image (all others).

A sheared gel shows in markers that moved by fractions of a pixel. From one image a network has to know where each marker
was; beside a picture of the same sensor before it was touched the displacement lies open, also on a sensor that the
network never saw. Tactile cameras are commonly read against such a first frame (GelSight: Yuan, Dong and Adelson
2017, Sensors 17(12) 2762).
"""

import math
from typing import TYPE_CHECKING

from gelforge.errors import BadInput

if TYPE_CHECKING:
    import torch

CELL_PX = 10  # widest cell of the map whose mean is the total force, where totals are all that is asked for


def map_grid(image, grid) -> tuple[int, int]:
    """Rows and columns that a network works on: those of `grid`, and for totals (1, 1) a map of cells of at most CELL_PX px."""
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
    """Pixels and cells, rows and columns of each, that are left where the border of an image hides a fraction of both sides."""
    cell = cell_pixels(image, grid, who)
    rows, cols = (slice(margin, count - margin) for margin, count in ((round(fraction * n / 2), n) for n in grid))
    return (slice(cell * rows.start, cell * rows.stop), slice(cell * cols.start, cell * cols.stop)), (rows, cols)


def network_input(pictures: "torch.Tensor", norm: dict) -> "torch.Tensor":
    """Input (n, 3 or 6, h, w) of a network in its own units.

    :param pictures: (n, 3, h, w) images in 0..1, or (n, 6, h, w) with the no-contact image behind each.
    :param norm: what networks.data.scales returns.
    """
    import torch

    mean, std = (
        torch.tensor(norm[key], device=pictures.device).float().view(1, 3, 1, 1)
        for key in ("image_mean", "image_std")
    )
    image = (pictures[:, :3] - mean) / std
    if pictures.shape[1] == 3:
        return image
    return torch.cat([image, (pictures[:, :3] - pictures[:, 3:]) / std], 1)
