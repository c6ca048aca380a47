"""Stage 30: finite element solves of a shard's samples, kept in a store by key: what it holds is not solved again."""

import json
import tempfile
from argparse import Namespace
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tqdm import tqdm

from gelforge.errors import BadInput
from gelforge.flow.calibration import calibrated
from gelforge.flow.cli import stage
from gelforge.flow.files import read_json
from gelforge.flow.layout import POSES, Layout
from gelforge.flow.params import StageParameters, read_parameters
from gelforge.flow.tables import InterfaceTable
from gelforge.geometry.gel import load_gel
from gelforge.geometry.indenters import bodies_of
from gelforge.mechanics.contact.law import Frictionless, NoSlip
from gelforge.mechanics.material import Material
from gelforge.mechanics.result import Result, friction_error_n
from gelforge.mechanics.scene import Interface, PosedFile, Scene
from gelforge.mechanics.solve import Solvers, settings_of, solve_key
from gelforge.mechanics.solvers.ccx import CcxResult
from gelforge.records.frames import presses_of
from gelforge.records.log import read_poses
from gelforge.records.press import PosedPress
from gelforge.records.solvestore import SolveStore
from gelforge.records.solvetable import Solved, write_solves
from gelforge.records.status import Status
from gelforge.sweeps.isolate import Clock

VERSION = 25
FIRM_N = 0.2  # force sideways, N, from which on a reading is compared with the contact law
# Force sideways over mu times the normal force above which a reading contradicts the law: a body that slides also ploughs,
# solved slides of balls, blocks and edges reach 1.08, that of a pyramid 1.20.
BEYOND_LAW = 1.2
NAMED = 5  # samples in a note


def scene_of(
    press: PosedPress, bodies: dict, sensors: dict, params: StageParameters, poses: Path | None = None
) -> Scene:
    """The scene of one press of a pose table; poses: folder of stage 10, with the posed surfaces."""
    interface = Interface(params.interface.law, params.interface.mu)
    gel = load_gel(sensors[press.sensor_id]["gel"])
    material = Material(nu=params.material.nu)
    posed = PosedFile(poses / press.stl, press.press) if poses and press.stl else None
    return Scene(gel, material, bodies[press.indenter], press.press, interface, posed)


# Keys of an indenter's table that do not affect its shape. A file's name is one; its content counts by `sha256`.
NO_SHAPE = {"seen", "spare", "file"}


def shape_of(press: PosedPress, tables: dict) -> dict:
    """The values of an indenter's table that its surface is built from."""
    return {key: value for key, value in tables["indenters"][press.indenter].items() if key not in NO_SHAPE}


def press_keys(frames: list[PosedPress], scenes: list[Scene], params: StageParameters, tables: dict) -> list[str]:
    """Key of the solve of each frame of a press."""
    how = settings_of(params.fea.method, params.fea, scenes[0].gel)
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
        "method": evidence["method"], "total": result.total.tolist(), "moment": result.moment.tolist(),
        "evidence": evidence, "deck": {},
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


def solved(record: dict, press: PosedPress, interface: InterfaceTable) -> Solved:
    """A sample's row of the shard's table, from the record of its solve."""
    evidence = dict(record["evidence"])
    off = friction_error_n(evidence, interface.mu, interface.mu_error)
    if np.isfinite(off):
        evidence["friction_error_n"] = off
    return Solved(
        press.sample_id, Status[record["status"]], record["reason"], record["method"], record["mesh"], record["key"],
        tuple(record["total"]), evidence, press.press_id, tuple(record["moment"]),
    )  # fmt: skip


def run_shard(
    presses: list[PosedPress],
    params: StageParameters,
    tables: dict,
    bodies: dict,
    store: SolveStore,
    poses: Path,
    shard: str,
) -> list[Solved]:
    """Solve the presses of a shard that the store lacks, frames of a press together; return rows in their order.

    poses: folder of stage 10. shard: name that the progress shows.
    """
    records: dict[str, dict] = {}
    store.folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".work-", dir=store.folder) as work:
        solvers = Solvers(work, params.fea)
        for frames in tqdm(presses_of(presses), f"fea {shard}"):
            scenes = [scene_of(press, bodies, tables["sensors"], params, poses) for press in frames]
            keys = press_keys(frames, scenes, params, tables)
            try:
                found = run_press(keys, scenes, solvers, store)
            except OSError as error:
                raise BadInput(
                    f"{store.folder}: sample {frames[0].sample_id}: {error}; free space or repair the folder, then"
                    " run make again; it resumes at this sample"
                ) from error
            records |= {press.sample_id: record for press, record in zip(frames, found, strict=True)}
    return [solved(records[press.sample_id], press, params.interface) for press in presses]


def timed(scenes: Sequence[Scene], solvers: Solvers) -> list[Result]:
    """Results of the frames of one press; their evidence holds their shares of its processor time, "cpu_seconds"."""
    with Clock() as clock:
        results = solvers.solve_frames(scenes, solvers.settings.method)
    for result in results:
        result.evidence["cpu_seconds"] = clock.cpu_seconds / len(results)
    return results


def run_press(keys: list[str], scenes: list[Scene], solvers: Solvers, store: SolveStore) -> list[dict]:
    """Records of the frames of one press: from the store, else all from one solve."""
    records = [finished(store, key, solvers.settings.timeout_s) for key in keys]
    if None in records:
        # solve all frames again: a frame's result must not depend on which other frames were finished already
        for at, result in enumerate(timed(scenes, solvers)):
            records[at] = records[at] or publish_solve(result, keys[at], store)
    return [record for record in records if record is not None]


def friction_notes(presses: Sequence[PosedPress], interface: InterfaceTable) -> list[str]:
    """Rows that contradict the contact law: too much force sideways, or a slide without slip.

    A force sideways beyond mu times the normal one counts from FIRM_N on: below it, a sensor's zero may do it.
    """
    law = Interface(interface.law, interface.mu).contact
    most = {Frictionless.name: 0.0, NoSlip.name: np.inf}.get(interface.law, interface.mu)
    strong, far = [], []
    for press in presses:
        fx, fy, fz = press.force
        aside = float(np.hypot(fx, fy))
        if aside > FIRM_N and aside > BEYOND_LAW * most * abs(fz):
            strong.append(press.sample_id)
        if law.sticks and not law.slips and np.hypot(press.dx_mm, press.dy_mm) > -(press.z0_mm + press.dz_mm):
            far.append(press.sample_id)
    found = []
    if strong:
        found.append(
            f"{_named(strong)}: the log's force sideways is more than {most:g} times the normal one, which the law"
            f" {interface.law} does not allow: labels will be lower; calibrate friction, or set mu of [interface]"
        )
    if far:
        found.append(
            f"{_named(far)}: the tip moves farther sideways than down, and under the law {interface.law} no point may slip:"
            ' labels may be several times too large sideways; set law = "coulomb" of [interface]'
        )
    return found


def _named(names: list[str]) -> str:
    return ", ".join(names[:NAMED]) + (f" and {len(names) - NAMED} more" if len(names) > NAMED else "")


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
    solves = run_shard(presses, params, tables, bodies, SolveStore(of.solves), of.folder(POSES), args.shard)
    write_solves(args.out, solves)
    for solve in solves:
        if not solve.status.valid:
            print(f"failed: {solve.sample_id}: {solve.status.name}, {solve.reason}")
        elif solve.reason:
            print(f"note: {solve.sample_id}: {solve.reason}")
    for line in friction_notes(presses, params.interface):
        print(f"note: {line}")
    lost = Counter(f"{solve.status.name}: {solve.reason}" for solve in solves if not solve.status.valid)
    print(json.dumps({"done": len(solves) - lost.total(), "failed": lost}))


if __name__ == "__main__":
    main.exit()
