"""Presses of a ball of known diameter by hand, and the forces that pressed by the marked radius of the contact.

    FOLDER/background.png                  the sensor while nothing touches it
    FOLDER/DIAMETERmm/N/gelsight.png       a press
    FOLDER/DIAMETERmm/N/label.npz          center (u, v) and radius in px of the contact's circle, marked by hand

`balls.csv` holds finite elements of balls on gels of a GelSight Mini at C10 = 0.0725 MPa (`ball_table.py`); force is proportional to C10.
"""

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from gelforge.records.image import read_image
from gelforge.records.table import read_table

COLUMNS = "diameter_mm", "thickness_mm", "depth_mm", "radius_mm", "force_n"
TABLE = Path(__file__).with_name("balls.csv")
BACKGROUND = "background.png"
CAMERA_MM = 23.0  # of a GelSight Mini's pinhole below the apex: markers around real balls show 21 to 25
THICKNESS_MM = 4.0


@dataclass(frozen=True)
class BallPress:
    """A press: its picture (h, w, 3) uint8 RGB, and the normal force in N that made it.

    radius: of the marked circle, px. diameter: of the ball, mm. px_per_mm: where the image shows the gel.
    """

    name: str
    image: np.ndarray
    force: float
    radius: float
    diameter: float
    px_per_mm: float


@dataclass(frozen=True)
class BallCurve:
    """One ball at growing depth: radius of contact and the same as an image shows it, mm, and normal force, N, (k,) each."""

    radius: np.ndarray
    seen: np.ndarray
    force: np.ndarray

    def force_at(self, radius: float) -> float:
        """Normal force in N at a radius of contact in mm as an image shows it, linear in the logarithms; NaN outside of the table."""
        return float(np.exp(np.interp(np.log(radius), np.log(self.seen), np.log(self.force), np.nan, np.nan)))


@cache
def ball_curve(diameter: float) -> BallCurve:
    """A ball of a diameter (mm) on a gel of THICKNESS_MM, linear in the logarithms between the balls of the table."""
    rows = np.array([[float(row[name]) for name in COLUMNS] for row in read_table(TABLE, "restore it")])
    rows = rows[rows[:, 1] == THICKNESS_MM]
    sizes = np.unique(rows[:, 0])
    solves = np.log([rows[rows[:, 0] == size][:, 2:].T for size in sizes])
    k = int(np.clip(np.searchsorted(sizes, diameter) - 1, 0, len(sizes) - 2))
    part = np.log(diameter / sizes[k]) / np.log(sizes[k + 1] / sizes[k])
    depth, radius, force = np.exp((1.0 - part) * solves[k] + part * solves[k + 1])
    return BallCurve(radius, as_seen(radius, diameter, depth), force)


def as_seen(radius: np.ndarray, diameter: float, depth: np.ndarray) -> np.ndarray:
    """Radius (k,) mm of a ball's contact as the camera shows it, by the scale of the undeformed surface.

    The edge of contact lies deeper than that surface, nearer to the camera, and looks 2 to 4 % larger. depth: (k,) mm of the ball.
    """
    ball = diameter / 2
    edge = depth - (ball - np.sqrt(ball**2 - np.minimum(radius, ball) ** 2))
    return np.asarray(radius * CAMERA_MM / (CAMERA_MM - edge))


def read_presses(folder: Path, px_per_mm: float) -> list[BallPress]:
    """The marked presses of a folder whose circle lies in the image, in the order of their numbers."""
    found = []
    for path in sorted(folder.glob("*mm/*/gelsight.png"), key=lambda one: (len(one.parent.name), one.parent.name)):
        size = re.fullmatch(r"(\d+(?:\.\d+)?)mm", path.parents[1].name)
        image = read_image(path)
        with np.load(path.with_name("label.npz"), allow_pickle=False) as label:
            (u, v), radius = label["center"].astype(float), float(label["radius"])
        height, width = image.shape[:2]
        if size and radius < u < width - radius and radius < v < height - radius:
            force = ball_curve(float(size[1])).force_at(radius / px_per_mm)
            name = str(path.parent.relative_to(folder))
            found.append(BallPress(name, image, force, radius, float(size[1]), px_per_mm))
    return [one for one in found if np.isfinite(one.force)]
