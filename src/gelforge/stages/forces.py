"""Stage 40: nodal contact forces of a shard's solves, scaled to the material."""

import json
from argparse import Namespace
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.calibration import calibrated
from gelforge.flow.cli import stage
from gelforge.flow.files import DAMAGED
from gelforge.flow.layout import Layout
from gelforge.flow.params import read_parameters
from gelforge.flow.tables import MaterialTable
from gelforge.mechanics.material import REFERENCE_C10
from gelforge.mechanics.mesh.names import load_mesh
from gelforge.mechanics.result import moment_of_nodes
from gelforge.records.arrays import in_short
from gelforge.records.forcefile import ERRORS, INTERVALS, SampleForces, write_forces
from gelforge.records.solvestore import SolveStore
from gelforge.records.solvetable import Solved, read_solves
from gelforge.records.status import Status

VERSION = 4


def read_sample(solve: Solved, store: SolveStore) -> tuple[SampleForces, str]:
    """Forces of one row of 30_fea's table at the reference C10, and the reason if there are none."""
    status, reason = solve.status, solve.reason
    if not status.valid:
        return SampleForces.failed(solve.sample_id, status.name, solve.mesh, solve.press_id), reason
    mesh = load_mesh(solve.mesh)
    path = store.arrays(solve.key)
    reason = ""
    try:
        with np.load(path, allow_pickle=False) as file:
            force, displacement = file["force"], file["displacement"]
        shape = len(mesh.surface_nodes), 3
        if not force.shape == displacement.shape == shape:
            status = Status.UNREADABLE
            reason = (
                f"{path}: forces {force.shape} and displacement {displacement.shape} of a surface of {shape[0]} nodes"
            )
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
        solve.number("friction_error_n"),
        moment_of_nodes(mesh.nodes[top] + displacement, force).sum(axis=0),
    )
    return found, ""


def material_c10(material: MaterialTable) -> tuple[float, dict]:
    """C10 in MPa, and its intervals if it was calibrated."""
    known = {name: getattr(material, name) for name in INTERVALS}
    return float(material.c10), {name: list(pair) for name, pair in known.items() if pair is not None}


def refuse_lost(table: Path, solves: list[Solved], store: SolveStore) -> None:
    """Remove the shard's table and raise BadInput if the store lacks solves that it lists.

    Without its table the shard is outdated: the next make solves what is lacking and keeps the rest.
    """
    lost = [solve.key for solve in solves if store.record(solve.key) is None]
    if lost:
        table.unlink()
        raise BadInput(
            f"{store.folder}: {lost[0]}{f' and {len(lost) - 1} more' if len(lost) > 1 else ''}: missing or changed since it"
            f" was written; {table} was removed, so run make again: it solves what is lacking and keeps the rest"
        )


@stage(Layout.forces)
def main(args: Namespace) -> None:
    of = args.of
    params = calibrated(read_parameters(of.parameters("forces")), of.base)
    c10, intervals = material_c10(params.material)
    samples: list[SampleForces] = []
    lost: Counter[str] = Counter()
    table = of.fea(args.shard)
    solves = list(read_solves(table))
    store = SolveStore(of.solves)
    refuse_lost(table, solves, store)
    for solve in solves:
        sample, reason = read_sample(solve, store)
        if solve.status.valid and reason:  # stage 30 reported the others
            print(f"failed: {sample.sample_id}: {sample.status}, {reason}")
            lost[f"{sample.status}: {Status[sample.status].value}"] += 1
        # At a fixed Poisson's ratio and prescribed motion every force is proportional to C10.
        stiffer = c10 / REFERENCE_C10
        errors = {name: stiffer * getattr(sample, name) for name in ERRORS}
        samples.append(replace(sample, force=stiffer * sample.force, moment=stiffer * sample.moment, **errors))
    write_forces(args.out, samples, c10, intervals)
    valid = sum(Status[sample.status].valid for sample in samples)
    print(json.dumps({"done": valid, "failed": lost}))


if __name__ == "__main__":
    main.exit()
