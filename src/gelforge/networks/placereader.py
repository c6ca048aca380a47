"""A small network that reads from the printed dots how a gel sits in its holder, whatever touches it.

A gel that was taken out and put back, or that is seen by a driver that crops otherwise, has all its dots moved alike: by a
shift, a turn and a zoom. Contact moves dots too, but only as a gel can move that is held at its back: most where it is
touched, little far from it. So both can be told apart, by who has seen many presses.

The similarity that fits all dots best, by least squares, holds both. The network sees the dots as that similarity leaves
them, which is the same however the gel sits, and tells from them what part of it contact did. So it learns from gels that
sat still alone, and what it tells of a gel that was moved is moved exactly as the gel was.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from gelforge.networks.dotaugment import kept_dots, mirrored
from gelforge.networks.lattice import IMAGES, lattice_plane, mirror_images, straightened
from gelforge.networks.smallnet import OneByOne, Stack, Whole, in_pieces, train_small

WIDTH, HIDDEN = 48, 96
# Units of the network's four answers: px to the right and down, radians of turn, zoom - 1.
UNITS = (1.0, 1.0, 0.01, 0.01)
LOST = 0.4  # most of the dots that are taken away at random
# (images, 1, answers), of the answers in the mirror images of a motion, all of which are read and their mean told: how a gel
# sits beside a press that it did not learn from is told to 0.10 px in the mean in place of 0.12.
SIGNS = np.column_stack([IMAGES, IMAGES.prod(axis=1), np.ones(len(IMAGES))])[:, None]


@dataclass(frozen=True)
class Places:
    """How the gel sits in each of n pictures: a dot at z px from the lattice's middle is at a z + b.

    a, b: (n,) complex, 1 and 0 where it sits as it did untouched; z is u + i v for dots PITCH px apart.
    contact: (n,) px, root mean square over the dots found of what contact did to all of them alike; what is told of the gel
    is off by about a twentieth of it.
    """

    a: np.ndarray
    b: np.ndarray
    contact: np.ndarray


class PlaceReader(nn.Module):
    """Dots as their best similarity leaves them (`straightened`) to what of that similarity is no contact, (n, 4).

    Right and down in px, turn in radians, zoom - 1: how the gel sits, seen from that similarity.
    """

    def __init__(self) -> None:
        super().__init__()
        self.convolutions = Stack((WIDTH,) * 4)
        self.inner = Whole(WIDTH, HIDDEN)
        self.outer = nn.Linear(HIDDEN, len(UNITS))

    def forward(self, left: torch.Tensor) -> torch.Tensor:
        return self.outer(F.relu(self.inner(self.convolutions(left)), inplace=True).flatten(1)) * torch.tensor(UNITS)

    def places(self, motion: np.ndarray) -> Places:
        """How the gel sits in each of some pictures, by the motion of their dots (n, 3, ROWS, COLS) float32."""
        left, a, b = straightened(motion)
        told = np.stack([in_pieces(self, image) for image in mirror_images(left)])
        return _places(motion, a, b, (told * SIGNS).mean(axis=0))


class PlacesOneByOne:
    """A reader of places that reads one motion after another, as it is now (networks.smallnet.OneByOne)."""

    def __init__(self, reader: PlaceReader) -> None:
        self._read = OneByOne(reader.convolutions, reader.inner, reader.outer)

    def places(self, motion: np.ndarray) -> Places:
        """As `PlaceReader.places`."""
        left, a, b = straightened(motion)
        told = [
            (self._read(images)[0] * SIGNS[:, 0]).mean(axis=0) * UNITS
            for images in mirror_images(left).swapaxes(0, 1)
        ]
        return _places(motion, a, b, np.array(told).reshape(-1, len(UNITS)))


def _places(motion: np.ndarray, a: np.ndarray, b: np.ndarray, told: np.ndarray) -> Places:
    """How gels sit whose dots' motion (n, 3, ROWS, COLS) has best similarities a, b (n,), of which told (n, 4) is no contact."""
    right, down, turn, zoom = told.T
    shift, spun = right + 1j * down, zoom + 1j * turn
    moved = shift[:, None, None] + spun[:, None, None] * lattice_plane()
    found = motion[:, 2]
    squared = (found * (moved.real**2 + moved.imag**2)).sum((1, 2))
    return Places(a * (1 + spun), b + a * shift, np.sqrt(squared / np.maximum(found.sum((1, 2)), 1.0)))


def train_place_reader(motion: np.ndarray, epochs: int, seed: int) -> PlaceReader:
    """A reader of how gels sit, from presses (n, 3, ROWS, COLS) of gels that sat still; the same seed gives the same one."""
    units = torch.tensor(UNITS)

    def lesson(reader: PlaceReader, rows: torch.Tensor, draw: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        seen, _ = mirrored(torch.from_numpy(motion[rows.numpy()]), draw)
        found = (seen[:, 2] * kept_dots(len(rows), LOST, draw))[:, None]
        left, a, b = straightened(torch.cat([found * seen[:, :2], found], dim=1).numpy())
        shift, spun = -b / a, 1 / a - 1  # back to where the gel sat
        wanted = torch.from_numpy(np.stack([shift.real, shift.imag, spun.imag, spun.real], axis=1)).float()
        return reader(torch.from_numpy(left)) / units, wanted / units

    return train_small(PlaceReader, lesson, "places", len(motion), epochs, seed)
