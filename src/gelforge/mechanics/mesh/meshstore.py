"""Tetrahedral gel meshes by what they are made from: those that ship, those that a project keeps, and new ones.

pytetwild draws random numbers that cannot be fixed: the same input gives another mesh each time, and a remesh would change
labels and solve every press again. So a mesh that was made once is kept, and those of the usual gel ship.
"""

import shutil
from dataclasses import asdict, dataclass
from pathlib import Path

from gelforge.flow.files import alone, digest_of_value, listed, publish, read_json, write_json
from gelforge.flow.params import read_parameters
from gelforge.flow.tables import MeshesTable
from gelforge.geometry.gel import Gel, gel_shape, load_gel
from gelforge.mechanics.mesh.gelmesh import GelMesh

MESHER = 1  # raised when `family.make_mesh` makes other meshes of the same numbers
SHIPPED = Path(__file__).parents[1] / "gelmeshes"
MESH_FOLDER = "meshes"  # folder in workflow/ of those that were made here
WORKFLOW = Path("workflow")


def recipe(name: dict, half: tuple[float, float], gel: Gel, meshes: MeshesTable) -> str:
    """Digest of all that a mesh is made from. name: engine, region and size. half: extents of the fine region, mm."""
    grading = [meshes.growth, meshes.coarsest_mm, meshes.fine_depth_mm, meshes.hold.get(name["region"], 0.0)]
    size = float(name["size"])
    return digest_of_value([MESHER, gel_shape(gel), name["engine"], size, list(half), list(map(float, grading))])


def find(folder: Path, key: str) -> Path | None:
    """The mesh file in a folder whose report names the recipe `key`."""
    for report in listed(folder, "*.json"):
        path = report.with_suffix(".npz")
        if path.exists() and read_json(report).get("recipe") == key:
            return path
    return None


def add(folder: Path, name: str, mesh: GelMesh, report: dict) -> Path:
    """Write a mesh and its report to a folder, by a name that holds a digest of the content; the mesh's path."""
    path = folder / f"{name}-{mesh.digest}.npz"
    write_json(path.with_suffix(".json"), report)
    mesh.save(path)
    return path


def copied(path: Path, folder: Path) -> Path:
    """The same mesh and report in another folder, byte for byte."""
    for source in (path.with_suffix(".json"), path):
        with publish(folder / source.name) as part:
            shutil.copyfile(source, part)
    return folder / path.name


@dataclass(frozen=True)
class MeshSource:
    """Where the meshes of a gel come from: the gel, [meshes], and the folder in which those made here are kept."""

    gel: Gel
    meshes: MeshesTable
    kept: Path = WORKFLOW / MESH_FOLDER

    def key(self, name: str) -> str:
        """The recipe of a mesh by its name, ccx-REGION-SIZE."""
        from gelforge.mechanics.mesh.family import MeshName, region

        parsed = MeshName.parse(name)
        return recipe(asdict(parsed), region(parsed, self.meshes), self.gel, self.meshes)

    def known(self, name: str, folder: Path) -> Path | None:
        """The mesh in a folder of stage 20 or where meshes are kept; None where it must be made."""
        places = (folder, SHIPPED, self.kept)
        return next((path for place in places if (path := find(place, self.key(name)))), None)

    def fetch(self, name: str, folder: Path) -> Path:
        """The mesh in a folder of stage 20: it lies there, is copied from where it is kept, or is made and kept."""
        from gelforge.mechanics.mesh.family import MeshName, make_mesh

        path = find(folder, self.key(name))
        if path:
            return path
        with alone(folder / name):
            path = self.known(name, folder)
            if path is None:
                path = add(self.kept, name, *make_mesh(MeshName.parse(name), self.gel, self.meshes))
            return path if path.parent == folder else copied(path, folder)


def source_of(params: Path, workflow: Path = WORKFLOW) -> MeshSource:
    """Where a stage gets meshes from. params: the slice of [meshes]."""
    table = read_parameters(params).meshes
    return MeshSource(load_gel(table.gel), table, workflow / MESH_FOLDER)
