"""A smooth force law in place of finite element curves, for tests of the inference alone."""

import emcee  # noqa: F401, its first import starts a process (uname), which no unit test may
import numpy as np

from gelforge.calibration.emulator import Curve, Emulator, curve_table, friction_axis, friction_table
from gelforge.calibration.parameters import make_model
from gelforge.calibration.posterior import Posterior
from gelforge.calibration.readings import Readings
from gelforge.geometry.gel import USUAL_GEL
from gelforge.records.press import POSE, TILT
from tests.support.parameters import parameters

TOP = 2.4
MUS = (0.0, 0.4, np.inf)
NODES = (0.0, 0.1, 0.2, 0.4, 0.8, 1.6, np.inf)
PARAMS = parameters().calibrate
TRUTH = {"c10": 0.085, "offset": 0.03, "compliance": 0.006, "shear_compliance": 0.0, "mu": 0.7,
         "tare_x": 0.0, "tare_y": 0.0, "tare_z": 0.0, "discretisation": 0.0}  # fmt: skip


def normal_force(depth, mu, stiffness=4.0):
    """Normal force at REFERENCE_C10, like a sphere on a thin layer: stiffer with depth and with friction."""
    depth = np.clip(depth, 0.0, None)
    return -stiffness * (1 + 0.2 * friction_axis(mu)) * depth**1.5 * (1 + 0.25 * depth)


def law_curve(mu, stiffness=4.0, ratio=0.0) -> Curve:
    """Fourteen points of the law, with a sideways force of `ratio` times the normal one."""
    depth = np.linspace(0.0, TOP, 15)[1:]
    force = np.zeros((len(depth), 3))
    force[:, 2] = normal_force(depth, mu, stiffness)
    force[:, 0] = ratio * force[:, 2]
    return Curve(depth, force)


def law_emulator(stiffness=(4.0,)) -> Emulator:
    """Emulator with one press per stiffness."""
    tables = [friction_table(MUS, [curve_table(law_curve(mu, k), TOP) for mu in MUS]) for k in stiffness]
    n = len(stiffness)
    return Emulator(np.array(tables), np.full(n, TOP), np.zeros(n, int), np.zeros(n))


def make_readings(depth, force, sheared=False) -> Readings:
    """Straight presses of one sphere at the apex."""
    n = len(depth)
    pose = np.zeros((n, len(POSE) + len(TILT)))
    pose[:, 5] = -np.asarray(depth)
    pose[:, 3] = 0.3 if sheared else 0.0
    ids = np.array([f"p{i:03d}" for i in range(n)])
    full = np.full((n, 3), np.nan)
    full[:, 2] = force
    return Readings(
        "log.csv", np.arange(2, n + 2), ids, np.array(["sphere_15"] * n), pose, full, np.array([USUAL_GEL] * n),
        *one_mounting(n),
    )  # fmt: skip


def one_mounting(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mountings, moments and whether the tilt is stated, of n presses on one mounting without moments."""
    return np.array([""] * n), np.full((n, 2), np.nan), np.zeros(n, bool)


def true_values(**changes) -> dict:
    values = {name: np.array([value]) for name, value in {**TRUTH, **changes}.items()}
    shared = {"indenter": np.zeros((1, 1)), "touch": values["offset"][:, None], "tilt": np.zeros((1, 1, 2))}
    return {**values, **shared}


def law_posterior(rng, depth, stiffness=None, law="coulomb", noise=0.03, **truth) -> Posterior:
    """Posterior for readings of the law with normal noise."""
    depth = np.asarray(depth, float)
    emulator = law_emulator(stiffness or [4.0] * len(depth))
    forces, _, _ = emulator.forces(depth, true_values(**truth))
    observed = np.full((len(depth), 3), np.nan)
    observed[:, 2] = forces[0, :, 2] + truth.get("tare_z", 0.0) + noise * rng.standard_normal(len(depth))
    return Posterior(emulator, make_model(PARAMS, law, sideways=False), depth, observed, 4.0)


def law_session(seed=0, presses=24, noise=0.03, **truth) -> tuple[Readings, Emulator]:
    """A session of presses with shear in all directions, each read once with normal noise, and its emulator.

    Tangential over normal force is mu tanh(1.5 travel / (mu depth)), which scales with mu and travel together, as
    under Coulomb's law.
    """
    rng = np.random.default_rng(seed)
    ranges = ((0.4, 1.6), (0.1, 0.4), (0.0, 2 * np.pi))
    depth, travel, way = (rng.uniform(low, high, presses) for low, high in ranges)
    names = np.array([f"ball_{k % 3}" for k in range(presses)])
    tables = []
    for k in range(presses):
        curves = [law_curve(mu, (2.0, 4.0, 8.0)[k % 3]) for mu in NODES]
        for mu, curve in zip(NODES, curves, strict=True):
            mu = min(max(mu, 1e-9), 1e9)
            dragged = -mu * np.tanh(1.5 * travel[k] / mu / curve.depth) * curve.force[:, 2]
            curve.force[:, 0], curve.force[:, 1] = dragged * np.cos(way[k]), dragged * np.sin(way[k])
        tables.append(friction_table(NODES, [curve_table(curve, TOP) for curve in curves]))
    emulator = Emulator(np.array(tables), np.full(presses, TOP), np.arange(presses) % 3, travel)
    pose = np.zeros((presses, len(POSE) + len(TILT)))
    pose[:, 3], pose[:, 4], pose[:, 5] = travel * np.cos(way), travel * np.sin(way), -depth
    pose[:, 6] = rng.uniform(0, 360, presses)
    values = {**true_values(**truth), "indenter": np.zeros((1, 3))}
    force = emulator.forces(depth, values)[0][0] + noise * rng.standard_normal((presses, 3))
    ids = np.array([f"p{k:03d}" for k in range(presses)])
    rows, gels = np.arange(2, presses + 2), np.array([USUAL_GEL] * presses)
    return Readings("log.csv", rows, ids, names, pose, force, gels, *one_mounting(presses)), emulator
