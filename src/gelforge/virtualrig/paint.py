"""The print on the unloaded gel: markers with ragged rims, flecks and coloured shadows."""

import cv2
import numpy as np

from gelforge.virtualrig.appearance import HEIGHT, WIDTH, Appearance

MARGIN = 32  # px painted beyond the image, because a press can pull gel into view
SUPER = 3  # samples per px in each direction


def printed(appearance: Appearance, rng: np.random.Generator) -> np.ndarray:
    """Fraction of light that the printed gel reflects, ((240 + 2 MARGIN) SUPER, (320 + 2 MARGIN) SUPER, 3) float32.

    Sample (i, j) lies at v = (i + 0.5) / SUPER - MARGIN px from the image's corner, u likewise.
    """
    shape = (HEIGHT + 2 * MARGIN) * SUPER, (WIDTH + 2 * MARGIN) * SUPER
    cover = np.zeros(shape, np.float32)
    fleck = np.zeros(shape, np.float32)
    for centre in appearance.markers:
        _print_marker(cover, fleck, centre, appearance, rng)
    out = np.empty((*shape, 3), np.float32)
    for colour in range(3):
        shadow = appearance.shadow_depth * _smeared(
            cover, -appearance.light[colour], appearance.shadow_length[colour] * SUPER
        )
        ink = (1.0 - appearance.ink[colour] - appearance.flecks[colour] * fleck) * cover
        out[..., colour] = 1.0 - np.maximum(ink, shadow * (1.0 - appearance.ink[colour]) * (1.0 - cover))
    for _ in range(appearance.specks):
        _add_speck(out, rng)
    return cv2.GaussianBlur(out, (0, 0), appearance.blur * SUPER) if appearance.blur > 0 else out


def sample_position(pixel: np.ndarray) -> np.ndarray:
    """Sample index (fractional) at a distance in px from the image's corner."""
    return (pixel + MARGIN) * SUPER - 0.5


def wear_off(paint: np.ndarray, centre: np.ndarray, diameter: float, left: float) -> None:
    """Reduce a marker's ink and shadow in a print (h, w, 3) to a fraction `left`; centre (2,) and diameter in px."""
    reach = int(2 * diameter * SUPER)
    column, row = np.rint(sample_position(np.asarray(centre))).astype(int).tolist()
    top, first = max(row - reach, 0), max(column - reach, 0)
    window = paint[top : row + reach + 1, first : column + reach + 1]
    v, u = np.ogrid[top : top + window.shape[0], first : first + window.shape[1]]
    off = np.clip(2.0 - np.hypot(u - column, v - row) / (0.6 * diameter * SUPER), 0.0, 1.0)[..., None]
    window += ((1.0 - left) * off * (1.0 - window)).astype(np.float32)


def _print_marker(cover, fleck, centre, appearance: Appearance, rng: np.random.Generator) -> None:
    reach = int(appearance.diameter * SUPER)
    middle = sample_position(np.asarray(centre))
    left, top = (np.round(middle).astype(int)) - reach
    size = 2 * reach + 1
    y0, x0 = max(top, 0), max(left, 0)
    y1, x1 = min(top + size, cover.shape[0]), min(left + size, cover.shape[1])
    harmonics = rng.normal(scale=appearance.raggedness / np.arange(2, 7), size=(2, 5))
    spots = cv2.GaussianBlur(rng.standard_normal((size, size), dtype=np.float32), (0, 0), 0.6 * SUPER)
    if y0 >= y1 or x0 >= x1:
        return
    y, x = np.mgrid[y0:y1, x0:x1]
    dx, dy = (x - middle[0]) / SUPER, (y - middle[1]) / SUPER
    angle = np.arctan2(dy, dx)
    order = np.arange(2, 7)[:, None, None]
    rim = (
        harmonics[0, :, None, None] * np.cos(order * angle) + harmonics[1, :, None, None] * np.sin(order * angle)
    ).sum(0)
    inside = np.clip((appearance.diameter / 2 * (1.0 + rim) - np.hypot(dx, dy)) * SUPER + 0.5, 0.0, 1.0)
    window = np.s_[y0:y1, x0:x1]
    cover[window] = np.maximum(cover[window], inside)
    bright = np.clip(spots[y0 - top : y1 - top, x0 - left : x1 - left] / (spots.std() + 1e-9) - 0.8, 0.0, 1.5)
    fleck[window] = np.maximum(fleck[window], bright)


def _add_speck(out: np.ndarray, rng: np.random.Generator) -> None:
    """A grain of dust or a short scratch, darker or brighter than the gel around it."""
    middle = rng.uniform((0, 0), out.shape[1::-1])
    angle = rng.uniform(0, np.pi)
    half = rng.uniform(0.2, 3.0) * SUPER * np.array([np.cos(angle), np.sin(angle)])
    start, end = (np.rint(middle + sign * half).astype(int).tolist() for sign in (-1, 1))
    mark = cv2.line(
        np.zeros(out.shape[:2], np.float32), start, end, 1.0, int(rng.uniform(0.5, 2.0) * SUPER), cv2.LINE_AA
    )
    out *= (1.0 + rng.uniform(-0.5, 0.25) * mark)[..., None]


def _smeared(cover: np.ndarray, direction: np.ndarray, length: float) -> np.ndarray:
    """`cover` smeared along `direction` with exponential decay over `length` samples; zero for a length of 0."""
    if length == 0.0:
        return np.zeros_like(cover)
    reach = int(np.ceil(3 * length))
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1), np.float32)
    steps = np.arange(0, 3 * length, 0.25)
    x, y = reach + direction[0] * steps, reach + direction[1] * steps
    np.add.at(kernel, (np.round(y).astype(int), np.round(x).astype(int)), np.exp(-steps / length))
    # filter2D correlates, so the kernel is rotated by 180 degrees for a convolution
    return cv2.filter2D(cover, -1, kernel[::-1, ::-1] / kernel.sum(), borderType=cv2.BORDER_CONSTANT)
