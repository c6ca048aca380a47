"""A gel whose top is a plane."""

from dataclasses import dataclass

import numpy as np

from gelforge.geometry.gel import Gel


@dataclass(frozen=True)
class FlatPad(Gel):
    """A pad whose top is a plane."""

    def top(self, x, y):
        return np.zeros(np.broadcast(x, y).shape)
