"""Stage 30: finite element solves of a shard's samples; a rerun resumes at the missing ones."""

import json
import shutil
import tempfile
from argparse import Namespace
from collections import Counter
from pathlib import Path

import numpy as np
from tqdm import tqdm

from gelforge.errors import BadInput
from gelforge.flow.cli import stage
from gelforge.flow.files import digest_of, digest_of_value, publish, read_json, record_of, write_json
from gelforge.flow.layout import Layout
from gelforge.flow.params import StageParameters, read_parameters
from gelforge.flow.schema import altered
from gelforge.flow.tables import IN_PROCESS
from gelforge.geometry.gel import load_gel, use_gels_of
from gelforge.geometry.indenters import bodies_of
from gelforge.labelling.sensor import sensor_of
from gelforge.mechanics.material import Material
from gelforge.mechanics.mesh.basemesh import use_meshes_of
from gelforge.mechanics.mesh.names import load_mesh
from gelforge.mechanics.result import Result
from gelforge.mechanics.scene import Interface, Scene
from gelforge.mechanics.solve import Solvers, settings_of, solve_key
from gelforge.mechanics.solvers.ccx import CcxResult
from gelforge.records.frames import presses_of
from gelforge.records.log import read_poses
from gelforge.records.press import SENSOR_TABLES, PosedPress
from gelforge.records.solvetable import Solved, corrupt, write_solves
from gelforge.records.status import Status
from gelforge.sweeps import verification

VERSION = 17


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
    how = settings_of(params.fea.method, params.fea, scenes[0].gel)
    return [solve_key(scenes, shape_of(frame, tables), how, params.version, at) for at, frame in enumerate(frames)]


def finished(folder: Path, sample_id: str, key: str, timeout_s: float) -> dict | None:
    """The record of a sample that was solved under the same key and whose files are intact, else None.

    A solve that was stopped at a shorter time limit than `timeout_s` does not count.
    """
    record = record_of(folder / f"{sample_id}.json", key)
    if record is None or corrupt(folder, record):
        return None
    return None if record["evidence"].get("stopped_after_s", timeout_s) < timeout_s else record


def publish_solve(sample_id: str, result: Result, key: str, folder: Path) -> dict:
    """Publish the arrays of one solved sample, its record last; return the record.

    The arrays are forces and displacements of the surface's nodes. For a press solved by CalculiX, further arrays and
    the record's "deck" hold what is needed to write its deck again.
    """
    evidence = result.kept_evidence
    record = {
        "key": key, "sample_id": sample_id, "status": result.status.name, "mesh": evidence.get("mesh", ""),
        # for a valid result: why another method than the requested one solved it
        "reason": str(evidence.get("replaced", "") if result.status.valid else evidence.get("reason") or result.status.value),
        "method": evidence["method"], "total": result.total.tolist(),
        "evidence": evidence, "files": [], "deck": {},
    }  # fmt: skip
    if result.status.valid and result.mesh is not None:
        top = result.mesh.surface_nodes
        arrays = {"force": result.forces[top], "displacement": result.displacement[top]}
        if isinstance(result, CcxResult) and result.start is not None and result.prescribed is not None:
            record["deck"] = result.deck
            arrays |= {"start": result.start, "prescribed": result.prescribed.astype(np.int32)}
            arrays["displacement"] = arrays["displacement"].astype(np.float32)
        with publish(folder / f"{sample_id}.npz") as part:
            np.savez_compressed(part, **arrays)
        record["files"] = [f"{sample_id}.npz"]
    record["sha256"] = {name: digest_of(folder / name) for name in record["files"]}
    write_json(folder / f"{sample_id}.json", record)
    return record


def borrow(record: dict, sample_id: str, folder: Path) -> dict:
    """Publish the solve of a sample for another one that shows the same press by another sensor."""
    files = [name.replace(record["sample_id"], sample_id, 1) for name in record["files"]]
    for source, name in zip(record["files"], files, strict=True):
        with publish(folder / name) as part:
            shutil.copyfile(folder / source, part)
    digests = {name: record["sha256"][source] for source, name in zip(record["files"], files, strict=True)}
    found = {**record, "sample_id": sample_id, "files": files, "sha256": digests}
    write_json(folder / f"{sample_id}.json", found)
    return found


def solved(record: dict, press: PosedPress, folder: Path) -> Solved:
    """A sample's row of the shard's table, from its record."""
    file = f"{folder.name}/{record['files'][-1]}" if record["files"] else ""
    return Solved(
        record["sample_id"], Status[record["status"]], record["reason"], record["method"], record["mesh"], file,
        tuple(record["total"]), record["evidence"], press.press_id,
    )  # fmt: skip


def run_shard(
    presses: list[PosedPress], params: StageParameters, tables: dict, bodies: dict, folder: Path
) -> list[Solved]:
    """Solve the missing samples of a shard, frames of a press together; return rows in the order of the presses."""
    folder.mkdir(parents=True, exist_ok=True)
    for stale in folder.glob(".work-*"):
        shutil.rmtree(stale, ignore_errors=True)
    records: dict[str, dict] = {}
    known: dict[str, dict] = {}
    with tempfile.TemporaryDirectory(prefix=".work-", dir=folder) as work:
        solvers = Solvers(work, params.fea)
        for frames in tqdm(presses_of(presses), f"fea {folder.name}"):
            scenes = [scene_of(press, bodies, tables["sensors"], params) for press in frames]
            keys = press_keys(frames, scenes, params, tables)
            try:
                found = run_press(frames, keys, scenes, solvers, known, folder)
            except OSError as error:
                raise BadInput(
                    f"{folder}: sample {frames[0].sample_id}: {error}; free space or repair the folder, then"
                    " run make again; it resumes at this sample"
                ) from error
            records |= {record["sample_id"]: record for record in found}
            by_ccx = altered(params, fea=altered(params.fea, method="ccx"))
            twin = press_keys(frames, scenes, by_ccx, tables)[-1]
            verify_press(frames[-1], (keys[-1], twin), scenes, found[-1], solvers, tables["sensors"], folder)
    return [solved(records[press.sample_id], press, folder) for press in presses]


def run_press(frames: list[PosedPress], keys: list[str], scenes: list[Scene], solvers: Solvers, known: dict,
              folder: Path) -> list[dict]:  # fmt: skip
    """Records of the frames of one press: finished ones, copies from other sensors, and the rest from one solve.

    known: records of this shard by key, extended here, because several sensors may have seen the same press.
    """
    limit = solvers.settings.timeout_s
    records = [finished(folder, press.sample_id, key, limit) for press, key in zip(frames, keys, strict=True)]
    for at, press in enumerate(frames):
        if records[at] is None and keys[at] in known:
            records[at] = borrow(known[keys[at]], press.sample_id, folder)
    if None in records:
        # solve all frames again: a frame's result must not depend on which other frames were finished already
        for at, result in enumerate(solvers.solve_frames(scenes, solvers.settings.method)):
            records[at] = records[at] or publish_solve(frames[at].sample_id, result, keys[at], folder)
    found = [record for record in records if record is not None]
    known |= dict(zip(keys, found, strict=True))
    return found


def verify_press(press: PosedPress, keys: tuple[str, str], scenes: list[Scene], record: dict, solvers: Solvers,
                 sensors: dict, folder: Path) -> None:  # fmt: skip
    """Solve a press by CalculiX, too, if "auto" solved it without CalculiX and [fea] verify selects it.

    press, keys, record: of the last frame; the second key is that of CalculiX' solve. CalculiX' result is kept as a
    sample called ID.ccx; the difference is ID.verify.json.
    """
    path, twin = folder / f"{press.sample_id}{verification.ENDING}", f"{press.sample_id}.ccx"
    automatic = solvers.settings.method == "auto" and Status[record["status"]].valid
    solvable = automatic and record["method"] in IN_PROCESS and not record["evidence"]["failed_attempts"]
    if not (solvable and verification.chosen(press.sample_id, solvers.settings.verify)):
        for stale in (path, *folder.glob(f"{twin}.*")):
            stale.unlink(missing_ok=True)
        return
    key = digest_of_value(keys)
    whole = finished(folder, twin, keys[1], solvers.settings.timeout_s)
    if whole and (kept := verification.kept_verified(path)) and kept.key == key:
        return
    path.unlink(missing_ok=True)
    result = solvers.solve_frames(scenes, "ccx")[-1]
    right = publish_solve(twin, result, keys[1], folder)
    about = (key, press.sample_id, record["method"])
    sensor = sensor_of(SENSOR_TABLES, press.sensor_id, sensors[press.sensor_id])
    if right["method"] != "ccx" or not right["files"]:
        reason = (
            right["reason"] or "; ".join(right["evidence"].get("failed_attempts", [])) or "CalculiX found no solution"
        )
        found = verification.compare(about, [], reason, None)
    else:
        result_mesh = load_mesh(right["mesh"])
        with np.load(folder / record["files"][-1], allow_pickle=False) as file:
            forces = [file["force"], result.forces[result_mesh.surface_nodes]]
        meshes = [load_mesh(record["mesh"]), result_mesh]
        pairs = [(force.sum(axis=0), verification.surface_cells(mesh, force, sensor))
                 for mesh, force in zip(meshes, forces, strict=True)]  # fmt: skip
        errors = [tuple(of["evidence"][name] for name in ("error_n", "cells_error_n")) for of in (record, right)]
        found = verification.compare(about, errors, *pairs)
    verification.write_verified(path, found)


def read_shard(of: Layout, shard: str) -> tuple[StageParameters, dict, list[PosedPress], dict]:
    """Inputs of stage 30 for a shard: parameters, catalogues, presses, and their bodies by name."""
    tables = {name: read_json(of.parameters(name)) for name in ("sensors", "indenters")}
    presses = read_poses(of.poses(shard))
    read = read_parameters(of.parameters("fea"))
    return read, tables, presses, bodies_of(presses, tables["indenters"], of.workflow, of.surfaces)


@stage(Layout.fea)
def main(args: Namespace) -> None:
    of = args.of
    use_gels_of(of.workflow)
    use_meshes_of(of.meshes)
    params, tables, presses, bodies = read_shard(of, args.shard)
    solves = run_shard(presses, params, tables, bodies, of.solves(args.shard))
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
