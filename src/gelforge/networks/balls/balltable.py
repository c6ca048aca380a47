"""Radius of an imprint to the force of the ball that made it, by finite elements that were solved beforehand.

`balls.csv` holds balls on gels of a GelSight Mini at C10 = 0.0725 MPa (`python -m tests.benchmarks.ball_table` solves them again); force is
proportional to C10. A ball beside the apex, where the gel is a tenth of a millimetre lower, is taken as one on it.
"""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.records.table import read_table

COLUMNS = "diameter_mm", "thickness_mm", "depth_mm", "radius_mm", "rim_mm", "force_n"
TABLE = Path(__file__).with_name("balls.csv")
# The rim of an imprint: where the difference between two pictures, blurred by BLUR_MM, has fallen to RIM of its largest.
BLUR_MM, RIM = 0.16, 0.6
CAMERA_MM = 23.0  # of a GelSight Mini's pinhole below the apex: markers around real balls show 21 to 25
THICKNESS_MM, C10_MPA = 4.0, 0.0725  # of a gel of which nothing else is known; C10 is that of the table


@dataclass(frozen=True)
class BallCurve:
    """One ball at growing depth: radius of contact, the same as an image shows it, and of the rim around it, mm, and normal force, N, (k,) each."""

    radius: np.ndarray
    seen: np.ndarray
    rim: np.ndarray
    force: np.ndarray

    def force_at(self, radius: float) -> float:
        """Normal force in N at a radius of contact in mm as an image shows it; NaN for one that the table does not cover."""
        return _power_law(radius, self.seen, self.force)

    def radius_at(self, rim: float) -> float:
        """Radius of contact in mm within a rim in mm, both as an image shows them; NaN for a rim that the table does not cover.

        The rim looks larger by about as much as the contact does, so their ratio is that of the table.
        """
        return _power_law(rim, self.rim, self.radius)


def as_seen(radius: np.ndarray, diameter: float, depth: np.ndarray) -> np.ndarray:
    """Radius (k,) mm of a ball's contact as the camera shows it, by the scale of the undeformed surface.

    The edge of contact lies deeper than that surface, nearer to the camera, and looks 2 to 4 % larger; force is 6 to 9 % less than
    by the radius as it is seen. depth: (k,) mm by which the ball is pressed in.
    """
    ball = diameter / 2
    edge = depth - (ball - np.sqrt(ball**2 - np.minimum(radius, ball) ** 2))
    return np.asarray(radius * CAMERA_MM / (CAMERA_MM - edge))


def _power_law(x: float, known: np.ndarray, values: np.ndarray) -> float:
    """Linear interpolation of logarithms; NaN outside."""
    return float(np.exp(np.interp(np.log(x), np.log(known), np.log(values), np.nan, np.nan)))


@dataclass(frozen=True)
class BallTable:
    """Solves over ball diameter (d,) mm, gel thickness (t,) mm and depth: depth, radius, rim and force in `solves`, (4, d, t, k)."""

    diameters: np.ndarray
    thicknesses: np.ndarray
    solves: np.ndarray

    def curve(self, diameter: float, thickness: float = THICKNESS_MM) -> BallCurve:
        """Radii and forces of one ball on one gel, linear in the logarithms; BadInput for sizes that the table lacks."""
        for what, value, known in (("a ball", diameter, self.diameters), ("a gel", thickness, self.thicknesses)):
            if not known[0] <= value <= known[-1]:
                raise BadInput(
                    f"{what} of {value:g} mm: the table of solves covers {known[0]:g} to {known[-1]:g} mm; for others install the"
                    " extra [flow] and press it with gelforge.solve"
                )
        of_ball = _between(np.log(self.solves), np.log(self.diameters), np.log(diameter), 1)
        depth, radius, rim, force = np.exp(_between(of_ball, np.log(self.thicknesses), np.log(thickness), 1))
        return BallCurve(radius, as_seen(radius, diameter, depth), rim, force)


def _between(values: np.ndarray, known: np.ndarray, at: float, axis: int) -> np.ndarray:
    """Values that lie at `known` (n,) along an axis, linearly interpolated along it."""
    k = int(np.clip(np.searchsorted(known, at) - 1, 0, len(known) - 2))
    part = (at - known[k]) / (known[k + 1] - known[k])
    return np.asarray((1.0 - part) * values.take(k, axis) + part * values.take(k + 1, axis))


@cache
def ball_table() -> BallTable:
    """The table that ships."""
    rows = np.array([[float(row[name]) for name in COLUMNS] for row in read_table(TABLE, "install gelforge again")])
    rows = rows[np.lexsort(rows[:, 2::-1].T)]
    diameters, thicknesses = np.unique(rows[:, 0]), np.unique(rows[:, 1])
    return BallTable(diameters, thicknesses, rows[:, 2:].T.reshape(4, len(diameters), len(thicknesses), -1))
