"""The lattice of printed dots: where they rest, and the part of their motion that is alike for all of them.

Motions of dots are (n, 3, ROWS, COLS) as networks.dots gives them: along u and v in px, and whether a dot was found.
"""

import functools

import torch

from gelforge.networks.dots import COLS, ROWS

PITCH = 32.0  # px between neighbouring dots at the scale that networks read
LEAST_SPREAD = 1e-3  # px^2, of dots about their middle, below which they tell no turn and no zoom


@functools.cache
def lattice_points() -> tuple[torch.Tensor, torch.Tensor]:
    """Where the dots rest along u and v, px from the lattice's middle, (ROWS, COLS) each."""
    v, u = torch.meshgrid(*(PITCH * (torch.arange(n) - n // 2) for n in (ROWS, COLS)), indexing="ij")
    return u, v


def moved_alike(right, down, turn, zoom) -> torch.Tensor:
    """Motion (n, 2, ROWS, COLS) px of dots that are all shifted, turned and zoomed about the lattice's middle.

    right, down: px; turn: radians, positive from u towards v; zoom: factor - 1; tensors (n,).
    """
    u, v = lattice_points()
    right, down, turn, zoom = (part[:, None, None] for part in (right, down, turn, zoom))
    return torch.stack([right + zoom * u - turn * v, down + zoom * v + turn * u], dim=1)


def straightened(motion: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Motion of dots (n, 3, ROWS, COLS) less the similarity z -> a z + b that fits it best, and a and b (n,) complex.

    By least squares over the dots that were found. What is left is seen as before the similarity, and so is the same
    for dots that were shifted, turned or zoomed besides.
    """
    u, v = (points.to(motion) for points in lattice_points())
    z, found = torch.complex(u, v), motion[:, 2]
    there = z + torch.complex(motion[:, 0], motion[:, 1])
    count = found.sum((1, 2)).clamp(min=1.0)
    rest, middle = ((found * points).sum((1, 2)) / count for points in (z, there))
    around = found * (z - rest[:, None, None])
    spread = (around.abs() ** 2).sum((1, 2))
    slope = (around.conj() * (there - middle[:, None, None])).sum((1, 2)) / spread.clamp(min=LEAST_SPREAD)
    a = torch.where(spread > LEAST_SPREAD, slope, torch.ones_like(slope))
    b = middle - a * rest
    left = found * ((there - b[:, None, None]) / a[:, None, None] - z)
    return torch.stack([left.real, left.imag, found], dim=1), a, b
