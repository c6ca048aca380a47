"""A gel with a plane top, and a path that no log can describe."""

from dataclasses import dataclass

import numpy as np

from gelforge.geometry.gel import Gel
from gelforge.records.press import Press


@dataclass(frozen=True)
class FlatPad(Gel):
    """A pad with a plane top."""

    def top(self, x, y):
        return np.zeros(np.broadcast(x, y).shape)


@dataclass(frozen=True)
class SlideThenPress(Press):
    """Slides with a gap in the first half of the press leg, then goes straight down."""

    def pose(self, press, shear):
        rotation, _ = super().pose(0.0, 0.0)
        slide, down = min(max(2 * press, 0.0), 1.0), min(max(2 * press - 1, 0.0), 1.0)
        height = 0.1 + down * (self.dz - 0.1)
        return rotation, np.array([self.x0 + slide * self.dx, self.y0 + slide * self.dy, height])
