"""Networks: their shapes, their files, their training."""

import json
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from parameters import parameters, with_values
from synthetic_presses import SETTINGS, write_dataset

from gelforge.errors import BadInput
from gelforge.networks.augment import (
    RGB_TO_YIQ,
    augment,
    colour_matrices,
    mirror_together,
    misplace_untouched,
    narrow_views,
    shift_together,
)
from gelforge.networks.batches import Ahead, epoch_order
from gelforge.networks.data import open_data, scales
from gelforge.networks.inputs import network_input
from gelforge.networks.latency import predict_images
from gelforge.networks.modelfile import SensorNet, load_model, require_fit, save_model
from gelforge.networks.models import BasicBlock, ResNetTotal, UNet, build, parameter_count, strides
from gelforge.networks.training import Training, fit, loss_of, normalisations, predict_rows, resume, save_checkpoint
from gelforge.stages.train import resolve, train

SMALL = {"kind": "grid", "width": 8, "blocks": 1}
IMAGE, GRID = (48, 64), (6, 8)
LEARNING = {"epochs": 40, "learning_rate": 4e-3, "schedule": "cosine", "total_weight": 1.0}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_dataset(tmp_path_factory.mktemp("dataset") / "6x8", 96, IMAGE, GRID)


@pytest.fixture(scope="module")
def trained(folder):
    return train(open_data(folder), "small", SMALL, with_values(SETTINGS, **LEARNING))


def test_unet_is_the_papers():
    net = UNet((24, 32)).eval()
    seen = {}
    net.head.register_forward_hook(lambda module, inputs, output: seen.update(size=tuple(output.shape[2:])))
    with torch.inference_mode():
        assert net(torch.zeros(1, 3, 240, 320)).shape == (1, 3, 24, 32)
    # Four halvings and 18 unpadded convolutions of 240 x 320 by hand: 7 x 12 at the bottom, 52 x 132 at the top.
    assert seen["size"] == (52, 132)
    pairs = [(3, 16), (16, 32), (32, 64), (64, 128), (128, 256)]
    down = sum(9 * a * b + b + 9 * b * b + b for a, b in pairs)
    up = sum(4 * a * b + b + 9 * a * b + b + 9 * b * b + b for b, a in pairs[1:])
    assert parameter_count(net) == down + up + 16 * 3 + 3


def test_resnet34_has_its_known_size():
    # ResNet-34 has 21 797 672 values with its 513 000 of 1000 classes; ours ends in three outputs.
    assert parameter_count(ResNetTotal()) == 21_797_672 - 513_000 + 512 * 3 + 3


@pytest.mark.parametrize("grid", [(12, 16), (24, 32), (48, 64), (30, 40)])
def test_grid_net_writes_any_grid_that_divides_the_image(grid):
    with torch.inference_mode():
        assert build(SMALL, (240, 320), grid).eval()(torch.zeros(1, 3, 240, 320)).shape == (1, 3, *grid)


def test_a_thinned_shortcut_is_the_strided_convolution():
    block, x = BasicBlock(6, 10, stride=2).eval(), torch.randn(3, 6, 11, 14)
    convolution, norm = block.shortcut
    strided = norm(torch.nn.functional.conv2d(x, convolution.weight, stride=2))
    rest = torch.relu(block.first_norm(block.first(x)))
    wanted = torch.relu(block.second_norm(block.second(rest)) + strided)
    torch.testing.assert_close(block(x), wanted, rtol=1e-5, atol=1e-6)


NARROW = """
import torch
from gelforge.networks.models import BasicBlock

for before in (3, 4, 8):
    block = BasicBlock(before, 2 * before, stride=2).to(memory_format=torch.channels_last)
    for step in range(40):
        x = torch.randn(8, before, 48, 64).to(memory_format=torch.channels_last).requires_grad_()
        block(x).square().sum().backward()
        beside = [torch.randn(7, step + 1) for _ in range(5)]
"""


def test_narrow_networks_train_without_corrupting_memory():
    ran = subprocess.run([sys.executable, "-c", NARROW], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr[-500:]


def test_every_network_of_the_table_builds(root):
    from gelforge.flow.params import read_toml

    models = read_toml(root / "workflow" / "models.toml")
    settings = parameters().train
    assert len(models) >= 10
    for name in models:
        model, own = resolve(models, name, settings)
        assert build(model, (240, 320), (24, 32)) is not None
        assert own.epochs == settings.epochs


def test_a_kind_may_get_epochs_of_its_own():
    settings = parameters(train={"epochs_of": {"resnet": 7}}).train
    assert resolve({"small": SMALL}, "small", settings)[1].epochs == settings.epochs
    assert resolve({"total": {"kind": "resnet"}}, "total", settings)[1].epochs == 7
    assert resolve({"total": {"kind": "resnet", "train": {"epochs": 9}}}, "total", settings)[1].epochs == 9


@pytest.mark.parametrize("image, grid", [((240, 320), (7, 9)), ((240, 320), (24, 24)), ((24, 32), (24, 32))])
def test_grid_net_refuses_cells_of_uneven_size(image, grid):
    with pytest.raises(BadInput, match="a light net: "):
        strides(image, grid)


def test_unknown_kind_and_wrong_size_are_named():
    with pytest.raises(BadInput, match="transformer"):
        build({"kind": "transformer"}, IMAGE, GRID)
    with pytest.raises(BadInput, match="depth"):
        build({"kind": "grid", "depth": 3}, IMAGE, GRID)
    with pytest.raises(BadInput, match="MODEL=nothing"):
        resolve({"grid": SMALL}, "nothing", parameters().train)
    with pytest.raises(BadInput, match=r"models.toml: \[grid.train\] epoch: is read by nothing; epochs is meant"):
        resolve({"grid": {**SMALL, "train": {"epoch": 3}}}, "grid", parameters().train)


def test_colours_keep_luma_and_grey():
    draw = torch.Generator().manual_seed(0)
    matrices = colour_matrices(1 + torch.rand(20, generator=draw), torch.rand(20, generator=draw))
    grey = matrices @ torch.ones(3)
    # Chroma is turned and scaled about the grey axis; the YIQ matrix is given to four digits.
    torch.testing.assert_close(grey, torch.ones(20, 3), atol=1e-3, rtol=0)
    colour = torch.tensor([0.2, 0.5, 0.3])
    torch.testing.assert_close((matrices @ colour) @ RGB_TO_YIQ[0], (colour @ RGB_TO_YIQ[0]).expand(20))


def test_a_shift_moves_image_and_label_alike_and_loses_nothing():
    rng = np.random.default_rng(0)
    images, labels = rng.integers(0, 256, (16, 24, 32, 3), np.uint8), rng.normal(size=(16, 3, 6, 8)).astype("f4")
    # pictures of the labels: each cell shows its own force
    images[..., 0] = np.kron(labels[:, 0], np.ones((4, 4))) * 30 + 120
    seen, wanted = shift_together(images, labels, 2, torch.Generator().manual_seed(1))
    assert np.abs(np.kron(wanted[:, 0], np.ones((4, 4))) * 30 + 120 - seen[..., 0]).max() < 1  # bytes
    np.testing.assert_allclose(wanted.sum((2, 3)), labels.sum((2, 3)), rtol=1e-5, atol=1e-5)
    moved = (seen != images).any((1, 2, 3))
    assert 0 < moved.sum() < 16


def test_a_mirrored_press_is_a_press():
    # Coordinates as forces point away from the middle, also in the mirror; heights as normal forces go with the image.
    v, u = np.meshgrid(np.arange(6) - 2.5, np.arange(8) - 3.5, indexing="ij")
    height = np.random.default_rng(0).integers(0, 256, (16, 6, 8)).astype("f4")
    labels = np.stack([np.stack([u, v, h]) for h in height]).astype("f4")
    images = np.repeat(np.kron(height, np.ones((4, 4)))[..., None], 3, -1).astype(np.uint8)
    before = images.copy(), labels.copy()
    seen, wanted = mirror_together(images, labels, torch.Generator().manual_seed(1))
    np.testing.assert_array_equal(wanted[:, :2], labels[:, :2])
    np.testing.assert_array_equal(seen[:, ::4, ::4, 0], wanted[:, 2])
    moved = (seen != images).any((1, 2, 3))
    assert 0 < moved.sum() < 16
    np.testing.assert_array_equal(images, before[0])  # the mapped file's own rows stay
    np.testing.assert_array_equal(labels, before[1])


def test_a_shift_needs_cells_of_whole_pixels():
    with pytest.raises(BadInput, match="shift_cells = 1: cells of 7 x 8 on an image of 24 x 32"):
        shift_together(np.zeros((1, 24, 32, 3), np.uint8), np.zeros((1, 3, 7, 8)), 1, torch.Generator())


def test_the_untouched_sensor_is_coloured_as_its_image():
    image = 0.3 + 0.3 * torch.rand(4, 3, 8, 8, generator=torch.Generator().manual_seed(1))
    settings = replace(SETTINGS.augment, probability=1.0, noise=0.0, hue=0.02)
    changed = augment(torch.cat([image, image], 1), settings, torch.Generator().manual_seed(2))
    assert torch.equal(changed[:, :3], changed[:, 3:]) and not torch.equal(changed[:, :3], image)
    torch.testing.assert_close(changed[:, :3], augment(image, settings, torch.Generator().manual_seed(2)))
    noisy = augment(torch.cat([image, image], 1), replace(settings, noise=0.1), torch.Generator().manual_seed(2))
    assert not torch.equal(noisy[:, :3], noisy[:, 3:])


def test_a_misplaced_untouched_picture_leaves_the_image_alone():
    pairs, none = np.random.default_rng(0).integers(0, 255, (6, 24, 32, 6), np.uint8), np.zeros(6, bool)
    every = replace(SETTINGS.augment, misplaced_share=1.0)
    assert np.array_equal(misplace_untouched(pairs, ~none, every, torch.Generator().manual_seed(1)), pairs)
    still = replace(SETTINGS.augment, misplaced_share=0.0)
    assert np.array_equal(misplace_untouched(pairs, none, still, torch.Generator().manual_seed(1)), pairs)
    moved = misplace_untouched(pairs, none, replace(still, misplaced_share=1.0), torch.Generator().manual_seed(1))
    assert np.array_equal(moved[..., :3], pairs[..., :3])
    assert all((one != other).any() for one, other in zip(moved[..., 3:], pairs[..., 3:], strict=True))
    aside = replace(still, misplaced_share=1.0, misplaced_px=2.0, misplaced_deg=0.0, misplaced_zoom=0.0)
    dot = np.zeros((40, 24, 32, 6), np.uint8)
    dot[:, 12, 16] = 255
    moved = misplace_untouched(dot, np.zeros(40, bool), aside, torch.Generator().manual_seed(1))[..., 3].astype(float)
    v, u = np.mgrid[:24, :32]
    places = np.array([[(w * u).sum() / w.sum(), (w * v).sum() / w.sum()] for w in moved]) - [16, 12]
    assert np.abs(places).max() <= 2.01 and np.ptp(places, axis=0).min() > 3.0


def test_a_narrow_view_shows_no_force_and_no_difference_at_its_rim():
    rng = np.random.default_rng(0)
    pairs = rng.integers(0, 255, (30, 24, 32, 6), np.uint8)
    labels = rng.normal(size=(30, 3, 6, 8)).astype(np.float32)
    settings = replace(SETTINGS.augment, narrowed_share=1.0, narrowed=0.6)
    seen, wanted, chosen = narrow_views(pairs, labels, settings, torch.Generator().manual_seed(1))
    hidden_cells = (wanted == 0).all(axis=1)
    assert 5 < hidden_cells.any(axis=(1, 2)).sum() <= 30
    assert chosen.all()
    for k in range(30):
        hidden_pixels = np.kron(hidden_cells[k], np.ones((4, 4), bool))
        assert np.array_equal(seen[k][~hidden_pixels], pairs[k][~hidden_pixels])
        assert (seen[k][hidden_pixels][:, :3] == seen[k][hidden_pixels][:, 3:]).all()
        assert np.array_equal(wanted[k][:, ~hidden_cells[k]], labels[k][:, ~hidden_cells[k]])
    none = narrow_views(pairs, labels, replace(settings, narrowed_share=0.0), torch.Generator().manual_seed(1))
    assert np.array_equal(none[0], pairs) and np.array_equal(none[1], labels)


def test_augmentation_leaves_alone_what_it_must():
    images = torch.rand(6, 3, 8, 8, generator=torch.Generator().manual_seed(1))
    still = dict.fromkeys(("noise", "brightness", "contrast", "saturation", "hue"), 0.0)
    one = augment(images, replace(SETTINGS.augment, **still, probability=1.0), torch.Generator().manual_seed(2))
    torch.testing.assert_close(one, images, atol=1e-5, rtol=0)  # a matrix and its inverse in single precision
    none = augment(images, replace(SETTINGS.augment, probability=0.0), torch.Generator().manual_seed(2))
    assert torch.equal(none, images)
    changed = augment(images, replace(SETTINGS.augment, probability=1.0), torch.Generator().manual_seed(2))
    assert (changed != images).flatten(1).any(1).all() and changed.min() >= 0 and changed.max() <= 1


def test_total_force_loss_is_blind_to_where_the_force_is():
    wanted = torch.zeros(1, 3, 2, 2)
    wanted[0, :, 0, 0] = 1
    moved = wanted.roll(1, 3)
    scale = torch.ones(3)
    off, square, linear = (
        replace(SETTINGS, total_weight=w, total_huber=h) for w, h in ((0.0, 0.0), (1.0, 0.0), (1.0, 0.1))
    )
    only_cells = loss_of(moved, wanted, scale, scale, off)
    assert loss_of(moved, wanted, scale, scale, square) == only_cells == 0.5
    assert loss_of(moved, wanted, scale, scale, linear) == 0.5
    assert loss_of(2 * wanted, wanted, scale, scale, square) == pytest.approx(0.25 + 1.0)
    # an error of one scale: one beyond the corner at 0.1, less half of it
    assert loss_of(2 * wanted, wanted, scale, scale, linear) == pytest.approx(0.25 + 1.0 - 0.05)


def test_epochs_visit_every_press_once_in_their_own_order():
    rows = np.arange(100, 140)
    first, second = epoch_order(rows, 1, 0), epoch_order(rows, 1, 1)
    assert sorted(first) == sorted(second) == list(rows)
    assert list(first) != list(second) and list(first) == list(epoch_order(rows, 1, 0))


def test_reading_ahead_keeps_order_and_hands_on_errors():
    assert list(Ahead(iter(range(20)))) == list(range(20))

    def broken():
        yield 1
        raise BadInput("the second one is missing")

    with pytest.raises(BadInput, match="second"):
        list(Ahead(broken()))


def test_training_learns(folder, trained):
    data = open_data(folder)
    guess = np.abs(data.totals(data.splits["val"]) - np.median(data.totals(data.splits["train"]), axis=0)).mean(0)
    curve = trained.about["curve"]
    best = curve[trained.about["best_epoch"] - 1]
    # Forty epochs bring the loss on 48 small images to a tenth, whichever way rounding sends the weights; how well
    # unseen ones are read is another matter, but better than by guessing.
    assert curve[-1]["loss"] < 0.25 * curve[0]["loss"]
    assert best["val_total"] < guess.sum() and best["val_grid_x"] < guess[0]
    assert best["val_total"] == min(row["val_total"] for row in trained.about["curve"])


def test_same_seed_same_curve_other_seed_other_curve(folder):
    data = open_data(folder)
    curves = [
        train(data, "small", SMALL, with_values(SETTINGS, epochs=2, seed=seed)).about["curve"] for seed in (5, 5, 6)
    ]
    assert curves[0] == curves[1] != curves[2]


@pytest.mark.parametrize(
    "kind, schedule", [("grid", "cosine"), ("grid", "plateau"), ("unet", "plateau"), ("resnet", "plateau")]
)
def test_resumed_training_has_the_same_curve_and_weights(folder, tmp_path, kind, schedule):
    model = {
        "grid": SMALL,
        "unet": {"kind": "unet", "widths": [4, 8]},
        "resnet": {"kind": "resnet", "blocks": [1, 1], "widths": [4, 8]},
    }[kind]
    data = open_data(folder)
    norm = scales(data, kind == "resnet")
    grid = (1, 1) if kind == "resnet" else GRID

    def start():
        settings = with_values(SETTINGS, epochs=5, schedule=schedule, mirrored_share=0.8)
        return Training(model, settings, norm, IMAGE, grid, "cpu")

    whole, cut, rest = start(), start(), start()
    fit(whole, data)
    fit(cut, data, tmp_path / "c.pt", "same", epochs=2)
    fit(rest, data, tmp_path / "c.pt", "same")
    assert rest.cost["resumed"] == 1 and rest.curve == whole.curve
    for a, b in zip(whole.net.state_dict().values(), rest.net.state_dict().values()):
        assert torch.equal(a, b)


@pytest.mark.parametrize("share", [0.5, 0.4])
def test_the_last_epochs_train_the_network_that_is_used(folder, share, monkeypatch):
    """Frozen statistics stay, the weights go on; before, each epoch has its own."""
    data = open_data(folder)
    settings = with_values(SETTINGS, epochs=4, frozen_share=share)
    frozen = [False, False, True, True] if share == 0.5 else [False, False, False, True]
    settled = []
    monkeypatch.setattr(
        "gelforge.networks.training.settle_batch_norm", lambda net, *_: settled.append(training.epochs_done)
    )
    training = Training(SMALL, settings, scales(data, False), IMAGE, GRID, "cpu")
    seen = []
    for _ in range(4):
        training.close_epoch(data, training.train_epoch(training.batches(data)))
        state = training.net.state_dict()
        seen.append((state["stem_norm.running_mean"].clone(), state["stem.weight"].clone()))
    assert [torch.equal(a[0], b[0]) for a, b in zip(seen, seen[1:])] == frozen[1:]
    assert settled == [epoch + 1 for epoch in range(4) if not frozen[epoch]]
    assert not any(torch.equal(a[1], b[1]) for a, b in zip(seen, seen[1:]))


@pytest.fixture(scope="module")
def few(tmp_path_factory):
    """Twelve presses to train on, of the same law as `folder`."""
    return open_data(write_dataset(tmp_path_factory.mktemp("few") / "6x8", 24, IMAGE, GRID, seed=7))


def test_a_network_that_goes_on_begins_as_the_one_it_goes_on_from(few, trained):
    still = with_values(SETTINGS, epochs=1, learning_rate=1e-12, frozen_share=1.0, least_rate=0.0)
    found = train(few, "tuned", SMALL, still, start=trained)
    norm, before = found.about["normalisation"], trained.about["normalisation"]
    assert all(norm[key] == before[key] for key in ("image_mean", "image_std", "label", "total"))
    rows = few.splits["test"]
    assert np.allclose(
        predict_rows(found.net, few, rows, norm), predict_rows(trained.net, few, rows, before), atol=1e-4
    )
    assert found.about["start"]["name"] == "small" and "start" not in trained.about["model"]


def test_a_network_that_goes_on_never_ends_worse_than_it_began(few, trained):
    spoilt = with_values(SETTINGS, epochs=1, learning_rate=1.0, schedule="cosine")
    found = train(few, "tuned", SMALL, spoilt, start=trained)
    assert found.about["best_epoch"] == 0 < found.about["curve"][0]["val_total"]
    weights = trained.net.state_dict()
    assert all(torch.equal(value, weights[name]) for name, value in found.net.state_dict().items())


def test_few_presses_teach_more_to_a_network_that_goes_on(few, trained, tmp_path):
    alone = with_values(SETTINGS, **LEARNING)
    further = with_values(alone, learning_rate=2e-4, frozen_share=1.0)
    others = open_data(write_dataset(tmp_path / "6x8", 96, IMAGE, GRID, seed=9))
    rows, errors = np.arange(96), []
    for settings, start in ((further, trained), (alone, None)):
        found = train(few, "tuned", SMALL, settings, start=start)
        told = predict_rows(found.net, others, rows, found.about["normalisation"]).sum((2, 3), dtype=float)
        errors.append(np.abs(told - others.totals(rows)).mean())
    assert errors[0] < 0.7 * errors[1]


def test_a_network_goes_on_from_one_of_its_own_kind_only(few, trained, folder, tmp_path):
    with pytest.raises(BadInput, match="width = 16, there 8"):
        train(few, "tuned", {**SMALL, "width": 16}, SETTINGS, start=trained)
    finer = open_data(write_dataset(tmp_path / "12x16", 16, IMAGE, (12, 16)))
    with pytest.raises(BadInput, match="grid"):
        train(finer, "tuned", SMALL, SETTINGS, start=trained)
    with pytest.raises(BadInput, match="only 'shipped'"):
        resolve({"tuned": {**SMALL, "start": "mine"}}, "tuned", parameters().train)


def test_checkpoint_of_another_training_is_not_used(folder, tmp_path):
    data = open_data(folder)
    for name in ("one", "other"):
        training = Training(SMALL, with_values(SETTINGS, epochs=1), scales(data, False), IMAGE, GRID, "cpu")
        fit(training, data, tmp_path / "c.pt", name)
        assert training.cost["resumed"] == 0


def test_model_file_round_trip(trained, tmp_path):
    save_model(tmp_path / "m.pt", trained)
    again = load_model(tmp_path / "m.pt")
    digest = again.about.pop("sha256")
    assert len(digest) == 64 and again.about == json.loads(json.dumps({"format": 2} | trained.about))
    x = torch.rand(2, 3, *IMAGE, generator=torch.Generator().manual_seed(0)) * 255
    with torch.inference_mode():
        assert torch.equal(SensorNet(again)(x), SensorNet(trained)(x))


def test_model_file_keeps_the_untouched_sensors(folder, tmp_path):
    data = open_data(folder)
    pair = train(data, "pair", {**SMALL, "reads": "pair"}, with_values(SETTINGS, epochs=1))
    save_model(tmp_path / "m.pt", pair)
    again = load_model(tmp_path / "m.pt")
    assert again.untouched.keys() == {"mini0"}
    np.testing.assert_array_equal(again.untouched["mini0"], data.nocontact["mini0"])
    content = torch.load(tmp_path / "m.pt", weights_only=True)
    torch.save(content | {"untouched": {"mini0": torch.zeros(9, dtype=torch.uint8)}}, tmp_path / "m.pt")
    with pytest.raises(BadInput, match="untouched mini0: cannot be read as an image"):
        load_model(tmp_path / "m.pt")


@pytest.mark.parametrize("reads", ["image", "difference", "pair"])
@pytest.mark.parametrize(
    "model",
    [
        SMALL,
        {"kind": "unet", "widths": [4, 8]},
        {"kind": "unet_single", "widths": [2, 4]},
        {"kind": "resnet", "blocks": [1, 1], "widths": [4, 8]},
    ],
    ids=lambda model: model["kind"],
)
def test_a_reader_is_the_network_it_was_trained_as(folder, model, reads):
    data = open_data(folder)
    rows = data.splits["test"]
    trained = train(data, reads, {**model, "reads": reads}, with_values(SETTINGS, epochs=1))
    wanted = predict_rows(trained.net, data, rows, trained.about["normalisation"])
    reader = SensorNet(trained, data.nocontact["mini0"]).eval()
    assert not normalisations(reader)  # in the convolutions before them
    got = predict_images(reader, data.seen(rows, reads)[..., :3])  # under the light of the untouched picture
    np.testing.assert_allclose(got, wanted, atol=1e-5 * np.abs(wanted).max())


def test_differences_forget_the_picture_they_are_taken_from():
    pictures = torch.rand(2, 6, 4, 4, generator=torch.Generator().manual_seed(0))
    brighter = pictures + torch.rand(2, 3, 4, 4, generator=torch.Generator().manual_seed(1)).repeat(1, 2, 1, 1)
    norm = {"image_mean": [0.3, 0.4, 0.5], "image_std": [0.1, 0.2, 0.3], "reads": "difference"}
    torch.testing.assert_close(network_input(pictures, norm), network_input(brighter, norm))
    both = network_input(pictures, norm | {"reads": "pair"})
    torch.testing.assert_close(both[:, 3:], network_input(pictures, norm))
    torch.testing.assert_close(both[:, :3], network_input(pictures[:, :3], norm | {"reads": "image"}))
    with pytest.raises(BadInput, match="reads = 'sound'"):
        build({**SMALL, "reads": "sound"}, IMAGE, GRID)


def test_a_dataset_without_the_untouched_sensor_is_named(folder):
    data = replace(open_data(folder), nocontact={})
    with pytest.raises(BadInput, match="nocontact/mini0.png"):
        train(data, "pair", {**SMALL, "reads": "pair"}, with_values(SETTINGS, epochs=1))


def test_damaged_and_foreign_model_files_are_refused(trained, tmp_path):
    path = tmp_path / "m.pt"
    save_model(path, trained)
    whole = path.read_bytes()
    for content in (whole[: len(whole) // 2], b"", b"no model"):
        path.write_bytes(content)
        with pytest.raises(BadInput, match="m.pt"):
            load_model(path)
    torch.save({"weights": torch.zeros(2)}, path)
    with pytest.raises(BadInput, match="not a gelforge model"):
        load_model(path)
    about = json.dumps({"format": 2} | trained.about)
    torch.save({"about": about, "tensors": {"a": torch.zeros(2)}, "untouched": {}}, path)
    with pytest.raises(BadInput, match="do not fit"):
        load_model(path)
    with pytest.raises(BadInput, match="no such model"):
        load_model(tmp_path / "absent.pt")


class WritesWhenLoaded:
    """A pickle of this object writes a file as it is loaded."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.write_text, (self.path, "executed")


def test_code_in_a_model_file_is_never_run(tmp_path):
    mark = tmp_path / "mark"
    pickle.loads(pickle.dumps(WritesWhenLoaded(mark)))
    assert mark.exists(), "the trap must work for the test to mean something"
    mark.unlink()
    torch.save(WritesWhenLoaded(mark), tmp_path / "m.pt")
    with pytest.raises(BadInput, match="never run"):
        load_model(tmp_path / "m.pt")
    assert not mark.exists()


def test_model_of_another_sensor_grid_or_size_is_refused(folder, trained):
    data = open_data(folder)
    require_fit(trained, data)
    for key, value, word in (
        ("known_sensors", ["digit"], "digit"),
        ("grid", [5, 5], "grid"),
        ("image", [10, 10], "images"),
    ):
        other = type(trained)(trained.net, trained.about | {key: value})
        with pytest.raises(BadInput, match=word):
            require_fit(other, data)


@pytest.mark.parametrize("damage", [lambda b: b[: len(b) // 2], lambda b: b"", lambda b: b"no tensors at all"])
def test_a_damaged_checkpoint_starts_the_training_over(folder, tmp_path, damage, capsys):
    data, path = open_data(folder), tmp_path / "c.pt"
    first = Training(SMALL, with_values(SETTINGS, epochs=1), scales(data, False), IMAGE, GRID, "cpu")
    fit(first, data, None, "one")
    save_checkpoint(path, first, "one")
    path.write_bytes(damage(path.read_bytes()))
    again = Training(SMALL, with_values(SETTINGS, epochs=1), scales(data, False), IMAGE, GRID, "cpu")
    assert not resume(path, again, "one")
    assert "starting over" in capsys.readouterr().out


def test_a_changed_weight_is_noticed(trained, tmp_path):
    """One bit of one weight: still a file of tensors that fit, but not the network that was trained."""
    path = tmp_path / "m.pt"
    save_model(path, trained)
    content = torch.load(path, weights_only=True)
    name = max(content["tensors"], key=lambda name: content["tensors"][name].numel())
    content["tensors"][name].view(-1)[0] += 1e-3
    torch.save(content, path)
    with pytest.raises(BadInput, match="weights are not those that were trained"):
        load_model(path)
