"""What training makes of pictures and labels before a network sees them."""

import numpy as np
import torch

from gelforge.flow.schema import altered
from gelforge.learning.augment import (
    RGB_TO_YIQ,
    augment,
    colour_matrices,
    mirror_together,
    misplace_nocontact,
    narrow_views,
    shift_together,
)
from tests.support.refused import refused
from tests.support.synthetic_presses import SETTINGS


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
    seen, target = shift_together(images, labels, 2, torch.Generator().manual_seed(1))
    assert np.abs(np.kron(target[:, 0], np.ones((4, 4))) * 30 + 120 - seen[..., 0]).max() < 1  # bytes
    np.testing.assert_allclose(target.sum((2, 3)), labels.sum((2, 3)), rtol=1e-5, atol=1e-5)
    moved = (seen != images).any((1, 2, 3))
    assert 0 < moved.sum() < 16
    said = "shift_cells = 1: cells of 7 x 8 on an image of 32 x 24"  # which are not of whole pixels
    refused(said, shift_together, images, np.zeros((1, 3, 7, 8)), 1, torch.Generator())


def test_a_mirrored_press_is_a_press():
    # Coordinates as forces point away from the middle, also in the mirror; heights as normal forces go with the image.
    v, u = np.meshgrid(np.arange(6) - 2.5, np.arange(8) - 3.5, indexing="ij")
    height = np.random.default_rng(0).integers(0, 256, (16, 6, 8)).astype("f4")
    labels = np.stack([np.stack([v, u, h]) for h in height]).astype("f4")
    images = np.repeat(np.kron(height, np.ones((4, 4)))[..., None], 3, -1).astype(np.uint8)
    before = images.copy(), labels.copy()
    seen, target = mirror_together(images, labels, torch.Generator().manual_seed(1))
    np.testing.assert_array_equal(target[:, :2], labels[:, :2])
    np.testing.assert_array_equal(seen[:, ::4, ::4, 0], target[:, 2])
    moved = (seen != images).any((1, 2, 3))
    assert 0 < moved.sum() < 16
    np.testing.assert_array_equal(images, before[0])  # the mapped file's own rows stay
    np.testing.assert_array_equal(labels, before[1])


def test_the_nocontact_image_is_coloured_as_its_image():
    image = 0.3 + 0.3 * torch.rand(4, 3, 8, 8, generator=torch.Generator().manual_seed(1))
    settings = altered(SETTINGS.augment, probability=1.0, noise=0.0, hue=0.02)
    changed = augment(torch.cat([image, image], 1), settings, torch.Generator().manual_seed(2))
    assert torch.equal(changed[:, :3], changed[:, 3:]) and not torch.equal(changed[:, :3], image)
    torch.testing.assert_close(changed[:, :3], augment(image, settings, torch.Generator().manual_seed(2)))
    noisy = augment(torch.cat([image, image], 1), altered(settings, noise=0.1), torch.Generator().manual_seed(2))
    assert not torch.equal(noisy[:, :3], noisy[:, 3:])


def test_a_misplaced_nocontact_image_leaves_the_image_alone():
    pairs, none = np.random.default_rng(0).integers(0, 255, (6, 24, 32, 6), np.uint8), np.zeros(6, bool)
    every = altered(SETTINGS.augment, misplaced_share=1.0)
    assert np.array_equal(misplace_nocontact(pairs, ~none, every, torch.Generator().manual_seed(1)), pairs)
    still = altered(SETTINGS.augment, misplaced_share=0.0)
    assert np.array_equal(misplace_nocontact(pairs, none, still, torch.Generator().manual_seed(1)), pairs)
    moved = misplace_nocontact(pairs, none, altered(still, misplaced_share=1.0), torch.Generator().manual_seed(1))
    assert np.array_equal(moved[..., :3], pairs[..., :3])
    assert all((one != other).any() for one, other in zip(moved[..., 3:], pairs[..., 3:], strict=True))
    aside = altered(still, misplaced_share=1.0, misplaced_px=2.0, misplaced_deg=0.0, misplaced_zoom=0.0)
    spot = np.zeros((40, 24, 32, 6), np.uint8)
    spot[:, 12, 16] = 255
    moved = misplace_nocontact(spot, np.zeros(40, bool), aside, torch.Generator().manual_seed(1))[..., 3].astype(
        float
    )
    v, u = np.mgrid[:24, :32]
    places = np.array([[(w * u).sum() / w.sum(), (w * v).sum() / w.sum()] for w in moved]) - [16, 12]
    assert np.abs(places).max() <= 2.01 and np.ptp(places, axis=0).min() > 3.0


def test_a_narrow_view_shows_no_force_and_no_difference_at_its_rim():
    rng = np.random.default_rng(0)
    pairs = rng.integers(0, 255, (30, 24, 32, 6), np.uint8)
    labels = rng.normal(size=(30, 3, 6, 8)).astype(np.float32)
    settings = altered(SETTINGS.augment, narrowed_share=1.0, narrowed=0.6)
    seen, target, chosen = narrow_views(
        pairs, labels, np.ones(len(pairs), bool), settings, torch.Generator().manual_seed(1)
    )
    hidden_cells = (target == 0).all(axis=1)
    assert 5 < hidden_cells.any(axis=(1, 2)).sum() <= 30
    assert chosen.all()
    for k in range(30):
        hidden_pixels = np.kron(hidden_cells[k], np.ones((4, 4), bool))
        assert np.array_equal(seen[k][~hidden_pixels], pairs[k][~hidden_pixels])
        assert (seen[k][hidden_pixels][:, :3] == seen[k][hidden_pixels][:, 3:]).all()
        assert np.array_equal(target[k][:, ~hidden_cells[k]], labels[k][:, ~hidden_cells[k]])
    none = narrow_views(
        pairs,
        labels,
        np.ones(len(pairs), bool),
        altered(settings, narrowed_share=0.0),
        torch.Generator().manual_seed(1),
    )
    assert np.array_equal(none[0], pairs) and np.array_equal(none[1], labels)


def test_augmentation_leaves_alone_what_it_must():
    images = torch.rand(6, 3, 8, 8, generator=torch.Generator().manual_seed(1))
    still = dict.fromkeys(("noise", "brightness", "contrast", "saturation", "hue"), 0.0)
    one = augment(images, altered(SETTINGS.augment, **still, probability=1.0), torch.Generator().manual_seed(2))
    torch.testing.assert_close(one, images, atol=1e-5, rtol=0)  # a matrix and its inverse in single precision
    none = augment(images, altered(SETTINGS.augment, probability=0.0), torch.Generator().manual_seed(2))
    assert torch.equal(none, images)
    changed = augment(images, altered(SETTINGS.augment, probability=1.0), torch.Generator().manual_seed(2))
    assert (changed != images).flatten(1).any(1).all() and changed.min() >= 0 and changed.max() <= 1


def test_colours_are_varied_as_the_paper_states(monkeypatch):
    """Brightness, then contrast about the mean luma of the image, then hue and saturation: one image by hand."""
    image = 0.35 + 0.2 * torch.rand(1, 3, 8, 8, generator=torch.Generator().manual_seed(1))
    for name, width in (("brightness", 0.2), ("contrast", 0.3), ("saturation", 0.4), ("hue", 0.05)):
        off = dict.fromkeys(("noise", "brightness", "contrast", "saturation", "hue"), 0.0) | {name: width}
        settings = altered(SETTINGS.augment, probability=1.0, **off)
        found = augment(image, settings, torch.Generator().manual_seed(3))[0].double()
        luma, before = (torch.einsum("c,chw->hw", RGB_TO_YIQ[0].double(), one) for one in (found, image[0].double()))
        if name == "brightness":
            factor = (found / image[0]).mean()
            torch.testing.assert_close(found, factor * image[0].double(), atol=1e-4, rtol=0)
        elif name == "contrast":
            assert abs(float(luma.mean() - before.mean())) < 1e-4  # which keeps its mean
            factor = float((luma - before.mean()).std() / (before - before.mean()).std())
            torch.testing.assert_close(
                found, before.mean() + factor * (image[0].double() - before.mean()), atol=1e-3, rtol=0
            )
        else:
            factor = 0.0
            torch.testing.assert_close(luma, before, atol=1e-3, rtol=0)  # chroma alone changes
        assert abs(float(factor) - 1.0) > 0.005 and (found - image[0]).abs().max() > 2e-3
