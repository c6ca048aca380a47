"""Augmentation: colour and noise of images, shifts, mirrors and crops of image and label together."""

import math

import numpy as np
import torch

from gelforge.flow.tables import AugmentTable
from gelforge.learning.nets import cell_pixels, inner_part, map_grid

# Luma and the two chroma axes of YIQ (NTSC 1953): hue rotates the chroma plane, saturation scales it.
RGB_TO_YIQ = torch.tensor([[0.299, 0.587, 0.114], [0.5959, -0.2746, -0.3213], [0.2115, -0.5227, 0.3112]])
YIQ_TO_RGB = torch.linalg.inv(RGB_TO_YIQ)


def uniform(n: int, half_width: float, generator):
    """Draw `n` values in +-`half_width`."""
    return (2 * torch.rand(n, generator=generator) - 1) * half_width


def colour_matrices(saturation, hue_turns):
    """RGB matrices (n, 3, 3) that scale chroma by `saturation` (n,) and rotate it by `hue_turns` (n,) of a circle."""
    angle = 2 * math.pi * hue_turns
    turn = torch.zeros(len(angle), 3, 3)
    turn[:, 0, 0] = 1
    turn[:, 1, 1] = turn[:, 2, 2] = saturation * torch.cos(angle)
    turn[:, 2, 1] = saturation * torch.sin(angle)
    turn[:, 1, 2] = -turn[:, 2, 1]
    return YIQ_TO_RGB @ turn @ RGB_TO_YIQ


def augment(images, settings: AugmentTable, generator):
    """Vary noise, brightness, contrast, saturation and hue of a random fraction of the images (n, 3, h, w) in 0..1.

    The order is the paper's; all but the noise is linear in RGB, so factors, an offset and a matrix per image
    suffice. `settings` holds probability, noise (standard deviation), brightness, contrast, saturation (half widths
    around 1) and hue (half width in turns). In pairs (n, 6, h, w) the last three channels are the no-contact image:
    its colours vary like the image's, and it gets no noise.
    """
    n = len(images)
    chosen = torch.rand(n, generator=generator) < settings.probability
    brightness, contrast, saturation = (
        1 + uniform(n, width, generator) for width in (settings.brightness, settings.contrast, settings.saturation)
    )
    matrices = colour_matrices(saturation, uniform(n, settings.hue, generator))
    where = torch.nonzero(chosen).flatten()
    if len(where) == 0:
        return images
    part = images[where].unflatten(1, (-1, 3))
    noise = torch.empty_like(part[:, 0]).normal_(0, 1, generator=generator).mul_(settings.noise)
    part[:, 0] += noise
    part.mul_(brightness[where, None, None, None, None])
    luma = torch.einsum("c,nchw->n", RGB_TO_YIQ[0], part[:, 0]) / (part.shape[3] * part.shape[4])
    factor = contrast[where, None, None, None, None]
    part = part.mul_(factor).add_((1 - factor) * luma[:, None, None, None, None])
    turned = (matrices[where, None] @ part.flatten(3)).view_as(part)
    images = images.clone()
    images[where] = turned.clamp_(0, 1).flatten(1, 2)
    return images


def shift_together(images, labels, cells: int, generator) -> tuple[np.ndarray, np.ndarray]:
    """Shift each image (n, h, w, channels) with its label (n, 3, rows, cols) by up to `cells` cells along both axes.

    Shifts are periodic, so that no force is lost: what leaves on one side enters on the other, in image and label.
    With probability 1/2 an image stays; otherwise its shift is uniform.
    """
    image = images.shape[1:3]
    pixels = cell_pixels(image, map_grid(image, labels.shape[2:]), f"[train] shift_cells = {cells}")
    by = torch.randint(-cells, cells + 1, (len(images), 2), generator=generator)
    by[torch.rand(len(images), generator=generator) < 0.5] = 0
    moved = zip(images, labels, by.tolist(), strict=True)
    pairs = [(np.roll(image, (pixels * v, pixels * u), (0, 1)), np.roll(label, (v, u), (1, 2)))
             for image, label, (v, u) in moved]  # fmt: skip
    return np.stack([image for image, _ in pairs]), np.stack([label for _, label in pairs])


def misplace_nocontact(pairs: np.ndarray, narrow: np.ndarray, settings: AugmentTable, generator) -> np.ndarray:
    """Shift, rotate and zoom the no-contact image of a fraction of the pairs (n, h, w, 6) uint8.

    The gel then seems mounted differently. Markers near the gel's clamped rim do not move under force, so they show
    the network the misplacement. narrow: (n,) bool, pairs that are left as they are: without the rim in view, a
    common motion of markers means shear.
    """
    import cv2

    pairs, (h, w) = np.array(pairs), pairs.shape[1:3]
    chosen = (torch.rand(len(pairs), generator=generator) < settings.misplaced_share) & ~torch.from_numpy(narrow)
    drawn = torch.stack([uniform(len(pairs), width, generator) for width in (
        settings.misplaced_px, settings.misplaced_px, settings.misplaced_deg, settings.misplaced_zoom)], 1)  # fmt: skip
    for k in torch.nonzero(chosen).flatten().tolist():
        right, down, turn, zoom = drawn[k].tolist()
        move = cv2.getRotationMatrix2D((w / 2, h / 2), turn, 1.0 + zoom)
        move[:, 2] += right, down
        behind = np.ascontiguousarray(pairs[k, ..., 3:])
        pairs[k, ..., 3:] = cv2.warpAffine(behind, move, (w, h), borderMode=cv2.BORDER_REPLICATE)
    return pairs


def narrow_views(
    pairs, labels, maps: np.ndarray, settings: AugmentTable, generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Hide the rim of a fraction of the pairs (n, h, w, 6) uint8 and of their labels (n, 3, rows, cols), up to `narrowed`.

    Returns both and which were chosen, (n,) bool. Images of a camera that sees less of the gel look like this at the
    scale of the others: a margin of uniform colour, in which no force is read. Wide margins are drawn more often than
    narrow ones, because they hide the markers that a network would rely on. Only pairs whose label is a map, maps
    (n,) bool, are chosen: otherwise the hidden force is unknown.
    """
    pairs, labels = np.array(pairs), np.array(labels)
    chosen = (torch.rand(len(pairs), generator=generator) < settings.narrowed_share) & torch.from_numpy(maps)
    fractions = torch.sqrt(torch.rand(len(pairs), generator=generator)) * settings.narrowed
    for k in torch.nonzero(chosen).flatten().tolist():
        pixels, inner = inner_part(
            float(fractions[k]), pairs.shape[1:3], labels.shape[2:], "[train.augment] narrowed"
        )
        shown, force = pairs[k][pixels].copy(), labels[k][(slice(None), *inner)].copy()
        # fill the margin of both images with the mean colour of the no-contact image
        mean = shown.sum(axis=0, dtype=np.uint64).sum(axis=0) / (
            shown.shape[0] * shown.shape[1]
        )  # by whole lines of memory
        pairs[k] = np.tile(np.rint(mean[3:]).astype(np.uint8), 2)
        labels[k] = 0.0
        pairs[k][pixels] = shown
        labels[k][(slice(None), *inner)] = force
    return pairs, labels, chosen.numpy()


def mirror_together(images, labels, generator) -> tuple[np.ndarray, np.ndarray]:
    """Mirror each image (n, h, w, channels) and its label (n, 3, rows, cols) along each axis with probability 1/2.

    Mechanics and markers are symmetric: a mirrored press is a press whose force along the mirrored axis is reversed.
    The coloured light is not symmetric, so a network learns to rely on it less.
    """
    import cv2

    images, labels = np.array(images), np.array(labels)
    # fy runs along the columns, fx along the rows; OpenCV's code of a flip about that axis
    for component, axis, code in ((1, -1, 1), (0, -2, 0)):
        chosen = (torch.rand(len(images), generator=generator) < 0.5).numpy()
        for k in np.flatnonzero(chosen):
            images[k] = cv2.flip(images[k], code).reshape(images[k].shape)
        labels[chosen] = np.flip(labels[chosen], axis)
        labels[chosen, component] *= -1
    return images, labels
