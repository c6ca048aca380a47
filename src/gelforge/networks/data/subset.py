"""Subsets of the training presses, to see how much a network gains from more presses and from more units of a sensor."""

from dataclasses import dataclass, replace
from math import ceil

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.params.tables import TrainingTable
from gelforge.networks.data.arrays import Data
from gelforge.records.splits import TRAINING, VALIDATION


@dataclass(frozen=True)
class Subset:
    """What a network may learn from: `count` presses of all units, or all presses of `count` units."""

    what: str
    count: int

    @property
    def name(self) -> str:
        return f"{self.what}_{self.count}"


def parse_subset(name: str) -> Subset:
    """The part of that name, such as presses_250 or units_4; BadInput for another."""
    what, _, count = name.partition("_")
    if what not in ("presses", "units") or not count.isascii() or not count.isdigit() or int(count) < 1:
        raise BadInput(f"part {name!r}: give presses_N or units_N, N a number from 1 on")
    return Subset(what, int(count))


def take_subset(data: Data, part: Subset, seed: int) -> Data:
    """The dataset with part of its training rows; all other splits stay, but for units also the one for validation.

    By that the epoch is chosen that is kept, and who has few units has no others to choose it by.
    Presses and units are drawn in an order that depends on `seed` alone, so that a smaller part lies within a larger one.
    BadInput where there are not so many.
    """
    rows = data.splits[TRAINING]
    of_row = data.presses(rows) if part.what == "presses" else data.names("sensor_id")[rows]
    known = np.unique(of_row)
    if part.count > len(known):
        raise BadInput(f"{data.folder}: part {part.name} asks for more {part.what} than the {len(known)} that train")
    chosen = known[np.random.default_rng(seed).permutation(len(known))[: part.count]]
    splits = data.splits | {TRAINING: rows[np.isin(of_row, chosen)]}
    if part.what == "units":
        others = data.splits.get(VALIDATION, rows[:0])
        splits[VALIDATION] = others[np.isin(data.names("sensor_id")[others], chosen)]
    return replace(data, splits=splits)


def as_many_passes(settings: TrainingTable, taken: Data, whole: Data) -> TrainingTable:
    """Settings by which a part is passed over as often as the whole would be: its epochs are shorter by its fraction."""
    fraction = len(taken.splits[TRAINING]) / len(whole.splits[TRAINING])
    return replace(settings, epoch_images=ceil(settings.epoch_images * fraction))
