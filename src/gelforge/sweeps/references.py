"""Gel meshes of the chart: the label regions at several densities, and tight regions for references."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.params import Params
from gelforge.flow.params.stages import ForPareto, ForParetoMeshes, ForStability
from gelforge.geometry.gel import Gel
from gelforge.mechanics.mesh.family import MeshFamily, MeshName, choose_mesh, make_mesh, required_meshes, sizing
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.scene import Scene

Charted = Params | ForPareto | ForStability  # what names the meshes and the solver of labels


def label_meshes(params: Charted) -> list[str]:
    """Names of the tetrahedral meshes on which labels are made."""
    return required_meshes(replace(params.fea, fidelity="ccx"), params.meshes)


def density_meshes(params: ForPareto | Params) -> list[str]:
    """Names of the tetrahedral meshes of the chart's densities, in every label region."""
    sizes, regions = params.pareto.ccx_sizes_mm, params.meshes.regions
    return [f"ccx-{region}-{size}" for size in sizes for region in regions]


def reference_mesh(params: ForPareto | Params, region: str, halved: bool = False) -> str:
    """Name of the reference mesh of a region of [pareto.regions], or of the one of half its size."""
    regions = params.pareto.regions
    if region not in regions:
        known = ", ".join(regions)
        raise BadInput(f"workflow/scenes.toml: fine = {region!r} is no region; [pareto.regions] has {known}")
    return f"fine-{region}-{regions[region].size * (0.5 if halved else 1.0)}"


def turns(params: ForPareto | Params, region: str) -> bool:
    """Whether a region of [pareto.regions] is the same after half a turn about z."""
    x_min, x_max, y_min, y_max = params.pareto.regions[region].box
    return (x_min, y_min) == (-x_max, -y_max)


def all_meshes(params: ForPareto | Params, tables: dict[str, dict]) -> list[str]:
    """Every mesh that the chart of these scenes (raw tables by name) needs, without repetition."""
    fine = [reference_mesh(params, tables[name]["fine"]) for name in tables]
    fine += [reference_mesh(params, tables[name]["fine"], True) for name in params.pareto.halved]
    return list(dict.fromkeys([*label_meshes(params), *density_meshes(params), *fine]))


def build_mesh(name: str, gel: Gel, params: ForParetoMeshes | ForPareto) -> tuple[GelMesh, dict]:
    """Build one mesh by its name and report on it."""
    if not name.startswith("fine-"):
        return make_mesh(MeshName.parse(name), gel, params.meshes)
    from gelforge.mechanics.mesh.tetmesh import SIZING_STEP_MM, gel_mesh, mesh_report

    _, region, size = name.split("-")
    table = params.pareto.regions[region]
    x_min, x_max, y_min, y_max = table.box
    centre = np.array([(x_min + x_max) / 2, (y_min + y_max) / 2, 0.0])
    half = (x_max - x_min) / 2, (y_max - y_min) / 2
    # pytetwild's edges come out longer than asked for, the more so where the grid that holds the sizes is coarse
    # beside them: asked like this, those of disc are 0.41 mm, and half of that where the reference is halved
    # (where `hold` splits them, they are as asked)
    halved, hold = float(size) < table.size, table.hold or 0.0
    factor, step = (1.0, SIZING_STEP_MM) if hold else (0.8, 0.4) if halved else (0.9, SIZING_STEP_MM)
    grading = params.pareto.grading
    graded = replace(params.meshes, growth=grading.growth, fine_depth_mm=grading.fine_depth_mm)
    at = sizing(half, factor * float(size), graded)
    mesh = gel_mesh(gel, lambda points: at(points - centre), step=step, hold=hold)
    report = {"engine": "fine", "region": region, "size": float(size), "half_mm": list(half), "gel": gel.name}
    return mesh, report | mesh_report(mesh, gel)


def density_mesh(scene: Scene, folder: Path, params: Charted, size: float) -> str:
    """The mesh of one density that a press would be given among the label regions."""
    names = [f"ccx-{region}-{size}" for region in params.meshes.regions]
    return choose_mesh(scene, MeshFamily(folder, names))
