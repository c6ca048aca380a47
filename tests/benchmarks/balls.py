"""Presses of a ball by hand into a real sensor: the imprint's radius and finite elements give the force that was pressed.

The level is uncertain by a quarter (circles are marked by hand, the diameter is a catalogue's); spread and correlation are less so.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gelforge.geometry.gel import Gel
from gelforge.geometry.indenters import build
from gelforge.labelling.sensor import load_sensors
from gelforge.mechanics.material import Material
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solvers.hex import HexSolver
from gelforge.networks.balls.ballpresses import BACKGROUND, BallPress, read_presses
from gelforge.networks.balls.balltable import ball_table
from gelforge.networks.balls.slopefit import fit_slope_table, known_slopes
from gelforge.networks.inference.sensorprofile import fit_gain
from gelforge.networks.preprocess.illumination import match_light
from gelforge.networks.preprocess.slopetable import SlopeTable, light_change
from gelforge.records.image import read_image, write_png
from gelforge.records.press import Press
from gelforge.virtualrig.appearance import read_appearances
from gelforge.virtualrig.bench import SETTINGS
from gelforge.virtualrig.fields import body_of, field_of, surface_of
from gelforge.virtualrig.render import Pressed, Renderer
from tests.benchmarks.ball_table import DEPTHS
from tests.benchmarks.figures import Figure

FOLDER = "balls/unit_a"
ROOT = Path(__file__).parents[2]
# Where balls are pressed that the virtual rig draws: x, y and depth in mm.
DRAWN = (
    (-3.0, -5.0, 0.6), (3.0, -4.0, 1.4), (2.5, 4.5, 0.8), (-2.5, 5.0, 1.2),
    (0.5, 0.5, 1.0), (-3.5, 0.0, 1.5), (3.5, 1.0, 0.5), (0.0, -6.0, 0.9),
)  # fmt: skip
Read = Callable[
    [np.ndarray], tuple[np.ndarray, bool]
]  # a picture to its forces (3, rows, cols) N, and whether it is flagged


def ball_figures(presses: list[BallPress], read: Read) -> list[Figure]:
    """Forces that are read over those of finite elements, and again with a factor from every other press."""
    found = [read(press.image) for press in presses]
    normal, force = (
        np.array([-forces[2].sum(dtype=float) for forces, _ in found]),
        np.array([p.force for p in presses]),
    )
    note = f"{len(presses)} presses that lie completely in the image; the level is uncertain by a quarter"
    gain = fit_gain(force[::2], normal[::2])
    fitted = (
        f"{len(force[1::2])} presses; factor {gain.value:.2f} ({gain.low:.2f} to {gain.high:.2f}) from the others"
    )
    return [
        *_level("real balls, read over finite elements", normal, force, note),
        *_level("real balls, factor of every other press", gain.value * normal[1::2], force[1::2], fitted),
        Figure("good ball presses flagged", 100 * float(np.mean([flag for _, flag in found])), "<=", 10.0, "%"),
    ]


def _level(what: str, normal: np.ndarray, force: np.ndarray, note: str) -> list[Figure]:
    """Level, spread and correlation of normal forces (n,) N with those of finite elements."""
    median = float(np.median(normal / force))
    low, high = (np.quantile(normal / force, [0.1, 0.9]) / median).tolist()
    r = float(np.corrcoef(normal, force)[0, 1])
    return [
        Figure(f"{what}, median: at least", median, ">=", 0.8, "", note),
        Figure(f"{what}, median: at most", median, "<=", 1.25),
        Figure(f"{what}: over the median, 10 %", low, ">=", 0.8),
        Figure(f"{what}: over the median, 90 %", high, "<=", 1.25),
        Figure(f"{what}: correlation", r, ">=", 0.75, "", "circles are marked in whole px, and this series spans little force"),
    ]  # fmt: skip


def table_figures(presses: list[BallPress], nocontact: np.ndarray, px_per_mm: float) -> list[Figure]:
    """Slopes by the sensor's own table in presses that it did not learn from."""
    learnt = [replace(one, image=match_light(one.image, nocontact).undo(one.image)) for one in presses]
    figures = []
    for count, low, high in ((40, 0.93, 1.08), (10, 0.85, 1.15)):
        gains = slope_gains(learnt, count, nocontact, px_per_mm)
        least, middle, most = np.quantile(gains, [0.1, 0.5, 0.9]).tolist()
        what = f"slopes by a table of {count} presses over the ball's"
        figures += [
            Figure(f"{what}, 10 %", least, ">=", low, "", f"median {middle:.2f}; {len(gains)} presses"),
            Figure(f"{what}, 90 %", most, "<=", high),
        ]
    return figures


def slope_gains(presses: Sequence[BallPress], count: int, nocontact: np.ndarray, px_per_mm: float) -> np.ndarray:
    """Slopes by tables of `count` presses over those that the ball dictates, for the presses left out of each of five tables."""
    gains, rng = [], np.random.default_rng(0)
    for _ in range(5):
        order = rng.permutation(len(presses))
        table = fit_slope_table([presses[k] for k in order[:count]], nocontact, px_per_mm)
        gains += [slope_gain(table, presses[k], nocontact) for k in order[count:]]
    return np.array(gains)


def slope_gain(table: SlopeTable, press: BallPress, nocontact: np.ndarray) -> float:
    """Slopes by a table over those that the ball dictates, by least squares."""
    _, clear = light_change(press.image, nocontact, table.px_per_mm)
    within, _, slope = known_slopes(press, clear, table.px_per_mm)
    found = table.slopes(press.image, nocontact)[:, within].T
    return float((found * slope).sum() / (slope**2).sum())


def circle_figures(folder: Path, nocontact: np.ndarray, px_per_mm: float) -> list[Figure]:
    """Circles of contact that are found without marks, against those marked by hand."""
    marked, found = (
        {
            press.name: press.circle
            for press in read_presses(folder, nocontact, px_per_mm=px_per_mm, marks=marks).presses
        }
        for marks in (True, False)
    )
    pairs = [(found[name], marked[name]) for name in marked.keys() & found.keys()]
    ratio = np.array([one.radius / other.radius for one, other in pairs])
    beside = np.array([np.hypot(one.u - other.u, one.v - other.v) for one, other in pairs])
    note = "10 to 90 % {:.2f} to {:.2f}; median distance of centres {:.1f} px".format(
        *np.quantile(ratio, [0.1, 0.9]), np.median(beside)
    )
    return [Figure("real balls: found circles against marked ones, radius, median error", 100 * abs(float(np.median(ratio)) - 1), "<=", 5.0, "%",
                   f"{len(pairs)} presses; {note}")]  # fmt: skip


def drawn_figures(folder: Path) -> list[Figure]:
    """Forces of balls that the virtual rig draws, from circles found without marks, over those of their depths."""
    predicted: list[float] = []
    truth: list[float] = []
    for unit in ("mini_a", "mini_b"):
        for diameter in (4.0, 6.0):
            place = draw_balls(folder / f"{unit}_{diameter:g}", unit, diameter, DRAWN)
            found = read_presses(place, read_image(place / BACKGROUND)).presses
            predicted += [press.force for press in found]
            truth += [true_force(diameter, DRAWN[int(Path(press.name).name)][2]) for press in found]
    asked = 4 * len(DRAWN)
    ratio, note = (
        np.array(predicted) / truth,
        f"{len(predicted)} of {asked} presses: 4 and 6 mm, two units; circles found without marks",
    )
    median = float(np.median(ratio))
    low, high = (np.quantile(ratio, [0.1, 0.9]) / median).tolist()
    return [
        Figure(
            "drawn balls, force by their circle over the true one, median: at least", median, ">=", 0.95, "", note
        ),
        Figure("drawn balls, force by their circle over the true one, median: at most", median, "<=", 1.05),
        Figure("the same over the median, 10 %", low, ">=", 0.9),
        Figure("the same over the median, 90 %", high, "<=", 1.1),
        Figure("the same, correlation", float(np.corrcoef(predicted, truth)[0, 1]), ">=", 0.96),
    ]


def draw_balls(folder: Path, unit: str, diameter: float, where: Sequence[tuple[float, float, float]]) -> Path:
    """Draw presses of a ball on a virtual unit into a folder in gs_sdk's layout; where: x, y, and depth below the gel there, mm."""
    gel = Gel()
    looks, sensors = (
        read_appearances(ROOT / "workflow/rig/sensors.toml"),
        load_sensors(ROOT / "workflow/sensors.toml"),
    )
    camera = Renderer(looks[unit], sensors[unit].projection, gel)
    ball = build("ball", {"kind": "sphere", "diameter": diameter, "height": diameter}, "a drawn ball")
    body, solver = body_of(ball, 0.0, 0.6, 0.0), HexSolver(SETTINGS)
    folder.mkdir(parents=True)
    write_png(folder / BACKGROUND, camera.image(rng=np.random.default_rng(0)))
    for number, (x, y, depth) in enumerate(where):
        press = Press(x, y, float(gel.top(x, y)), 0.0, 0.0, -depth, 0.0)
        result = solver.solve(Scene(gel, Material(), ball, press))
        field = field_of(gel, surface_of(result.solved_mesh, result.displacement, press))
        picture = camera.image(field, Pressed(body, press), np.random.default_rng(number + 1))
        (path := folder / f"{diameter:.3f}mm" / str(number)).mkdir(parents=True)
        write_png(path / "gelsight.png", picture)
    return folder


def true_force(diameter: float, depth: float) -> float:
    """Normal force in N of a ball that is pressed so many mm deep, between the depths of the table."""
    force = ball_table().curve(diameter).force
    return float(np.exp(np.interp(np.log(depth), np.log(DEPTHS), np.log(force))))
