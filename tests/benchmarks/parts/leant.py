"""Tilt of FEATS' wide presses by their images: pose known to fractions of a millimetre, depth fitted with the tilt.

The light is fitted to all presses of the unit together; a press' own depth and tilt are those at which the least is left
of all.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gelforge.evidence.imprints import Window, shading
from gelforge.evidence.leaning import NEIGHBOURS, Equations, Shaded, equations, leant, least_left
from gelforge.evidence.logimages import LogPairs
from gelforge.formats.featsfile import read_npy
from gelforge.geometry.indenters import load_catalogue
from gelforge.labelling.sensor import load_sensors
from gelforge.records.press import Press
from gelforge.records.table import read_table
from tests.support.feats_film import feats_maps

WIDE = ("cuboid_7", "cuboid_12", "cuboid_15", "ellipse_15_10", "polygon_6_10", "cylinder_10_7", "cross_15_10_3")
DEPTHS = (0.05, 0.15, 0.25, 0.4, 0.55, 0.7, 0.9, 1.1, 1.4, 1.7)
ANGLES = (-4.0, -2.0, 0.0, 2.0, 4.0)
ROUNDS = 4  # over all presses, each fitted beside the others

Place = tuple[float, float, float]  # depth, tilt about x, tilt about y


@dataclass
class Fitted:
    """A press, its equations at each depth and tilt that is tried, and where the least is left."""

    frame: int
    shaded: Shaded
    tried: dict[Place, Equations]
    at: Place = (0.7, 0.0, 0.0)

    def equations(self, depth: float, x: float, y: float) -> Equations:
        upright = replace(self.shaded.press, dz=-depth)
        return equations(replace(self.shaded, press=upright), leant(upright, x, y))


def fitted_presses(reference: Path) -> list[Fitted]:
    """All presses of the consensus, those of WIDE bodies with tilts."""
    nocontact = read_npy(reference / "feats/images/nocontact_train_sensor.npy")["gs_img"]
    images = [image for image, _ in feats_maps(reference / "feats/images/demo.gif", nocontact)]
    rows = read_table(reference / "feats/consensus.csv", "")
    bodies = load_catalogue("workflow/indenters.toml", sorted({row["indenter"] for row in rows}))
    window, pairs = Window(load_sensors("workflow/sensors.toml")["gelsight_mini"]), LogPairs(nocontact)
    found = []
    for row in rows:
        image = images[int(row["frame"])]
        change, turn = shading(pairs.as_logged(image, pairs(image))), float(row["rot_deg"])
        press = Press(float(row["x_mm"]), float(row["y_mm"]), 0.0, 0.0, 0.0, -0.7, turn)
        one = Fitted(int(row["frame"]), Shaded(change, window, bodies[row["indenter"]], press), {})
        angles = ANGLES if row["indenter"] in WIDE else (0.0,)
        one.tried = {(d, x, y): one.equations(d, x, y) for d in DEPTHS for x in angles for y in angles}
        found.append(one)
    return found


def wide_tilts(reference: Path) -> dict[int, np.ndarray]:
    """Tilt about gel x and y, (2,) degrees, of each press of a wide flat body, by its frame of FEATS' film."""
    every = fitted_presses(reference)

    def beside(one: Fitted) -> Equations:
        return sum((other.tried[other.at] for other in every if other is not one), Equations.empty())

    for _ in range(ROUNDS):
        for one in every:
            rest = beside(one)
            one.at = min(one.tried, key=lambda place: (rest + one.tried[place]).left)
    tilts = {}
    for one in every:
        if len(one.tried) > len(DEPTHS):
            depth, *tilt = one.at
            found, rest = np.array(tilt), beside(one)
            for step in (1.0, 0.5):
                near = found + step * NEIGHBOURS
                grid = [[rest, one.equations(depth, float(x), float(y))] for x, y in near]
                found = np.clip(least_left(near, grid), ANGLES[0], ANGLES[-1])
            tilts[one.frame] = found
    return tilts
