"""Stage 40: nodal contact forces of a shard's solves, scaled to the material."""

import json
from argparse import Namespace
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.cli import stage
from gelforge.flow.files import DAMAGED, read_json, record_of
from gelforge.flow.layout import Layout, command_for
from gelforge.flow.params import read_parameters
from gelforge.flow.tables import MaterialTable
from gelforge.mechanics.material import REFERENCE_C10
from gelforge.mechanics.mesh.basemesh import use_meshes_of
from gelforge.mechanics.mesh.names import load_mesh
from gelforge.records.arrays import in_short
from gelforge.records.forcefile import INTERVALS, SampleForces, write_forces
from gelforge.records.solvetable import Solved, corrupt, read_solves
from gelforge.records.status import Status

VERSION = 3


def read_sample(solve: Solved, folder: Path) -> tuple[SampleForces, str]:
    """Forces of one row of 30_fea's table at the reference C10, and the reason if there are none."""
    status, reason = solve.status, solve.reason
    if not status.valid:
        return SampleForces.failed(solve.sample_id, status.name, solve.mesh, solve.press_id), reason
    mesh = load_mesh(solve.mesh)
    path = folder / solve.file
    reason = ""
    try:
        with np.load(path, allow_pickle=False) as file:
            force, displacement = file["force"], file["displacement"]
    except DAMAGED as error:
        status, reason = Status.UNREADABLE, f"{path}: {in_short(error)}"
    if not status.valid:
        return SampleForces.failed(solve.sample_id, status.name, solve.mesh, solve.press_id), reason
    top = mesh.surface_nodes
    factor = solve.number("extrapolated")
    found = SampleForces(
        solve.sample_id,
        status.name,
        solve.mesh,
        top,
        force,
        displacement,
        solve.press_id,
        1.0 if np.isnan(factor) else factor,
        solve.number("error_n"),
        solve.number("cells_error_n"),
    )
    return found, ""


def material_c10(material: MaterialTable, calibration: Path) -> tuple[float, dict]:
    """C10 in MPa and its intervals: from [material], or from the summary `calibration` if c10 = "calibrated"."""
    if not isinstance(material.c10, str):
        known = {name: getattr(material, name) for name in INTERVALS}
        return float(material.c10), {name: list(pair) for name, pair in known.items() if pair is not None}
    if not calibration.exists():
        command = command_for("calibrate", calibration)
        raise BadInput(
            f'[material] c10 = "calibrated" needs {calibration}, which is not there; run `{command}` first'
        )
    try:
        found = read_json(calibration)["c10"]
        intervals = {f"c10_{name}": found[name] for name in ("interval68", "interval95")}
        return float(found["median"]), intervals
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadInput(
            f"{calibration}: holds no c10 with median and intervals ({error!r}); run `{command_for('calibrate', calibration)}`"
        ) from error


def refuse_corrupt(table: Path, solves: list[Solved]) -> None:
    """Remove the shard's table and raise BadInput if files of a solved sample are missing or changed.

    Without its table the shard is outdated: the next make solves the corrupt samples and keeps the rest.
    """
    folder = table.parent / table.name.split(".")[0]
    lost = []
    for solve in solves:
        if solve.status.valid:
            record = record_of(folder / f"{solve.sample_id}.json")
            lost += [folder / f"{solve.sample_id}.json"] if record is None else corrupt(folder, record)
    if lost:
        table.unlink()
        raise BadInput(
            f"{lost[0]}{f' and {len(lost) - 1} more' if len(lost) > 1 else ''}: missing or changed since it was written;"
            f" {table} was removed, so run make again: it solves what is corrupt and keeps the rest"
        )


@stage(Layout.forces)
def main(args: Namespace) -> None:
    of = args.of
    use_meshes_of(of.meshes)
    params = read_parameters(of.parameters("forces"))
    c10, intervals = material_c10(params.material, of.calibration())
    samples: list[SampleForces] = []
    lost: Counter[str] = Counter()
    table = of.fea(args.shard)
    solves = list(read_solves(table))
    refuse_corrupt(table, solves)
    for solve in solves:
        sample, reason = read_sample(solve, table.parent)
        if solve.status.valid and reason:  # stage 30 reported the others
            print(f"failed: {sample.sample_id}: {sample.status}, {reason}")
            lost[f"{sample.status}: {Status[sample.status].value}"] += 1
        # At a fixed Poisson's ratio and prescribed motion every force is proportional to C10.
        stiffer = c10 / REFERENCE_C10
        errors = {name: stiffer * getattr(sample, name) for name in ("error_n", "cells_error_n")}
        samples.append(replace(sample, force=sample.force * stiffer, **errors))
    write_forces(args.out, samples, c10, intervals)
    valid = sum(Status[sample.status].valid for sample in samples)
    print(json.dumps({"done": valid, "failed": lost}))


if __name__ == "__main__":
    main.exit()
