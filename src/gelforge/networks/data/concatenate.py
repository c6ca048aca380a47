"""Several datasets concatenated to one to learn from."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gelforge.errors import BadInput
from gelforge.networks.data.arrays import Data
from gelforge.records.rowfile import ChainedRows
from gelforge.records.samplefile import DatasetSample
from gelforge.records.splits import TRAINING, VALIDATION


def concatenate(own: Data, others: Sequence[Data]) -> Data:
    """One dataset to learn from: all of `own`, and what `others` have to train on and to validate with.

    It is named after all of them, and rows of `own` come first. Sensors and groups of another one carry its name, so that the
    same name in two datasets stays two things. Raises BadInput for one of other images or another grid, and for one that is given twice.
    """
    if not others:
        return own
    for at, other in enumerate(others):
        require_alike(own, other)
        if other.name in [own.name, *(one.name for one in others[:at])]:
            raise BadInput(f"{other.folder}: dataset {other.name} is given twice to learn from; name each once")
    table, splits, pictures = list(own.table), dict(own.splits), dict(own.nocontact)
    for other in others:
        for name in (TRAINING, VALIDATION):
            mine = splits.get(name, np.zeros(0, int))
            splits[name] = np.concatenate([mine, len(table) + other.splits.get(name, np.zeros(0, int))])
        table += [carrying(other.name, sample) for sample in other.table]
        pictures |= {f"{other.name}/{name}": picture for name, picture in other.nocontact.items()}
    every = [own, *others]
    images, labels = ChainedRows([one.images for one in every]), ChainedRows([one.labels for one in every])
    info = own.info | {"name": ", ".join(one.name for one in every)}
    return replace(own, images=images, labels=labels, table=table, splits=splits, info=info, nocontact=pictures)


def carrying(dataset: str, sample: DatasetSample) -> DatasetSample:
    """A sample whose sensor and group carry the name of their dataset; a press without a group has none."""
    press = replace(sample.press, sensor_id=f"{dataset}/{sample.press.sensor_id}")
    return replace(sample, press=press, group=f"{dataset}/{sample.group}" if sample.group else "")


def require_alike(own: Data, other: Data) -> None:
    """Raise BadInput where two datasets cannot be learnt from together."""
    seen, required = (
        f"images of {one.image_size[1]} x {one.image_size[0]} and a grid of {one.grid[0]} x {one.grid[1]}"
        for one in (other, own)
    )
    if seen != required:
        raise BadInput(
            f"{other.folder}: has {seen}, {own.folder} has {required}: only what is alike can be learnt from together"
        )
