"""Presses of wide flat bodies that lean, drawn by the rig: how large the contact is that a network reads in them.

Poses are those of FEATS' wide presses, whose real bench leans by 2 to 3 degrees about one axis.
"""

from pathlib import Path

import numpy as np

from gelforge.api import SolvedPress, label
from gelforge.geometry.gel import Gel
from gelforge.geometry.indenters import load_catalogue
from gelforge.geometry.solids import Indenter
from gelforge.labelling.sensor import load_sensors
from gelforge.mechanics.material import REFERENCE_C10, Material
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solvers.hex import HexSolver
from gelforge.reading.model import ForceModel
from gelforge.reading.reader import Reader
from gelforge.records.press import Press
from gelforge.records.table import read_table
from gelforge.virtualrig.appearance import read_appearances
from gelforge.virtualrig.bench import SETTINGS
from gelforge.virtualrig.fields import body_of, field_of, surface_of
from gelforge.virtualrig.render import Pressed, Renderer
from tests.benchmarks.parts.balls import RIG_C10, UNITS
from tests.benchmarks.parts.leant import WIDE
from tests.support.figures import ROOT, Figure

TILT_DEG, DEPTH_MM = 2.0, 0.6
FOOT = 0.35  # fraction of a map's largest force from which a cell counts as pressed


def wide_poses(reference: Path) -> list[tuple[str, Press]]:
    """Indenter and leaning press of each of FEATS' wide presses."""
    rows = [row for row in read_table(reference / "feats/consensus.csv", "") if row["indenter"] in WIDE]
    tip = Gel().top
    return [
        (row["indenter"], Press(x, y, float(tip(x, y)), 0.0, 0.0, -DEPTH_MM, float(row["rot_deg"]), TILT_DEG))
        for row in rows
        for x, y in [(float(row["x_mm"]), float(row["y_mm"]))]
    ]


def area(normal: np.ndarray) -> int:
    """Cells of a map of normal force (rows, cols) N, larger for more pressure, that count as pressed."""
    return int((normal > FOOT * normal.max()).sum())


def pressed_twin(body: Indenter, press: Press) -> SolvedPress:
    """The press solved as the rig does, at the reference stiffness."""
    result = HexSolver(SETTINGS).solve(Scene(Gel(), Material(), body, press))
    nan = float("nan")
    return SolvedPress("gelsight_mini", result.solved_mesh, result.forces, result.displacement, nan, nan, {},
                       body.name, "draft", -press.dz)  # fmt: skip


def twin_figures(reference: Path, model: ForceModel) -> list[Figure]:
    """Area and force that are read of leaning twins on two units of the rig, over those of their labels."""
    poses, sensors = wide_poses(reference), load_sensors(ROOT / "workflow/sensors.toml")
    looks = read_appearances(ROOT / "workflow/rig/sensors.toml")
    bodies = load_catalogue(ROOT / "workflow/indenters.toml", sorted({name for name, _ in poses}))
    solved = [pressed_twin(bodies[name], press) for name, press in poses]
    figures = []
    for unit in UNITS:
        camera = Renderer(looks[unit], sensors[unit].projection, Gel())
        reader = Reader(camera.image(rng=np.random.default_rng(0)), model=model)
        areas, forces = [], []
        for k, ((name, press), one) in enumerate(zip(poses, solved, strict=True)):
            field = field_of(Gel(), surface_of(one.mesh, one.displacement, press))
            body = Pressed(body_of(bodies[name], 0.0, 0.6, 0.0), press)
            read = -reader(camera.image(field, body, np.random.default_rng(k + 1))).cells[2]
            true = -label(one, sensor=sensors[unit])[2]
            areas.append(area(read) / area(true))
            forces.append(float(read.sum() / true.sum()) * REFERENCE_C10 / RIG_C10)
        median = float(np.median(areas))
        note = f"median {median:.2f}, {min(areas):.2f} to {max(areas):.2f}; {len(areas)} presses at {TILT_DEG:g} degrees; force {np.median(forces):.2f}, {min(forces):.2f} to {max(forces):.2f}"
        worst = 100 * float(np.abs(np.array(areas) - 1).max())
        figures.append(
            Figure(f"leaning twins, {unit}: area of contact read, largest error", worst, "<=", 10.0, "%", note)
        )
    return figures
