"""A gel mesh with its displacement and nodal forces as .vtu, for ParaView and pyvista."""

from collections.abc import Mapping

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import need_room, publish
from gelforge.mechanics.mesh.gelmesh import GelMesh

VTK_CELL = {"hex8": 12, "tet10": 24}  # VTK_HEXAHEDRON, VTK_QUADRATIC_TETRA: same node order as C3D8 and C3D10


def write_vtu(
    path,
    mesh: GelMesh,
    displacement: np.ndarray | None = None,
    force: np.ndarray | None = None,
    known: np.ndarray | None = None,
    cells: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write the undeformed gel with arrays at its nodes and elements, whole or not at all.

    displacement (n, 3) mm ("Warp By Vector" shows the pressed gel), force (n, 3) N on the gel, known (n,)
    bool: where the displacement was computed, not interpolated. cells: arrays (e,) by name. BadInput where arrays do
    not match the mesh.
    """
    import pyvista as pv

    moved = np.zeros_like(mesh.nodes) if displacement is None else displacement
    loads = np.zeros_like(mesh.nodes) if force is None else force
    if moved.shape != mesh.nodes.shape or loads.shape != mesh.nodes.shape:
        raise BadInput(
            f"{path}: displacement {moved.shape} and force {loads.shape} for {len(mesh.nodes)} nodes;"
            " they belong to another mesh, run make again"
        )
    count, width = mesh.elements.shape
    corners = np.column_stack([np.full(count, width), mesh.elements]).ravel()
    grid = pv.UnstructuredGrid(corners, np.full(count, VTK_CELL[mesh.kind], np.uint8), mesh.nodes)
    if displacement is not None:
        grid.point_data["displacement"] = displacement
    if force is not None:
        grid.point_data["force"] = force
    if known is not None:
        grid.point_data["displacement_known"] = known.astype(np.uint8)
    for name, values in (cells or {}).items():
        grid.cell_data[name] = values
    with publish(path) as part:
        # VTK's writer aborts the process on a full disk; actual_memory_size is in KiB
        need_room(part.parent, 2 * 1024 * grid.actual_memory_size)
        grid.save(part)


def fill_inside(mesh: GelMesh, surface: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    """Interpolate displacements (n, 3) of all nodes from those (s, 3) of the nodes `surface` (s,) and the fixed base.

    Each inner node gets the mean of its neighbours, which is smooth, but good for pictures only.
    """
    from scipy.sparse import coo_matrix, diags
    from scipy.sparse.linalg import spsolve

    count, width = len(mesh.nodes), mesh.elements.shape[1]
    filled = np.zeros((count, 3))
    filled[surface] = displacement
    fixed = np.zeros(count, bool)
    fixed[surface] = fixed[mesh.base] = True
    used = np.zeros(count, bool)
    used[mesh.elements] = True
    inner = np.flatnonzero(used & ~fixed)
    if not len(inner):
        return filled
    a, b = np.repeat(mesh.elements, width, axis=1).ravel(), np.tile(mesh.elements, (1, width)).ravel()
    graph = coo_matrix((np.ones(len(a)), (a, b)), shape=(count, count)).tocsr()
    graph.data[:] = 1.0
    laplace = (diags(np.asarray(graph.sum(axis=1)).ravel()) - graph).tocsr()[inner]
    filled[inner] = spsolve(laplace[:, inner].tocsc(), -(laplace[:, np.flatnonzero(fixed)] @ filled[fixed]))
    return filled
