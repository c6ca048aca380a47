"""What the network above both readers learns from: presses, some of them new to both, as they read them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.params.tables import TrainingTable
from gelforge.flow.progress import progress
from gelforge.networks.agreement import has_shape
from gelforge.networks.augment import narrow_views
from gelforge.networks.batches import generator
from gelforge.networks.data import Data
from gelforge.networks.dotaugment import kept_dots
from gelforge.networks.dotreader import LOST
from gelforge.networks.modelfile import Trained
from gelforge.networks.stacking import StackedFactor, features, train_stacking
from gelforge.networks.use import GIVEN, CanonicalPair, TwoReadings, Untouched, read_both, told_together
from gelforge.records.splits import TRAINING

FEWEST_PRESSES = 250  # of fewer it learns their chances: with 125 presses others were read worse than without it


@dataclass(frozen=True)
class Lessons:
    """Presses as both readers see them: seen (n, count) (`stacking.features`); told and true normal forces (n,) N."""

    seen: np.ndarray
    told: np.ndarray
    true: np.ndarray


def fit_stacking(trained: Trained, new: Sequence[Data], learnt: Data, settings: TrainingTable) -> StackedFactor:
    """The network above both readers of a model, from the training presses of `learnt`, the datasets `new` and others as one.

    new: those, at least one, that are new to both readers. Raises BadInput where their training presses are fewer than
    FEWEST_PRESSES, or where the model does not read dots.
    """
    count = sum(len(np.unique(one.presses(one.splits[TRAINING]))) for one in new)
    if trained.dots is None:
        raise BadInput(
            f"{trained.about['name']} does not read dots beside its picture: nothing can be learnt above both"
        )
    if count < FEWEST_PRESSES:
        raise BadInput(
            f"{new[0].folder}: {count} presses train; how both readers err is learnt from {FEWEST_PRESSES} or more: log more"
        )
    found = lessons(trained, learnt, learnt.splits[TRAINING], settings)
    return train_stacking(found.seen, found.told, found.true, settings.stacking_epochs, settings.seed)


def lessons(trained: Trained, data: Data, rows: np.ndarray, settings: TrainingTable) -> Lessons:
    """Each of some rows as it is, and once more in a narrow view or with dots lost; those that hardly press are left out.

    trained: a model above whose readers nothing stands. Raises BadInput where none presses and shows dots.
    """
    sensors, found = data.names("sensor_id"), []
    beside = {name: Untouched(trained, data.nocontact[name]) for name in set(sensors[rows].tolist())}
    for row in progress(rows, "presses read", len(rows)):
        for readings, label in variants_of(beside[sensors[row]], data, int(row), settings):
            if readings.by_dots is not None and has_shape(readings.forces):
                told = told_together(trained, readings)[2].sum(dtype=float)
                seen = features(readings.forces, readings.by_dots, readings.dots_found, readings.pooled)
                found.append((seen, told, label[2].sum(dtype=float)))
    if not found:
        raise BadInput(f"{data.folder}: no picture shows printed dots and a press; how both readers err needs both")
    seen, told, true = (np.array(part) for part in zip(*found, strict=True))
    return Lessons(seen, told, true)


def variants_of(
    untouched: Untouched, data: Data, row: int, settings: TrainingTable
) -> Iterator[tuple[TwoReadings, np.ndarray]]:
    """What both readers tell of a picture as it is and of one that is varied, each with its label (3, rows, cols) N."""
    draw = generator(settings.seed, "stacking", row)
    kept = kept_dots(1, LOST, draw)[0].numpy()
    label = np.asarray(data.labels[row])
    pair, readings = read(untouched, np.ascontiguousarray(data.images[row]))
    yield readings, label
    half = replace(settings.augment, narrowed_share=0.5)
    (seen,), (shown,), (narrow,) = narrow_views(data.seen([row], "pair"), label[None], half, draw)
    if narrow:
        image, rest = (np.ascontiguousarray(part) for part in (seen[..., :3], seen[..., 3:]))
        pair, readings = read(Untouched(untouched.trained, rest), image)
        label = shown
    reader = untouched.reader_of_dots
    if reader is not None and readings.by_dots is not None:
        yield readings.with_dots(reader, (pair.motion * kept).astype(np.float32)), label


def read(untouched: Untouched, image: np.ndarray) -> tuple[CanonicalPair, TwoReadings]:
    """An image beside its untouched picture, and what both readers tell of it."""
    pair = untouched.pair(image, GIVEN)
    return pair, read_both(untouched, GIVEN, pair.lit, pair)
