"""The finite element solves behind `gelforge sensor --balls`, minutes of a core; rows that are there stay."""

from argparse import Namespace
from itertools import product
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

from gelforge.errors import GelforgeError
from gelforge.flow.files import read_csv, write_csv
from gelforge.flow.main import command, option
from gelforge.flow.progress import progress
from gelforge.geometry.gel import USUAL_GEL, Gel, load_gel
from gelforge.geometry.indenters import build
from gelforge.mechanics.hexsettings import quality
from gelforge.mechanics.material import Material
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solvers.hex import HexResult, HexSolver
from gelforge.networks.balls.balltable import BLUR_MM, COLUMNS, RIM, TABLE
from gelforge.records.press import Press

THICKNESSES = 4.0, 3.6, 4.4  # mm of gel at its apex
DIAMETERS = 5.0, 4.0, 6.0, 8.0, 10.0, 12.0  # mm of ball
DEPTHS = 0.3, 0.5, 0.8, 1.1, 1.4, 1.7  # mm
# The imprint ends where the gap is this wide: less is not seen. Extrapolated to a gap of zero, radii are 3 to 6 % smaller.
CLOSED_MM = 0.01
# The gap of a smooth body opens with the power 3/2 of the distance from the contact (Johnson 1985, Contact Mechanics, 3.4).
POWER, FITTED_MM = 2.0 / 3.0, (0.3 * CLOSED_MM, 10 * CLOSED_MM)
# What pictures make of slopes: the gel's coating bridges this much, and flanks steeper than this are hardly brighter. With both
# 45 real circles come out as they were marked (1.01 in the median), and those of 39 rendered balls 3 % too wide.
SKIN_MM, LEVELS_OFF = 0.2, 0.5
REACH_MM, BIN_MM, PIXEL_MM = 8.0, 0.1, 0.04  # how far, in what rings, and how finely slopes are sampled


def contact_radius(result: HexResult, diameter: float, depth: float) -> float:
    """Radius in mm at which the gap between the gel and a ball that is `depth` mm below the apex is CLOSED_MM wide."""
    if result.contact is None:
        raise GelforgeError(f"a ball of {diameter:g} mm, {depth:g} mm deep, touches nothing")
    x, y, z = result.contact.position.T
    radius = np.hypot(x, y)
    gap = np.hypot(radius, z - (diameter / 2 - depth)) - diameter / 2
    near = (gap > FITTED_MM[0]) & (gap < FITTED_MM[1])
    slope, edge = np.polyfit(gap[near] ** POWER, radius[near], 1)
    return float(edge + slope * CLOSED_MM**POWER)


def rim_radius(result: HexResult, gel: Gel) -> float:
    """Radius in mm beyond the contact at which the brightness that slopes make has fallen to RIM of its largest."""
    if result.contact is None:
        raise GelforgeError("a ball that touches nothing has no rim")
    x, y, z = result.contact.position.T
    bins = np.arange(0.0, REACH_MM, BIN_MM)
    at = np.digitize(np.hypot(x, y), bins)
    held = [k for k in range(1, len(bins)) if (at == k).any()]
    radius, sunk = (np.array([of[at == k].mean() for k in held]) for of in (np.hypot(x, y), z - gel.top(x, y)))
    axis = np.arange(-REACH_MM, REACH_MM, PIXEL_MM)
    height = gaussian_filter(np.interp(np.hypot(axis, axis[:, None]), radius, sunk, right=0.0), SKIN_MM / PIXEL_MM)
    slope = np.hypot(*np.gradient(height, PIXEL_MM))
    bright = gaussian_filter(slope / np.sqrt(1.0 + (slope / LEVELS_OFF) ** 2), BLUR_MM / PIXEL_MM)
    middle = len(axis) // 2
    seen = bright[middle, middle:] / bright[middle].max()
    past = int(seen.argmax()) + int(np.argmax(seen[seen.argmax() :] < RIM))
    return float(axis[middle] + (past - 1 + (seen[past - 1] - RIM) / (seen[past - 1] - seen[past])) * PIXEL_MM)


def solved_rows(solver: HexSolver, diameter: float, thickness: float) -> list[dict[str, float]]:
    """Rows of the table for one ball on one gel, from one load path; GelforgeError where a frame is not solved."""
    gel = load_gel(f"{USUAL_GEL}-{thickness:g}mm")
    ball = build("ball", {"kind": "sphere", "diameter": diameter, "height": diameter}, "ball table")
    scenes = [Scene(gel, Material(), ball, Press(0.0, 0.0, 0.0, 0.0, 0.0, -depth, 0.0)) for depth in DEPTHS]
    rows = []
    for depth, result in zip(DEPTHS, solver.solve_frames(scenes), strict=True):
        if not result.status.valid:
            raise GelforgeError(
                f"ball of {diameter:g} mm, gel of {thickness:g} mm, {depth:g} mm deep: {result.status.value}"
            )
        found = contact_radius(result, diameter, depth), rim_radius(result, gel), -result.total[2]
        rows.append(dict(zip(COLUMNS, (diameter, thickness, depth, *np.round(found, 4).tolist()), strict=True)))
    return rows


@command(option("--out", type=Path, default=TABLE))
def main(args: Namespace) -> None:
    rows = [{name: float(row[name]) for name in COLUMNS} for row in read_csv(args.out)] if args.out.exists() else []
    held = {(row["thickness_mm"], row["diameter_mm"]) for row in rows}
    missing = [pair for pair in product(THICKNESSES, DIAMETERS) if pair not in held]
    solver = HexSolver(quality("label"))
    for thickness, diameter in progress(missing, "balls", len(missing)):
        rows += solved_rows(solver, diameter, thickness)
        write_csv(args.out, COLUMNS, sorted(rows, key=lambda row: tuple(row.values())))


if __name__ == "__main__":
    main.exit()
