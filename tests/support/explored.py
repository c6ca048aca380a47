"""An invented dataset of any size for the report's page: real packing, simple numbers."""

import numpy as np

from gelforge.geometry.gel import USUAL_GEL, load_gel
from gelforge.records.press import PosedPress
from gelforge.records.samplefile import DatasetSample
from gelforge.records.solvetable import Solved
from gelforge.records.status import Status
from gelforge.reporting.explorer import Explorer, grid_points
from gelforge.reporting.page import Explored, render
from gelforge.reporting.parts import MICRON, PART, arrows, in_parts, jpeg, pack, place_parts
from gelforge.reporting.presses import as_columns, press_rows
from tests.support.press_records import press_record

GRID = (24, 32)
SHAPES = ("sphere_15", "cuboid_10", "cylinder_8")
SPLITS = ("train", "train", "train", "val", "test")
GELS = {"mini_a": "gelsight_mini", "mini_b": "gelsight_mini-2.6mm"}


def tables(count: int):
    """Rows of the stages' tables for `count` presses; every tenth solve failed, one row of the log was rejected."""
    rng = np.random.default_rng(3)
    poses, solved, samples, wrenches = [], {}, {}, {}
    for k in range(count):
        name = f"made-{k:06d}"
        place = {"x0_mm": rng.uniform(-6, 6), "y0_mm": rng.uniform(-8, 8), "z0_mm": 0.0, "dx_mm": 0.1, "dy_mm": 0.0,
                 "dz_mm": -rng.uniform(0.3, 1.5), "rot_deg": rng.uniform(0, 360)}  # fmt: skip
        force = (0.3, -0.1, 12 * place["dz_mm"])
        press = press_record(row=k + 2, sample_id=name, indenter=SHAPES[k % 3], sensor_id=list(GELS)[k % 2],
                             fz_n=force[2], **place)  # fmt: skip
        posed = PosedPress(**{key: value for key, value in vars(press).items() if key != "time_utc"})
        poses.append((f"{k // 100:04d}", posed))
        good = k % 10 != 9
        status, reason = (Status.OK, "") if good else (Status.DIVERGED, "no equilibrium <b>at</b> 0.7")
        evidence = {"seconds": 1.5, "peak_mib": 120}
        solved[name] = Solved(
            name,
            status,
            reason,
            "hex",
            "hex@made",
            "",
            force if good else (0.0, 0.0, 0.0),
            evidence,
            moment=(1.0, 2.0, 3.0),
        )
        if good:
            # Two frames are one press.
            samples[name] = DatasetSample(
                posed, np.array([*force, 0.001, 0.002, 0.003]), np.zeros(6), {}, SPLITS[k // 2 % 5], str(k // 2)
            )
            wrenches[name] = (0.3, -0.1 + 0.02, force[2] + rng.normal(0, 0.5), 1.1, 2.1, 3.1)
    rejected = [{"sample_id": "", "shard": "0000", "row": "7", "column": "dz_mm", "value": "x",
                 "reason": "not a number", "hint": "write a number of millimetres"}]  # fmt: skip
    return poses, rejected, solved, samples, wrenches, GELS


def press(k: int, shown: bool = True) -> dict:
    """What the page draws of press `k`: a bump whose row depends on k."""
    rows, cols = np.mgrid[: GRID[0], : GRID[1]]
    bump = np.exp(-((rows - 4 - k % 16) ** 2 + (cols - 16) ** 2) / 12.0)
    label = np.stack([0.01 * bump, 0.02 * bump, -0.2 * bump])
    points = grid_points(load_gel("gelsight_mini"))[2]
    dent = -np.exp(-(points[:, 0] ** 2 + points[:, 1] ** 2) / 9.0)
    packed = {"label": label, "network": 1.1 * label, "gel": (np.column_stack([0 * dent, 0 * dent, dent]), MICRON)}
    packed |= arrows(points[::20], np.column_stack([0 * dent, 0 * dent, dent])[::20])
    image = np.full((240, 320, 3), 90 + k % 100, np.uint8)
    return ({"image": jpeg(image)} | pack(packed)) if shown else pack({})


def write_page(folder, count: int, limit: float = 12e6):
    """Write the page of `count` presses to a folder, and its parts beside it if they are large; return its path."""
    rows = press_rows(*tables(count))
    explorer = Explorer(folder, "24x32", rows, {}, load_gel(USUAL_GEL))
    made = [press(k) for k in range(16)]
    shown = (made[k % 16] if row["status"] == "OK" else press(k, False) for k, row in enumerate(rows))
    beside, held = place_parts(folder, in_parts(shown), limit)
    controls = {
        name: {"n": 9, "controls": {"constant_guess": {"fx": 1.0, "fy": 1.0, "fz": 4.0}}} for name in set(SPLITS)
    }
    data = {
        "columns": as_columns(rows), "shared": explorer.shared(), "costs": {"10_poses/0000": [2.0, 1.5, 100.0]},
        "stages": [{"name": name, "targets": 3, "seconds": 4.0, "cpu_seconds": 3.0, "peak_mib": 90.0, "reads": reads}
                   for name, reads in (("10_poses", []), ("30_fea", ["10_poses"]), ("90_report", ["30_fea", "10_poses"]))],
        "about": {"dataset": "made", "resolution": "24x32", "model": "made", "learnt_here": True, "grid": list(GRID),
                  "force_edges": [0.0, 2.0, 5.0, 10.0], "controls": controls},
        "parts": {"size": PART, "beside": beside},
    }  # fmt: skip
    path = folder / "index.html"
    path.write_text(render("made <i>up</i>", "a made-up dataset", [], Explored(data, held)), encoding="utf-8")
    return path
