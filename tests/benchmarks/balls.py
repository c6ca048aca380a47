"""Presses of a ball by hand into a real sensor: the imprint's radius and finite elements give the force that was pressed.

The level is sure to a quarter (circles are marked by hand, the diameter is a catalogue's); spread and correlation are surer.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gelforge.records.image import read_image
from tests.benchmarks.figures import Figure

# A 5 mm ball, `hex` at label quality, C10 0.0725 MPa: radius in mm at which the gap between ball and gel closes, and force in N.
RADIUS_MM = (1.24, 1.45, 1.53, 1.65, 1.73, 1.81, 1.98)
FORCE_N = (0.57, 1.00, 1.27, 1.56, 1.88, 2.24, 3.51)
FOLDER = "balls/unit_a"
Read = Callable[
    [np.ndarray], tuple[np.ndarray, bool]
]  # a picture to its forces (3, rows, cols) N, and whether it is flagged


@dataclass(frozen=True)
class BallPress:
    """A press: picture (h, w, 3) uint8 RGB, normal force by finite elements, N, and whether all of its circle is seen."""

    image: np.ndarray
    force: float
    whole: bool


def no_contact(folder: Path) -> np.ndarray:
    """The no-contact image (h, w, 3) uint8 RGB of the sensor whose presses lie in a folder (gs_sdk's layout)."""
    return read_image(folder / "background.png")[..., :3]


def ball_presses(folder: Path, px_per_mm: float) -> list[BallPress]:
    """The presses of a folder in the layout of gs_sdk's calibration, in the order of their numbers."""
    pressed = sorted(folder.glob("5.000mm/*/gelsight.png"), key=lambda path: int(path.parent.name))
    return [_press(path, px_per_mm) for path in pressed]


def _press(path: Path, px_per_mm: float) -> BallPress:
    image = read_image(path)[..., :3]
    with np.load(path.with_name("label.npz")) as label:
        (u, v), radius = label["center"].astype(float), float(label["radius"])
    height, width = image.shape[:2]
    whole = radius < u < width - radius and radius < v < height - radius
    return BallPress(image, float(np.interp(radius / px_per_mm, RADIUS_MM, FORCE_N)), whole)


def ball_figures(presses: list[BallPress], read: Read) -> list[Figure]:
    """Forces that are read in presses that lie wholly in the picture, over those of finite elements."""
    whole = [press for press in presses if press.whole]
    found = [read(press.image) for press in whole]
    normal, force = np.array([-forces[2].sum(dtype=float) for forces, _ in found]), np.array([p.force for p in whole])
    ratio = normal / force
    median = float(np.median(ratio))
    low, high = (np.quantile(ratio, [0.1, 0.9]) / median).tolist()
    r = float(np.corrcoef(normal, force)[0, 1])
    note = f"{len(whole)} presses that lie wholly in the picture; the level is sure to a quarter"
    return [
        Figure("real balls, read over finite elements, median: at least", median, ">=", 0.8, "", note),
        Figure("real balls, read over finite elements, median: at most", median, "<=", 1.25),
        Figure("the same over the median, 10 %", low, ">=", 0.8),
        Figure("the same over the median, 90 %", high, "<=", 1.25),
        Figure("the same, correlation", r, ">=", 0.75, "", "circles are marked in whole px, and this series spans little force"),
        Figure("good ball presses flagged", 100 * float(np.mean([flag for _, flag in found])), "<=", 10.0, "%"),
    ]  # fmt: skip
