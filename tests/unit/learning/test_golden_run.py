"""One training with every ingredient, and one with none, against a plain loop that follows the same recipe."""

import copy

import numpy as np
import pytest
import torch

from gelforge.learning.augment import augment, mirror_together, misplace_nocontact, narrow_views, shift_together
from gelforge.learning.batches import PIECE, generator
from gelforge.learning.data import open_data, scales
from gelforge.learning.nets import network_input
from gelforge.learning.train import initial_net
from gelforge.records.axes import CHANNELS
from gelforge.stages.train import train
from tests.support.parameters import with_values
from tests.support.small_networks import GRID, IMAGE, SMALL
from tests.support.synthetic_presses import SETTINGS, write_dataset

EPOCHS = 4
NONE = {"epoch_images": 0, "shift_cells": 0, "mirrored_share": 0.0, "frozen_share": 0.0, "averaged_share": 0.0,
        "total_weight": 0.0, "total_huber": 0.0}  # fmt: skip
# two of four epochs are mirrored and frozen, one of these is averaged; 14 of 20 rows in an epoch cut its passes
EVERY = {"epoch_images": 14, "shift_cells": 1, "mirrored_share": 0.5, "frozen_share": 0.5, "averaged_share": 0.25,
         "total_weight": 0.7, "total_huber": 0.1}  # fmt: skip
UNVARIED = {"probability": 0.0, "misplaced_share": 0.0, "narrowed_share": 0.0}
VARIED = {"probability": 0.5, "misplaced_share": 0.5, "narrowed_share": 0.5, "narrowed": 0.5}
# The loop does the same sums in the same order; only the mean of the weights is summed otherwise.
SAME = 1e-4


def settings_of(changes: dict, varied: dict):
    return with_values(SETTINGS, epochs=EPOCHS, batch=6, learning_rate=4e-3, **changes, augment=varied)


def tensor(images) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(images.transpose(0, 3, 1, 2))).float() / 255


def plain_batch(data, rows, s, draws, mirrored: bool):
    """Images and labels of a batch, varied in the order that the paper and params.toml give."""
    shown, labels = data.seen(rows, True), np.array(data.labels[rows])
    shown, labels, narrow = narrow_views(shown, labels, data.maps[rows], s.augment, draws["view"])
    shown = misplace_nocontact(shown, narrow, s.augment, draws["seat"])
    if s.shift_cells:
        shown, labels = shift_together(shown, labels, s.shift_cells, draws["shift"])
    if mirrored:
        shown, labels = mirror_together(shown, labels, draws["mirror"])
    return augment(tensor(shown), s.augment, draws["augment"]), torch.from_numpy(np.array(labels))


def plain_loss(output, labels, label_scale, total_scale, s):
    loss = ((output - labels / label_scale) ** 2).mean()
    if s.total_weight:
        error = ((output * label_scale - labels).sum((2, 3)) / total_scale.view(1, 3)).abs()
        square, corner = error**2, s.total_huber
        # Girshick's smooth L1: squared below the corner, linear above it, of one slope where they meet
        bent = torch.where(error < corner, square / (2 * corner), error - corner / 2) if corner else square
        loss = loss + s.total_weight * bent.mean()
    return loss


def as_used(net, shown, norm, s) -> torch.Tensor:
    """What a reader takes of a network: of one that learnt from mirrored images the mean with the rotated image."""
    with torch.inference_mode():
        found = net(network_input(tensor(shown), norm))
        if not s.mirrored_share:
            return found
        rotated = net(network_input(tensor(shown[:, ::-1, ::-1]), norm)).flip(2, 3)
        return (found + rotated * torch.tensor([-1.0, -1.0, 1.0]).view(1, 3, 1, 1)) / 2


def plain_run(data, s) -> tuple[list[dict], dict]:
    """The curve, and the weights of its best epoch, of a training written down from its description."""
    norm, rows = scales(data), data.splits["train"]
    label_scale, total_scale = (
        torch.tensor(norm["label"]).float().view(1, 3, 1, 1),
        torch.tensor(norm["total"]).float(),
    )
    net = initial_net(SMALL, IMAGE, GRID, s.seed).to(memory_format=torch.channels_last)
    optimiser = torch.optim.Adam(net.parameters())
    size = s.epoch_images or len(rows)
    passes = [torch.randperm(len(rows), generator=generator(s.seed, "order", k)).numpy() for k in range(EPOCHS)]
    order, sums, steps, curve, best = rows[np.concatenate(passes)], None, 0, [], (np.inf, None)
    for epoch in range(EPOCHS):
        for group in optimiser.param_groups:
            group["lr"] = s.learning_rate * (1 + np.cos(np.pi * epoch / EPOCHS)) / 2
        net.train()
        for layer in net.modules():
            if isinstance(layer, torch.nn.BatchNorm2d):
                layer.train(EPOCHS - epoch > s.frozen_share * EPOCHS)
        draws = {name: generator(s.seed, name, epoch) for name in ("augment", "shift", "mirror", "seat", "view")}
        losses, own = [], order[epoch * size : (epoch + 1) * size]
        for batch in (np.sort(own[at : at + s.batch]) for at in range(0, size, s.batch)):
            mirrored = epoch < s.mirrored_share * EPOCHS
            parts = [
                plain_batch(data, batch[at : at + PIECE], s, draws, mirrored) for at in range(0, len(batch), PIECE)
            ]
            shown, labels = (torch.cat(each) for each in zip(*parts))
            optimiser.zero_grad()
            loss = plain_loss(net(network_input(shown, norm)), labels, label_scale, total_scale, s)
            loss.backward()
            optimiser.step()
            losses.append(loss.item())
            if EPOCHS - epoch <= s.averaged_share * EPOCHS:
                weights = {name: value.detach().double() for name, value in net.named_parameters()}
                sums = weights if sums is None else {name: sums[name] + value for name, value in weights.items()}
                steps += 1
        kept = copy.deepcopy(net)
        if sums is not None:
            kept.load_state_dict({name: value / steps for name, value in sums.items()}, strict=False)
        judges = data.splits["val"]
        shown = data.seen(judges, True)
        at_rest = np.concatenate([shown[..., 3:]] * 2, axis=3)
        found = as_used(kept.eval(), shown, norm, s) - as_used(kept, at_rest, norm, s)
        found = found * label_scale
        errors = np.abs(found.double().sum((2, 3)).numpy() - data.labels[judges].sum((2, 3), dtype=float)).mean(0)
        score = float((errors / norm["total"]).mean())
        curve.append({"loss": np.mean(losses), "val_score": score} | {
            f"val_{name}": value for name, value in zip(CHANNELS, errors, strict=True)})  # fmt: skip
        if score < best[0]:
            best = score, kept.state_dict()
    return curve, best[1]


def numbers(curve: list[dict]) -> np.ndarray:
    return np.array(
        [[row[name] for name in ("loss", "val_score", *(f"val_{axis}" for axis in CHANNELS))] for row in curve]
    )


@pytest.fixture(scope="module")
def few(tmp_path_factory):
    """Twenty presses to train on, and some to choose the epoch by."""
    return open_data(write_dataset(tmp_path_factory.mktemp("golden") / "6x8", 40, IMAGE, GRID, seed=3))


@pytest.mark.parametrize("changes, varied", [(NONE, UNVARIED), (EVERY, VARIED)], ids=["plain", "every ingredient"])
def test_a_training_is_what_its_settings_say(few, changes, varied):
    settings = settings_of(changes, varied)
    found = train(few, "small", SMALL, settings)
    curve, weights = plain_run(few, settings)
    np.testing.assert_allclose(numbers(found.metadata["curve"]), numbers(curve), rtol=SAME)
    assert found.metadata["best_epoch"] == 1 + int(np.argmin([row["val_score"] for row in curve]))
    for name, value in found.net.state_dict().items():
        torch.testing.assert_close(value, weights[name], rtol=SAME, atol=SAME)


@pytest.mark.slow
def test_every_ingredient_is_seen_in_the_curve(few):
    """Or the law above could not fail without it: each alone, left out, changes the curve by more than its tolerance."""
    whole = numbers(plain_run(few, settings_of(EVERY, VARIED))[0])
    for name in (*EVERY, *UNVARIED):
        # weights are averaged only where the statistics are kept
        least = EVERY["averaged_share"] if name == "frozen_share" else NONE.get(name)
        less = {**EVERY, name: least} if name in EVERY else EVERY
        varied = {**VARIED, name: 0.0} if name in UNVARIED else VARIED
        other = numbers(plain_run(few, settings_of(less, varied))[0])
        assert np.abs(other / whole - 1).max() > 2 * SAME, name
