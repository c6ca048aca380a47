"""Compares all contacts of a sensor with poses and projection: other axes, or a common shift, turn and scale."""

import math
from collections.abc import Sequence

import numpy as np

from gelforge.evidence.imprints import COLS, ROWS, Seen
from gelforge.reading.measures import FLIPS
from gelforge.reading.picture import likeness

# Of the rig's presses, contacts lie within 0.2 mm of their poses in the median.
FEWEST = 6  # images of a sensor that are judged together
BETTER = 0.15  # least median gain of likeness by another explanation
OFTEN = 0.8  # least fraction of images that it suits better
FITS = 0.5  # likeness from which an imprint is where it was expected
TURNED_DEG, SCALED, OFFSET_MM = 3.0, 0.1, 0.7  # largest usual errors of a projection
TOGETHER = 1.0  # places of the map: largest median distance of contacts from where a common move puts them
SPREAD_MM = 2.0  # least spread of the poses that determines a rotation and a scale


def gains(base: np.ndarray, other: np.ndarray) -> bool:
    """Whether another explanation suits most images better."""
    return bool(np.median(other - base) > BETTER and (other > base).mean() >= OFTEN and np.median(other) > FITS)


def _turned(expected: np.ndarray, degrees: float) -> np.ndarray:
    import cv2

    turn = cv2.getRotationMatrix2D(((COLS - 1) / 2, (ROWS - 1) / 2), degrees, 1.0)
    return cv2.warpAffine(expected, turn, (COLS, ROWS))


AXES = {
    **FLIPS,
    "turned by 90 degrees": lambda expected: _turned(expected, 90.0),
    "turned by -90 degrees": lambda expected: _turned(expected, -90.0),
    "mirrored, with x and y exchanged": lambda expected: _turned(expected[:, ::-1], 90.0),
    "mirrored, with x and y exchanged and both signs": lambda expected: _turned(expected[:, ::-1], -90.0),
}


def other_axes(mine: list[Seen]) -> str:
    base = np.array([one.likeness for one in mine])
    best, how = base, ""
    for what, change in AXES.items():
        other = np.array([likeness(one.measured, change(one.expected)) for one in mine])
        if gains(base, other) and np.median(other) > np.median(best):
            best, how = other, what
    if not how:
        return ""
    return (
        f"the contacts match the poses once these are {how} (likeness {np.median(best):.2f}, as logged {np.median(base):.2f}):"
        " check the projection, the axes and signs of x0_mm and y0_mm, and whether the camera mirrors"
    )


def projection(mine: list[Seen]) -> tuple[str, np.ndarray | None]:
    """Fit a similarity from the expected places of contacts to those seen; return a sentence about it.

    Also return it as OpenCV's matrix (2, 3) where it includes a shift and most contacts fit then, else None.
    """
    good = [(one.middle, one.displaced[1]) for one in mine if one.displaced[0] > FITS]
    if len(good) < FEWEST:
        return "", None
    at, move, mm = np.array([at for at, _ in good]), np.array([move for _, move in good]), mine[0].mm
    at -= (COLS - 1) / 2, (ROWS - 1) / 2
    for _ in range(3):  # without outliers: single wrong rows are reported by themselves
        turn, scale, offset, left = _similarity(at, move)
        near = left <= max(0.5, 3.0 * float(np.median(left)))
        if near.all() or near.sum() < FEWEST:
            break
        at, move = at[near], move[near]
    said = []
    if np.hypot(*np.ptp(at, axis=0)) * mm >= SPREAD_MM:
        if abs(scale - 1.0) > SCALED:
            said.append(f"{scale:.2f} times as far from the image's middle")
        if abs(turn) > TURNED_DEG:
            said.append(f"turned by {_best_turn(mine, turn, scale, offset):.1f} degrees about the image's middle")
    moved = bool(np.hypot(*offset) * mm > OFFSET_MM)
    if moved:
        said.append(f"moved by {np.hypot(*offset) * mm:.1f} mm")
    if not said:
        return "", None
    text = (
        f"compared with the poses and the projection, the contacts are {' and '.join(said)}: check `projection` in sensors.toml"
        " (make projection), and the origin of x0_mm and y0_mm"
    )
    if not (moved and len(good) >= OFTEN * len(mine) and float(np.median(left)) < TOGETHER):
        return text, None
    linear = scale * np.array([[math.cos(math.radians(turn)), -math.sin(math.radians(turn))],
                               [math.sin(math.radians(turn)), math.cos(math.radians(turn))]])  # fmt: skip
    middle = np.array([(COLS - 1) / 2, (ROWS - 1) / 2])
    return text, np.column_stack([linear, middle + offset - linear @ middle])


def _best_turn(mine: Sequence[Seen], turn: float, scale: float, offset: np.ndarray) -> float:
    """The rotation, degrees, about the image's middle that fits whole maps best, near the one fitted to places alone.

    Places alone make it too small: a map that leaves the image, or is rotated itself, is found where most of it
    overlaps.
    """
    import cv2

    near = turn + np.arange(-4.0, 4.1, 0.5)
    fits = []
    for degrees in near:
        about = cv2.getRotationMatrix2D(((COLS - 1) / 2, (ROWS - 1) / 2), -degrees, scale)
        about[:, 2] += offset
        maps = (cv2.warpAffine(one.expected, about, (COLS, ROWS)) for one in mine)
        fits.append(np.mean([likeness(one.measured, expected) for one, expected in zip(mine, maps, strict=True)]))
    return float(near[int(np.argmax(fits))])


def _similarity(at: np.ndarray, move: np.ndarray) -> tuple[float, float, np.ndarray, np.ndarray]:
    """Turn in degrees, scale, offset (2,) and residuals (n,) of the similarity that moves places (n, 2) by `move`."""
    ones, zeros = np.ones(len(at)), np.zeros(len(at))
    along, across = at.T
    design = np.stack([np.column_stack([along, -across, ones, zeros]), np.column_stack([across, along, zeros, ones])])
    found = np.linalg.lstsq(design.reshape(-1, 4), (at + move).T.ravel(), rcond=None)[0]
    left = np.hypot(*((at + move).T - design @ found))
    return float(np.degrees(np.arctan2(found[1], found[0]))), float(np.hypot(*found[:2])), found[2:], left


def moved_map(expected: np.ndarray, moves: np.ndarray) -> np.ndarray:
    import cv2

    return np.asarray(cv2.warpAffine(expected, moves, (COLS, ROWS)))
