"""What labels cost in process: frames of one press, growth with the number of unknowns, many presses at once."""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from gelforge.labelling.sensor import Sensor
from gelforge.mechanics.hexsettings import HexSettings, quality
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solvers.hex import HexSolver
from gelforge.records.status import Status
from gelforge.sweeps.isolate import Clock, isolated, peak_mib
from gelforge.sweeps.methods import warm_up
from gelforge.sweeps.trial import cells_of
from tests.support.figures import Figure

FRAMES = 6
# Sizes of hexahedra under the press and layers, from some 5 000 to some 200 000 unknowns on a 10 mm cuboid.
GROWTH = ((0.9, 4), (0.6, 4), (0.45, 5), (0.35, 5), (0.25, 6), (0.2, 8), (0.165, 9))
LIMIT_S = 1800.0
BATCH = 12  # presses that each of the processes solves at once


# -- frames of one press


def frames_along(scene: Scene, count: int = FRAMES) -> list[Scene]:
    """`count` frames of a press: evenly down, and where it goes sideways the last two of them along that way."""
    press = scene.press
    aside = 2 if press.dx or press.dy else 0
    fractions = [(k / (count - aside), 0.0) for k in range(1, count - aside + 1)]
    fractions += [(1.0, k / aside) for k in range(1, aside + 1)]
    return [replace(scene, press=replace(press, dz=down * press.dz, dx=to * press.dx, dy=to * press.dy))
            for down, to in fractions]  # fmt: skip


def frames_of(scene: Scene, sensor: Sensor) -> dict:
    """Time of all frames over that of the last alone, and each frame's distance from a press solved to it alone."""
    settings, parts = quality("label"), frames_along(scene)
    warm_up()
    alone, whole = HexSolver(settings), HexSolver(settings)
    with Clock() as one:
        last = alone.solve(scene)
    with Clock() as all_:
        found = whole.solve_frames(parts)
    differences = []
    for part, result in zip(parts, found, strict=True):
        single = HexSolver(settings).solve(part)
        size = np.linalg.norm(single.total)
        cells, other = (cells_of(r.mesh, r.forces, sensor)[0] for r in (result, single))
        differences.append([float(np.linalg.norm(result.total - single.total) / size),
                            float(np.linalg.norm(cells - other, axis=0).sum() / size)])  # fmt: skip
    valid = all(r.status is Status.OK for r in [last, *found])
    return {"ratio": all_.cpu_seconds / one.cpu_seconds, "differences": differences, "valid": valid}


def frame_figures(scenes: dict[str, Scene], sensor: Sensor) -> list[Figure]:
    """Cost and agreement of frames over the scenes."""
    found = {name: frames_of(scene, sensor) for name, scene in scenes.items()}
    ratio = float(np.median([record["ratio"] for record in found.values()]))
    figures = [
        Figure(f"a press with {FRAMES} frames against its last alone, median scene", ratio, "<=", 2.0, "times"),
        Figure("scenes whose frames are all valid", sum(r["valid"] for r in found.values()), ">=", len(found)),
    ]
    for k, (what, goal) in enumerate((("total force", 0.3), ("cells", 2.0))):
        worst = {name: max(100 * frame[k] for frame in record["differences"]) for name, record in found.items()}
        late = max(
            100 * record["differences"][at][k] for record in found.values() for at in range(FRAMES // 2, FRAMES)
        )
        name = max(worst, key=worst.get)
        note = f"{name}; the later half of the frames {late:.2g}"
        figures.append(Figure(f"frames against single presses, worst {what}", worst[name], "<=", goal, "%", note))
    return figures


# -- growth with unknowns


def grown(scene: Scene, size: float, layers: int) -> dict:
    """Cost of one solve on hexahedra of a size, in a process of its own."""
    return isolated(partial(_grown, scene, size, layers), LIMIT_S)


def _grown(scene: Scene, size: float, layers: int) -> dict:
    warm_up()
    settings = replace(quality("label"), size=size, layers=layers, across=0)
    solver = HexSolver(settings)
    with Clock() as clock:
        result = solver.solve(scene)
    unknowns = 3 * (len(result.mesh.nodes) - len(result.mesh.base))
    return {"status": result.status.name, "unknowns": unknowns, "cpu_seconds": clock.cpu_seconds,
            "peak_mib": peak_mib()}  # fmt: skip


def exponent(records: list[dict], key: str = "cpu_seconds") -> float:
    """Slope of log(cost) over log(unknowns), least squares."""
    x, y = (np.log([record[k] for record in records]) for k in ("unknowns", key))
    return float(np.polyfit(x, y, 1)[0])


def growth_figures(scene: Scene) -> list[Figure]:
    """Solve the scene on ever smaller hexahedra."""
    records = [grown(scene, size, layers) for size, layers in GROWTH]
    solved = [record for record in records if record["status"] == "OK"]
    assert all(a["unknowns"] < b["unknowns"] for a, b in pairwise(solved))
    note = ", ".join(f"{r['unknowns'] / 1000:.0f}k {r['cpu_seconds']:.1f} s {r['peak_mib']:.0f} MiB" for r in solved)
    return [
        Figure("solved of the sizes of hexahedra", len(solved), ">=", len(GROWTH), "", note),
        Figure("exponent of time over unknowns", exponent(solved), "<=", 2.0, "", "nested dissection in space: 2"),
        Figure("exponent of memory over unknowns", exponent(solved, "peak_mib"), "<=", 4 / 3, "", "the same: 4/3"),
    ]


# -- many presses at once


def solve_batch(scenes: list[Scene], settings: HexSettings) -> float:
    """Solve scenes one after another; seconds by the clock, without what starting a process costs."""
    solver = HexSolver(settings)
    with Clock() as clock:
        for scene in scenes:
            solver.solve(scene)
    return clock.seconds


def presses_an_hour(scenes: list[Scene], processes: int) -> float:
    """Rate at which so many processes, each with all of the scenes, solve them to label quality."""
    with ProcessPoolExecutor(processes, initializer=warm_up) as pool:
        took = list(pool.map(solve_batch, [scenes] * processes, [quality("label")] * processes))
    return 3600.0 * len(scenes) * processes / max(took)


def throughput_figures(scenes: list[Scene], cores: int = 2) -> list[Figure]:
    """Presses an hour with one process and with two, by the clock: on a machine that does other things, less."""
    one, many = (presses_an_hour(scenes[:BATCH], count) for count in (1, cores))
    return [
        Figure(f"throughput of {cores} processes over that of one", many / one, ">=", 0.9 * cores, "times",
               f"{one:.0f} and {many:.0f} presses an hour"),
    ]  # fmt: skip
