"""The training loop: seeded, resumable to the same curve, best epoch by validation."""

import copy
import io
import math
import resource
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.nn import functional as F
from torch.optim.swa_utils import AveragedModel

from gelforge.errors import BadInput, GelforgeError
from gelforge.flow.files import publish
from gelforge.flow.params.tables import TrainingTable
from gelforge.flow.progress import progress
from gelforge.networks.data.loader import Prefetch, generator, images_to_tensor, training_batches
from gelforge.networks.models.inputs import network_input
from gelforge.networks.models.registry import begin_as, build
from gelforge.records.axes import CHANNELS
from gelforge.records.networkkind import kind_of
from gelforge.records.splits import TRAINING, VALIDATION

# Of the way from the weights that a network is fine-tuned from to those that it learnt, where validation looks between the two.
FRACTIONS = (0.25, 0.5, 0.75)


def initial_net(model: dict, image, grid, seed: int):
    """Build a network whose weights depend on `seed` alone; torch's own generator is left as it was."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(generator(seed, "weights").initial_seed())
        return build(model, image, grid)


def loss_of(output, target, scale, total_scale, settings: TrainingTable):
    """Mean square error per cell, plus `total_weight` times that of total force, both in units of their own scale.

    Beyond `total_huber` scales an error of total force counts linearly (smooth L1: Girshick 2015, equation 3, its
    corner at `total_huber`); where that is 0, all count squared.
    output, target: (n, 3, rows, cols) in training units; scale, total_scale: (3,) N.
    """
    loss = F.mse_loss(output, target)
    if settings.total_weight > 0 and output.shape[2:] != (1, 1):
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
            pictures = images_to_tensor(data.seen(rows[start : start + batch], norm["reads"])).to(device)
            parts.append((net(network_input(pictures, norm)) * scale).cpu().numpy())
    return np.concatenate(parts) if parts else np.zeros((0, 3, 1, 1), np.float32)


def validate(net, data, norm: dict, batch: int, device: str) -> dict:
    """Validation errors of an epoch: mean absolute error of total force per component, N, their sum, and what is chosen by.

    val_score: mean of the three, each over the scale of its own total, so that shear counts as much as normal force.
    """
    rows = data.splits[VALIDATION]
    error = predict_rows(net, data, rows, norm, batch, device).sum((2, 3), dtype=np.float64) - data.totals(rows)
    mae = np.abs(error).mean(0)
    return {f"val_{name}": float(value) for name, value in zip(CHANNELS, mae, strict=True)} | {
        "val_total": float(mae.sum()),
        "val_score": float((mae / norm["total"]).mean()),
    }


def cosine(epoch: int, epochs: int) -> float:
    """Share of the learning rate in an epoch (from 0) of a cosine schedule that ends near zero (Loshchilov 2017)."""
    return 0.5 * (1 + math.cos(math.pi * epoch / epochs))


def make_schedule(optimiser, settings: TrainingTable):
    """The schedule of the learning rate, and whether its step wants the validation error."""
    if settings.schedule == "plateau":
        return torch.optim.lr_scheduler.ReduceLROnPlateau(
            optimiser,
            factor=settings.plateau_factor,
            patience=settings.plateau_patience,
            min_lr=settings.least_rate,
        ), True
    return torch.optim.lr_scheduler.LambdaLR(optimiser, lambda n: cosine(n, settings.epochs)), False


def device_of(asked: str) -> str:
    """torch's device for [train] device; "auto" takes a graphics card where there is one. BadInput where it is not there."""
    there = torch.cuda.is_available()
    if asked == "cuda" and not there:
        raise BadInput(
            '[train] device = "cuda": torch finds no graphics card here; set "auto" or "cpu", or install torch for yours'
        )
    return "cuda" if asked == "cuda" or (asked == "auto" and there) else "cpu"


def normalisations(net) -> list[torch.nn.BatchNorm2d]:
    """The layers of a network that normalise by the statistics of a batch."""
    return [layer for layer in net.modules() if isinstance(layer, torch.nn.BatchNorm2d)]


def settle_batch_norm(net, data, norm: dict, settings: TrainingTable, device: str) -> None:
    """Replace the running statistics of batch normalisation by those of clean training images.

    While it trains, a network sees augmented images and its weights move faster than running means
    follow; with tens of steps an epoch that alone doubled the validation error. At most
    `settle_images` images, evenly picked, in batches (precise batch normalisation, Wu and Johnson 2021).
    """
    layers = normalisations(net)
    if not layers or settings.settle_images == 0:
        return
    rows = data.splits[TRAINING]
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), settings.settle_images)).astype(int)]
    for layer in layers:
        layer.reset_running_stats()
        layer.momentum = None  # a plain average over the batches
    net.train()
    with torch.no_grad():
        for part in np.array_split(rows, max(1, len(rows) // settings.batch)):
            net(network_input(images_to_tensor(data.seen(part, norm["reads"])).to(device), norm))


def mixes_precision(settings: TrainingTable, device: str) -> bool:
    """Whether steps run in bfloat16: if asked for, and done in hardware; emulated, it is slower than float32."""
    able = torch.cpu.get_capabilities()
    used = torch.backends.cpu.get_cpu_capability() == "AVX512"  # ATEN_CPU_CAPABILITY may hold torch back from it
    hardware = device == "cuda" or (used and (able.get("avx512_bf16") or able.get("amx_bf16")))
    return bool(settings.mixed_precision and hardware)


def between(first: dict, last: dict, fraction: float) -> dict:
    """Weights of one kind of network that lie `fraction` of the way from the first to the last; whole numbers are the first's."""
    return {
        name: torch.lerp(value, last[name], fraction) if value.is_floating_point() else value
        for name, value in first.items()
    }


class Training:
    """A network with everything that its training needs to go on where it stopped."""

    def __init__(self, model: dict, settings: TrainingTable, norm: dict, image, grid, device: str):
        self.settings, self.norm, self.device = settings, norm, device
        self.total_only = kind_of(model).totals_only
        # pixels side by side with their channels: convolutions on a CPU are a third faster
        self.net = initial_net(model, image, grid, settings.seed).to(device, memory_format=torch.channels_last)
        self.optimiser = torch.optim.Adam(self.net.parameters(), lr=settings.learning_rate)
        self.schedule, self.by_validation = make_schedule(self.optimiser, settings)
        self.mean: AveragedModel | None = None  # of the weights, once they are averaged
        self.mixed = mixes_precision(settings, device)
        self.epochs_done = 0
        self.curve: list[dict] = []
        self.best: dict[str, Any] = {"epoch": 0, "val_score": float("inf"), "weights": None}
        self.start: dict[str, Any] | None = None  # weights that it is fine-tuned from, and their validation
        self.fraction = 1.0  # of the way from these to the best ones, where those of the finished network lie
        # seconds: of all, step_seconds: of the steps alone
        self.cost: dict[str, Any] = {
            "seconds": 0.0,
            "step_seconds": 0.0,
            "wait_seconds": 0.0,
            "steps": 0,
            "resumed": 0,
        }

    def go_on_from(self, weights: dict, data) -> None:
        """Begin with the weights of another network of the same kind."""
        begin_as(self.net, weights)
        self.start = self._validated(self.net, data) | {"weights": copy.deepcopy(self.net.state_dict())}

    def _validated(self, net, data) -> dict:
        """Validation errors of a network that is scaled as this one."""
        return validate(net, data, self.norm, self.settings.batch, self.device)

    def finish(self, data) -> None:
        """Put the best epoch's weights into the network, or some between these and the ones that it went on from.

        Of two datasets learnt one after the other, weights between have more of both: they err less on pictures of either and
        on others (Wortsman et al. 2022, Robust fine-tuning of zero-shot models, CVPR, section 3.2). Validation selects which.
        """
        best = self.best["weights"]
        if self.start is not None:
            judged = {0.0: self.start["val_score"], 1.0: self.best["val_score"]}
            for fraction in FRACTIONS:
                self.net.load_state_dict(between(self.start["weights"], best, fraction))
                judged[fraction] = self._validated(self.net, data)["val_score"]
            self.fraction = min(judged, key=lambda fraction: judged[fraction])
            best = between(self.start["weights"], best, self.fraction)
        self.net.load_state_dict(best)
        self.net.to(memory_format=torch.contiguous_format).eval()

    @property
    def best_epoch(self) -> int:
        """The epoch, from 1, whose weights the finished network is a mean of; 0 where those it was fine-tuned from are better."""
        return self.best["epoch"] if self.fraction else 0

    @property
    def judged(self) -> torch.nn.Module:
        """The network whose error counts: that of the mean weights once they are averaged."""
        return self.net if self.mean is None else self.mean.module

    def keep(self, row: dict) -> None:
        """Take the weights that are judged for the best so far; row: of the curve."""
        self.best = {
            "epoch": row["epoch"],
            "val_score": row["val_score"],
            "weights": copy.deepcopy(self.judged.state_dict()),
        }

    def state(self, identity: str) -> dict:
        """Everything a checkpoint holds: tensors and plain values only."""
        return {
            "identity": identity,
            "net": self.net.state_dict(),
            "mean": None if self.mean is None else self.mean.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "schedule": self.schedule.state_dict(),
            "curve": self.curve,
            "best": self.best,
            "cost": self.cost,
        }

    def restore(self, state: dict) -> None:
        """Go back to where `state` was taken."""
        self.net.load_state_dict(state["net"])
        if state["mean"] is not None:
            self.mean = AveragedModel(self.net)
            self.mean.load_state_dict(state["mean"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.schedule.load_state_dict(state["schedule"])
        self.curve, self.best, self.cost = state["curve"], state["best"], state["cost"]
        self.epochs_done = len(self.curve)
        self.cost["resumed"] += 1

    def step(self, images, target) -> float:
        """One step of the optimiser on inputs (k, channels, h, w) and targets (k, 3, rows, cols); return the loss."""
        images, target = images.to(self.device), target.to(self.device)
        scale, total = (torch.tensor(self.norm[key], device=self.device).float() for key in ("label", "total"))
        self.optimiser.zero_grad(set_to_none=True)
        with torch.autocast(self.device, dtype=torch.bfloat16, enabled=self.mixed):
            output = self.net(images)
        loss = loss_of(output.float(), target, scale, total, self.settings)
        loss.backward()
        self.optimiser.step()
        if self.averages(self.epochs_done):
            self.mean = self.mean or AveragedModel(self.net)
            self.mean.update_parameters(self.net)
        return loss.item()

    def freezes(self, epoch: int) -> bool:
        """Whether an epoch (from 0) is one of the last, in which batch normalisation keeps its statistics."""
        return epoch >= (1 - self.settings.frozen_share) * self.settings.epochs

    def averages(self, epoch: int) -> bool:
        """Whether an epoch (from 0) is one of the last, over whose steps the weights are averaged (Izmailov et al. 2018)."""
        return epoch >= (1 - self.settings.averaged_share) * self.settings.epochs

    def batches(self, data) -> Prefetch:
        """Start preparing the batches of the next epoch."""
        return Prefetch(training_batches(data, self.norm, self.settings, self.epochs_done, self.total_only))

    def train_epoch(self, batches: Prefetch) -> float:
        """Go through one epoch's batches; return the mean loss."""
        started, waited = time.perf_counter(), batches.waited
        self.net.train()
        if self.freezes(self.epochs_done):
            for layer in normalisations(self.net):
                layer.eval()
        losses: list[float] = []
        for batch in batches:
            losses.append(self.step(*batch))
        self.cost["wait_seconds"] += batches.waited - waited
        seconds = time.perf_counter() - started
        self.cost["step_seconds"] += seconds
        self.cost["seconds"] += seconds
        self.cost["steps"] += len(losses)
        self.epochs_done += 1
        if not np.isfinite(losses).all():
            raise GelforgeError(
                f"training diverged in epoch {self.epochs_done}: a loss is not finite; lower "
                f"[train] learning_rate, now {self.settings.learning_rate:g} at its start"
            )
        return float(np.mean(losses))

    def close_epoch(self, data, loss: float) -> dict:
        """Validate, move the learning rate, keep the best weights; return the curve's new row."""
        started = time.perf_counter()
        if not self.freezes(self.epochs_done - 1):
            settle_batch_norm(self.net, data, self.norm, self.settings, self.device)
        row = {
            "epoch": self.epochs_done,
            "learning_rate": self.optimiser.param_groups[0]["lr"],
            "loss": loss,
            **self._validated(self.judged, data),
        }
        self.schedule.step(*[row["val_score"]] if self.by_validation else [])
        self.curve.append(row)
        if row["val_score"] < self.best["val_score"]:
            self.keep(row)
        self.cost["seconds"] += time.perf_counter() - started
        return row


def save_checkpoint(path, training: Training, identity: str) -> None:
    """Write a checkpoint, whole or not at all; OSError where there is no room for it."""
    content = io.BytesIO()  # torch's own error of a full disk is none of the system's
    torch.save(training.state(identity), content)
    with publish(path) as part:
        part.write_bytes(content.getvalue())


def resume(path, training: Training, identity: str) -> bool:
    """Go on from a checkpoint if it belongs to the same training; say so either way."""
    if path is None or not Path(path).exists():
        return False
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises a dozen kinds for a corrupt file, none of them documented
        print(f"{path}: cannot be read ({type(error).__name__}), starting over", flush=True)
        return False
    if not isinstance(state, dict) or state.get("identity") != identity:
        print(f"{path}: of another configuration or dataset, starting over", flush=True)
        return False
    training.restore(state)
    print(f"{path}: going on after epoch {len(training.curve)}", flush=True)
    return True


def fit(training: Training, data, checkpoint=None, identity: str = "", epochs: int | None = None) -> None:
    """Train up to `epochs` (all of them if None), then let validation choose the network's weights (`Training.finish`).

    :param checkpoint: file to resume from and to write every `checkpoint_seconds`; None for neither.
    :param identity: text that identifies one training; a checkpoint of another one is not used.
    """
    resume(checkpoint, training, identity)
    planned = training.settings.epochs
    epochs = planned if epochs is None else epochs
    saved = time.monotonic()
    batches = training.batches(data)
    try:
        for number in progress(range(training.epochs_done, epochs), f"epochs of {planned}"):
            loss = training.train_epoch(batches)
            if number + 1 < epochs:
                batches = training.batches(data)  # read while this epoch is validated
            row = training.close_epoch(data, loss)
            if number % max(1, planned // 20) == 0 or number == planned - 1:
                errors = ", ".join(f"{name} {row[f'val_{name}']:.3f}" for name in CHANNELS)
                print(
                    f"epoch {row['epoch']}: loss {loss:.4g}, validation {errors} N, rate {row['learning_rate']:.2g}",
                    flush=True,
                )
            if checkpoint and time.monotonic() - saved >= training.settings.checkpoint_seconds:
                save_checkpoint(checkpoint, training, identity)
                saved = time.monotonic()
    finally:
        batches.close()
    training.finish(data)


def peak_memory_gib() -> float:
    """Peak resident memory of this process so far, GiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
