"""Compiled evaluation of the emulator's tables for all walkers and presses."""

import numpy as np
from numba import njit

LEAST_WAY = 1e-6  # share of the travel that is left at least


@njit(cache=True, fastmath=False)
def sideways_left(yielded, exponent):
    """Share of a sideways force that is left where the frame yields.

    yielded: part of the travel that the frame would take under the whole force. exponent: d ln force / d ln travel.
    The travel x that remains, as a share, meets x + yielded * x**exponent = 1; the force is x**exponent.
    """
    x = 1.0 / (1.0 + yielded)
    for _ in range(4):
        x -= (x + yielded * x**exponent - 1.0) / (1.0 + yielded * exponent * x ** (exponent - 1.0))
        x = max(x, LEAST_WAY)  # concave: a step may go beyond the root, and beyond 0
    return x**exponent


@njit(cache=True, fastmath=False)
def evaluate(table, top, nu_nodes, depth, travel, scale, offset, compliance, shear_compliance, friction, nu):
    """Forces (w, n, 3) N, slopes (w, n, 3) N per mm, effective depths (w, n) mm; see Emulator.forces.

    scale: (w, n). friction: (w,) position on the friction axis in grid steps. Others (w,) in their own units.
    With the force linear between grid depths d_j, the commanded depth that ends at d_j is
    d_j - offset + compliance |f_j|, which increases with j: one bisection finds the interval and
    the answer in it is exact. Sideways, the force at another travel follows from the force at another friction
    coefficient: under Coulomb's law it is proportional when both are scaled (Cattaneo 1938, Mindlin 1949), so its
    exponent over travel is 1 less that over friction.
    """
    walkers, presses = offset.size, depth.size
    grid = table.shape[3]
    forces = np.zeros((walkers, presses, 3))
    slopes = np.zeros((walkers, presses, 3))
    depths = np.zeros((walkers, presses))
    for w in range(walkers):
        m = min(max(int(friction[w]), 0), table.shape[2] - 2)
        fm = friction[w] - m
        k = 0
        while k + 2 < nu_nodes.size and nu[w] > nu_nodes[k + 1]:
            k += 1
        k2 = min(k + 1, nu_nodes.size - 1)
        fk = 0.0 if k2 == k else (nu[w] - nu_nodes[k]) / (nu_nodes[k2] - nu_nodes[k])
        axis = min(friction[w] / (table.shape[2] - 1), 1.0)
        over_log_mu = axis * (1.0 - axis) * (table.shape[2] - 1)  # d (grid steps of friction) / d ln mu
        for p in range(presses):
            w00, w01 = (1 - fk) * (1 - fm) * scale[w, p], (1 - fk) * fm * scale[w, p]
            w10, w11 = fk * (1 - fm) * scale[w, p], fk * fm * scale[w, p]
            a, b, c, d = table[p, k, m], table[p, k, m + 1], table[p, k2, m], table[p, k2, m + 1]
            step = top[p] / (grid - 1)
            target = depth[p] + offset[w]
            if target <= 0.0:
                depths[w, p] = target
                continue
            low, high = 0, grid - 1
            while high - low > 1:
                j = (low + high) // 2
                f = w00 * a[j, 2] + w01 * b[j, 2] + w10 * c[j, 2] + w11 * d[j, 2]
                if j * step + compliance[w] * abs(f) <= target:
                    low = j
                else:
                    high = j
            f0 = w00 * a[low, 2] + w01 * b[low, 2] + w10 * c[low, 2] + w11 * d[low, 2]
            f1 = w00 * a[high, 2] + w01 * b[high, 2] + w10 * c[high, 2] + w11 * d[high, 2]
            c0 = low * step + compliance[w] * abs(f0)
            c1 = high * step + compliance[w] * abs(f1)
            t = (target - c0) / (c1 - c0)
            depths[w, p] = (low + t) * step
            for i in range(3):
                g0 = w00 * a[low, i] + w01 * b[low, i] + w10 * c[low, i] + w11 * d[low, i]
                g1 = w00 * a[high, i] + w01 * b[high, i] + w10 * c[high, i] + w11 * d[high, i]
                forces[w, p, i] = (1 - t) * g0 + t * g1
                slopes[w, p, i] = (g1 - g0) / (c1 - c0)
            sideways = np.hypot(forces[w, p, 0], forces[w, p, 1])
            if shear_compliance[w] <= 0.0 or travel[p] <= 0.0 or sideways == 0.0:
                continue
            more = 0.0  # what one grid step of friction adds to the sideways force
            for i in range(2):
                s0 = (1 - fk) * (b[low, i] - a[low, i]) + fk * (d[low, i] - c[low, i])
                s1 = (1 - fk) * (b[high, i] - a[high, i]) + fk * (d[high, i] - c[high, i])
                more += forces[w, p, i] / sideways * scale[w, p] * ((1 - t) * s0 + t * s1)
            exponent = min(max(1.0 - more * over_log_mu / sideways, 0.0), 1.0)
            left = sideways_left(shear_compliance[w] * sideways / travel[p], exponent)
            for i in range(2):
                forces[w, p, i] *= left
                slopes[w, p, i] *= left
    return forces, slopes, depths
