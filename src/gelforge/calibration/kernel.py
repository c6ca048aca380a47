"""Compiled evaluation of the emulator's tables for all walkers and presses."""

from typing import NamedTuple

import numpy as np
from numba import njit

LEAST_WAY = 1e-6  # least fraction of the travel that is left


class Walkers(NamedTuple):
    """Values of w walkers: scale (w, n) of forces, offset (w, n) mm, friction (w,) in grid steps, others (w,) in mm/N."""

    scale: np.ndarray
    offset: np.ndarray
    compliance: np.ndarray
    shear_compliance: np.ndarray
    friction: np.ndarray


class Found(NamedTuple):
    """Results of n presses: forces (n, 3), slopes (n, 3), depths (n,), and their place in the grid of depths.

    low: (n,) grid interval, -1 off the gel. t: (n,) fraction within it.
    """

    forces: np.ndarray
    slopes: np.ndarray
    depths: np.ndarray
    low: np.ndarray
    t: np.ndarray


@njit(cache=True, fastmath=False)
def sideways_left(yielded, exponent):
    """Fraction of a sideways force that is left when the frame yields.

    yielded: fraction of the travel that the frame would take under full force. exponent: d ln force / d ln travel.
    The fraction x of the travel that is left solves x + yielded * x**exponent = 1; the force is x**exponent.
    """
    x = 1.0 / (1.0 + yielded)
    for _ in range(4):
        x -= (x + yielded * x**exponent - 1.0) / (1.0 + yielded * exponent * x ** (exponent - 1.0))
        x = max(x, LEAST_WAY)  # concave: a step may overshoot the root, and 0
    return x**exponent


# The following functions loop over all presses of one walker: helpers called for each press take a third longer.
# at: (m, fm), the friction interval in which a walker lies, and the fraction within it.


@njit(cache=True, fastmath=False)
def _press(table, top, at, target, scale, compliance, found):
    """Fill in `found` of each press, for a frame that is rigid sideways.

    target: (n,) mm, commanded depth plus offset. scale: (n,).
    """
    m, fm = at
    grid = table.shape[2]
    for p in range(target.size):
        w0, w1 = (1 - fm) * scale[p], fm * scale[p]
        a, b = table[p, m], table[p, m + 1]
        step = top[p] / (grid - 1)
        if target[p] <= 0.0:
            found.depths[p], found.low[p] = target[p], -1
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
        found.depths[p], found.low[p], found.t[p] = (low + t) * step, low, t
        for i in range(3):
            g0 = w0 * a[low, i] + w1 * b[low, i]
            g1 = w0 * a[high, i] + w1 * b[high, i]
            found.forces[p, i] = (1 - t) * g0 + t * g1
            found.slopes[p, i] = (g1 - g0) / (c1 - c0)


@njit(cache=True, fastmath=False)
def _yield_sideways(table, travel, at, over_log_mu, scale, compliance, found):
    """Reduce sideways forces and slopes, because the yielding frame takes a part of the travel (n,) mm."""
    m = at[0]
    forces, slopes = found.forces, found.slopes
    for p in range(travel.size):
        sideways = np.hypot(forces[p, 0], forces[p, 1])
        if found.low[p] < 0 or travel[p] <= 0.0 or sideways == 0.0:
            continue
        a, b = table[p, m], table[p, m + 1]
        low, high, t = found.low[p], found.low[p] + 1, found.t[p]
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
def evaluate(table, top, depth, travel, of):
    """Forces (w, n, 3) N, slopes (w, n, 3) N per mm, effective depths (w, n) mm; see Emulator.forces.

    of: the Walkers.
    With the force linear between grid depths d_j, the commanded depth that ends at d_j is
    d_j - offset + compliance |f_j|, which increases with j: one bisection finds the interval and
    the answer in it is exact. Sideways, the force at another travel follows from the force at another friction
    coefficient: under Coulomb's law it scales with both if these are scaled alike (Cattaneo 1938, Mindlin 1949), so
    its exponent in travel is 1 minus that in friction.
    """
    walkers, presses = of.offset.shape
    forces = np.zeros((walkers, presses, 3))
    slopes = np.zeros((walkers, presses, 3))
    depths = np.zeros((walkers, presses))
    low, t = np.empty(presses, np.intp), np.empty(presses)
    for w in range(walkers):
        m = min(max(int(of.friction[w]), 0), table.shape[1] - 2)
        at = m, of.friction[w] - m
        target = depth + of.offset[w]
        found = Found(forces[w], slopes[w], depths[w], low, t)
        _press(table, top, at, target, of.scale[w], of.compliance[w], found)
        if of.shear_compliance[w] <= 0.0:
            continue
        axis = min(of.friction[w] / (table.shape[1] - 1), 1.0)
        over_log_mu = axis * (1.0 - axis) * (table.shape[1] - 1)  # d (grid steps of friction) / d ln mu
        _yield_sideways(table, travel, at, over_log_mu, of.scale[w], of.shear_compliance[w], found)
    return forces, slopes, depths


@njit(cache=True, fastmath=False)
def log_likelihood(residual, serves, forces, slopes, noise, scatter, errors, tail, constant):
    """Log-likelihood (w, n) of the readings of n presses, each press one draw of a multivariate Student's t.

    residual: (w, n, 3) N. serves: (n, 3), which components are used. forces, slopes: (w, n, 3). noise, scatter: (w,).
    errors: relative errors of emulated forces: of all components, of both sideways ones, and of each sideways one by
    the normal force. tail: degrees of freedom. constant: (4,), of the log-density, by the number of components.
    The components of a press share the touch error, along the slope of the force, and the first two of `errors`.
    """
    walkers, presses = residual.shape[:2]
    found = np.zeros((walkers, presses))
    root, z = np.zeros((3, 3)), np.zeros(3)
    for w in range(walkers):
        for p in range(presses):
            f, s, r = forces[w, p], slopes[w, p], residual[w, p]
            used, log_det, square = 0, 0.0, 0.0
            for i in range(3):
                if not serves[p, i]:
                    continue
                z[i] = r[i]
                for j in range(i + 1):
                    if not serves[p, j]:
                        root[i, j] = 0.0
                        continue
                    value = scatter[w] ** 2 * s[i] * s[j] + errors[0] ** 2 * f[i] * f[j]
                    if i < 2 and j < 2:
                        value += errors[1] ** 2 * f[i] * f[j]
                    if i == j:
                        value += noise[w] ** 2
                        if i < 2:
                            value += (errors[2] * f[2]) ** 2
                    for k in range(j):
                        value -= root[i, k] * root[j, k]
                    root[i, j] = np.sqrt(value) if i == j else value / root[j, j]
                for k in range(i):
                    if root[i, k] != 0.0:
                        z[i] -= root[i, k] * z[k]
                z[i] /= root[i, i]
                log_det += np.log(root[i, i])
                square += z[i] * z[i]
                used += 1
            found[w, p] = constant[used] - log_det - 0.5 * (tail + used) * np.log1p(square / tail)
    return found
