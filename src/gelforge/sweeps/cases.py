"""Cases of the stability map: one factor varied at a time around a centre, and random combinations."""

from dataclasses import asdict, dataclass, replace

import numpy as np

from gelforge.flow.params.tables import StabilityTable
from gelforge.geometry.gel import load_gel
from gelforge.geometry.indenters import build
from gelforge.mechanics.scene import Interface, Material, Press, Scene

# A flat, a round, a sharp one, and one that touches in several places.
BODIES = {
    "round": {"kind": "sphere", "diameter": 15, "height": 10},
    "flat": {"kind": "cuboid", "size": [7, 7], "fillet": 1.0, "height": 10},
    "sharp": {"kind": "cuboid", "size": [5, 5], "fillet": 0.1, "height": 10},
    "several": {"kind": "triple_triangle", "side": 10, "wall": 1, "first_corner_deg": -90, "fillet": 0.7,
                "height": 10},
}  # fmt: skip
# Where the axis stands, mm; at the rim part of every body hangs over the gel's edge.
PLACES = {"centre": (0.0, 0.0), "off-centre": (3.0, 5.0), "rim": (8.5, 0.0)}
FACTORS = ("depth", "shear", "place", "nu", "size", "steps")
SHEAR_DEG = 30.0  # direction of the shear, between mesh lines


@dataclass(frozen=True)
class Case:
    """One solve of the map.

    depth: mm below the gel's top under the axis. shear: share of the depth. size: of bricks or
    tetrahedra under the press, mm. steps: load steps of the press; half as many of the shear.
    """

    fidelity: str
    kind: str
    depth: float
    shear: float
    place: str
    nu: float
    size: float
    steps: int

    @property
    def scene(self) -> Scene:
        gel = load_gel("gelsight_mini")
        x, y = PLACES[self.place]
        travel = self.shear * self.depth * np.array([np.cos(np.deg2rad(SHEAR_DEG)), np.sin(np.deg2rad(SHEAR_DEG))])
        press = Press(x, y, float(gel.top(x, y)), float(travel[0]), float(travel[1]), -self.depth)
        return Scene(gel, Material(nu=self.nu), build(self.kind, BODIES[self.kind]), press, Interface())

    @property
    def press(self) -> tuple:
        """What is pressed, whichever way it is solved."""
        return self.kind, self.depth, self.shear, self.place, self.nu

    def describe(self) -> dict:
        return asdict(self)


def centre(table: StabilityTable, fidelity: str, kind: str) -> Case:
    """The case that rows vary one factor of."""
    size = table.sizes[fidelity][-1] if fidelity == "ccx-native" else table.size[fidelity]
    return Case(fidelity, kind, table.depth_mm, 0.0, "centre", table.nu, size, table.steps)


def row_cases(table: StabilityTable, row: str) -> list[Case]:
    """Cases of one row: a factor, "random", or "native" (CalculiX' own contact and, to hold it against, hex)."""
    if row == "random":
        return random_cases(table)
    if row == "native":
        around = [centre(table, fidelity, kind) for fidelity in ("ccx-native", "hex") for kind in ("round", "flat")]
        return [replace(case, depth=depth) for case in around for depth in table.native_depths_mm]
    around = [centre(table, fidelity, kind) for fidelity in ("hex", "ccx") for kind in BODIES]
    return [replace(case, **{row: level}) for case in around for level in levels(table, row, case.fidelity)]


def levels(table: StabilityTable, row: str, fidelity: str) -> list:
    """Values that a row takes."""
    if row == "place":
        return list(PLACES)
    if row == "size":
        return list(table.sizes[fidelity])
    return list(getattr(table.levels, row))


def random_cases(table: StabilityTable) -> list[Case]:
    """Random combinations of all factors within their ranges, each by both fidelities."""
    rng = np.random.default_rng(table.seed)
    reach = {factor: (min(values), max(values)) for factor, values in vars(table.levels).items()}
    cases = []
    for _ in range(table.random):
        depth = float(np.round(rng.uniform(*reach["depth"]), 3))
        shear = float(np.round(rng.uniform(*reach["shear"]), 3))
        nu = float(np.round(rng.uniform(*reach["nu"]), 4))
        place, kind = str(rng.choice(list(PLACES))), str(rng.choice(list(BODIES)))
        steps = int(rng.choice(table.levels.steps))
        at = int(rng.integers(len(table.sizes["ccx"])))
        cases += [Case(fidelity, kind, depth, shear, place, nu, table.sizes[fidelity][at], steps)
                  for fidelity in ("hex", "ccx")]  # fmt: skip
    return cases
