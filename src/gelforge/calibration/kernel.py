"""Compiled evaluation of the emulator's tables for all walkers and presses."""

import numpy as np
from numba import njit

LEAST_WAY = 1e-6  # fraction of the travel that is left at least


@njit(cache=True, fastmath=False)
def sideways_left(yielded, exponent):
    """Share of a sideways force that is left where the frame yields.

    yielded: part of the travel that the frame would take under the whole force. exponent: d ln force / d ln travel.
    The travel x that remains, as a fraction, meets x + yielded * x**exponent = 1; the force is x**exponent.
    """
    x = 1.0 / (1.0 + yielded)
    for _ in range(4):
        x -= (x + yielded * x**exponent - 1.0) / (1.0 + yielded * exponent * x ** (exponent - 1.0))
        x = max(x, LEAST_WAY)  # concave: a step may go beyond the root, and beyond 0
    return x**exponent


# What follows goes over all presses of one walker: with helpers called for each press it takes a third longer.
# at: (m, fm), the friction coefficients between which a walker lies, and how far.


@njit(cache=True, fastmath=False)
def _press(table, top, at, target, scale, compliance, forces, slopes, depths, low_of, t_of):
    """Fill forces (n, 3), slopes (n, 3), depths (n,) and the place in the grid: low_of (n,), -1 off the gel, and t_of (n,).

    target: (n,) mm, the commanded depth with its offset. scale: (n,).
    """
    m, fm = at
    grid = table.shape[2]
    for p in range(target.size):
        w0, w1 = (1 - fm) * scale[p], fm * scale[p]
        a, b = table[p, m], table[p, m + 1]
        step = top[p] / (grid - 1)
        if target[p] <= 0.0:
            depths[p], low_of[p] = target[p], -1
            continue
        low, high = 0, grid - 1
        while high - low > 1:
            j = (low + high) // 2
            f = w0 * a[j, 2] + w1 * b[j, 2]
            if j * step + compliance * abs(f) <= target[p]:
                low = j
            else:
                high = j
        f0 = w0 * a[low, 2] + w1 * b[low, 2]
        f1 = w0 * a[high, 2] + w1 * b[high, 2]
        c0 = low * step + compliance * abs(f0)
        c1 = high * step + compliance * abs(f1)
        t = (target[p] - c0) / (c1 - c0)
        depths[p], low_of[p], t_of[p] = (low + t) * step, low, t
        for i in range(3):
            g0 = w0 * a[low, i] + w1 * b[low, i]
            g1 = w0 * a[high, i] + w1 * b[high, i]
            forces[p, i] = (1 - t) * g0 + t * g1
            slopes[p, i] = (g1 - g0) / (c1 - c0)


@njit(cache=True, fastmath=False)
def _yield_sideways(table, travel, at, over_log_mu, scale, compliance, low_of, t_of, forces, slopes):
    """Lessen the sideways parts of forces (n, 3) and slopes (n, 3) by what the frame takes of the travel (n,) mm."""
    m = at[0]
    for p in range(travel.size):
        sideways = np.hypot(forces[p, 0], forces[p, 1])
        if low_of[p] < 0 or travel[p] <= 0.0 or sideways == 0.0:
            continue
        a, b = table[p, m], table[p, m + 1]
        low, high, t = low_of[p], low_of[p] + 1, t_of[p]
        more = 0.0  # what one grid step of friction adds to the sideways force
        for i in range(2):
            more_here = (1 - t) * (b[low, i] - a[low, i]) + t * (b[high, i] - a[high, i])
            more += forces[p, i] / sideways * scale[p] * more_here
        exponent = min(max(1.0 - more * over_log_mu / sideways, 0.0), 1.0)
        left = sideways_left(compliance * sideways / travel[p], exponent)
        for i in range(2):
            forces[p, i] *= left
            slopes[p, i] *= left


@njit(cache=True, fastmath=False)
def evaluate(table, top, depth, travel, scale, offset, compliance, shear_compliance, friction):
    """Forces (w, n, 3) N, slopes (w, n, 3) N per mm, effective depths (w, n) mm; see Emulator.forces.

    scale: (w, n). friction: (w,) position on the friction axis in grid steps. Others (w,) in their own units.
    With the force linear between grid depths d_j, the commanded depth that ends at d_j is
    d_j - offset + compliance |f_j|, which increases with j: one bisection finds the interval and
    the answer in it is exact. Sideways, the force at another travel follows from the force at another friction
    coefficient: under Coulomb's law it is proportional when both are scaled (Cattaneo 1938, Mindlin 1949), so its
    exponent over travel is 1 less that over friction.
    """
    walkers, presses = offset.size, depth.size
    forces = np.zeros((walkers, presses, 3))
    slopes = np.zeros((walkers, presses, 3))
    depths = np.zeros((walkers, presses))
    low, t = np.empty(presses, np.intp), np.empty(presses)
    for w in range(walkers):
        m = min(max(int(friction[w]), 0), table.shape[1] - 2)
        at = m, friction[w] - m
        target = depth + offset[w]
        _press(table, top, at, target, scale[w], compliance[w], forces[w], slopes[w], depths[w], low, t)
        if shear_compliance[w] <= 0.0:
            continue
        axis = min(friction[w] / (table.shape[1] - 1), 1.0)
        over_log_mu = axis * (1.0 - axis) * (table.shape[1] - 1)  # d (grid steps of friction) / d ln mu
        give = shear_compliance[w]
        _yield_sideways(table, travel, at, over_log_mu, scale[w], give, low, t, forces[w], slopes[w])
    return forces, slopes, depths
