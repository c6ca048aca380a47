"""A sensor's table from colours to slopes, learnt from its presses of a ball of known diameter.

In the circle of contact the ball dictates the slope of the gel, and far from it the gel is level. The coefficients follow by ridge
regression (Hoerl and Kennard 1970, Technometrics 12) in a second or two, without a random choice.
"""

from collections.abc import Sequence

import numpy as np

from gelforge.errors import BadInput
from gelforge.networks.balls.ballpresses import BallPress
from gelforge.networks.preprocess.slopetable import (
    COLOUR_TERMS,
    PLACE_TERMS,
    SlopeTable,
    colour_terms,
    light_change,
    place_terms,
)

RIDGE = 0.01  # added to the normal equations, per press
WITHIN = 0.9  # of the radius of circle and ball: inside it the gel has the ball's slope
BEYOND, EVERY = 2.2, 23  # beyond so many radii the gel is taken as level, at every so many of its pixels
LEAST_PRESSES = 8  # of five, slopes elsewhere were wrong by a half


def fit_slope_table(presses: Sequence[BallPress], nocontact: np.ndarray, px_per_mm: float) -> SlopeTable:
    """The table of a sensor. BadInput where presses are fewer than LEAST_PRESSES.

    presses: their images under the illumination of the no-contact image. nocontact: (h, w, 3) uint8 RGB.
    """
    if len(presses) < LEAST_PRESSES:
        raise BadInput(
            f"{len(presses)} presses of the ball are too few for a table of slopes: press it {LEAST_PRESSES} times at least, 40"
            " times for a good one"
        )
    squares = RIDGE * len(presses) * np.eye(COLOUR_TERMS * PLACE_TERMS)
    products = np.zeros((len(squares), 2))
    for press in presses:
        steep, level, slope = _known(press, nocontact, px_per_mm)
        squares += steep.T @ steep + level.T @ level
        products += steep.T @ slope
    found = np.linalg.solve(squares, products)
    return SlopeTable(found.reshape(COLOUR_TERMS, PLACE_TERMS, 2), px_per_mm)


def known_slopes(press: BallPress, clear: np.ndarray, px_per_mm: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which pixels (h, w) of a halved image have the ball's slope, which are level, and the slopes (n, 2) of the first.

    clear: (h, w) pixels that no marker hides.
    """
    v, u = np.indices(clear.shape) * 2.0 + 1.0
    across = np.stack([u - press.circle.u, v - press.circle.v], 2)
    distance = np.hypot(across[..., 0], across[..., 1])
    ball = press.diameter / 2 * px_per_mm
    within = clear & (distance < WITHIN * min(press.circle.radius, ball))
    slope = across[within] / np.sqrt(ball**2 - distance[within] ** 2)[:, None]
    return within, clear & (distance > BEYOND * press.circle.radius), slope


def _known(press: BallPress, nocontact: np.ndarray, px_per_mm: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Terms of colours and place where the ball dictates the slope and where there is none, and the slopes (n, 2)."""
    change, clear = light_change(press.image, nocontact, px_per_mm)
    within, beyond, slope = known_slopes(press, clear, px_per_mm)
    colours, place = colour_terms(change), place_terms(clear.shape)
    steep, level = (
        (colours[chosen][:, :, None] * place[chosen][:, None, :])
        .reshape(-1, COLOUR_TERMS * PLACE_TERMS)
        .astype(float)
        for chosen in (within, beyond)
    )
    return steep, level[::EVERY], slope
