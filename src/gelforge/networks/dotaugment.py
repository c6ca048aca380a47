"""What small networks learn from besides presses as they are: gels that sit otherwise, mirrored presses, lost dots.

Motions of dots are (n, 3, ROWS, COLS) as networks.dots gives them: along u and v in px, and whether a dot was found.
"""

import torch

from gelforge.networks.dots import COLS, ROWS

PITCH = 32.0  # px between neighbouring dots at the scale that networks read


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


def kept_dots(count: int, most: float, draw: torch.Generator) -> torch.Tensor:
    """Which places of the lattice keep their dot, (count, ROWS, COLS) bool: of each picture a share up to `most` is lost.

    Dots are worn, covered, or not followed.
    """
    shape = (count, ROWS, COLS)
    return torch.rand(shape, generator=draw) >= most * torch.rand(count, 1, 1, generator=draw)


def mirrored(motion: torch.Tensor, draw: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """Motions of presses mirrored either way at random, and the signs (n, 2) that u and v of a force get by it."""
    signs = []
    for axis, component in ((3, 0), (2, 1)):
        flip = torch.rand(len(motion), generator=draw) < 0.5
        sign = torch.where(flip, -1.0, 1.0)
        motion = torch.where(flip[:, None, None, None], motion.flip(axis), motion)
        motion[:, component] *= sign[:, None, None]
        signs.append(sign)
    return motion, torch.stack(signs, dim=1)
