"""Batches of a dataset, prepared one ahead of the step that uses them."""

from collections.abc import Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from math import ceil

import numpy as np
import torch

from gelforge.flow.params.tables import TrainingTable
from gelforge.networks.data.augment import augment, mirror_together, misplace_nocontact, narrow_views, shift_together
from gelforge.networks.models.inputs import network_input
from gelforge.records.samplefile import TRAINING

STREAMS = {"order": 0, "augment": 1, "weights": 2, "shift": 3, "mirror": 4, "seat": 5, "view": 6}
VARIED = ("augment", "shift", "mirror", "seat", "view")  # what an epoch's pictures draw from

# Pictures prepared at a time. A whole batch would be arrays of tens of MB, for each of which the system clears new memory:
# more than half of the time. Those of a few pictures are used again, and stay in the processor's cache.
PIECE = 4


def generator(seed: int, stream: str, *numbers: int) -> torch.Generator:
    """A torch generator that depends on nothing but a seed, what it is for, and where in the work it stands.

    So a resumed training draws what the uninterrupted one drew, and no generator's state is stored.
    """
    words = np.random.SeedSequence([seed, STREAMS[stream], *numbers]).generate_state(2, np.uint32)
    return torch.Generator().manual_seed(int(words[0]) << 31 | int(words[1]) >> 1)


def epoch_order(rows: np.ndarray, seed: int, epoch: int, most: int = 0) -> np.ndarray:
    """The training rows of one epoch (from 0) in the order in which they are seen.

    rows: (n,) of a dataset. most: rows in an epoch; with fewer than there are, epochs share a pass over all of them
    between them, so that no row is seen a second time before every other was seen once. 0: an epoch is a pass.
    """
    size = min(most or len(rows), len(rows))
    first, last = epoch * size, (epoch + 1) * size
    through = range(first // len(rows), (last - 1) // len(rows) + 1)
    order = [torch.randperm(len(rows), generator=generator(seed, "order", number)).numpy() for number in through]
    begin = first % len(rows)
    return rows[np.concatenate(order)[begin : begin + size]]


def images_to_tensor(images) -> torch.Tensor:
    """Images (n, h, w, channels) uint8 to a contiguous float tensor (n, channels, h, w) in 0..1.

    Channels are turned to the front while they are bytes: four times faster than as floats.
    """
    return torch.from_numpy(np.require(images, requirements=["C", "W"])).permute(0, 3, 1, 2).contiguous() / 255


def target(labels, norm: dict) -> torch.Tensor:
    """Labels (n, 3, rows, cols) in N to what a network is fitted to, in training units."""
    return torch.from_numpy(np.require(labels, requirements=["C", "W"])) / torch.tensor(norm["label"]).float().view(
        1, 3, 1, 1
    )


def training_batches(data, norm: dict, settings: TrainingTable, epoch: int, pair: bool):
    """Yield (input, target, maps) of one epoch, augmented, in the network's units.

    Shapes (k, 3 or 6, h, w), (k, 3, rows, cols) and (k,): of which targets the map is known, not the total alone.
    """
    order = epoch_order(data.splits[TRAINING], settings.seed, epoch, settings.epoch_images)
    draws = {stream: generator(settings.seed, stream, epoch) for stream in VARIED}
    mirrors = epoch < settings.mirrored_share * settings.epochs
    for start in range(0, len(order), settings.batch):
        # Sorted rows read the file forwards; the order inside a batch changes nothing but rounding.
        rows = np.sort(order[start : start + settings.batch])
        pieces = [rows[first : first + PIECE] for first in range(0, len(rows), PIECE)]
        varied = [_varied(data, piece, pair, settings, mirrors, draws) for piece in pieces]
        yield (
            torch.cat([network_input(pictures, norm) for pictures, _ in varied]),
            torch.cat([target(labels, norm) for _, labels in varied]),
            torch.from_numpy(data.maps[rows]),
        )


def _varied(data, rows: np.ndarray, pair: bool, settings: TrainingTable, mirrors: bool, draws: dict):
    """Pictures (k, channels, h, w) in 0..1 and labels (k, 3, rows, cols) N of some rows, varied as training asks for."""
    pictures, labels = data.seen(rows, pair), data.labels[rows]
    if pair:
        pictures, labels, narrow = narrow_views(pictures, labels, data.maps[rows], settings.augment, draws["view"])
        pictures = misplace_nocontact(pictures, narrow, settings.augment, draws["seat"])
    if settings.shift_cells:
        pictures, labels = shift_together(pictures, labels, settings.shift_cells, draws["shift"])
    if mirrors:
        pictures, labels = mirror_together(pictures, labels, draws["mirror"])
    return augment(images_to_tensor(pictures), settings.augment, draws["augment"]), labels


def epoch_steps(data, settings: TrainingTable) -> int:
    """Batches of an epoch."""
    count = len(data.splits[TRAINING])
    return ceil(min(settings.epoch_images or count, count) / settings.batch)


def batches_from(data, norm: dict, settings: TrainingTable, first: int, pair: bool):
    """Yield the batches of all epochs from the `first` one on (from 0), as `training_batches` has them."""
    for epoch in range(first, settings.epochs):
        yield from training_batches(data, norm, settings, epoch, pair)


def prefetched(batches: Iterator) -> Generator:
    """The same batches, of which a thread prepares the next one while one is used.

    torch's DataLoader with a worker process takes 10 to 40 % longer for a step than this: it copies each batch.
    """
    # A new thread starts with OpenMP's own count; one is enough here and keeps sums in one order.
    with ThreadPoolExecutor(1, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        ahead = pool.submit(next, batches, None)
        while (batch := ahead.result()) is not None:
            ahead = pool.submit(next, batches, None)
            yield batch
