"""A small network above both readers of a picture, which tells by what factor the normal force that they tell is off.

The network of a picture's brightness and the reader of its dots err less on presses that they learnt from than on others, so
it is from presses new to both that one can learn how they err (stacked generalisation: Wolpert 1992, Neural Networks 5,
241-259). What tells it: how the force is spread, what the dots say beside it, and what the network sees in the picture.
"""

import math

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from gelforge.networks.smallnet import train_small

MEMBERS, HIDDEN = 6, 32  # networks side by side, whose mean counts, and units of each
# Shares of what they see, and of their units, that are left out at random while they learn.
DROPPED_IN, DROPPED = 0.05, 0.1
MOST_LOG = 0.4  # natural logarithm of the largest factor
FARTHEST = 4.0  # spreads from its mean beyond which a value is taken to lie there
# Spreads that forces lie from those of the presses that it learnt from, root mean square, where it says half as much as it
# learnt to. Films of two fingers lie about so far: without this it moved the force of one against the other's.
HALF_SAID = 2.0
TOUCHED = 0.05  # of the largest normal force of a cell: one with so much counts half towards the contact's area
LEAST_SHARE = 0.01  # of the normal force, that dots are taken to tell at least
OF_FORCES = 14  # numbers that `features` tells of the forces themselves


def features(forces: np.ndarray, by_dots: np.ndarray, dots_found: float, pooled: np.ndarray) -> np.ndarray:
    """What the small network sees of a press, (OF_FORCES + k,) float32.

    forces: (3, rows, cols) N as the brightness tells them, which press with LEAST_PRESS or more. by_dots: totals (3,) N.
    dots_found: share of the print's places that these were told from. pooled: (k,) of the network (`Unrolled.with_pooled`).
    None of them jumps where a force moves a little.
    """
    total = forces.sum((1, 2), dtype=float)
    pressed = np.maximum(-forces[2].astype(float), 0.0)
    weight, peak = pressed.sum(), pressed.max()
    rows, cols = (np.linspace(-1.0, 1.0, count) for count in pressed.shape)
    down, right = (pressed.sum(1) @ rows) / weight, (pressed.sum(0) @ cols) / weight
    square = pressed.sum(1) @ (rows - down) ** 2 + pressed.sum(0) @ (cols - right) ** 2
    told = [
        math.log(weight),
        math.log(peak),
        math.log((pressed / (pressed + TOUCHED * peak)).sum()),  # area of the contact, in cells
        math.log((pressed**2).sum() / weight**2),  # how unevenly it is pressed
        0.5 * math.log(square / weight + 1e-3),  # how wide it is
        math.hypot(down, right),  # how far aside it lies
        np.hypot(*forces[:2].astype(float)).sum() / weight,  # sideways force of its cells, and of all together
        math.hypot(*total[:2]) / weight,
        math.log(max(-by_dots[2] / weight, LEAST_SHARE)),
        *(total[:2] / weight),
        *(by_dots[:2] / weight),
        dots_found,
    ]
    return np.concatenate([told, pooled]).astype(np.float32)


class StackedFactor(nn.Module):
    """What is seen of presses (n, count) (`features`) to the logarithm of a factor on normal force, (n,)."""

    mean: torch.Tensor  # (count,), of what was seen of the presses that it learnt from
    spread: torch.Tensor  # (count,), standard deviations of the same

    def __init__(self, count: int) -> None:
        super().__init__()
        self.inner = nn.Linear(count, MEMBERS * HIDDEN)
        self.outer = nn.Parameter(torch.zeros(MEMBERS, HIDDEN))
        self.bias = nn.Parameter(torch.zeros(MEMBERS))
        self.register_buffer("mean", torch.zeros(count))
        self.register_buffer("spread", torch.ones(count))

    def each(self, seen: torch.Tensor) -> torch.Tensor:
        """What each member tells, (n, MEMBERS)."""
        seen = ((seen - self.mean) / self.spread).clamp(-FARTHEST, FARTHEST)
        units = F.relu(self.inner(F.dropout(seen, DROPPED_IN, self.training))).unflatten(1, (MEMBERS, HIDDEN))
        told = (F.dropout(units, DROPPED, self.training) * self.outer).sum(2) + self.bias
        return told.clamp(-MOST_LOG, MOST_LOG)

    def near(self, seen: torch.Tensor) -> torch.Tensor:
        """How near presses lie to those that it learnt from, (n,) from 1 to 0, by what their forces are like."""
        apart = (seen - self.mean)[:, :OF_FORCES] / self.spread[:OF_FORCES]
        return 1.0 / (1.0 + (apart / HALF_SAID).square().mean(dim=1))

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        return self.near(seen) * self.each(seen).mean(dim=1)

    def factor(self, seen: np.ndarray) -> float:
        """Factor on the normal force of one press, of which (count,) is seen."""
        with torch.inference_mode():
            return math.exp(self(torch.from_numpy(seen)[None]).item())


def train_stacking(seen: np.ndarray, told: np.ndarray, true: np.ndarray, epochs: int, seed: int) -> StackedFactor:
    """The small network trained on presses, some of them new to both readers; the same seed gives the same one.

    seen: (n, count). told, true: normal forces (n,) N, as both readers tell them together and as they are.
    """
    scale = float(np.sqrt((true**2).mean()))
    values, normal, wanted = (
        torch.from_numpy(np.asarray(part, np.float32)) for part in (seen, told / scale, true / scale)
    )

    def make() -> StackedFactor:
        net = StackedFactor(seen.shape[1])
        net.mean, net.spread = values.mean(0), values.std(0).clamp(min=1e-6)
        return net

    def lesson(net: StackedFactor, rows: torch.Tensor, _draw: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        found = normal[rows, None] * torch.exp(net.each(values[rows]))
        return found, wanted[rows, None].expand_as(found)

    return train_small(make, lesson, "stacking", len(values), epochs, seed)
