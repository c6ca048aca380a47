"""Cases of the stability map: one factor varied at a time around label settings, and random combinations."""

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from gelforge.flow.tables import StabilityTable
from gelforge.geometry.gel import load_gel
from gelforge.geometry.indenters import build
from gelforge.mechanics.material import Material
from gelforge.mechanics.scene import Interface, Scene
from gelforge.records.press import Press

# A flat, a round, a sharp one, and one that touches in several places.
BODIES = {
    "round": {"kind": "sphere", "diameter": 15, "height": 10},
    "flat": {"kind": "cuboid", "size": [7, 7], "fillet": 1.0, "height": 10},
    "sharp": {"kind": "cuboid", "size": [5, 5], "fillet": 0.1, "height": 10},
    "several": {"kind": "triple_triangle", "side": 10, "wall": 1, "first_corner_deg": -90, "fillet": 0.7,
                "height": 10},
}  # fmt: skip
TILTED, RIDGE = "tilted", "ridge"  # bodies with rows of their own that vary `shape`
# Where the axis stands, mm; at the rim part of every body hangs over the gel's edge.
PLACES = {"centre": (0.0, 0.0), "off-centre": (3.0, 5.0), "rim": (8.5, 0.0)}
# Rows of the map, as in STABILITY_ROWS of rules/branches.mk: one per factor, and one of random combinations.
ROWS = ("depth", "shear", "place", "tilt", "ridge", "nu", "friction", "size", "steps", "random")
SHAPED = {"tilt": TILTED, "ridge": RIDGE}  # rows that vary a body
SERIES = ("size", "steps")  # rows of element sizes and load steps, whose values do not include the label setting
FINEST = "fine"  # quality of hexahedra with which the solvers are compared
SHEAR_DEG = 30.0  # direction of the shear, between mesh lines


@dataclass(frozen=True)
class Case:
    """One solve of the map.

    solver: hex, ccx, or FINEST, with which the others are compared. depth: mm below the gel's top under the axis.
    shear: fraction of the depth. shape: slope in degrees of a tilted block, width in mm of a ridge. friction: coefficient;
    None: no slip. size: of elements under the press, mm; steps: load steps of the press, half as many of the shear;
    both are 0 at label settings.
    """

    solver: str
    kind: str
    depth: float
    shear: float
    place: str
    nu: float
    size: float = 0.0
    steps: int = 0
    shape: float = 0.0
    friction: float | None = None

    @property
    def body(self) -> dict:
        """Table of the indenter."""
        if self.kind == TILTED:
            return {"kind": "sloping_cuboid", "size": [7, 7], "slope_deg": self.shape, "fillet": 1.0, "height": 10}
        if self.kind == RIDGE:
            fillet = min(0.1, 0.4 * self.shape)
            return {"kind": "cuboid", "size": [6, self.shape], "fillet": fillet, "height": 10}
        return BODIES[self.kind]

    @property
    def law(self) -> Interface:
        """Contact law between gel and indenter."""
        return Interface() if self.friction is None else Interface.of_friction(self.friction)

    @property
    def scene(self) -> Scene:
        gel = load_gel("gelsight_mini")
        x, y = PLACES[self.place]
        travel = self.shear * self.depth * np.array([np.cos(np.deg2rad(SHEAR_DEG)), np.sin(np.deg2rad(SHEAR_DEG))])
        press = Press(x, y, float(gel.top(x, y)), float(travel[0]), float(travel[1]), -self.depth)
        return Scene(gel, Material(nu=self.nu), build(self.kind, self.body, "stability map"), press, self.law)

    @property
    def press(self) -> tuple:
        """Key of what is pressed, independent of how it is solved."""
        return self.kind, self.shape, self.depth, self.shear, self.place, self.nu, self.friction

    def describe(self) -> dict:
        return asdict(self)


def centre(table: StabilityTable, solver: str, kind: str) -> Case:
    """The case at label settings, of which rows vary one factor."""
    return Case(solver, kind, table.depth_mm, 0.0, "centre", table.nu)


def series(table: StabilityTable, solver: Any, kind: str) -> Case:
    """The case of which the rows in SERIES vary one factor."""
    return replace(centre(table, solver, kind), size=table.size[solver], steps=table.steps)


def row_cases(table: StabilityTable, row: str) -> list[Case]:
    """Cases of one row: a factor, or "random"."""
    if row == "random":
        return random_cases(table)
    if row in SERIES:
        around = [series(table, solver, kind) for solver in ("hex", "ccx") for kind in BODIES]
        return [replace(case, **{row: level}) for case in around for level in levels(table, row, case.solver)]
    kinds = [SHAPED[row]] if row in SHAPED else list(BODIES)
    around = [centre(table, solver, kind) for solver in ("hex", "ccx", FINEST) for kind in kinds]
    return [replace(case, **{factor_of(row): level}) for case in around for level in levels(table, row)]


def factor_of(row: str) -> str:
    """The field of a case that a row varies."""
    return {"random": "depth", **dict.fromkeys(SHAPED, "shape")}.get(row, row)


def levels(table: StabilityTable, row: str, solver: Any = "") -> list:
    """Values that a row takes."""
    if row == "place":
        return list(PLACES)
    if row == "size":
        return list(table.sizes[solver])
    return list(getattr(table.levels, row))


def random_cases(table: StabilityTable) -> list[Case]:
    """Random combinations of depth, shear, place, body and Poisson's ratio within their ranges, by each solver."""
    rng = np.random.default_rng(table.seed)
    reach = {factor: (min(values), max(values)) for factor, values in vars(table.levels).items()}
    cases = []
    for _ in range(table.random):
        depth = float(np.round(rng.uniform(*reach["depth"]), 3))
        shear = float(np.round(rng.uniform(*reach["shear"]), 3))
        nu = float(np.round(rng.uniform(*reach["nu"]), 4))
        place, kind = str(rng.choice(list(PLACES))), str(rng.choice(list(BODIES)))
        cases += [Case(solver, kind, depth, shear, place, nu) for solver in ("hex", "ccx", FINEST)]
    return cases
