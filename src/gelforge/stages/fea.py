"""Stage 30: finite element solves of a shard's samples; a rerun resumes at the missing ones."""

import gzip
import json
import shutil
import tempfile
from argparse import Namespace
from dataclasses import asdict
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import digest_of, publish, read_json, write_json
from gelforge.flow.layout import beside
from gelforge.flow.main import command, option
from gelforge.flow.params import digest_of_value, plain
from gelforge.flow.params.slices import ForFea, read_slice
from gelforge.flow.params.tables import CHOOSING, IN_PROCESS, TETRAHEDRAL
from gelforge.flow.progress import progress
from gelforge.geometry.gel import load_gel
from gelforge.mechanics.ccx.deck import INCLUDES
from gelforge.mechanics.family import MeshFamily, mesh_names
from gelforge.mechanics.fidelity import Solvers
from gelforge.mechanics.hex.settings import QUALITIES, quality
from gelforge.mechanics.scene import Interface, Material, Result, Scene
from gelforge.records.frames import presses_of
from gelforge.records.log import read_poses
from gelforge.records.press import POSE, PosedPress
from gelforge.records.solvetable import Solved, damaged, read_record, write_solves
from gelforge.records.status import Status

VERSION = 12


def scene_of(press: PosedPress, bodies: dict, sensors: dict, params: ForFea) -> Scene:
    """The scene of one press of a pose table."""
    interface = params.interface
    law = Interface(interface.law, interface.mu if interface.law == "coulomb" else 0.0)
    gel = load_gel(sensors[press.sensor_id]["gel"])
    material = Material(nu=params.material.nu)
    return Scene(gel, material, bodies[press.indenter], press.press, law)


# What of an indenter's table says nothing of its shape; a file's name does not either, its content (sha256) does.
NO_SHAPE = {"seen", "spare", "file"}


def sample_key(press: PosedPress, frames: list[PosedPress], params: ForFea, tables: dict, family: MeshFamily) -> str:
    """Digest of everything a sample's solve depends on: content and numbers, no names.

    frames: the moments of its press, this one among them, which share one path and one mesh.
    """
    cells, indenter = press.cells(), tables["indenters"][press.indenter]
    shape = {key: value for key, value in indenter.items() if key not in NO_SHAPE}
    bricks, settings = asdict(quality(params.fea.hex_quality)), plain(params)
    if params.fea.fidelity == "auto":
        bricks |= {name: asdict(quality(name)) for name in QUALITIES}  # which of them serves, a solve decides
    else:
        # they choose among fidelities: a chart that is drawn anew leaves solves as they are, and so do other meshes for others
        idle = CHOOSING | (TETRAHEDRAL if params.fea.fidelity in IN_PROCESS else frozenset())
        settings["fea"] = {key: value for key, value in settings["fea"].items() if key not in idle}
    parts = [[cells[c] for c in POSE], settings, bricks, shape, tables["sensors"][press.sensor_id]["gel"],
             family.reports]  # fmt: skip
    if len(frames) > 1:
        parts.append([[frame.cells()[c] for c in POSE] for frame in frames])
    return digest_of_value(parts)


def finished(folder: Path, sample_id: str, key: str) -> dict | None:
    """The record of a sample that was solved whole under the same key, else None."""
    record = read_record(folder / f"{sample_id}.json")
    if record is None or record.get("key") != key or damaged(folder, record):
        return None
    include = record["include"]  # none of a press that was solved in process
    return record if not include or (folder.parent / INCLUDES / include).exists() else None


def publish_solve(sample_id: str, result: Result, solvers: Solvers, key: str, folder: Path) -> dict:
    """Publish the files of one solved sample, its record last; return the record."""
    evidence, include = result.kept_evidence, getattr(result, "include", None)
    record = {
        "key": key, "sample_id": sample_id, "status": result.status.name, "mesh": evidence.get("mesh", ""),
        "reason": "" if result.status.valid else str(evidence.get("reason") or result.status.value),
        "fidelity": evidence.get("fidelity", solvers.settings.fidelity), "total": result.total.tolist(),
        "evidence": evidence, "files": [], "include": include.name if include else "",
    }  # fmt: skip
    if result.status.valid:
        record["files"] = publish_result(folder, sample_id, result, solvers.family.load(record["mesh"]))
    record["sha256"] = {name: digest_of(folder / name) for name in record["files"]}
    write_json(folder / f"{sample_id}.json", record)
    return record


def publish_result(folder: Path, sample_id: str, result, mesh) -> list[str]:
    """Write deck and output of CalculiX, or the surface's arrays of a result that has none; names of the files.

    The mesh that a deck includes lies beside the shards' folders, once for all decks.
    """
    if getattr(result, "dat", None):
        if not (mesh_text := folder.parent / INCLUDES / result.include.name).exists():
            with publish(mesh_text) as part:
                shutil.copyfile(result.include, part)
        with publish(folder / f"{sample_id}.inp") as part:
            part.write_text(result.deck)
        with publish(folder / f"{sample_id}.dat.gz") as part:
            # no time stamp inside: the same solve writes the same bytes
            part.write_bytes(gzip.compress(result.dat.encode(), 6, mtime=0))
        return [f"{sample_id}.inp", f"{sample_id}.dat.gz"]
    top = mesh.surface_nodes
    with publish(folder / f"{sample_id}.npz") as part:
        np.savez(part, force=result.forces[top], displacement=result.displacement[top])
    return [f"{sample_id}.npz"]


def borrow(record: dict, sample_id: str, key: str, folder: Path) -> dict:
    """Publish the solve of a sample for another one that is the same press, seen by another sensor."""
    files = [name.replace(record["sample_id"], sample_id, 1) for name in record["files"]]
    for source, name in zip(record["files"], files, strict=True):
        with publish(folder / name) as part:
            shutil.copyfile(folder / source, part)
    digests = {name: record["sha256"][source] for source, name in zip(record["files"], files, strict=True)}
    found = {**record, "key": key, "sample_id": sample_id, "files": files, "sha256": digests}
    write_json(folder / f"{sample_id}.json", found)
    return found


def solved(record: dict, press: PosedPress, folder: Path) -> Solved:
    """The row of the shard's table that a sample's record makes."""
    file = f"{folder.name}/{record['files'][-1]}" if record["files"] else ""
    return Solved(
        record["sample_id"], Status[record["status"]], record["reason"], record["fidelity"], record["mesh"], file,
        tuple(record["total"]), record["evidence"], press.press_id,
    )  # fmt: skip


def run_shard(poses: Path, meshes: Path, params: ForFea, tables: dict, bodies: dict, folder: Path) -> list[Solved]:
    """Solve what is missing of a shard, frames of a press together; rows in the order of the pose table."""
    presses = read_poses(poses)
    # only the meshes asked for: one that another setting left behind must not be chosen
    family = MeshFamily(meshes, mesh_names(params.fea))
    folder.mkdir(parents=True, exist_ok=True)
    for stale in folder.glob(".work-*"):
        shutil.rmtree(stale, ignore_errors=True)
    records: dict[str, dict] = {}
    known: dict[tuple, dict] = {}
    with tempfile.TemporaryDirectory(prefix=".work-", dir=folder) as work:
        solvers = Solvers(family, work, params.fea)
        for frames in progress(presses_of(presses), f"fea {folder.name}"):
            keys = [sample_key(press, frames, params, tables, family) for press in frames]
            scenes = [scene_of(press, bodies, tables["sensors"], params) for press in frames]
            try:
                found = run_press(frames, keys, scenes, solvers, known, folder)
            except OSError as error:
                raise BadInput(
                    f"{folder}: sample {frames[0].sample_id}: {error}; free space or mend the folder and"
                    " run make again, it resumes at this sample"
                ) from error
            records |= {record["sample_id"]: record for record in found}
    return [solved(records[press.sample_id], press, folder) for press in presses]


def run_press(frames: list[PosedPress], keys: list[str], scenes: list[Scene], solvers: Solvers, known: dict,
              folder: Path) -> list[dict]:  # fmt: skip
    """Records of the frames of one press: those finished before, borrowed ones, and the rest from one solve.

    known: record of each scene met in this shard, which grows: several sensors may have seen a press.
    """
    path = tuple(scene.press for scene in scenes)
    same = [(scene.gel.name, press.indenter, scene.press, path) for press, scene in zip(frames, scenes, strict=True)]
    records = [finished(folder, press.sample_id, key) for press, key in zip(frames, keys, strict=True)]
    for at, press in enumerate(frames):
        if records[at] is None and same[at] in known:
            records[at] = borrow(known[same[at]], press.sample_id, keys[at], folder)
    if None in records:
        # all moments again: what a frame is solved from must not depend on which others were there before
        for at, result in enumerate(solvers.solve_frames(scenes, solvers.settings.fidelity)):
            records[at] = records[at] or publish_solve(frames[at].sample_id, result, solvers, keys[at], folder)
    found = [record for record in records if record is not None]
    known |= dict(zip(same, found, strict=True))
    return found


@command(
    option("--poses", type=Path, help="10_poses/NNNN.csv"),
    option("--meshes", type=Path, help="20_meshes"),
    option("--params", type=Path, help="fea.json, beside sensors.json, indenters.json"),
    option("--workflow", type=Path, default=Path("workflow"), help="where STL paths start"),
    option("--out", type=Path, help="30_fea/NNNN.csv; samples go to 30_fea/NNNN/"),
)
def main(args: Namespace) -> None:
    from gelforge.geometry.indenters import build

    params = read_slice(args.params, ForFea)
    tables = {name: read_json(args.params.parent / f"{name}.json") for name in ("sensors", "indenters")}
    wanted = {press.indenter for press in read_poses(args.poses)}
    bodies = {
        name: build(name, tables["indenters"][name], "indenter catalogue", args.workflow) for name in sorted(wanted)
    }
    folder = beside(args.out, "")
    solves = run_shard(args.poses, args.meshes, params, tables, bodies, folder)
    write_solves(args.out, solves)
    for solve in solves:
        if not solve.status.valid:
            print(f"failed: {solve.sample_id}: {solve.status.name}, {solve.reason}")
    counts = {state.name: n for state in Status if (n := sum(solve.status is state for solve in solves))}
    print(json.dumps(counts))


if __name__ == "__main__":
    main.exit()
