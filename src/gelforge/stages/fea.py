"""Stage 30: finite element solves of a shard's samples, kept in a store by key: what it holds is not solved again."""

import json
import tempfile
from argparse import Namespace
from collections import Counter
from pathlib import Path

import numpy as np
from tqdm import tqdm

from gelforge.errors import BadInput
from gelforge.flow.calibration import calibrated
from gelforge.flow.cli import stage
from gelforge.flow.files import digest_of_value, read_json
from gelforge.flow.layout import Layout
from gelforge.flow.params import StageParameters, read_parameters
from gelforge.flow.schema import altered
from gelforge.flow.tables import IN_PROCESS
from gelforge.geometry.gel import load_gel
from gelforge.geometry.indenters import bodies_of
from gelforge.labelling.sensor import sensor_of
from gelforge.mechanics.material import Material
from gelforge.mechanics.mesh.names import load_mesh
from gelforge.mechanics.result import Result
from gelforge.mechanics.scene import Interface, Scene
from gelforge.mechanics.solve import Solvers, settings_of, solve_key
from gelforge.mechanics.solvers.ccx import CcxResult
from gelforge.records.frames import presses_of
from gelforge.records.log import read_poses
from gelforge.records.press import SENSOR_TABLES, PosedPress
from gelforge.records.solvestore import SolveStore
from gelforge.records.solvetable import Solved, write_solves
from gelforge.records.status import Status
from gelforge.sweeps import verification

VERSION = 18


def scene_of(press: PosedPress, bodies: dict, sensors: dict, params: StageParameters) -> Scene:
    """The scene of one press of a pose table."""
    interface = Interface(params.interface.law, params.interface.mu)
    gel = load_gel(sensors[press.sensor_id]["gel"])
    material = Material(nu=params.material.nu)
    return Scene(gel, material, bodies[press.indenter], press.press, interface)


# Keys of an indenter's table that do not affect its shape. A file's name is one; its content counts by `sha256`.
NO_SHAPE = {"seen", "spare", "file"}


def shape_of(press: PosedPress, tables: dict) -> dict:
    """The values of an indenter's table that its surface is built from."""
    return {key: value for key, value in tables["indenters"][press.indenter].items() if key not in NO_SHAPE}


def press_keys(frames: list[PosedPress], scenes: list[Scene], params: StageParameters, tables: dict) -> list[str]:
    """Key of the solve of each frame of a press."""
    how = settings_of(params.fea.method, params.fea)
    return [solve_key(scenes, shape_of(frame, tables), how, params.version, at) for at, frame in enumerate(frames)]


def finished(store: SolveStore, key: str, timeout_s: float) -> dict | None:
    """The record of a solve in the store, else None; one stopped at a shorter limit than `timeout_s` does not count."""
    record = store.record(key)
    if record is None or record["evidence"].get("stopped_after_s", timeout_s) < timeout_s:
        return None
    return record


def publish_solve(result: Result, key: str, store: SolveStore) -> dict:
    """Put one solve into the store; return its record."""
    evidence = result.kept_evidence
    record = {
        "status": result.status.name, "mesh": evidence.get("mesh", ""),
        # for a valid result: why another method than the requested one solved it
        "reason": str(evidence.get("replaced", "") if result.status.valid else evidence.get("reason") or result.status.value),
        "method": evidence["method"], "total": result.total.tolist(), "evidence": evidence, "deck": {},
    }  # fmt: skip
    arrays: dict[str, np.ndarray] = {}
    if result.status.valid and result.mesh is not None:
        top = result.mesh.surface_nodes
        arrays = {"force": result.forces[top], "displacement": result.displacement[top]}
        if isinstance(result, CcxResult) and result.start is not None and result.prescribed is not None:
            record["deck"] = result.deck
            arrays |= {"start": result.start, "prescribed": result.prescribed.astype(np.int32)}
            arrays["displacement"] = arrays["displacement"].astype(np.float32)
    return store.publish(key, record, arrays)


def solved(record: dict, press: PosedPress) -> Solved:
    """A sample's row of the shard's table, from the record of its solve."""
    return Solved(
        press.sample_id, Status[record["status"]], record["reason"], record["method"], record["mesh"], record["key"],
        tuple(record["total"]), record["evidence"], press.press_id,
    )  # fmt: skip


def run_shard(
    presses: list[PosedPress], params: StageParameters, tables: dict, bodies: dict, store: SolveStore, checked: Path
) -> list[Solved]:
    """Solve the presses of a shard that the store lacks, frames of a press together; return rows in their order.

    checked: folder of the presses that were verified by a second method.
    """
    records: dict[str, dict] = {}
    store.folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".work-", dir=store.folder) as work:
        solvers = Solvers(work, params.fea)
        for frames in tqdm(presses_of(presses), f"fea {checked.name}"):
            scenes = [scene_of(press, bodies, tables["sensors"], params) for press in frames]
            keys = press_keys(frames, scenes, params, tables)
            try:
                found = run_press(keys, scenes, solvers, store)
            except OSError as error:
                raise BadInput(
                    f"{store.folder}: sample {frames[0].sample_id}: {error}; free space or repair the folder, then"
                    " run make again; it resumes at this sample"
                ) from error
            records |= {press.sample_id: record for press, record in zip(frames, found, strict=True)}
            by_ccx = altered(params, fea=altered(params.fea, method="ccx"))
            twin = press_keys(frames, scenes, by_ccx, tables)[-1]
            verify_press(frames[-1], (keys[-1], twin), scenes, found[-1], solvers, tables["sensors"], store, checked)
    return [solved(records[press.sample_id], press) for press in presses]


def run_press(keys: list[str], scenes: list[Scene], solvers: Solvers, store: SolveStore) -> list[dict]:
    """Records of the frames of one press: from the store, else all from one solve."""
    records = [finished(store, key, solvers.settings.timeout_s) for key in keys]
    if None in records:
        # solve all frames again: a frame's result must not depend on which other frames were finished already
        for at, result in enumerate(solvers.solve_frames(scenes, solvers.settings.method)):
            records[at] = records[at] or publish_solve(result, keys[at], store)
    return [record for record in records if record is not None]


def verify_press(press: PosedPress, keys: tuple[str, str], scenes: list[Scene], record: dict, solvers: Solvers,
                 sensors: dict, store: SolveStore, checked: Path) -> None:  # fmt: skip
    """Solve a press by CalculiX, too, if "auto" solved it without CalculiX and [fea] verify selects it.

    press, keys, record: of the last frame; the second key is that of CalculiX' solve. The difference is
    ID.verify.json in the folder `checked`.
    """
    path = checked / f"{press.sample_id}{verification.ENDING}"
    automatic = solvers.settings.method == "auto" and Status[record["status"]].valid
    solvable = automatic and record["method"] in IN_PROCESS and not record["evidence"]["failed_attempts"]
    if not (solvable and verification.chosen(press.sample_id, solvers.settings.verify)):
        path.unlink(missing_ok=True)
        return
    key = digest_of_value(keys)
    right = finished(store, keys[1], solvers.settings.timeout_s)
    if right and (kept := verification.kept_verified(path)) and kept.key == key:
        return
    path.unlink(missing_ok=True)
    right = right or publish_solve(solvers.solve_frames(scenes, "ccx")[-1], keys[1], store)
    about = (key, press.sample_id, record["method"])
    sensor = sensor_of(SENSOR_TABLES, press.sensor_id, sensors[press.sensor_id])
    if right["method"] != "ccx" or not right["sha256"]:
        reason = (
            right["reason"] or "; ".join(right["evidence"].get("failed_attempts", [])) or "CalculiX found no solution"
        )
        found = verification.compare(about, [], reason, None)
    else:
        pairs, errors = [], []
        for of in (record, right):
            with np.load(store.arrays(of["key"]), allow_pickle=False) as file:
                force = file["force"]
            pairs.append((force.sum(axis=0), verification.surface_cells(load_mesh(of["mesh"]), force, sensor)))
            errors.append((of["evidence"]["error_n"], of["evidence"]["cells_error_n"]))
        found = verification.compare(about, errors, *pairs)
    verification.write_verified(path, found)


def read_shard(of: Layout, shard: str) -> tuple[StageParameters, dict, list[PosedPress], dict]:
    """Inputs of stage 30 for a shard: parameters, catalogues, presses, and their bodies by name."""
    tables = read_json(of.used(shard))
    presses = read_poses(of.poses(shard))
    read = calibrated(read_parameters(of.parameters("fea")), of.base)
    return read, tables, presses, bodies_of(presses, tables["indenters"], of.workflow, of.surfaces)


@stage(Layout.fea)
def main(args: Namespace) -> None:
    of = args.of
    params, tables, presses, bodies = read_shard(of, args.shard)
    solves = run_shard(presses, params, tables, bodies, SolveStore(of.solves), of.checked(args.shard))
    write_solves(args.out, solves)
    for solve in solves:
        if not solve.status.valid:
            print(f"failed: {solve.sample_id}: {solve.status.name}, {solve.reason}")
        elif solve.reason:
            print(f"note: {solve.sample_id}: {solve.reason}")
    lost = Counter(f"{solve.status.name}: {solve.reason}" for solve in solves if not solve.status.valid)
    print(json.dumps({"done": len(solves) - lost.total(), "failed": lost}))


if __name__ == "__main__":
    main.exit()
