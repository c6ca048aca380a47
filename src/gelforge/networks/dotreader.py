"""A few small networks that read total force from the motion of the printed dots alone, and tell their mean.

What one of them makes of pictures unlike those it learnt from depends on the weights it began with: on films of real
sensors, normal forces of networks that differ in nothing else lie a third apart.
"""

import functools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from gelforge.flow.params.tables import AugmentTable
from gelforge.networks.augment import uniform
from gelforge.networks.dotaugment import kept_dots, mirrored
from gelforge.networks.dots import COLS, ROWS, PrintedDots
from gelforge.networks.inputs import inner_part
from gelforge.networks.lattice import IMAGES, mirror_images, moved_alike
from gelforge.networks.smallnet import OneByOne, Stack, Whole, in_pieces, train_small

MEMBERS = 4  # networks, each from weights of its own
WIDTH, LAST, HIDDEN = 32, 48, 64
VIEWS = (0.0, 0.1, 0.2, 0.3)  # parts of height and width that a camera may not show; each press is learnt from all
KEPT = 64  # patterns of found dots, of which is kept what they tell where they did not move
LOST = 0.25  # most of the dots that are taken away at random
# Images of a motion that are read, whose mean is told: as it is and turned by half, as pictures are (networks.bothways). Of
# presses by units that training never saw the error of normal force falls by a tenth; by no more with all four images.
WAYS = IMAGES[[0, 3]]
SIGNS = np.column_stack([WAYS, np.ones(len(WAYS))])[:, None]  # (ways, 1, 3), of total force in them


class DotReader(nn.Module):
    """Motion of dots (n, 3, ROWS, COLS) (networks.dots) to total force (n, 3) N; dots that did not move tell none.

    The members stand side by side as groups of channels, so that they are read in one go.
    """

    scale: torch.Tensor  # (3,) N

    def __init__(self) -> None:
        super().__init__()
        self.convolutions = Stack((WIDTH, WIDTH, LAST, LAST), MEMBERS)
        self.inner = Whole(MEMBERS * LAST, MEMBERS * HIDDEN, groups=MEMBERS)
        self.outer = nn.Conv2d(MEMBERS * HIDDEN, MEMBERS * 3, 1, groups=MEMBERS)
        self.register_buffer("scale", torch.ones(3))

    def read(self, motion: torch.Tensor) -> torch.Tensor:
        """What the members' layers make of it, (n, MEMBERS, 3) in units of `scale`."""
        seen = self.convolutions(motion)
        return self.outer(F.relu(self.inner(seen), inplace=True)).view(-1, MEMBERS, 3)

    def each(self, motion: torch.Tensor) -> torch.Tensor:
        """Total force (n, MEMBERS, 3) N that each member tells."""
        still = motion * torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
        moved, unmoved = self.read(torch.cat([motion, still])).chunk(2)
        return (moved - unmoved) * self.scale

    def forward(self, motion: torch.Tensor) -> torch.Tensor:
        return self.each(motion).mean(dim=1)

    def totals(self, motion: np.ndarray) -> np.ndarray:
        """Total force (n, 3) float64 N of motions (n, 3, ROWS, COLS), read in all WAYS."""
        told = np.stack([in_pieces(self, way) for way in mirror_images(motion, WAYS)])
        return np.asarray((told * SIGNS).mean(axis=0))


class DotsOneByOne:
    """A reader of dots that reads one motion after another, as it is now (networks.smallnet.OneByOne), in all WAYS.

    What it tells of dots that did not move hangs on which of them were found alone, and is kept for the last few prints.
    """

    def __init__(self, reader: DotReader) -> None:
        self._read = OneByOne(reader.convolutions, reader.inner, reader.outer)
        self._scale = reader.scale.double().numpy().copy()
        self._unmoved = functools.lru_cache(KEPT)(self._of_unmoved)

    def _of_unmoved(self, found: bytes) -> np.ndarray:
        motion = np.zeros((3, ROWS, COLS), np.float32)
        motion[2] = np.frombuffer(found, np.float32).reshape(ROWS, COLS)
        return self._read(mirror_images(motion, WAYS))

    def total(self, motion: np.ndarray) -> np.ndarray:
        """Total force (3,) float64 N of one motion (3, ROWS, COLS) float32."""
        told = self._read(mirror_images(motion, WAYS)) - self._unmoved(motion[2].tobytes())
        return np.asarray((told * SIGNS[:, 0]).mean(axis=(0, 1)) * self._scale)


@dataclass(frozen=True)
class DotPresses:
    """Presses as dots show them: motion (n, 3, ROWS, COLS); shown (n, views, ROWS, COLS) bool and totals (n, views, 3) N.

    The views are those of VIEWS: which dots a camera shows, and the force in what it shows.
    """

    motion: np.ndarray
    shown: np.ndarray
    totals: np.ndarray


def motions(data, rows: np.ndarray, dots: Mapping[str, PrintedDots]) -> np.ndarray:
    """Motion of the dots (k, 3, ROWS, COLS) in the pictures of some rows of a dataset (networks.data.Data).

    dots: of each untouched sensor.
    """
    names = data.names("sensor_id")[rows]
    lit = (np.ascontiguousarray(data.seen([row], "pair")[0, ..., :3]) for row in rows)
    return np.stack([dots[name].on_lattice(dots[name].follow(image)) for image, name in zip(lit, names, strict=True)])


def dot_presses(data, rows: np.ndarray, dots: Mapping[str, PrintedDots], motion: np.ndarray) -> DotPresses:
    """The presses of some rows of a dataset in all VIEWS; dots: of each untouched sensor, motion: their `motions`."""
    parts = [inner_part(share, data.image_size, data.grid, "the reader of dots") for share in VIEWS]
    shown = {name: np.stack([one.within(*pixels) for pixels, _ in parts]) for name, one in dots.items()}
    labels = data.labels[rows]
    totals = [labels[(slice(None), slice(None), *cells)].sum((2, 3)) for _, cells in parts]
    names = data.names("sensor_id")[rows]
    return DotPresses(motion, np.stack([shown[name] for name in names]), np.stack(totals, axis=1))


def misplaced(
    motion: torch.Tensor, whole: torch.Tensor, settings: AugmentTable, draw: torch.Generator
) -> torch.Tensor:
    """Motion of dots (n, 3, ROWS, COLS) as if the gel sat otherwise in a share of the pictures; whole: (n,) that show its rim.

    As in `augment.misplace_untouched`: what the dots at the rim do, where the gel is held, is no force.
    """
    count = len(motion)
    chosen = whole & (torch.rand(count, generator=draw) < settings.misplaced_share)
    right, down, zoom = (
        uniform(count, width, draw)
        for width in (settings.misplaced_px, settings.misplaced_px, settings.misplaced_zoom)
    )
    turn = torch.deg2rad(uniform(count, settings.misplaced_deg, draw))
    found, moved = motion[:, 2:], moved_alike(right, down, turn, zoom)
    return torch.cat([motion[:, :2] + chosen[:, None, None, None] * found * moved, found], dim=1)


def varied(
    presses: DotPresses, rows: torch.Tensor, settings: AugmentTable, draw: torch.Generator
) -> tuple[torch.Tensor, torch.Tensor]:
    """Motions and totals of some presses, each in a view and a place of its own, mirrored either way, some dots lost."""
    count, at = len(rows), rows.numpy()
    view = torch.randint(len(VIEWS), (count,), generator=draw)
    view[torch.rand(count, generator=draw) < 0.5] = 0
    kept = torch.from_numpy(presses.shown[at, view.numpy()])
    kept &= kept_dots(count, LOST, draw)
    motion = misplaced(torch.from_numpy(presses.motion[at]) * kept[:, None], view == 0, settings, draw)
    totals = torch.from_numpy(presses.totals[at, view.numpy()]).float()
    motion, signs = mirrored(motion, draw)
    totals[:, :2] *= signs
    return motion, totals


def train_dot_reader(presses: DotPresses, epochs: int, seed: int, settings: AugmentTable) -> DotReader:
    """A reader of dots trained on presses, each member as if alone; the same seed gives the same one.

    settings: how gels sit otherwise than in their untouched pictures.
    """
    scale = torch.from_numpy(np.sqrt((presses.totals[:, 0] ** 2).mean(axis=0))).float().clamp(min=1e-6)

    def make() -> DotReader:
        reader = DotReader()
        reader.scale = scale
        return reader

    def lesson(reader: DotReader, rows: torch.Tensor, draw: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        motion, totals = varied(presses, rows, settings, draw)
        told = reader.each(motion) / scale
        return told, (totals / scale)[:, None].expand_as(told)

    return train_small(make, lesson, "dots", len(presses.motion), epochs, seed)
