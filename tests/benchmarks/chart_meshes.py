"""Meshes of the chart for a benchmark that stands alone: elsewhere make builds them."""

from pathlib import Path

from gelforge.flow.files import write_json
from gelforge.flow.params import Params, StageParameters
from gelforge.geometry.gel import load_gel
from gelforge.mechanics.mesh.family import MeshName, make_mesh
from gelforge.sweeps.trial import ChartBench


def need_mesh(name: str, folder: Path, params: StageParameters | Params) -> Path:
    """Path of a mesh of the folder, which is built first where it is missing."""
    path = Path(folder) / f"{name}.npz"
    if not (path.exists() and path.with_suffix(".json").exists()):
        mesh, report = make_mesh(MeshName.parse(name), load_gel(params.meshes.gel), params.meshes)
        write_json(path.with_suffix(".json"), report)
        mesh.save(path)
    return path


def ensure_meshes(bench: ChartBench, names: list[str]) -> None:
    """Build what is missing of the meshes (make builds them as targets; a benchmark may stand alone)."""
    for name in names:
        need_mesh(name, bench.meshes, bench.params)
