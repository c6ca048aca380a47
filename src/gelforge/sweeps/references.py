"""Gel meshes of the chart: the label regions at several densities, and those of references, which follow the edge of contact."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.params import Params, StageParameters
from gelforge.mechanics.mesh.family import MeshFamily, choose_mesh, required_meshes, sizing
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.scene import Scene

Charted = Params | StageParameters | StageParameters  # what names the meshes and the solver of labels

EDGE_QUALITY = "label"  # of the hexahedra that show where the contact ends
BESIDE = 1.6  # spacings of their points, within which a point that touches and one that does not are neighbours
RIM_MM, RIM_GROWTH = 0.15, 0.7  # how far beside the edge of contact edges are shortest, and how they grow from there
MARGIN_MM = 0.5  # of the small tetrahedra beside the contact
LONGEST = 1.3  # of the edges asked for: what pytetwild leaves longer is split


def label_meshes(params: Charted) -> list[str]:
    """Names of the tetrahedral meshes on which labels are made."""
    return required_meshes(replace(params.fea, method="ccx"), params.meshes)


def chart_meshes(params: StageParameters | Params) -> list[str]:
    """Names of the tetrahedral meshes that scenes share: those of labels, and the chart's densities in every label region."""
    sizes, regions = params.pareto.ccx_sizes_mm, params.meshes.regions
    densities = [f"ccx-{region}-{size}" for size in sizes for region in regions]
    return list(dict.fromkeys([*label_meshes(params), *densities]))


def density_mesh(scene: Scene, folder: Path, params: Charted, size: float) -> str:
    """The mesh of one density that a press would be given among the label regions."""
    names = [f"ccx-{region}-{size}" for region in params.meshes.regions]
    return choose_mesh(scene, MeshFamily(folder, names))


def edge_of_contact(scene: Scene) -> np.ndarray:
    """Where the contact ends on the undeformed gel, as hexahedra have it: places (k, 2) mm; BadInput where they find no force."""
    from scipy.spatial import cKDTree

    from gelforge.mechanics.contact.penalty import FREE
    from gelforge.mechanics.hexsettings import quality
    from gelforge.mechanics.solvers.hex import HexSolver

    result = HexSolver(quality(EDGE_QUALITY)).solve(scene)
    contact = result.contact
    if not result.status.valid or contact is None:
        raise BadInput(f"the edge of contact of {scene.indenter.name} is not known: {result.status.value}")
    places, touches = contact.reference[:, :2], contact.status != FREE
    apart, nearest = cKDTree(places[touches]).query(places[~touches])
    beside = apart < BESIDE * np.sqrt(np.median(contact.weights[touches]))
    return (places[~touches][beside] + places[touches][nearest[beside]]) / 2


def reference_mesh(scene: Scene, params: StageParameters, doubled: bool = False) -> GelMesh:
    """Tetrahedra for the reference of one scene: small under the press, smallest where the contact ends.

    doubled: all of them of twice the size. BadInput where an element is inverted.
    """
    from scipy.spatial import cKDTree

    from gelforge.mechanics.mesh.tetmesh import gel_mesh, mesh_report

    table, factor = params.pareto.reference, 2.0 if doubled else 1.0
    edge = edge_of_contact(scene)
    low, high = edge.min(axis=0) - MARGIN_MM, edge.max(axis=0) + MARGIN_MM
    half, centre = (high - low) / 2, np.append((high + low) / 2, 0.0)
    graded = replace(params.meshes, growth=table.growth, fine_depth_mm=table.fine_depth_mm)
    at = sizing((float(half[0]), float(half[1])), factor * table.size_mm, graded)
    tree = cKDTree(edge)

    def longest(points: np.ndarray) -> np.ndarray:
        apart, _ = tree.query(points[:, :2])
        away = np.maximum(np.hypot(apart, points[:, 2]) - RIM_MM, 0.0)
        return np.minimum(factor * table.edge_mm + RIM_GROWTH * away, LONGEST * at(points - centre))

    mesh = gel_mesh(scene.gel, lambda points: at(points - centre), longest=longest)
    mesh_report(mesh, scene.gel)  # which refuses inverted elements
    return mesh
