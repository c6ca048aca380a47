"""Training: its loss, its order, that it learns, goes on and is resumed."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gelforge.errors import BadInput
from gelforge.learning.batches import epoch_order, epoch_steps, images_to_tensor, prefetched, target, training_batches
from gelforge.learning.data import open_data, scales
from gelforge.learning.export import Exported
from gelforge.learning.nets import network_input
from gelforge.learning.predictions import predict_rows
from gelforge.learning.start import Start
from gelforge.learning.train import FRACTIONS, Training, between, fit, loss_of, training_epochs, validate
from gelforge.records.axes import CHANNELS
from gelforge.stages.train import resolve, train
from tests.support.parameters import parameters, with_values
from tests.support.refused import refused
from tests.support.small_networks import GRID, IMAGE, LEARNING, MODELS, SMALL
from tests.support.synthetic_presses import SETTINGS, write_dataset


def start_of(trained) -> Start:
    """A network to fine-tune."""
    return Start(trained.net, trained.metadata)


def test_total_force_loss_is_blind_to_where_the_force_is():
    expected = torch.zeros(1, 3, 2, 2)
    expected[0, :, 0, 0] = 1
    moved = expected.roll(1, 3)
    scale = torch.ones(3)
    off, square, linear = (
        replace(SETTINGS, total_weight=w, total_huber=h) for w, h in ((0.0, 0.0), (1.0, 0.0), (1.0, 0.1))
    )
    maps = torch.ones(1, dtype=torch.bool)
    only_cells = loss_of(moved, expected, maps, scale, scale, off)
    assert loss_of(moved, expected, maps, scale, scale, square) == only_cells == 0.5
    assert loss_of(moved, expected, maps, scale, scale, linear) == 0.5
    assert loss_of(2 * expected, expected, maps, scale, scale, square) == pytest.approx(0.25 + 1.0)
    # an error of one scale: one beyond the corner at 0.1, less half of it
    assert loss_of(2 * expected, expected, maps, scale, scale, linear) == pytest.approx(0.25 + 1.0 - 0.05)
    # where the total alone is known, no place is wrong
    assert loss_of(moved, expected, ~maps, scale, scale, square) == 0.0
    assert loss_of(2 * expected, expected, ~maps, scale, scale, square) == pytest.approx(1.0)


def test_epochs_that_share_a_pass_visit_every_press_once_in_it():
    """An epoch of all presses is a pass of its own; each pass has its own order, which the seed decides."""
    rows = np.arange(100, 140)
    for most in (0, 7, 39, 60):
        size = min(most or 40, 40)
        epochs = [epoch_order(rows, 1, epoch, most) for epoch in range(3 * 40 // size + 1)]
        assert {len(epoch) for epoch in epochs} == {size}
        seen = np.concatenate(epochs)
        passes = [list(seen[40 * number : 40 * (number + 1)]) for number in range(len(seen) // 40)]
        for number, each in enumerate(passes):
            assert sorted(each) == list(rows) and each == list(epoch_order(rows, 1, number))
        assert passes[0] != passes[1]


def test_reading_ahead_keeps_order_and_hands_on_errors():
    assert list(prefetched(iter(range(20)))) == list(range(20))

    def broken():
        yield 1
        raise BadInput("the second one is missing")

    refused("second", list, prefetched(broken()))


def test_batches_hold_the_pictures_of_an_epoch_each_beside_its_own_label(folder):
    data = open_data(folder)
    norm, rows = scales(data), data.splits["train"]
    for batch in (1, 7, 64):
        still = with_values(SETTINGS, batch=batch, shift_cells=0, augment={"probability": 0.0})
        batches = list(training_batches(data, norm, still, 3, True))
        assert [len(pictures) for pictures, _, _ in batches[:-1]] == [batch] * (epoch_steps(data, still) - 1)
        parts = np.split(epoch_order(rows, still.seed, 3), range(batch, len(rows), batch))
        order = np.concatenate([np.sort(part) for part in parts])
        expected = network_input(images_to_tensor(data.seen(order, True)), norm)
        assert torch.equal(torch.cat([pictures for pictures, _, _ in batches]), expected)
        assert torch.equal(torch.cat([labels for _, labels, _ in batches]), target(data.labels[order], norm))


def test_training_learns(folder, trained):
    data = open_data(folder)
    guess = np.abs(data.totals(data.splits["val"]) - np.median(data.totals(data.splits["train"]), axis=0)).mean(0)
    curve = trained.metadata["curve"]
    best = curve[trained.metadata["best_epoch"] - 1]
    # Forty epochs bring the loss on 48 small images to a tenth, whichever way rounding sends the weights; how well
    # unseen ones are read is another matter, but better than by guessing.
    assert curve[-1]["loss"] < 0.25 * curve[0]["loss"]
    rates = [row["learning_rate"] / LEARNING["learning_rate"] for row in curve]
    assert rates[0] == 1.0 and rates[-1] < 0.01 and rates == sorted(rates, reverse=True)
    assert best["val_total"] < guess.sum() and best["val_fy"] < guess[0]
    assert best["val_score"] == min(row["val_score"] for row in trained.metadata["curve"])


def test_shear_counts_as_much_as_normal_force_where_weights_are_chosen(folder, trained):
    """An error of a tenth of its own scale is the same step of the score, whichever component has it."""
    data, norm = open_data(folder), trained.metadata["normalisation"]
    plain = validate(Exported(trained.net, trained.metadata), data, 8, "cpu")
    expected = np.mean([plain[f"val_{name}"] / scale for name, scale in zip(CHANNELS, norm["total"], strict=True)])
    assert plain["val_score"] == pytest.approx(expected)


def test_same_seed_same_curve_other_seed_other_curve(few):
    curves = [
        train(few, "small", SMALL, with_values(SETTINGS, epochs=2, seed=n)).metadata["curve"] for n in (5, 5, 6)
    ]
    assert curves[0] == curves[1] != curves[2]


@pytest.mark.parametrize(
    "name, most, averaged", [("pair", 11, 0.8), pytest.param("unet", 0, 0.0, marks=pytest.mark.slow)]
)  # fmt: skip
def test_resumed_training_has_the_same_curve_and_weights(few, tmp_path, name, most, averaged):
    data, norm = few, scales(few)

    def start():
        settings = with_values(
            SETTINGS, epochs=5, mirrored_share=0.8, epoch_images=most, averaged_share=averaged,
            frozen_share=max(averaged, SETTINGS.frozen_share),
        )  # fmt: skip
        return Training(MODELS[name], settings, norm, IMAGE, GRID, "cpu")

    whole, cut, rest = start(), start(), start()
    fit(whole, data)
    fit(cut, data, tmp_path / "c.pt", "same", epochs=2)
    fit(rest, data, tmp_path / "c.pt", "same")
    assert rest.cost["resumed"] == 1 and rest.curve == whole.curve
    for a, b in zip(whole.net.state_dict().values(), rest.net.state_dict().values()):
        assert torch.equal(a, b)


def test_the_last_epochs_train_the_network_that_is_used(folder):
    """Frozen statistics stay, the weights go on; before, each epoch has its own."""
    data = open_data(folder)
    training = Training(SMALL, with_values(SETTINGS, epochs=4, frozen_share=0.4), scales(data), IMAGE, GRID, "cpu")
    seen = []
    for _ in training_epochs(training, data):
        state = training.net.state_dict()
        seen.append((state["stem_norm.running_mean"].clone(), state["stem.weight"].clone()))
    assert [torch.equal(a[0], b[0]) for a, b in zip(seen, seen[1:])] == [False, False, True]
    assert not any(torch.equal(a[1], b[1]) for a, b in zip(seen, seen[1:]))


def test_averaged_weights_are_the_mean_over_the_steps_of_the_last_epochs(folder):
    """The network that is validated and kept has them; the one that trains goes its own way."""
    data = open_data(folder)
    settings = with_values(SETTINGS, epochs=3, frozen_share=0.7, averaged_share=0.7, learning_rate=1e-2)
    training = Training(SMALL, settings, scales(data), IMAGE, GRID, "cpu")
    passed, step = [], training.optimiser.step

    def noting():
        step()
        passed.append((len(training.curve), training.net.state_dict()["stem.weight"].clone()))

    training.optimiser.step = noting
    for row in training_epochs(training, data):  # noqa: B007, the last one is looked at
        pass
    mean = torch.stack([weights for epoch, weights in passed if epoch >= 1]).mean(0)
    net = training.judged
    assert torch.allclose(net.state_dict()["stem.weight"], mean, atol=1e-6)
    assert not torch.allclose(training.net.state_dict()["stem.weight"], mean, atol=1e-4)
    assert torch.equal(
        net.state_dict()["stem_norm.running_mean"], training.net.state_dict()["stem_norm.running_mean"]
    )
    assert training.validated(net, data)["val_total"] == row["val_total"]


@pytest.fixture(scope="module")
def few(tmp_path_factory):
    """Twenty presses to train on, of the same law as `folder`."""
    return open_data(write_dataset(tmp_path_factory.mktemp("few") / "6x8", 40, IMAGE, GRID, seed=7))


def test_a_network_that_goes_on_begins_as_the_one_it_goes_on_from(few, trained):
    still = with_values(SETTINGS, epochs=1, learning_rate=1e-12, frozen_share=1.0)
    found = train(few, "tuned", SMALL, still, start=start_of(trained))
    norm, before = found.metadata["normalisation"], trained.metadata["normalisation"]
    assert all(norm[key] == before[key] for key in ("image_mean", "image_std", "label", "total"))
    rows = few.splits["test"]
    after, first = (predict_rows(one.model, few, rows).forces for one in (found, trained))
    assert np.allclose(after, first, atol=1e-4)
    assert found.metadata["start"]["name"] == "small" and "start" not in trained.metadata["model"]


def test_a_deeper_network_begins_as_the_one_it_goes_on_from(few, trained):
    deeper = {**SMALL, "blocks": SMALL["blocks"] + 2}
    spoilt = with_values(SETTINGS, epochs=1, learning_rate=1.0)
    # spoilt at once, so what it began as is kept
    begun = train(few, "deeper", deeper, spoilt, start=start_of(trained))
    rows, norm = few.splits["test"], trained.metadata["normalisation"]
    reported = [predict_rows(found.model, few, rows).forces for found in (begun, trained)]
    assert np.allclose(*reported, atol=1e-5)
    training = Training(deeper, SETTINGS, norm, IMAGE, GRID, "cpu")
    training.go_on_from(trained.net.state_dict(), few)
    last = training.net.late[-1].second_norm.weight
    assert not last.any()
    next(training_epochs(training, few))
    assert last.any()
    said = f"blocks = {SMALL['blocks']} here and {deeper['blocks']} in "
    refused(said, train, few, "shallower", SMALL, SETTINGS, start=start_of(begun))


def test_a_network_that_goes_on_never_ends_worse_than_it_began(few, trained):
    spoilt = with_values(SETTINGS, epochs=1, learning_rate=1.0)
    found = train(few, "tuned", SMALL, spoilt, start=start_of(trained))
    assert found.metadata["best_epoch"] == 0 < found.metadata["curve"][0]["val_total"]
    weights = trained.net.state_dict()
    assert all(torch.equal(value, weights[name]) for name, value in found.net.state_dict().items())


def test_weights_between_first_and_last_are_tried(few, trained):
    """They lie on the straight way from one to the other, and the finished network is what validation likes best of it."""
    settings = with_values(SETTINGS, epochs=3, learning_rate=2e-3, frozen_share=1.0)
    training = Training(SMALL, settings, trained.metadata["normalisation"], IMAGE, GRID, "cpu")
    training.go_on_from(trained.net.state_dict(), few)
    fit(training, few)
    first, last = training.start["weights"], training.best["weights"]
    judged = {}
    for fraction in (0.0, *FRACTIONS, 1.0):
        training.net.load_state_dict(between(first, last, fraction))
        judged[fraction] = training.validated(training.net, few)["val_score"]
    assert judged[0.0] == pytest.approx(training.start["val_score"])
    assert judged[1.0] == pytest.approx(training.best["val_score"])
    assert training.fraction == min(judged, key=lambda fraction: judged[fraction])
    assert training.best_epoch == (training.best["epoch"] if training.fraction else 0)
    middle = between(first, last, 0.5)
    assert all(
        torch.allclose(2 * value, first[name] + last[name], atol=1e-5)
        for name, value in middle.items()
        if value.is_floating_point()
    )


def test_few_presses_teach_more_to_a_network_that_goes_on(few, trained, tmp_path):
    alone = with_values(SETTINGS, **LEARNING | {"epochs": 20})
    further = with_values(alone, learning_rate=2e-4, frozen_share=1.0)
    others = open_data(write_dataset(tmp_path / "6x8", 64, IMAGE, GRID, seed=9))
    few = replace(few, splits=few.splits | {"train": few.splits["train"][:12]})
    rows, errors = np.arange(64), []
    for settings, start in ((further, start_of(trained)), (alone, None)):
        found = train(few, "tuned", SMALL, settings, start=start)
        reported = predict_rows(found.model, others, rows).forces.sum((2, 3), dtype=float)
        errors.append(np.abs(reported - others.totals(rows)).mean())
    assert errors[0] < 0.7 * errors[1]


def test_what_a_network_cannot_learn_from_or_go_on_from_is_refused(few, trained, folder, tmp_path):
    start, one = start_of(trained), with_values(SETTINGS, epochs=1)
    finer = open_data(write_dataset(tmp_path / "12x16", 16, IMAGE, (12, 16)))
    hardly = open_data(write_dataset(tmp_path / "6x8", 24, IMAGE, GRID))
    refused("width = 16 here and 8 in ", train, few, "tuned", {**SMALL, "width": 16}, SETTINGS, start=start)
    refused("grid", train, finer, "tuned", SMALL, SETTINGS, start=start)
    said = "validation has 3 of its presses; at least .* raise .params.dataset. validation"
    refused(said, train, hardly, "tuned", SMALL, SETTINGS, start=start)
    refused("only 'shipped'", resolve, {"tuned": {**SMALL, "start": "mine"}}, "tuned", parameters().train)
    alone = replace(open_data(folder), nocontact={})
    refused("nocontact/mini0.png", train, alone, "small", SMALL, one)


def test_a_corrupt_or_foreign_checkpoint_starts_the_training_over(folder, tmp_path, capsys):
    data, path = open_data(folder), tmp_path / "c.pt"

    def start():
        return Training(SMALL, with_values(SETTINGS, epochs=1), scales(data), IMAGE, GRID, "cpu")

    first = start()
    fit(first, data)
    first.save(path, "one")
    assert start().resume(path, "one") and not start().resume(path, "another training")
    whole = path.read_bytes()
    for corrupt in (whole[: len(whole) // 2], b"", b"no tensors at all"):
        path.write_bytes(corrupt)
        capsys.readouterr()
        assert not start().resume(path, "one")
        assert "starting over" in capsys.readouterr().out
