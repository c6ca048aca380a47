"""Solve a scene by a method and keep the record in a file of its own."""

import shutil
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import digest_of_value, record_of, write_json
from gelforge.flow.params import StageParameters, plain
from gelforge.geometry.gel import Gel
from gelforge.labelling.grid import Grid
from gelforge.labelling.operator import assemble
from gelforge.labelling.sensor import Sensor
from gelforge.mechanics.solve import settings_of
from gelforge.sweeps.isolate import CRASHED, REFUSED, TIMED_OUT, Clock, isolated, peak_mib
from gelforge.sweeps.keptreferences import elements_doubled, kept_reference, reference_key
from gelforge.sweeps.methods import LARGE_REFERENCE, REFERENCE, Method, hex_settings, prepare, warm_up
from gelforge.sweeps.scenes import NamedScene

GRID = Grid(24, 32)  # of FEATS' labels


@dataclass(frozen=True)
class ChartBench:
    """Setting in which methods are measured: the sensor whose cells are compared, parameters, folder of records.

    references: folder of references that were solved elsewhere (sweeps.keptreferences); None: all are solved here.
    """

    sensor: Sensor
    params: StageParameters
    records: Path
    references: Path | None = None

    def record_path(self, scene: NamedScene, method: Method) -> Path:
        return self.records / scene.name / f"{method.name}.json"

    def key(self, scene: NamedScene, method: Method) -> str:
        """Digest of a record's inputs; `reference_key` for the large chart's reference."""
        if method == LARGE_REFERENCE:
            return reference_key(scene.table, self.params.material.nu, self.sensor, self.params.pareto.reference)
        parts = [scene.table, asdict(method), self.params.version, self.params.material.nu,
                 self.sensor.image, self.sensor.projection.tolist(), self._settings(method, scene.scene.gel)]  # fmt: skip
        return digest_of_value(parts)

    def _settings(self, method: Method, gel: Gel) -> list:
        p = self.params
        if method.solver == "hex":
            return [asdict(hex_settings(method))]
        if method.solver == REFERENCE:  # with elements of twice the size: the reference itself has a key of its own
            return [plain(p.pareto.reference), *settings_of("ccx", p.fea, gel)]
        return settings_of(method.name if method.name in ("auto", "ccx-contact") else "ccx", p.fea, gel)


def cells_of(mesh, forces: np.ndarray, sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """Label cells (3, 24, 32) in N along gel x, y, z of nodal forces (n, 3), and the force outside (3,)."""
    nodes = mesh.surface_nodes
    cells, outside = assemble(mesh, sensor, GRID).apply(np.array([0, len(nodes)]), nodes, forces[nodes])
    return cells[0], outside[0]


def outcome(result, mesh, sensor: Sensor | None) -> dict:
    """The part of a record that comes from the result itself."""
    found = {"status": result.status.name, "total": result.total.tolist(), "nodes": len(mesh.nodes),
             "evidence": result.kept_evidence, "reason": ""}  # fmt: skip
    if not result.status.valid:
        found["reason"] = str(result.evidence.get("reason") or result.status.value)
    elif sensor is not None:
        cells, outside = cells_of(mesh, result.forces, sensor)
        found |= {"cells": np.round(cells, 7).tolist(), "outside": outside.tolist()}
    return found


def solve_isolated(make: Callable[[Path], Callable], sensor: Sensor | None, limit_s: float, work: Path) -> dict:
    """Run `make(folder)()`, a prepared solve, in a process of its own; returns its record with its cost.

    `make` must be picklable: a function of a module, or functools.partial of one.
    """
    work.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix=".work-", dir=work))
    try:
        return isolated(partial(_solved, make, folder, sensor), limit_s)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _solved(make, folder, sensor) -> dict:
    warm_up()
    solve = make(folder)
    with Clock() as clock:
        result, mesh = solve()
    cost = {"seconds": clock.seconds, "cpu_seconds": clock.cpu_seconds, "peak_mib": peak_mib()}
    return outcome(result, mesh, sensor) | cost


def kept(path: Path, key: str, limit_s: float) -> dict | None:
    """The record that was made under the same key, else None.

    Refused and crashed solves are tried again, because their cause may be gone; a solve that timed out is tried again
    if the limit is longer.
    """
    record = record_of(path, key) or {}
    status = record.get("status")
    again = status in (REFUSED, CRASHED) or (status == TIMED_OUT and record.get("limit_s", 0.0) < limit_s)
    return None if again else record or None


def measure(bench: ChartBench, scene: NamedScene, method: Method) -> dict:
    """The record of a scene solved by a method: the kept one, or a new one, which is kept.

    {"status", "reason", "total" (3,) N, "cells" (3, 24, 32) N, "outside" (3,) N, "seconds", "cpu_seconds"
    (the solve alone, on one thread), "peak_mib", "nodes", "evidence"}. A failed solve has no cells, a reference that
    was solved elsewhere has no cost.
    """
    path, key = bench.record_path(scene, method), bench.key(scene, method)
    # a reference kept elsewhere is always read there: the record made from it here may be outdated
    given = given_reference(bench, scene) if method == LARGE_REFERENCE else None
    record = None if given else kept(path, key, bench.params.pareto.limit_s)
    if record is None:
        for stale in path.parent.glob(".work-*"):
            shutil.rmtree(stale, ignore_errors=True)

        found = given or solve_method(bench, scene, method, path.parent)
        record = {"key": key, "scene": scene.name, "method": method.name, "solver": method.solver} | found
        write_json(path, record)
        print(f"{scene.name} {method.name}: {record['status']} {record.get('cpu_seconds', float('nan')):.1f} s"
              f" {np.round(record.get('total', []), 4).tolist()} {record['reason']}", flush=True)  # fmt: skip
    return record


def given_reference(bench: ChartBench, scene: NamedScene) -> dict | None:
    """The reference of a scene if it was solved elsewhere under the same key, else None."""
    if bench.references is None:
        return None
    return kept_reference(bench.references, scene.name, bench.key(scene, LARGE_REFERENCE), GRID.shape)


def given_check(bench: ChartBench, scene: NamedScene) -> dict | None:
    """Difference of a solve with elements and load steps of twice the size from a reference solved elsewhere."""
    if bench.references is None or given_reference(bench, scene) is None:
        return None
    return elements_doubled(bench.references).get(scene.name)


def solve_method(bench: ChartBench, scene: NamedScene, method: Method, work: Path) -> dict:
    """The record of a scene solved now, in a process of its own."""
    make = partial(prepare, method, scene.scene, bench.params)
    return solve_isolated(make, bench.sensor, bench.params.pareto.limit_s, work)


def load_bench(params: StageParameters, sensors: dict, records: Path, references: Path | None = None) -> ChartBench:
    """A bench that compares cells as the chart's sensor sees them."""
    name = params.pareto.sensor
    if name not in sensors:
        raise BadInput(
            f"workflow/sensors.toml has no [{name}], in whose image the chart compares forces; add it again"
        )
    return ChartBench(sensors[name], params, Path(records), references)
