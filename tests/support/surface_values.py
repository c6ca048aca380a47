"""Values at points of a gel's surface from nodal values, and forces at its base from the displacement."""

import numpy as np

from gelforge.mechanics.elements.element import ELEMENTS
from gelforge.mechanics.material import Material
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.hexmesh import surface_lines


def interpolate_surface(mesh: GelMesh, values: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Nodal values (n, k) of a structured hexahedral mesh at reference points (m, 2) of its top surface, (m, k).

    Bilinear on the cells; points off the surface take the value at the nearest edge. The mesh may come from
    GelMesh.load, because its lines are derived from the nodes.
    """
    xs, ys, first = surface_lines(mesh)
    nx = len(xs) - 1
    xy = np.asarray(xy, float)
    i = np.clip(np.searchsorted(xs, xy[:, 0], "right") - 1, 0, nx - 1)
    j = np.clip(np.searchsorted(ys, xy[:, 1], "right") - 1, 0, len(ys) - 2)
    s = np.clip((xy[:, 0] - xs[i]) / (xs[i + 1] - xs[i]), 0.0, 1.0)[:, None]
    t = np.clip((xy[:, 1] - ys[j]) / (ys[j + 1] - ys[j]), 0.0, 1.0)[:, None]
    corner = first + j * (nx + 1) + i
    low = (1 - s) * values[corner] + s * values[corner + 1]
    high = (1 - s) * values[corner + nx + 1] + s * values[corner + nx + 2]
    return (1 - t) * low + t * high


def base_reactions(mesh: GelMesh, displacement: np.ndarray, material: Material) -> np.ndarray:
    """Internal forces (b, 3) N of the elements at the nodes of the base, from the displacement (n, 3) mm alone."""
    inner = np.zeros_like(mesh.nodes)
    solid = ELEMENTS[mesh.kind].on(mesh.nodes, mesh.cells)
    solid.internal_forces(displacement, material.shear_modulus, material.bulk_modulus, inner)
    return inner[mesh.base]
