"""The axisymmetric presses with known forces as scenes that gelforge solves."""

import numpy as np

from data.fea_challenge import axisymmetric
from gelforge.geometry.gel import Gel
from gelforge.geometry.gelcatalogue import PadTable
from gelforge.geometry.indenters import build
from gelforge.geometry.solids import Body, Indenter
from gelforge.mechanics.material import Material
from gelforge.mechanics.scene import Interface, Scene
from gelforge.records.press import Press

SIDES = {"width": 40.0, "length": 40.0, "corner_radius": 1.0}  # mm, of a pad


class Revolved(Body):
    """A body of revolution with the profile of an `axisymmetric.Body`, for shapes that the catalogue lacks."""

    def __init__(self, name: str, body: axisymmetric.Body, reach: float, height: float):
        super().__init__(name, height)
        self.body, self.reach = body, reach

    def distance(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signed distance (n,) and outward normal (n, 3) at points (n, 3); the body has no upper end."""
        r = np.hypot(points[:, 0], points[:, 1])
        gap, normal, _ = self.body.distance(np.column_stack([r, points[:, 2]]))
        along = points[:, :2] / np.maximum(r, 1e-12)[:, None]
        return gap, np.column_stack([normal[:, :1] * along, normal[:, 1]])

    def radius(self) -> float:
        """Radius at its upper end, mm."""
        return self.reach

    @property
    def _surface(self) -> tuple[np.ndarray, np.ndarray]:
        raise NotImplementedError("only CalculiX' own contact needs triangles")


def indenter(kind: str, sizes: list[float]) -> Indenter:
    """The body from the catalogue, or revolved from its profile."""
    if kind == "sphere":
        return build(kind, {"kind": "sphere", "diameter": sizes[0], "height": max(10.0, sizes[0] / 2)})
    if kind == "cone":
        return Revolved(kind, axisymmetric.cone(*sizes), reach=10.0, height=6.0)
    hole = {"hole": sizes[1]} if kind == "tube" else {}
    return build(kind, {"kind": "cylinder", "diameter": sizes[0], "fillet": sizes[-1], "height": 10.0} | hole)


def pad(thickness: float) -> Gel:
    """The flat pad of that thickness."""
    return PadTable(thickness=thickness, **SIDES).gel(f"flat_{thickness:g}mm")


def scene_of(press: dict) -> Scene:
    """The press as a scene for every method."""
    way = Press(0.0, 0.0, 0.0, 0.0, 0.0, -press["depth_mm"])
    law = Interface(press["interface"], press["mu"] or 0.0)
    return Scene(
        pad(press["thickness_mm"]), Material(press["nu"]), indenter(press["kind"], press["sizes_mm"]), way, law
    )
