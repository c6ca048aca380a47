"""Results on other processors: every scene of the chart under the code paths of MKL and numba, and with two threads.

Libraries choose a code path by the processor, and these differ in the last bits. Each case runs in its own process;
its result is kept beside the JSON and used again while scenes and solver stay the same.
"""

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from argparse import Namespace
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from gelforge.flow import params as config
from gelforge.flow.cli import command, option
from gelforge.flow.files import read_json, write_json
from gelforge.labelling.sensor import load_sensors
from gelforge.mechanics.hexsettings import quality
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.result import Result
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solve import Solvers
from gelforge.mechanics.solvers.hex import HexSolver
from gelforge.sweeps.scenes import parse_scene, read_tables
from gelforge.sweeps.trial import cells_of
from tests.support.figures import Figure, publish_figures

CASES = {
    "as it is": {},
    # a processor without AVX-512: torch trains in single precision there, else in bfloat16
    "AVX2": {"MKL_CBWR": "AVX2", "ONEDNN_MAX_CPU_ISA": "AVX2", "ATEN_CPU_CAPABILITY": "avx2"},
    "AVX512": {"MKL_CBWR": "AVX512"},
    "COMPATIBLE": {"MKL_CBWR": "COMPATIBLE"},
    "two threads": {"MKL_NUM_THREADS": "2", "OMP_NUM_THREADS": "2"},
    "generic": {"MKL_CBWR": "COMPATIBLE", "NUMBA_CPU_NAME": "generic"},
}
TOTAL, CELLS = 0.1, 1.0  # % by which results may differ
WAYS = ("draft", "label", "ccx")  # qualities of `hex`, and CalculiX at label setting
ONE_THREAD = {"MKL_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def solver_of(way: str, params: config.Params, work: Path) -> Callable[[Scene], tuple[Result, GelMesh]]:
    """A function that solves a scene by one of WAYS and returns the result and its mesh."""
    if way != "ccx":
        hexahedra = HexSolver(quality(way))

        def solve(scene: Scene) -> tuple[Result, GelMesh]:
            found = hexahedra.solve(scene)
            return found, found.mesh

        return solve
    solvers = Solvers(work, params.fea)

    def solve_ccx(scene: Scene) -> tuple[Result, GelMesh]:
        found = solvers.solve(scene, "ccx")
        return found, found.mesh

    return solve_ccx


def solve_scenes(way: str, names: list[str] | None, workflow: Path) -> dict[str, dict]:
    """Status, total force (3,) and cells (3, 24, 32) in N of scenes solved in this process by one of WAYS."""
    params = config.load_params(workflow)
    sensor = load_sensors(workflow / "sensors.toml")[params.pareto.sensor]
    tables = read_tables(workflow)
    found = {}
    with tempfile.TemporaryDirectory() as work:
        solve = solver_of(way, params, Path(work))
        for name in names or tables:
            result, mesh = solve(parse_scene(name, tables[name], params.material.nu).scene)
            cells, _ = cells_of(mesh, result.forces, sensor)
            found[name] = {"status": result.status.name, "total": result.total.tolist(), "cells": cells.tolist()}
    return found


def digest_of_all(workflow: Path) -> str:
    """Digest of the code, parameters, scenes, shapes and sensors that a result may depend on."""
    code = sorted((Path(__file__).parents[2] / "src" / "gelforge").rglob("*.py"))
    return hashlib.sha256(
        b"".join(path.read_bytes() for path in [*code, *sorted(workflow.glob("*.toml"))])
    ).hexdigest()


def environment(case: str, folder: Path) -> dict[str, str]:
    """Environment of a process whose libraries take the code path of a case.

    Numba's code for another processor is kept separately, in `folder`.
    """
    free = {k: v for k, v in os.environ.items() if k != "MKL_CBWR"}
    caches = {"NUMBA_CACHE_DIR": str((folder / "numba" / case).resolve())} if "NUMBA_CPU_NAME" in CASES[case] else {}
    return {**free, **ONE_THREAD, **CASES[case], **caches}


def on_machine(case: str, way: str, names: list[str] | None, folder: Path, workflow: Path) -> dict[str, dict]:
    """`solve_scenes` in a process whose libraries take the code path of a case; the result is stored in `folder`."""
    content = json.dumps([digest_of_all(workflow), case, way, names])
    kept = folder / f"{way}-{case.replace(' ', '-')}-{hashlib.sha256(content.encode()).hexdigest()[:16]}.json"
    if not kept.exists():
        asked = [sys.executable, "-m", "tests.benchmarks.machines", "--solve", way, "--workflow", str(workflow)]
        asked += ["--out", str(kept), *(["--scenes", *names] if names else [])]
        subprocess.run(asked, check=True, env=environment(case, folder))
    return read_json(kept)


def difference(results: list[dict]) -> tuple[float, float]:
    """Largest differences, % of the force, of total and of cells between any two results of one scene."""
    totals, cells = ([np.array(result[name]) for result in results] for name in ("total", "cells"))
    size = np.linalg.norm(totals[0])
    total = max(np.linalg.norm(a - b) for a in totals for b in totals)
    cell = max(np.linalg.norm(a - b, axis=0).sum() for a in cells for b in cells)
    return 100 * total / size, 100 * cell / size


def compare(
    way: str, folder: Path, workflow: Path, names: list[str] | None = None, cases: Sequence[str] = tuple(CASES)
) -> dict[str, tuple[float, float]]:
    """Differences between the cases by scene, for one of WAYS; infinite if their statuses differ."""
    machines = [on_machine(case, way, names, folder, workflow) for case in cases]
    found = {}
    for name in machines[0]:
        results = [machine[name] for machine in machines]
        alike = len({result["status"] for result in results}) == 1
        found[name] = difference(results) if alike else (np.inf, np.inf)
    return found


def figures_of(way: str, differences: dict[str, tuple[float, float]], count: int) -> list[Figure]:
    """The worst scene's differences for one of WAYS on so many machines."""
    figures = []
    for place, (what, goal) in enumerate((("total force", TOTAL), ("cells", CELLS))):
        worst = max(differences, key=lambda name, place=place: differences[name][place])
        figures.append(Figure(f"{'ccx label' if way == 'ccx' else f'hex {way}'}: {what}, worst of {len(differences)} scenes over {count} machines",
                              differences[worst][place], "<=", goal, "%", worst))  # fmt: skip
    return figures


@command(
    option("--workflow", type=Path, default=Path("workflow")),
    option("--ways", nargs="+", choices=WAYS, default=WAYS, help="only these"),
    option("--solve", choices=WAYS, default=None, help="solve in this process and write the results"),
    option("--cases", nargs="+", choices=tuple(CASES), default=tuple(CASES), help="only these machines"),
    option("--scenes", nargs="+", default=None, help="only these of workflow/scenes.toml"),
    option("--out", type=Path, help="results/benchmarks/machines.json"),
)
def main(args: Namespace) -> None:
    if args.solve:
        write_json(args.out, solve_scenes(args.solve, args.scenes, args.workflow))
        return
    folder = args.out.parent / "machines"
    figures = []
    for way in args.ways:
        differences = compare(way, folder, args.workflow, args.scenes, args.cases)
        figures += figures_of(way, differences, len(args.cases))
    publish_figures(args.out, figures)


if __name__ == "__main__":
    main.exit()
