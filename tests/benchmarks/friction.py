"""Presses under Coulomb's law beside paths of eight times as many load steps on the same hexahedra.

Forty presses (TABLE): straight, dragged and sliding, of balls, flat, sharp and long bodies, at coefficients of 0.2 to
0.9. Both totals are without extrapolation, so that errors are those of the path alone. The long paths take twenty
minutes of one thread for `draft`; they are kept below --work as long as settings and presses are the same, whatever
code solved them.
"""

import hashlib
import math
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np

from gelforge.flow.cli import command, option
from gelforge.flow.files import read_json, write_json
from gelforge.geometry.gel import USUAL_GEL, load_gel
from gelforge.geometry.indenters import load_catalogue
from gelforge.mechanics.hexsettings import quality
from gelforge.mechanics.material import Material
from gelforge.mechanics.result import Result
from gelforge.mechanics.scene import Interface, Scene
from gelforge.mechanics.solve import hexahedra_key
from gelforge.mechanics.solvers.hex import HexSolver
from gelforge.records.press import Press
from gelforge.records.status import Status
from gelforge.sweeps.isolate import Clock
from tests.support.figures import ROOT, Figure, publish_figures

STEPS = 8  # times as many load steps in the long path
# Indenter, depth mm, sideways travel mm, its direction and the turn of the indenter in degrees, friction coefficient.
TABLE: tuple[tuple[str, float, float, float, float, float], ...] = (
    ("sphere_15", 0.8, 0.0, 0.0, 0.0, 0.7),
    ("sphere_10", 0.8, 0.2, 0.0, 0.0, 0.7),
    ("triangle_10", 0.8, 0.0, 0.0, 0.0, 0.7),
    ("cuboid_10", 0.4, 0.1, 0.0, 0.0, 0.4),
    ("cylinder_8", 0.6, 0.3, 0.0, 0.0, 0.7),
    ("pyramid_10", 1.0, 0.1, 0.0, 0.0, 0.7),
    ("bar_5", 0.6, 0.0, 0.0, 0.0, 0.3),
    ("sphere_10", 0.5, 1.2, 0.0, 0.0, 0.4),
    ("cuboid_10", 0.4, 0.94, 0.0, 0.0, 0.35),
    ("cuboid_10", 1.0, 0.0, 0.0, 0.0, 0.69),
    ("cuboid_7", 0.4, 0.94, 0.0, 0.0, 0.2),
    ("cuboid_7", 0.5, 0.0, 0.0, 20.0, 0.7),
    ("sphere_10", 0.6, 0.0, 0.0, 0.0, 0.3),
    ("sphere_20", 0.5, 0.0, 0.0, 0.0, 0.9),
    ("bar_5", 0.5, 0.0, 0.0, 30.0, 0.7),
    ("bar_10", 0.4, 0.0, 0.0, 90.0, 0.5),
    ("pyramid_10", 1.0, 0.0, 0.0, 15.0, 0.5),
    ("cylinder_8", 0.5, 0.0, 0.0, 0.0, 0.6),
    ("cross_15_10_3", 0.4, 0.0, 0.0, 10.0, 0.6),
    ("ellipse_15_10", 0.5, 0.0, 0.0, 0.0, 0.4),
    ("sloping_cuboid_10", 0.7, 0.0, 0.0, 0.0, 0.7),
    ("polygon_6_10", 0.4, 0.0, 0.0, 0.0, 0.2),
    ("cuboid_15", 0.3, 0.2, 40.0, 10.0, 0.7),
    ("triangle_15", 0.5, 0.2, 70.0, 0.0, 0.5),
    ("bar_5", 0.5, 0.2, 20.0, 0.0, 0.6),
    ("sphere_20", 0.6, 0.3, 130.0, 0.0, 0.4),
    ("cuboid_7", 0.6, 0.25, 60.0, 30.0, 0.9),
    ("ellipse_15_10", 0.5, 0.2, 45.0, 0.0, 0.7),
    ("cross_15_10_3", 0.5, 0.15, 90.0, 0.0, 0.7),
    ("sloping_cuboid_10", 0.8, 0.2, 30.0, 0.0, 0.5),
    ("triangle_10", 0.6, 0.3, 200.0, 40.0, 0.8),
    ("cuboid_7", 0.4, 0.94, 50.0, 0.0, 0.3),
    ("cylinder_8", 0.4, 1.0, 10.0, 0.0, 0.3),
    ("sphere_15", 0.6, 1.5, 80.0, 0.0, 0.6),
    ("sphere_15", 0.5, 1.0, 0.0, 0.0, 0.2),
    ("bar_5", 0.5, 0.8, 30.0, 0.0, 0.4),
    ("pyramid_10", 0.8, 1.0, 60.0, 0.0, 0.4),
    ("triangle_10", 0.6, 1.0, 15.0, 0.0, 0.5),
    ("cylinder_8", 0.56, 1.48, 125.0, 0.0, 0.7),
    ("ellipse_15_10", 0.4, 1.2, 20.0, 0.0, 0.3),
)
GOALS = {"draft": {"median": 0.2, "worst": 0.8, "over": 1.5, "iterations": (25, 80)}}


def scene_of(row: tuple[str, float, float, float, float, float], catalogue: dict) -> Scene:
    """The scene of a row of TABLE."""
    name, depth, travel, degrees, turn, mu = row
    way = math.radians(degrees)
    press = Press(0.0, 0.0, 0.0, travel * math.cos(way), travel * math.sin(way), -depth, turn)
    return Scene(load_gel(USUAL_GEL), Material(), catalogue[name], press, Interface.of_friction(mu)).direct


def bare(result: Result) -> np.ndarray:
    """Total force (3,) N without extrapolation."""
    return np.asarray(result.total) / float(result.evidence.get("extrapolated", 1.0))


def long_path(which: str, row: tuple, scene: Scene, work: Path) -> np.ndarray:
    """Total force (3,) N at the end of the long path, from `work` or solved; NaN where it fails."""
    settings = replace(quality(which).with_steps(STEPS), nested=None, walk_mm=0.0, slide_mm=0.0)
    key = hashlib.sha256(repr([row, hexahedra_key(settings)]).encode()).hexdigest()[:16]
    path = work / f"{key}.json"
    if not path.exists():
        found = HexSolver(settings).solve(scene)
        total = bare(found).tolist() if found.status is Status.OK else None
        write_json(path, {"press": list(row), "method": which, "total": total})
    total = read_json(path)["total"]
    return np.full(3, np.nan) if total is None else np.array(total)


def measured(which: str, work: Path, numbers: range) -> list[dict]:
    """Error in %, iterations, fallback and processor time of each press, and that of the same press without slip."""
    catalogue, rows = load_catalogue(ROOT / "workflow/indenters.toml"), []
    HexSolver(quality(which)).solve(scene_of(TABLE[0], catalogue))  # compiles what numba compiles
    for at in numbers:
        scene = scene_of(TABLE[at], catalogue)
        true = long_path(which, TABLE[at], scene, work)
        with Clock() as clock:
            found = HexSolver(quality(which)).solve(scene)
        stuck = replace(scene, interface=Interface("no_slip"))
        with Clock() as beside:
            HexSolver(quality(which)).solve(stuck)
        off = 100.0 * np.linalg.norm(bare(found) - true) / np.linalg.norm(true)
        row = {
            "press": list(TABLE[at]), "status": found.status.name, "off": float(off) if found.status is Status.OK else math.nan,
            "iterations": found.evidence["newton_iterations"], "fell_back": found.evidence.get("fell_back", ""),
            "slipping": found.evidence.get("slipping", math.nan), "seconds": clock.cpu_seconds, "no_slip_seconds": beside.cpu_seconds,
        }  # fmt: skip
        rows.append(row)
        print(f"{which} {at:2d} {TABLE[at]}: {row['off']:.2f} %, {row['iterations']} iterations, {row['seconds']:.1f} s, "
              f"{row['no_slip_seconds']:.1f} s without slip {row['fell_back']}", flush=True)  # fmt: skip
    return rows


def figures_of(which: str, rows: list[dict]) -> list[Figure]:
    """Median and worst of the presses whose long path ended, and how many fell back or failed."""
    goals = GOALS.get(which, {})
    known = [row for row in rows if math.isfinite(row["off"])]
    off = np.array([row["off"] for row in known])
    iterations = np.array([row["iterations"] for row in known])
    over = np.median([row["seconds"] / row["no_slip_seconds"] for row in known])
    worst = known[int(off.argmax())]
    middle, most = goals.get("iterations", (0.0, 0.0))

    def figure(what: str, value: float, goal: float, unit: str = "", note: str = "") -> Figure:
        return Figure(f"{which}: {what}", float(value), "<=" if goal else "", goal, unit, note)

    failed = sum(row["status"] != Status.OK.name for row in rows)
    return [
        figure("error, median", np.median(off), goals.get("median", 0.0), "%", f"{len(known)} presses"),
        figure("error, worst", off.max(), goals.get("worst", 0.0), "%", str(worst["press"])),
        figure("Newton iterations, median", np.median(iterations), middle),
        figure("Newton iterations, worst", iterations.max(), most),
        figure("processor time over that without slip, median", over, goals.get("over", 0.0)),
        figure("fell back to a path on fine hexahedra", sum(bool(row["fell_back"]) for row in rows), 0.0, "presses"),
        Figure(f"{which}: failed", float(failed), "==", 0.0, "presses"),
    ]


@command(
    option("--work", type=Path, default=Path("results/benchmarks/friction"), help="folder of the long paths"),
    option("--only", choices=("draft", "label"), default="draft"),
    option("--presses", type=int, default=len(TABLE), help="only the first so many"),
    option("--out", type=Path),
)
def main(args: Namespace) -> None:
    args.work.mkdir(parents=True, exist_ok=True)
    rows = measured(args.only, args.work, range(len(TABLE))[: args.presses])
    publish_figures(args.out, figures_of(args.only, rows), presses=rows)


if __name__ == "__main__":
    main.exit()
