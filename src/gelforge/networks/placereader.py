"""A small network that reads from the printed dots how a gel sits, whatever touches it.

A gel that was taken out and put back, or that is seen by a driver that crops otherwise, has all its dots moved alike: by a
shift, a turn and a zoom. Contact moves dots too, but only as a gel can move that is held at its back: most where it is
touched, little far from it. So both can be told apart, by who has seen many presses.
"""

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from gelforge.networks.augment import uniform
from gelforge.networks.dotaugment import kept_dots, lattice_points, mirrored, moved_alike
from gelforge.networks.smallnet import LEFT, Stack, in_pieces, train_small

WIDTH, HIDDEN = 48, 96
# What its answers are in units of: px to the right and down, radians of turn, part of a zoom.
UNITS = (1.0, 1.0, 0.01, 0.01)
# Farthest that a gel is taken to sit otherwise, in the same: the lattice is followed no farther than about 40 px.
FARTHEST = (12.0, 12.0, 0.07, 0.08)
MOVED, EACH = 0.6, 0.7  # share of the pictures whose gels sit otherwise, and of these that have one of the four
LOST = 0.4  # most of the dots that are taken away at random
ROUNDS = 2  # a second look at what the first one left finds large moves as well as small ones


class PlaceReader(nn.Module):
    """Motion of dots (n, 3, ROWS, COLS) (networks.dots) to how the gel sits, (n, 4): right, down, turn, zoom - 1.

    Of networks.dotaugment.moved_alike, about the lattice's middle.
    """

    def __init__(self) -> None:
        super().__init__()
        self.convolutions = Stack((WIDTH,) * 4)
        self.inner = nn.Conv2d(WIDTH, HIDDEN, LEFT)
        self.outer = nn.Linear(HIDDEN, len(UNITS))

    def forward(self, motion: torch.Tensor) -> torch.Tensor:
        return self.outer(F.relu(self.inner(self.convolutions(motion))).flatten(1)) * torch.tensor(UNITS)

    def similarities(self, motion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How the gel sits in each of some pictures: a and b (n,) complex, a dot at z px from the middle is at a z + b.

        motion: (n, 3, ROWS, COLS) float32. z is u + i v from the lattice's middle, whose dots are PITCH px apart.
        """
        u, v = (points.double().numpy() for points in lattice_points())
        z, found = u + 1j * v, motion[:, 2]
        there = z + motion[:, 0] + 1j * motion[:, 1]
        a, b = np.ones(len(motion), complex), np.zeros(len(motion), complex)
        for _ in range(ROUNDS):
            left = found * ((there - b[:, None, None]) / a[:, None, None] - z)
            lattice = np.stack([left.real, left.imag, found], axis=1).astype(np.float32)
            right, down, turn, zoom = in_pieces(self, lattice).T
            a, b = a * (1 + zoom + 1j * turn), b + a * (right + 1j * down)
        return a, b


def drawn_placements(count: int, draw: torch.Generator) -> torch.Tensor:
    """How gels sit that a reader learns from, (count, 4) in what it answers: many as they did, small moves more than large."""
    parts = torch.stack([uniform(count, most, draw) for most in FARTHEST], dim=1)
    parts = parts * torch.rand(count, 1, generator=draw) ** 1.5
    parts = parts * (torch.rand(count, 1, generator=draw) < MOVED)
    return parts * (torch.rand(parts.shape, generator=draw) < EACH)


def train_place_reader(motion: np.ndarray, epochs: int, seed: int) -> PlaceReader:
    """A reader of how gels sit, from presses (n, 3, ROWS, COLS) of gels that sat still; the same seed gives the same one."""
    units = torch.tensor(UNITS)

    def lesson(reader: PlaceReader, rows: torch.Tensor, draw: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        seen, _ = mirrored(torch.from_numpy(motion[rows.numpy()]), draw)
        found = (seen[:, 2] * kept_dots(len(rows), LOST, draw))[:, None]
        parts = drawn_placements(len(rows), draw)
        told = reader(torch.cat([found * (seen[:, :2] + moved_alike(*parts.T)), found], dim=1))
        return told / units, parts / units

    return train_small(PlaceReader, lesson, "places", len(motion), epochs, seed)
