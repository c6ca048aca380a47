"""Results on other processors: every scene of the chart under the code paths of MKL and numba, and with two threads.

A processor chooses among code paths that differ in the last bits. Each case runs in a process of its own; what it gave is
kept beside the JSON and taken from there while scenes and solver stay the same.
"""

import hashlib
import json
import os
import subprocess
import sys
from argparse import Namespace
from pathlib import Path

import numpy as np

from gelforge.flow import params as config
from gelforge.flow.files import read_json, write_json
from gelforge.flow.main import command, option
from gelforge.labelling.sensor import load_sensors
from gelforge.sweeps.scenes import parse_scene, read_tables
from gelforge.sweeps.trial import cells_of
from tests.benchmarks.figures import Figure, publish_figures

CASES = {
    "AVX2": {"MKL_CBWR": "AVX2"},
    "AVX512": {"MKL_CBWR": "AVX512"},
    "COMPATIBLE": {"MKL_CBWR": "COMPATIBLE"},
    "two threads": {"MKL_NUM_THREADS": "2", "OMP_NUM_THREADS": "2"},
    "generic": {"MKL_CBWR": "COMPATIBLE", "NUMBA_CPU_NAME": "generic"},
}
TOTAL, CELLS = 0.1, 1.0  # % that results may be apart


def solve_scenes(quality: str, names: list[str] | None, workflow: Path) -> dict[str, dict]:
    """Total force (3,) and cells (3, 24, 32) in N of scenes solved in this process by `hex` at a quality."""
    from gelforge.mechanics.hex.solver import HexSolver
    from gelforge.mechanics.hex.solver import quality as settings

    params = config.load_params(workflow)
    sensor = load_sensors(workflow / "sensors.toml")[params["pareto"]["sensor"]]
    tables = read_tables(workflow)
    found = {}
    for name in names or tables:
        result = HexSolver(settings(quality)).solve(parse_scene(name, tables[name], params["material"]["nu"]).scene)
        cells, _ = cells_of(result.mesh, result.forces, sensor)
        found[name] = {"status": result.status.name, "total": result.total.tolist(), "cells": cells.tolist()}
    return found


def on_machine(case: str, quality: str, names: list[str] | None, folder: Path, workflow: Path) -> dict[str, dict]:
    """`solve_scenes` in a process whose libraries take the code path of a case; kept in the folder."""
    source = Path(__file__).parents[2] / "src" / "gelforge" / "mechanics"
    parts = [path.read_bytes() for path in sorted(source.rglob("*.py"))] + [(workflow / "scenes.toml").read_bytes()]
    key = hashlib.sha256(b"".join(parts) + json.dumps([case, quality, names]).encode()).hexdigest()[:16]
    kept = folder / f"{quality}-{case.replace(' ', '-')}-{key}.json"
    if not kept.exists():
        asked = [sys.executable, "-m", "tests.benchmarks.machines", "--quality", quality, "--workflow", str(workflow)]
        asked += ["--out", str(kept), *(["--scenes", *names] if names else [])]
        caches = {"NUMBA_CACHE_DIR": str(folder / "numba" / case)} if "NUMBA_CPU_NAME" in CASES[case] else {}
        subprocess.run(asked, check=True, env={**os.environ, **CASES[case], **caches})
    return read_json(kept)


def apart(results: list[dict]) -> tuple[float, float]:
    """Largest differences, % of the force, of total and of cells between any two results of one scene."""
    totals, cells = ([np.array(result[name]) for result in results] for name in ("total", "cells"))
    size = np.linalg.norm(totals[0])
    total = max(np.linalg.norm(a - b) for a in totals for b in totals)
    cell = max(np.linalg.norm(a - b, axis=0).sum() for a in cells for b in cells)
    return 100 * total / size, 100 * cell / size


def compare(
    quality: str, folder: Path, workflow: Path, names: list[str] | None = None
) -> dict[str, tuple[float, float]]:
    """Differences between the machines by scene, of one quality."""
    machines = [on_machine(case, quality, names, folder, workflow) for case in CASES]
    return {name: apart([found[name] for found in machines]) for name in machines[0]}


def figures_of(quality: str, differences: dict[str, tuple[float, float]]) -> list[Figure]:
    """The worst scene's differences of one quality."""
    figures = []
    for place, (what, goal) in enumerate((("total force", TOTAL), ("cells", CELLS))):
        worst = max(differences, key=lambda name, place=place: differences[name][place])
        figures.append(Figure(f"hex {quality}: {what}, worst of {len(differences)} scenes over {len(CASES)} machines",
                              differences[worst][place], "<=", goal, "%", worst))  # fmt: skip
    return figures


@command(
    option("--workflow", type=Path, default=Path("workflow")),
    option("--quality", choices=("draft", "label"), default=None, help="solve in this process and write the results"),
    option("--scenes", nargs="+", default=None, help="only these of workflow/scenes.toml"),
    option("--out", type=Path, help="results/benchmarks/machines.json"),
)
def main(args: Namespace) -> None:
    if args.quality:
        write_json(args.out, solve_scenes(args.quality, args.scenes, args.workflow))
        return
    folder = args.out.parent / "machines"
    figures = []
    for quality in ("draft", "label"):
        figures += figures_of(quality, compare(quality, folder, args.workflow, args.scenes))
    publish_figures(args.out, figures)


if __name__ == "__main__":
    main.exit()
