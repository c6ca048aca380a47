"""How the forces of one mesh differ from those of a coarser one: normal and sideways force each by a factor of its own."""

import numpy as np

LEAST_ASIDE = 0.01  # of the normal force: below, sideways force is noise and gives no ratio


def mesh_ratios(fine: np.ndarray, coarse: np.ndarray) -> np.ndarray:
    """Factors (k, 3) from coarse forces (k, 3) N to fine ones of the same presses, compression negative.

    NaN where the coarse forces press on nothing, or are NaN.
    x and y share the ratio of sideways force, which is that of normal force where there is hardly any.
    """
    pressed = coarse[:, 2] < 0
    normal = np.divide(fine[:, 2], coarse[:, 2], out=np.full(len(coarse), np.nan), where=pressed)
    aside = np.hypot(coarse[:, 0], coarse[:, 1])
    sheared = pressed & (aside > LEAST_ASIDE * -coarse[:, 2])
    sideways = np.where(sheared, np.hypot(fine[:, 0], fine[:, 1]) / np.where(sheared, aside, 1.0), normal)
    return np.stack([sideways, sideways, normal], axis=1)
