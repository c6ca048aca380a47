"""The axis along which forces change evenly with friction: frictionless at 0, no slip at 1."""

import numpy as np

HALF_MU = 0.5  # the friction coefficient in the middle of the axis


def friction_axis(mu) -> np.ndarray:
    """Map a friction coefficient in [0, inf] to [0, 1]: mu / (mu + HALF_MU)."""
    mu = np.asarray(mu, float)
    return np.where(np.isinf(mu), 1.0, mu / (np.where(np.isinf(mu), 1.0, mu) + HALF_MU))


def friction_of(axis) -> np.ndarray:
    """Friction coefficient at positions in [0, 1) of the axis."""
    return HALF_MU * axis / (1.0 - axis)
