"""The finite element solves of balls by whose imprints `benchmark-real` knows the force, minutes of a core; rows that are there stay."""

from argparse import Namespace
from itertools import product
from pathlib import Path

import numpy as np
from tqdm import tqdm

from gelforge.errors import GelforgeError
from gelforge.flow.cli import command, option
from gelforge.flow.files import read_csv, write_csv
from gelforge.geometry.gel import USUAL_GEL, load_gel
from gelforge.geometry.indenters import build
from gelforge.mechanics.hexsettings import quality
from gelforge.mechanics.material import Material
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solvers.hex import HexResult, HexSolver
from gelforge.records.press import Press
from tests.benchmarks.parts.ball_presses import COLUMNS, TABLE

THICKNESSES = 4.0, 3.6, 4.4  # mm of gel at its apex
DIAMETERS = 5.0, 4.0, 6.0, 8.0, 10.0, 12.0  # mm of ball
DEPTHS = 0.3, 0.5, 0.8, 1.1, 1.4, 1.7  # mm
# The imprint ends where the gap is this wide: less is not seen. Extrapolated to a gap of zero, radii are 3 to 6 % smaller.
CLOSED_MM = 0.01
# The gap of a smooth body opens with the power 3/2 of the distance from the contact (Johnson 1985, Contact Mechanics, 3.4).
POWER, FITTED_MM = 2.0 / 3.0, (0.3 * CLOSED_MM, 10 * CLOSED_MM)


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
        found = contact_radius(result, diameter, depth), -result.total[2]
        rows.append(dict(zip(COLUMNS, (diameter, thickness, depth, *np.round(found, 4).tolist()), strict=True)))
    return rows


@command(option("--out", type=Path, default=TABLE))
def main(args: Namespace) -> None:
    rows = [{name: float(row[name]) for name in COLUMNS} for row in read_csv(args.out)] if args.out.exists() else []
    held = {(row["thickness_mm"], row["diameter_mm"]) for row in rows}
    missing = [pair for pair in product(THICKNESSES, DIAMETERS) if pair not in held]
    solver = HexSolver(quality("label"))
    for thickness, diameter in tqdm(missing, "balls", len(missing)):
        rows += solved_rows(solver, diameter, thickness)
        write_csv(args.out, COLUMNS, sorted(rows, key=lambda row: tuple(row.values())))


if __name__ == "__main__":
    main.exit()
