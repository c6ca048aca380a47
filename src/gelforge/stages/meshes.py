"""Stage 20: the tetrahedral gel mesh of each press of a shard; of a small family by region and density, made when needed."""

import json
from argparse import Namespace
from pathlib import Path

from gelforge.flow.cli import JOBS, stage
from gelforge.flow.files import write_csv, write_json
from gelforge.flow.jobs import in_slots
from gelforge.flow.layout import Layout
from gelforge.flow.params import StageParameters
from gelforge.flow.tables import IN_PROCESS
from gelforge.geometry.gel import use_gels_of
from gelforge.mechanics.mesh.family import MeshFamily, choose_mesh, first_candidate, mesh_names
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.meshstore import MeshSource, source_of
from gelforge.mechanics.scene import Scene
from gelforge.records.frames import presses_of
from gelforge.records.solvetable import MESH_COLUMNS

VERSION = 6


def publish_mesh(name: str, mesh: GelMesh, report: dict, out: Path) -> None:
    """Write a mesh to `out`, whatever its suffix, with the report NAME.json beside it, and show the report."""
    write_json(out.with_name(f"{name}.json"), report)
    whole = out.with_name(f".{name}.npz")
    mesh.save(whole)
    whole.replace(out)
    print(json.dumps(report, indent=1))


def meshed(presses: list[dict[str, Scene]], params: StageParameters) -> dict[str, Scene]:
    """Scenes by sample that are solved on tetrahedra. presses: frames of each by their samples, in order of time."""
    found: dict[str, Scene] = {}
    for frames in presses:
        if params.fea.method not in IN_PROCESS:
            found |= frames
    return found


def make_missing(names: set[str], source: MeshSource, folder: Path, jobs: int) -> None:
    """Put meshes into a folder of stage 20; those that must be made are made side by side."""
    missing = [name for name in sorted(names) if source.known(name, folder) is None]
    # a process that has meshed must not fork one that meshes again: this one has not
    list(in_slots(source.fetch, [(name, folder) for name in missing], min(jobs, len(missing))))


@stage(Layout.mesh_table, JOBS)
def main(args: Namespace) -> None:
    from gelforge.stages.fea import read_shard, scene_of

    of = args.of
    use_gels_of(of.workflow)
    source = source_of(of.parameters("meshes"), of.workflow)
    params, tables, presses, bodies = read_shard(of, args.shard)
    family = MeshFamily(of.meshes, mesh_names(params.fea), source)
    scenes = meshed(
        [
            {p.sample_id: scene_of(p, bodies, tables["sensors"], params) for p in frames}
            for frames in presses_of(presses)
        ],
        params,
    )
    make_missing({first_candidate(scene, family) for scene in scenes.values()}, source, of.meshes, args.jobs)
    chosen = {name: choose_mesh(scene, family) for name, scene in scenes.items()}
    write_csv(
        args.out, MESH_COLUMNS, [{"sample_id": p.sample_id, "mesh": chosen.get(p.sample_id, "")} for p in presses]
    )
    print(json.dumps({"presses": len(presses), "meshes": sorted({mesh.split("@")[0] for mesh in chosen.values()})}))


if __name__ == "__main__":
    main.exit()
