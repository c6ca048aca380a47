"""Batches of training: the order of an epoch, its augmentation, and a thread that prepares the next one."""

from collections.abc import Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from math import ceil

import numpy as np
import torch

from gelforge.flow.tables import TrainingTable
from gelforge.learning.augment import augment, mirror_together, misplace_nocontact, narrow_views, shift_together
from gelforge.learning.nets import network_input
from gelforge.records.samplefile import TRAINING

STREAMS = {"order": 0, "augment": 1, "weights": 2, "shift": 3, "mirror": 4, "seat": 5, "view": 6}
VARIED = ("augment", "shift", "mirror", "seat", "view")  # streams for the images of an epoch

# Images prepared at a time. Arrays of a whole batch take tens of MB, and clearing new memory for them takes more than
# half of the time; arrays of a few images are reused and stay in the processor's cache.
PIECE = 4


def generator(seed: int, stream: str, *numbers: int) -> torch.Generator:
    """A torch generator that depends only on a seed, its purpose (a key of STREAMS) and numbers such as the epoch.

    A resumed training therefore draws the same values as an uninterrupted one, and no generator state is stored.
    """
    words = np.random.SeedSequence([seed, STREAMS[stream], *numbers]).generate_state(2, np.uint32)
    return torch.Generator().manual_seed(int(words[0]) << 31 | int(words[1]) >> 1)


def epoch_order(rows: np.ndarray, seed: int, epoch: int, most: int = 0) -> np.ndarray:
    """The training rows of one epoch (from 0) in the order in which they are seen.

    rows: (n,) of a dataset. most: rows in an epoch; if fewer than n, consecutive epochs share a pass over all rows,
    so that every row is seen once before any is seen again. 0: an epoch is a pass.
    """
    size = min(most or len(rows), len(rows))
    first, last = epoch * size, (epoch + 1) * size
    through = range(first // len(rows), (last - 1) // len(rows) + 1)
    order = [torch.randperm(len(rows), generator=generator(seed, "order", number)).numpy() for number in through]
    begin = first % len(rows)
    return rows[np.concatenate(order)[begin : begin + size]]


def images_to_tensor(images) -> torch.Tensor:
    """Images (n, h, w, channels) uint8 to a contiguous float tensor (n, channels, h, w) in 0..1.

    Channels move to the front while they are bytes, which is four times faster than as floats.
    """
    return torch.from_numpy(np.require(images, requirements=["C", "W"])).permute(0, 3, 1, 2).contiguous() / 255


def target(labels, norm: dict) -> torch.Tensor:
    """Training target (n, 3, rows, cols): labels in N over the label scale of `norm`."""
    return torch.from_numpy(np.require(labels, requirements=["C", "W"])) / torch.tensor(norm["label"]).float().view(
        1, 3, 1, 1
    )


def training_batches(data, norm: dict, settings: TrainingTable, epoch: int, pair: bool):
    """Yield (input, target, maps) of one epoch, augmented, in the network's units.

    Shapes (k, 3 or 6, h, w), (k, 3, rows, cols) and (k,) bool: whether a target is a map or only a known total.
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
    """Augmented images (k, channels, h, w) in 0..1 and labels (k, 3, rows, cols) N of some rows."""
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
    """Yield the batches of `training_batches` for all epochs from the `first` one on (counted from 0)."""
    for epoch in range(first, settings.epochs):
        yield from training_batches(data, norm, settings, epoch, pair)


def prefetched(batches: Iterator) -> Generator:
    """The same batches; a thread prepares the next one while the current one is used.

    A step with torch's DataLoader and a worker process takes 10 to 40 % longer, because it copies each batch.
    """
    # By default a new thread uses OpenMP's own thread count; one is enough here and keeps the order of sums fixed.
    with ThreadPoolExecutor(1, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        ahead = pool.submit(next, batches, None)
        while (batch := ahead.result()) is not None:
            ahead = pool.submit(next, batches, None)
            yield batch
