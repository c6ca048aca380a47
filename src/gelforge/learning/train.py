"""Training of one network: its batches, loss, epochs and checkpoints.

Training is seeded, a resumed training gives the same curve, and validation selects the best epoch. `fit` runs the
loop `training_epochs`. The end of the file checks that a network can be fine-tuned from another one.
"""

import copy
import io
import time
from collections.abc import Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.nn import functional as F
from torch.optim.swa_utils import AveragedModel
from tqdm import tqdm

from gelforge.errors import BadInput, GelforgeError
from gelforge.flow.files import publish
from gelforge.flow.tables import TrainingTable
from gelforge.learning.augment import augment, mirror_together, misplace_nocontact, narrow_views, shift_together
from gelforge.learning.data import ONE_CELL, Data
from gelforge.learning.nets import begin_as, build, network_input
from gelforge.reading.frame import at_scale
from gelforge.reading.markers import markers_in
from gelforge.records.axes import CHANNELS
from gelforge.records.samplefile import TRAINING, VALIDATION

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


# Fine-tuning: interpolations between initial weights (0) and learnt weights (1) that validation compares with both.
FRACTIONS = (0.25, 0.5, 0.75)
# Validation presses; weights selected by a single one had five times the errors of the initial weights on others.
FEWEST_JUDGES = 5
FARTHER = 0.05  # fraction by which a new sensor's marker pitch (px) may lie outside the range that a network learnt


def initial_net(model: dict, image, grid, seed: int):
    """Build a network whose weights depend on `seed` alone; torch's own generator is left as it was."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(generator(seed, "weights").initial_seed())
        return build(model, image, grid)


def loss_of(output, target, maps, scale, total_scale, settings: TrainingTable):
    """Mean square error per cell, plus `total_weight` times that of total force, both in units of their own scale.

    Where `maps` (n,) bool is False, only the total is known, and only the sum of the output is compared with it; the
    presses with maps teach its shape. An error of total force beyond `total_huber` scales counts linearly (smooth L1:
    Girshick 2015, equation 3, with its corner at `total_huber`); with `total_huber` 0 all errors count squared.
    output, target: (n, 3, rows, cols) in training units; scale, total_scale: (3,) N.
    """
    square = F.mse_loss(output, target, reduction="none").mean((1, 2, 3))
    loss = square.mean() if output.shape[2:] == ONE_CELL else (square * maps).mean()
    if settings.total_weight > 0 and output.shape[2:] != ONE_CELL:
        error = (output - target).sum((2, 3)) * (scale / total_scale)
        corner = settings.total_huber
        total = F.smooth_l1_loss(error, torch.zeros_like(error), beta=corner) if corner > 0 else (error**2).mean()
        loss = loss + settings.total_weight * total
    return loss


def predict_rows(net, data, rows, norm: dict, batch: int = 8, device: str = "cpu") -> np.ndarray:
    """Predict forces (k, 3, rows, cols) in N per cell for some rows of a dataset; `net` is put in evaluation mode."""
    scale = torch.tensor(norm["label"], device=device).float().view(1, 3, 1, 1)
    net.eval()
    parts = []
    with torch.inference_mode():
        for start in range(0, len(rows), batch):
            pictures = images_to_tensor(data.seen(rows[start : start + batch], net.pair)).to(device)
            parts.append((net(network_input(pictures, norm)) * scale).cpu().numpy())
    return np.concatenate(parts) if parts else np.zeros((0, 3, 1, 1), np.float32)


def validate(net, data, norm: dict, batch: int, device: str) -> dict:
    """Validation errors of an epoch: mean absolute error of total force by component, their sum, N, and val_score.

    val_score selects the epoch: the mean of the three errors, each over the scale of its component's total, so that
    shear counts as much as normal force.
    """
    rows = data.splits[VALIDATION]
    error = predict_rows(net, data, rows, norm, batch, device).sum((2, 3), dtype=np.float64) - data.totals(rows)
    mae = np.abs(error).mean(0)
    return {f"val_{name}": float(value) for name, value in zip(CHANNELS, mae, strict=True)} | {
        "val_total": float(mae.sum()),
        "val_score": float((mae / norm["total"]).mean()),
    }


def device_of(asked: str) -> str:
    """torch's device for [train] device; "auto" takes a GPU if there is one. BadInput if the device is not there."""
    there = torch.cuda.is_available()
    if asked == "cuda" and not there:
        raise BadInput(
            '[train] device = "cuda": torch finds no graphics card here; set "auto" or "cpu", or install torch for yours'
        )
    return "cuda" if asked == "cuda" or (asked == "auto" and there) else "cpu"


def normalisations(net) -> list[torch.nn.BatchNorm2d]:
    """The layers of a network that normalise by the statistics of a batch."""
    return [layer for layer in net.modules() if isinstance(layer, torch.nn.BatchNorm2d)]


def between(first: dict, last: dict, fraction: float) -> dict:
    """Weights of one kind of network that lie `fraction` of the way from the first to the last; whole numbers are the first's."""
    return {
        name: torch.lerp(value, last[name], fraction) if value.is_floating_point() else value
        for name, value in first.items()
    }


class Training:
    """A network with all state that is needed to resume its training."""

    def __init__(self, model: dict, settings: TrainingTable, norm: dict, image, grid, device: str):
        self.settings, self.norm, self.device = settings, norm, device
        # with channels last in memory, convolutions on a CPU are a third faster
        self.net = initial_net(model, image, grid, settings.seed).to(device, memory_format=torch.channels_last)
        self.optimiser = torch.optim.Adam(self.net.parameters(), lr=settings.learning_rate)
        # decays to zero along half a cosine (Loshchilov and Hutter 2017)
        self.schedule = torch.optim.lr_scheduler.CosineAnnealingLR(self.optimiser, settings.epochs)
        self.mean: AveragedModel | None = None  # mean of the weights, once averaging has begun
        self.curve: list[dict] = []
        self.best: dict[str, Any] = {"epoch": 0, "val_score": float("inf"), "weights": None}
        self.start: dict[str, Any] | None = None  # initial weights of fine-tuning, and their validation errors
        self.fraction = 1.0  # position of the final weights between the initial (0) and the best ones (1)
        # seconds: of all training, step_seconds: of its steps, wait_seconds: part of these spent waiting for batches
        self.cost: dict[str, Any] = {
            "seconds": 0.0, "step_seconds": 0.0, "wait_seconds": 0.0, "steps": 0, "resumed": 0,
        }  # fmt: skip

    def go_on_from(self, weights: dict, data) -> None:
        """Fine-tune from the weights of another network of the same kind; validates them."""
        begin_as(self.net, weights)
        self.start = self.validated(self.net, data) | {"weights": copy.deepcopy(self.net.state_dict())}

    def validated(self, net, data) -> dict:
        """Validation errors of a network that uses the scales of this one."""
        return validate(net, data, self.norm, self.settings.batch, self.device)

    def finish(self, data) -> None:
        """Load the best epoch's weights; after fine-tuning, an interpolation between these and the initial weights.

        Interpolated weights have smaller errors on images of the old dataset, the new one and others (Wortsman et al.
        2022, Robust fine-tuning of zero-shot models, CVPR, section 3.2). Validation selects the interpolation.
        """
        best = self.best["weights"]
        if self.start is not None:
            judged = {0.0: self.start["val_score"], 1.0: self.best["val_score"]}
            for fraction in FRACTIONS:
                self.net.load_state_dict(between(self.start["weights"], best, fraction))
                judged[fraction] = self.validated(self.net, data)["val_score"]
            self.fraction = min(judged, key=lambda fraction: judged[fraction])
            best = between(self.start["weights"], best, self.fraction)
        self.net.load_state_dict(best)
        self.net.to(memory_format=torch.contiguous_format).eval()

    @property
    def best_epoch(self) -> int:
        """The best epoch, from 1; 0 if validation kept the initial weights of fine-tuning."""
        return self.best["epoch"] if self.fraction else 0

    @property
    def judged(self) -> torch.nn.Module:
        """The network that is validated: the one with mean weights once averaging has begun."""
        return self.net if self.mean is None else self.mean.module

    def save(self, path, identity: str) -> None:
        """Write a checkpoint, tensors and plain values only, whole or not at all; OSError if the disk is full."""
        content = io.BytesIO()  # torch would raise an error of its own, not OSError, on a full disk
        torch.save({
            "identity": identity, "net": self.net.state_dict(), "mean": None if self.mean is None else self.mean.state_dict(),
            "optimiser": self.optimiser.state_dict(), "schedule": self.schedule.state_dict(),
            "curve": self.curve, "best": self.best, "cost": self.cost,
        }, content)  # fmt: skip
        with publish(path) as part:
            part.write_bytes(content.getvalue())

    def resume(self, path, identity: str) -> bool:
        """Resume from a checkpoint of the same training; return whether it did. Prints why a file is not used."""
        if path is None or not Path(path).exists():
            return False
        try:
            state = torch.load(path, map_location="cpu", weights_only=True)
        except Exception as error:  # for a corrupt file torch raises a dozen types, none of them documented
            print(f"{path}: cannot be read ({type(error).__name__}), starting over", flush=True)
            return False
        if not isinstance(state, dict) or state.get("identity") != identity:
            print(f"{path}: of another configuration or dataset, starting over", flush=True)
            return False
        self.net.load_state_dict(state["net"])
        if state["mean"] is not None:
            self.mean = AveragedModel(self.net)
            self.mean.load_state_dict(state["mean"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.schedule.load_state_dict(state["schedule"])
        self.curve, self.best, self.cost = state["curve"], state["best"], state["cost"]
        self.cost["resumed"] += 1
        print(f"{path}: going on after epoch {len(self.curve)}", flush=True)
        return True


def training_epochs(training: Training, data) -> Generator[dict]:
    """Train through the remaining epochs; yield the curve's new row after each.

    In the last `frozen_share` of the epochs batch normalisation keeps its statistics. In the last `averaged_share`
    the weights are averaged over the steps (Izmailov et al. 2018), and their mean is validated.
    """
    settings, norm, net, cost, device = training.settings, training.norm, training.net, training.cost, training.device
    scale, total = (torch.tensor(norm[key], device=device).float() for key in ("label", "total"))
    first = len(training.curve)
    with closing(prefetched(batches_from(data, norm, settings, first, net.pair))) as batches:
        for epoch in range(first, settings.epochs):
            started = time.perf_counter()
            frozen = epoch >= (1 - settings.frozen_share) * settings.epochs
            averaged = epoch >= (1 - settings.averaged_share) * settings.epochs
            net.train()
            for layer in normalisations(net) if frozen else ():
                layer.eval()

            losses: list[float] = []
            for _ in range(epoch_steps(data, settings)):
                asked = time.perf_counter()
                images, target, maps = (one.to(device) for one in next(batches))
                cost["wait_seconds"] += time.perf_counter() - asked
                training.optimiser.zero_grad(set_to_none=True)
                loss = loss_of(net(images), target, maps, scale, total, settings)
                loss.backward()
                training.optimiser.step()
                if averaged:
                    training.mean = training.mean or AveragedModel(net)
                    training.mean.update_parameters(net)
                losses.append(loss.item())
            cost["step_seconds"] += time.perf_counter() - started
            cost["steps"] += len(losses)
            if not np.isfinite(losses).all():
                raise GelforgeError(
                    f"training diverged in epoch {epoch + 1}: a loss is not finite; lower [train] learning_rate, now"
                    f" {settings.learning_rate:g} at its start"
                )

            rate = training.optimiser.param_groups[0]["lr"]
            row = {"epoch": epoch + 1, "learning_rate": rate, "loss": float(np.mean(losses))}
            row |= training.validated(training.judged, data)
            training.schedule.step()
            training.curve.append(row)
            if row["val_score"] < training.best["val_score"]:
                weights = copy.deepcopy(training.judged.state_dict())
                training.best = {"epoch": row["epoch"], "val_score": row["val_score"], "weights": weights}
            cost["seconds"] += time.perf_counter() - started
            yield row


def fit(training: Training, data, checkpoint=None, identity: str = "", epochs: int | None = None) -> None:
    """Train up to `epochs` (all if None), then select the network's weights by validation (`Training.finish`).

    :param checkpoint: file to resume from and to write every `checkpoint_seconds`; None for neither.
    :param identity: text that identifies one training; a checkpoint of another one is not used.
    """
    training.resume(checkpoint, identity)
    planned, saved = training.settings.epochs, time.monotonic()
    last = planned if epochs is None else epochs
    with closing(training_epochs(training, data)) as rows:
        for number in tqdm(range(len(training.curve), last), f"epochs of {planned}"):
            row = next(rows)
            if number % max(1, planned // 20) == 0 or number == planned - 1:
                errors = ", ".join(f"{name} {row[f'val_{name}']:.3f}" for name in CHANNELS)
                print(
                    f"epoch {row['epoch']}: loss {row['loss']:.4g}, validation {errors} N, rate {row['learning_rate']:.2g}",
                    flush=True,
                )
            if checkpoint and time.monotonic() - saved >= training.settings.checkpoint_seconds:
                training.save(checkpoint, identity)
                saved = time.monotonic()
    training.finish(data)


def scales_before(
    metadata: dict[str, Any], model: dict[str, Any], data: Data, norm: dict[str, Any]
) -> dict[str, Any]:
    """Scales for fine-tuning: those that the initial weights expect, with the larger force range of the two datasets.

    metadata: of the network that is fine-tuned. model: table of the new one in workflow/models.toml. norm: scales of
    the new dataset. Raises BadInput as `require_alike`.
    """
    require_alike(metadata, model, data)
    ranges = zip(metadata["normalisation"]["range"], norm["range"], strict=True)
    return metadata["normalisation"] | {"range": [max(pair) for pair in ranges]}


def require_alike(metadata: dict[str, Any], model: dict[str, Any], data: Data) -> None:
    """Raise BadInput if two networks differ in architecture, or the dataset in grid, image size or scale of the gel.

    metadata: of the network that is fine-tuned. model: table of the new one, which may be a light net of more blocks.
    """
    before, name = metadata["model"], metadata["name"]
    differ = sorted(key for key in before.keys() | model.keys() if before.get(key) != model.get(key))
    both = before.keys() == model.keys()
    if both and differ == ["blocks"] and model["kind"] == "grid" and before["blocks"] < model["blocks"]:
        differ = []  # a light net can be made deeper
    if differ:
        values = ", ".join(f"{key} = {model.get(key)!r} here and {before.get(key)!r} in {name}" for key in differ)
        raise BadInput(
            f"it cannot be fine-tuned from {name}, which is another network: {values}; give the same values"
        )
    if [list(data.grid), list(data.image_size)] != [metadata["grid"], metadata["image"]]:
        (rows, cols), (high, wide) = metadata["grid"], metadata["image"]
        (of_rows, of_cols), (height, width) = data.grid, data.image_size
        raise BadInput(
            f"it cannot be fine-tuned from {name}: that writes a grid of {rows}x{cols} from images of {wide} x {high}, the dataset"
            f" has {of_rows}x{of_cols} and {width} x {height}; choose another MODEL"
        )
    require_scale(metadata, data)


def require_judges(metadata: dict[str, Any], data: Data) -> None:
    """Raise BadInput for too few validation presses to show whether fine-tuning improves a network."""
    count = len(np.unique(data.presses(data.splits[VALIDATION])))
    if count < FEWEST_JUDGES:
        raise BadInput(
            f"{data.folder}: validation has {count} of its presses; at least {FEWEST_JUDGES} are needed to show whether"
            f" fine-tuning improves {metadata['name']}: raise [params.dataset] validation, to 0.25 for a few dozen presses, or log"
            " more"
        )


def require_scale(metadata: dict[str, Any], data: Data) -> None:
    """Raise BadInput if a sensor's marker pitch lies outside the range that a network learnt, widened by FARTHER.

    A fine-tuned network learns pitches just outside that range and then reads images of that scale without zoom.
    """
    if not metadata["frame"]["pitch_px"]:
        return
    low, high = metadata["frame"]["pitch_px"]
    for name, picture in sorted(data.nocontact.items()):
        pitch = markers_in(picture).pitch
        if not at_scale(pitch, ((1 - FARTHER) * low, (1 + FARTHER) * high)):
            raise BadInput(
                f"the markers of sensor {name} are {pitch:.1f} px apart, those that {metadata['name']} learnt from {low:.1f} to"
                f" {high:.1f} px: it cannot be fine-tuned from another scale; choose another MODEL"
            )
