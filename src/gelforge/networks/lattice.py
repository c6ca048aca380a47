"""The lattice of printed dots: where they rest, and the part of their motion that is alike for all of them.

Motions of dots are (n, 3, ROWS, COLS) as networks.dots gives them: along u and v in px, and whether a dot was found.
"""

import functools

import numpy as np
import torch

from gelforge.networks.dots import COLS, ROWS

PITCH = 32.0  # px between neighbouring dots at the scale that networks read
LEAST_SPREAD = 1e-3  # px^2, of dots about their middle, below which they tell no turn and no zoom
# A dot stands still that moved by less than STILL px, and otherwise than its neighbours' median by so many px and this many
# of their own median distance from that. Of dots of 2500 presses none does, of those that something in front of the camera
# covers while all others move by 2 px three in four: with two such neighbours nine in ten of these presses are placed to 0.22
# px, to 0.51 px if they count.
STILL, APART_PX, APART_SPREADS = 0.3, 1.0, 1.5
LEAST_NEIGHBOURS = 3  # of eight, from which on a dot is judged
# Signs that u and v get in the images of a motion: as it is, mirrored along u, along v, and along both, which turns it by half.
IMAGES = np.array([[1, 1], [-1, 1], [1, -1], [-1, -1]])


@functools.cache
def lattice_points() -> tuple[torch.Tensor, torch.Tensor]:
    """Where the dots rest along u and v, px from the lattice's middle, (ROWS, COLS) each."""
    v, u = torch.meshgrid(*(PITCH * (torch.arange(n) - n // 2) for n in (ROWS, COLS)), indexing="ij")
    return u, v


def moved_alike(right: torch.Tensor, down: torch.Tensor, turn: torch.Tensor, zoom: torch.Tensor) -> torch.Tensor:
    """Motion (n, 2, ROWS, COLS) px of dots that are all shifted, turned and zoomed about the lattice's middle.

    right, down: px; turn: radians, positive from u towards v; zoom: factor - 1; all (n,). To first order in turn and zoom.
    """
    u, v = lattice_points()
    right, down, turn, zoom = (part[:, None, None] for part in (right, down, turn, zoom))
    return torch.stack([right + zoom * u - turn * v, down + zoom * v + turn * u], dim=1)


@functools.cache
def lattice_plane() -> np.ndarray:
    """Where the dots rest, u + i v in px from the lattice's middle, (ROWS, COLS) complex."""
    u, v = lattice_points()
    return np.asarray(u.numpy() + 1j * v.numpy())


@functools.cache
def _moments() -> tuple[np.ndarray, np.ndarray]:
    """What sums over the dots are taken of: (dots, 4) 1, u, v and |z|^2, and (dots, 2) 1 and the conjugate of z, z = u + i v."""
    z = lattice_plane().ravel()
    one = np.ones(z.shape)
    return np.stack([one, z.real, z.imag, abs(z) ** 2], axis=1), np.stack([one, z.conj()], axis=1)


def mirror_images(motion: np.ndarray, signs: np.ndarray = IMAGES) -> np.ndarray:
    """Motion of dots (..., 3, ROWS, COLS) float32 in some of its IMAGES, (images, ..., 3, ROWS, COLS).

    A press that is mirrored is a press. A reader is off by another error in each of its images, so their mean is nearer.
    """
    return np.stack(
        [motion[..., ::v, ::u] * np.array([u, v, 1], np.float32)[:, None, None] for u, v in signs.tolist()]
    )


def straightened(motion: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Motion of dots (n, 3, ROWS, COLS) less the similarity z -> a z + b that fits it best, float32, and a and b (n,) complex.

    By least squares over the dots that were found. z is u + i v of a dot at rest, px from the lattice's middle; a turns and
    zooms, b shifts. What is left is seen as before the similarity, (z + motion - b) / a - z, and so is the same for dots that
    were shifted, turned or zoomed besides. Where fewer than two dots are found, a is 1.
    """
    z, (of_found, of_moved) = lattice_plane(), _moments()
    found = motion[:, 2].astype(float)
    moved = found * (motion[:, 0] + 1j * motion[:, 1])
    number, u, v, squares = (found.reshape(len(found), z.size) @ of_found).T
    moves, turned = (moved.reshape(len(moved), z.size) @ of_moved).T
    number = np.maximum(number, 1.0)
    rest = (u + 1j * v) / number
    spread = squares - number * (rest.real**2 + rest.imag**2)
    spun = (turned - rest.conj() * moves) / np.maximum(spread, LEAST_SPREAD)
    a = 1.0 + np.where(spread > LEAST_SPREAD, spun, 0.0)
    b = rest + moves / number - a * rest
    left = found * ((z + moved - b[:, None, None]) / a[:, None, None] - z)
    return np.stack([left.real, left.imag, found], axis=1).astype(np.float32), a, b


def without_still(motion: np.ndarray) -> np.ndarray:
    """Motion of dots (n, 3, ROWS, COLS) in which those count as lost that stand still where all that surround them moved.

    A gel moves smoothly. What does not move along is writing in the picture or dirt on the lens. Neighbours are held
    against what a similarity leaves of a dot (`straightened`), or those at the rim of a picture that was zoomed would differ.
    """
    still = (motion[:, 2] > 0) & (np.hypot(motion[:, 0], motion[:, 1]) < STILL)
    if not still.any():
        return motion
    left, _, _ = straightened(motion)
    moved = np.where(left[:, 2] > 0, left[:, 0] + 1j * left[:, 1], np.nan)
    padded = np.pad(moved, ((0, 0), (1, 1), (1, 1)), constant_values=np.nan)
    steps = [(down, right) for down in range(3) for right in range(3) if (down, right) != (1, 1)]
    around = np.stack([padded[:, down : down + ROWS, right : right + COLS] for down, right in steps])
    usual = _median(around.real) + 1j * _median(around.imag)
    apart = _median(np.abs(around - usual))
    judged = np.isfinite(around).sum(axis=0) >= LEAST_NEIGHBOURS
    alone = judged & (np.abs(moved - usual) > APART_PX + APART_SPREADS * apart)
    return motion * ~(still & alone)[:, None]


def _median(values: np.ndarray) -> np.ndarray:
    """Median over the first axis of what is not NaN; NaN where nothing else is, of which numpy's warns. In a fifth of its time."""
    ordered = np.sort(values, axis=0)  # NaN last
    known = np.isfinite(values).sum(axis=0)[None]
    low, high = (np.take_along_axis(ordered, np.maximum(at, 0), axis=0)[0] for at in ((known - 1) // 2, known // 2))
    return np.asarray(0.5 * (low + high))
