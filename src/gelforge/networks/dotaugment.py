"""How presses are varied that small networks learn from: mirrored, with dots lost.

Motions of dots are (n, 3, ROWS, COLS) as networks.dots gives them: along u and v in px, and whether a dot was found.
"""

import torch

from gelforge.networks.dots import COLS, ROWS


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
