"""Presses of a ball by hand into a real sensor: the imprint's radius and finite elements give the force that was pressed.

The level is uncertain by a quarter (circles are marked by hand, the diameter is a catalogue's); spread and correlation are less so.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from gelforge.geometry.gel import Gel
from gelforge.geometry.indenters import build
from gelforge.labelling.sensor import load_sensors
from gelforge.mechanics.material import REFERENCE_C10, Material
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solvers.hex import HexSolver
from gelforge.networks.balls.ballpresses import BACKGROUND, BallPress, read_presses
from gelforge.networks.balls.balltable import ball_table
from gelforge.networks.balls.slopefit import fit_slope_table, known_slopes
from gelforge.networks.checkpoint.modelfile import ForceModel
from gelforge.networks.inference.predictor import Predictor
from gelforge.networks.inference.sensorprofile import fit_gain
from gelforge.networks.preprocess.illumination import match_light
from gelforge.networks.preprocess.slopetable import SlopeTable, light_change
from gelforge.records.forcereading import ForceReading
from gelforge.records.image import read_image, write_png
from gelforge.records.press import Press
from gelforge.virtualrig.appearance import read_appearances
from gelforge.virtualrig.bench import SETTINGS
from gelforge.virtualrig.fields import RoughBody, Surface, body_of, field_of, surface_of
from gelforge.virtualrig.render import Pressed, Renderer
from tests.benchmarks.ball_table import DEPTHS
from tests.benchmarks.figures import Figure

FOLDER = "balls/unit_a"
ROOT = Path(__file__).parents[2]
BALLS_MM = (4.0, 6.0)
# Where balls are pressed that the virtual rig draws: x, y and depth in mm.
DRAWN = (
    (-3.0, -5.0, 0.6), (3.0, -4.0, 1.4), (2.5, 4.5, 0.8), (-2.5, 5.0, 1.2),
    (0.5, 0.5, 1.0), (-3.5, 0.0, 1.5), (3.5, 1.0, 0.5), (0.0, -6.0, 0.9),
)  # fmt: skip
UNITS = {"mini_a": "weak", "mini_b": "strong"}  # of the rig's own, and how their light answers to a slope
MOTIONS = (
    1.0,
    0.7,
    0.5,
)  # factors on the in-plane motion of the way down; around real balls it is half of what is solved
RIG_C10 = 0.0785  # MPa, of the plans that the shipped network learnt from


def ball_figures(presses: list[BallPress], read: Sequence[ForceReading]) -> list[Figure]:
    """Forces that are read over those of finite elements, and again with a factor from every other press."""
    normal, force = np.array([-one.total[2] for one in read]), np.array([p.force for p in presses])
    note = f"{len(presses)} presses that lie completely in the image; the level is uncertain by a quarter"
    gain = fit_gain(force[::2], normal[::2])
    fitted = (
        f"{len(force[1::2])} presses; factor {gain.value:.2f} ({gain.low:.2f} to {gain.high:.2f}) from the others"
    )
    return [
        *_level("real balls, read over finite elements", normal, force, note),
        depth_figure(normal / force, force),
        *_level("real balls, factor of every other press", gain.value * normal[1::2], force[1::2], fitted),
        Figure("good ball presses flagged", 100 * float(np.mean([one.flag for one in read])), "<=", 2.0, "%"),
    ]


def depth_figure(ratio: np.ndarray, force: np.ndarray) -> Figure:
    """Whether deep presses are read as shallow ones are: ratio (n,) of read forces to known ones (n,) N."""
    thirds = [float(np.median(ratio[of])) for of in np.array_split(np.argsort(force), 3)]
    note = "thirds " + ", ".join(f"{third:.2f}" for third in thirds)
    return Figure("real balls, the deepest third over the shallowest", thirds[2] / thirds[0], ">=", 0.95, "", note)


def _level(what: str, normal: np.ndarray, force: np.ndarray, note: str) -> list[Figure]:
    """Level, spread and correlation of normal forces (n,) N with those of finite elements."""
    median = float(np.median(normal / force))
    low, high = (np.quantile(normal / force, [0.1, 0.9]) / median).tolist()
    r = float(np.corrcoef(normal, force)[0, 1])
    return [
        Figure(f"{what}, median: at least", median, ">=", 0.9, "", note),
        Figure(f"{what}, median: at most", median, "<=", 1.15),
        Figure(f"{what}: over the median, 10 %", low, ">=", 0.8),
        Figure(f"{what}: over the median, 90 %", high, "<=", 1.2),
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
    for unit in UNITS:
        for diameter in BALLS_MM:
            place = draw_balls(folder / f"{unit}_{diameter:g}", unit, diameter, DRAWN)
            found = read_presses(place, read_image(place / BACKGROUND)).presses
            predicted += [press.force for press in found]
            truth += [true_force(diameter, DRAWN[int(Path(press.name).name)][2]) for press in found]
    asked = len(UNITS) * len(BALLS_MM) * len(DRAWN)
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
    folder.mkdir(parents=True)
    write_png(folder / BACKGROUND, camera.image(rng=np.random.default_rng(0)))
    for number, place in enumerate(where):
        (path := folder / f"{diameter:.3f}mm" / str(number)).mkdir(parents=True)
        write_png(path / "gelsight.png", drawn_press(camera, diameter, place, number))
    return folder


@cache
def pressed_ball(diameter: float, x: float, y: float, depth: float) -> tuple[RoughBody, Surface]:
    """A ball pressed into the usual gel, and the gel's surface; solved once for every camera."""
    gel, ball = Gel(), build("ball", {"kind": "sphere", "diameter": diameter, "height": diameter}, "a drawn ball")
    press = Press(x, y, float(gel.top(x, y)), 0.0, 0.0, -depth, 0.0)
    result = HexSolver(SETTINGS).solve(Scene(gel, Material(), ball, press))
    return body_of(ball, 0.0, 0.6, 0.0), surface_of(result.solved_mesh, result.displacement, press)


def drawn_press(camera: Renderer, diameter: float, place: tuple[float, float, float], number: int) -> np.ndarray:
    """What a camera shows of a ball; place: x, y and depth, mm. number: of the press, which its noise belongs to."""
    body, surface = pressed_ball(diameter, *place)
    return camera.image(field_of(Gel(), surface), Pressed(body, surface.press), np.random.default_rng(number + 1))


def drawn_totals(model: ForceModel, unit: str, **changed) -> np.ndarray:
    """Normal forces (n,) N that are predicted of balls on a unit of the rig with another appearance when it is pressed."""
    look = read_appearances(ROOT / "workflow/rig/sensors.toml")[unit]
    projection = load_sensors(ROOT / "workflow/sensors.toml")[unit].projection
    camera = Renderer(replace(look, **changed), projection, Gel())
    predictor = Predictor(model, Renderer(look, projection, Gel()).image(rng=np.random.default_rng(0)))
    images = [drawn_press(camera, d, place, k) for d in BALLS_MM for k, place in enumerate(DRAWN)]
    return np.array([-predictor.predict(image).total[2] for image in images])


def motion_figures(model: ForceModel) -> list[Figure]:
    """Forces predicted of drawn balls whose markers move less than finite elements say, and how much of them hangs on what."""
    true = np.array([true_force(d, depth) for d in BALLS_MM for *_, depth in DRAWN]) * RIG_C10 / REFERENCE_C10
    figures, gone = [], {"in-plane motion": {"normal_motion": 0.0}, "slopes": {"slope_gain": np.zeros(3)}}
    shares: dict[str, list[float]] = {what: [] for what in gone}
    for unit, contrast in UNITS.items():
        exponents = []
        for motion in MOTIONS:
            read = drawn_totals(model, unit, normal_motion=motion)
            ratio = read / true
            exponents.append(float(np.polyfit(np.log(true), np.log(np.maximum(read, 0.05)), 1)[0]))
            note = f"median {np.median(ratio):.2f}, {ratio.min():.2f} to {ratio.max():.2f}; {len(ratio)} presses of {contrast} contrast"
            off = 100 * abs(float(np.median(ratio)) - 1)
            what = f"drawn balls, {unit}, in-plane motion times {motion:g}: predicted force, error"
            figures.append(Figure(what, off, "<=", 8.0, "%", note))
            if motion == 1.0:
                for what, change in gone.items():
                    shares[what].append(100 * float(np.median(1 - drawn_totals(model, unit, **change) / read)))
        off, note = max(abs(one - 1) for one in exponents), ", ".join(f"{one:.2f}" for one in exponents)
        figures.append(
            Figure(f"drawn balls, {unit}: exponent of predicted over true force, beside 1", off, "<=", 0.05, "", note)
        )
    for (what, found), goal in zip(shares.items(), (25.0, 0.0), strict=True):
        note = ", ".join(f"{unit} {share:.0f} %" for unit, share in zip(UNITS, found, strict=True))
        compare = "<=" if goal else ""
        figures.append(
            Figure(f"drawn balls, force that is gone without {what}", max(found), compare, goal, "%", note)
        )
    return figures


def true_force(diameter: float, depth: float) -> float:
    """Normal force in N of a ball that is pressed so many mm deep, between the depths of the table."""
    force = ball_table().curve(diameter).force
    return float(np.exp(np.interp(np.log(depth), np.log(DEPTHS), np.log(force))))
