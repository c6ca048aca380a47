"""Second-order tetrahedra: the gel with a sizing field, and the quality of a mesh."""

import contextlib
import itertools
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.geometry.gel import Gel
from gelforge.mechanics.mesh.gelmesh import GelMesh

EDGES = np.array([[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]])  # midside order of C3D10
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])  # corners, outward for a positive tetrahedron
OUTLINE_STEP_MM = 1.5  # length of a side of the outline polygon; no edge of a mesh there is shorter
ARC_SIDES = 4  # of the outline at each of its rounded corners
SIZING_STEP_MM = 0.75
# How far pytetwild may leave the flat pad's surface before top and base are made flat again. 0.007 takes four times the
# time, because the surface is sampled that densely.
ENVELOPE_MM = 0.016
ANEW = "make it again, pytetwild's meshes are never the same, or give it a smaller size (the last part of its name)"


def outline(gel: Gel) -> np.ndarray:
    """Outline of the gel as a polygon, counter-clockwise, (n, 2) mm, sides about OUTLINE_STEP_MM long."""
    half = np.array([gel.width, gel.length]) / 2
    centres = (half - gel.corner_radius) * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    corners = []
    for quarter, centre in enumerate(centres):
        angle = np.pi / 2 * (quarter + np.linspace(0, 1, ARC_SIDES + 1))
        corners.append(centre + gel.corner_radius * np.column_stack([np.cos(angle), np.sin(angle)]))
    points = np.concatenate(corners)
    filled = []
    for start, end in zip(points, np.roll(points, -1, axis=0), strict=True):
        pieces = max(1, round(np.linalg.norm(end - start) / OUTLINE_STEP_MM))
        filled.append(start + (end - start) * np.arange(pieces)[:, None] / pieces)
    return np.concatenate(filled)


def prism(polygon: np.ndarray, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Closed triangles of the convex prism over `polygon` (n, 2) from z = -height to z = 0."""
    count = len(polygon)
    top = np.column_stack([polygon, np.zeros(count)])
    bottom = np.column_stack([polygon, np.full(count, -height)])
    vertices = np.concatenate([top, bottom, [[0, 0, 0], [0, 0, -height]]])
    here = np.arange(count)
    there = np.roll(here, -1)
    faces = [
        np.column_stack([here, there, np.full(count, 2 * count)]),
        np.column_stack([there + count, here + count, np.full(count, 2 * count + 1)]),
        np.column_stack([here, here + count, there]),
        np.column_stack([there, here + count, there + count]),
    ]
    return vertices, np.concatenate(faces).astype(np.int32)


def sizing_grid(gel: Gel, size: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Background tetrahedra for pytetwild: vertices, tets and edge lengths from size(points) -> mm."""
    margin = step = SIZING_STEP_MM
    axes = [
        np.linspace(-extent / 2 - margin, extent / 2 + margin, int(np.ceil(extent / step)) + 3)
        for extent in (gel.width, gel.length)
    ]
    axes.append(np.linspace(-gel.height - margin, margin, int(np.ceil(gel.height / step)) + 3))
    vertices, tets = kuhn_grid(axes)
    return vertices, tets.astype(np.int32), size(vertices)


def kuhn_grid(axes: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (n, 3) and tetrahedra (e, 4) of a grid with lines `axes` (x, y, z), six to a cell (Kuhn 1960)."""
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    index: Any = np.arange(points[..., 0].size).reshape(points.shape[:3])
    corner: dict[tuple[int, ...], Any] = {
        (i, j, k): index[i : index.shape[0] - 1 + i, j : index.shape[1] - 1 + j, k : index.shape[2] - 1 + k].ravel()
        for i, j, k in itertools.product((0, 1), repeat=3)
    }
    tets = []
    for order in itertools.permutations(range(3)):
        path: list[tuple[int, ...]] = [(0, 0, 0)]
        for axis in order:
            path.append(tuple(1 if a == axis else v for a, v in enumerate(path[-1])))
        tets.append(np.column_stack([corner[p] for p in path]))
    vertices = points.reshape(-1, 3)
    return vertices, orient(vertices, np.concatenate(tets))


def orient(nodes: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """The same tetrahedra (e, 4), reordered so that every volume is positive."""
    tets = tets.copy()
    flip = signed_volumes(nodes, tets) < 0
    tets[flip, :2] = tets[flip, 1::-1]
    return tets


def signed_volumes(nodes: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Volume of each straight tetrahedron, (e,) mm^3, positive in CalculiX' node order."""
    a, b, c, d = (nodes[tets[:, i]] for i in range(4))
    return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6


def boundary_faces(tets: np.ndarray) -> np.ndarray:
    """Corner triples (f, 3) of the faces that belong to one tetrahedron only, oriented outward."""
    faces = tets[:, FACES].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[first[count == 1]]


def second_order(nodes: np.ndarray, tets: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict]:
    """Add midside nodes: nodes (n, 3), elements (e, 10), and the midside of each sorted corner pair."""
    pairs = np.sort(tets[:, EDGES].reshape(-1, 2), axis=1)
    unique, inverse = np.unique(pairs, axis=0, return_inverse=True)
    middles = nodes[unique].mean(axis=1)
    elements = np.concatenate([tets, len(nodes) + inverse.reshape(-1, 6)], axis=1).astype(np.int32)
    midside = {(int(a), int(b)): len(nodes) + i for i, (a, b) in enumerate(unique)}
    return np.concatenate([nodes, middles]), elements, midside


def gel_mesh(
    gel: Gel,
    size: Callable[[np.ndarray], np.ndarray],
    threads: int = 1,
    longest: Callable[[np.ndarray], np.ndarray] | None = None,
) -> GelMesh:
    """Mesh the gel with second-order tetrahedra.

    gel: the pad. size: points (n, 3) mm -> edge lengths (n,) mm, on the flat pad (top at z = 0). longest:
    points -> edge lengths (n,) mm above which edges are split (None: they stay as pytetwild leaves them, two to
    three sizes long where the fine part is small).
    The pad is meshed as a flat prism and then bent column by column onto `gel.top`, so that every
    top node, midsides included, lies on the exact surface and every base node on z = -height.
    """
    vertices, faces = prism(outline(gel), gel.height)
    background, bg_tets, values = sizing_grid(gel, size)
    envelope = ENVELOPE_MM / float(np.linalg.norm(np.ptp(vertices, axis=0)))  # of the diagonal
    nodes, tets = tetrahedralise(
        vertices, faces, edge_length_abs=float(values.max()), epsilon=envelope, num_threads=threads,
        bg_vertices=background, bg_tets=bg_tets, bg_values=values,
    )  # fmt: skip
    if longest:
        nodes, tets = split_long_edges(nodes, tets, longest)
    return from_flat(gel, nodes, tets)


def split_long_edges(
    nodes: np.ndarray, tets: np.ndarray, longest: Callable[[np.ndarray], np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Halve edges longer than longest(points (n, 3)) -> (n,) mm at their midpoints, until none is left.

    An edge is halved in all elements (e, 4) around it at once, so that the mesh stays conforming, and only where it
    is the longest to halve in each: longest-edge bisection (Rivara 1984), under which shapes stay sound.
    """
    while True:
        pairs = np.sort(tets[:, EDGES], axis=2).reshape(-1, 2)
        edges, of = np.unique(pairs, axis=0, return_inverse=True)
        of = of.reshape(-1, 6)
        length = np.linalg.norm(nodes[edges[:, 0]] - nodes[edges[:, 1]], axis=1)
        long = length > longest(nodes[edges].mean(axis=1))
        if not long.any():
            return nodes, tets
        rank = np.empty(len(edges), int)
        rank[np.argsort(length, kind="stable")] = np.arange(len(edges))
        own = np.where(long[of], rank[of], -1)  # an element's edges to halve, the longest highest
        first = np.where(own.max(axis=1) >= 0, of[np.arange(len(tets)), own.argmax(axis=1)], -1)
        agreed = np.bincount(first[first >= 0], minlength=len(edges)) == np.bincount(of.ravel())
        middle = np.full(len(edges), -1)
        middle[long & agreed] = len(nodes) + np.arange((long & agreed).sum())
        nodes = np.concatenate([nodes, nodes[edges[long & agreed]].mean(axis=1)])
        cut = (first >= 0) & (middle[first] >= 0)
        whole, ends, new = tets[cut], edges[first[cut]], middle[first[cut]][:, None]
        halves = [np.where(whole == ends[:, [side]], new, whole) for side in (0, 1)]
        tets = np.concatenate([tets[~cut], *halves])


def tetrahedralise(vertices: np.ndarray, faces: np.ndarray, **options: Any) -> tuple[np.ndarray, np.ndarray]:
    """Linear tetrahedra inside closed triangles: the nodes (n, 3) in use and elements (e, 4)."""
    import pytetwild

    # It leaves a file in the folder it runs in.
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder), _interrupt_kept():
        nodes, tets = pytetwild.tetrahedralize(vertices, faces, **options)
    used, numbered = np.unique(tets, return_inverse=True)
    return nodes[used], numbered.reshape(-1, 4)


@contextlib.contextmanager
def _interrupt_kept() -> Iterator[None]:
    """What SIGINT does stays what it was: pytetwild makes it end the process, so Ctrl-C would end a whole notebook."""
    handler = signal.getsignal(signal.SIGINT)
    try:
        yield
    finally:
        # Python lets its main thread alone set handlers.
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, handler)


def from_flat(gel: Gel, nodes: np.ndarray, tets: np.ndarray) -> GelMesh:
    """GelMesh from linear tetrahedra (e, 4) of the flat pad (top at z = 0)."""
    tets = orient(nodes, tets)
    faces = boundary_faces(tets)
    heights = nodes[faces][..., 2]
    tolerance = 1.25 * ENVELOPE_MM  # edges on the sides are longer than 0.2 mm
    is_top = (np.abs(heights) < tolerance).all(axis=1)
    is_base = (np.abs(heights + gel.height) < tolerance).all(axis=1)
    if not is_top.any() or not is_base.any():
        raise BadInput(f"the mesh of the gel lost its top or base; {ANEW}")
    nodes = nodes.copy()
    nodes[np.unique(faces[is_top]), 2] = 0.0
    nodes[np.unique(faces[is_base]), 2] = -gel.height
    nodes, elements, midside = second_order(nodes, tets)
    nodes[:, 2] = bend(gel, nodes)
    straighten(nodes, elements)

    def whole(corners: np.ndarray) -> np.ndarray:
        middles = [[midside[min(a, b), max(a, b)] for a, b in ((f[0], f[1]), (f[1], f[2]), (f[2], f[0]))]
                   for f in corners.tolist()]  # fmt: skip
        return np.concatenate([corners, np.array(middles)], axis=1).astype(np.int32)

    base = np.unique(whole(faces[is_base])).astype(np.int32)
    nodes[base, 2] = -gel.height
    return GelMesh("tet10", nodes, elements, whole(faces[is_top]), base)


def straighten(nodes: np.ndarray, elements: np.ndarray, least: float = 0.1) -> None:
    """Move midsides of elements (e, 10) whose scaled Jacobian is below `least` to the middle of their edges, in place.

    Where a gel falls steeply within one edge, an edge that is bowed onto its surface inverts the element.
    """
    while True:
        bowed = elements[scaled_jacobians(jacobians(nodes, elements)) < least]
        middles = nodes[bowed[:, EDGES]].mean(axis=2)
        if np.array_equal(nodes[bowed[:, 4:]], middles):
            return
        nodes[bowed[:, 4:]] = middles


def bend(gel: Gel, nodes: np.ndarray) -> np.ndarray:
    """Heights z after each column of the flat pad is stretched between the base and `gel.top`."""
    fraction = (nodes[:, 2] + gel.height) / gel.height
    return -gel.height + fraction * (gel.top(nodes[:, 0], nodes[:, 1]) + gel.height)


# --- quality ---------------------------------------------------------------------------------

# Barycentric (l1, l2, l3) of the four Gauss points of a C3D10, (4, 3), to the digits of CalculiX' gauss3d5.
GAUSS = np.full((4, 3), 0.13819660)
GAUSS[[1, 2, 3], [0, 1, 2]] = 0.58541020


def gradients(xi: np.ndarray) -> np.ndarray:
    """Derivatives of the ten shape functions at barycentric (l1, l2, l3) = xi (q, 3): (q, 10, 3)."""
    l1, l2, l3 = np.asarray(xi, float).T
    l0 = 1 - l1 - l2 - l3
    zero = np.zeros_like(l0)
    d0 = 4 * l0 - 1
    rows = [
        (-d0, -d0, -d0), (4 * l1 - 1, zero, zero), (zero, 4 * l2 - 1, zero), (zero, zero, 4 * l3 - 1),
        (4 * (l0 - l1), -4 * l1, -4 * l1), (4 * l2, 4 * l1, zero), (-4 * l2, 4 * (l0 - l2), -4 * l2),
        (-4 * l3, -4 * l3, 4 * (l0 - l3)), (4 * l3, zero, 4 * l1), (zero, 4 * l3, 4 * l2),
    ]  # fmt: skip
    return np.stack([np.stack(row, -1) for row in rows], axis=1)


def jacobians(nodes: np.ndarray, elements: np.ndarray) -> np.ndarray:
    """Determinant of each C3D10's Jacobian at its corners, midsides and Gauss points: (e, 14)."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    middles = (corners[EDGES[:, 0]] + corners[EDGES[:, 1]]) / 2
    matrix = np.einsum("eai,qaj->eqij", nodes[elements], gradients(np.concatenate([corners, middles, GAUSS])))
    return np.linalg.det(matrix)


def scaled_jacobians(dets: np.ndarray) -> np.ndarray:
    """Smallest of each element's `jacobians` (e, 14) as a share of its largest (e,); 0 or less where it is inverted."""
    return dets.min(axis=1) / np.maximum(dets.max(axis=1), 1e-300)


def volumes(dets: np.ndarray) -> np.ndarray:
    """Volume of each element within its bowed edges from its `jacobians` (e, 14), (e,) mm^3, to CalculiX' integration."""
    return dets[:, 10:].mean(axis=1) / 6.0


def analytic_volume(gel: Gel) -> float:
    """Volume under `gel.top` above the base, mm^3, by the midpoint rule over the outline."""
    step = 0.02
    x = (np.arange(round(gel.width / step)) + 0.5) * step - gel.width / 2
    y = (np.arange(round(gel.length / step)) + 0.5) * step - gel.length / 2
    xx, yy = np.meshgrid(x, y, indexing="ij")
    return float((gel.top(xx, yy) + gel.height)[gel.inside(xx, yy)].sum() * step**2)


def mesh_report(mesh: GelMesh, gel: Gel) -> dict:
    """Report of a C3D10 mesh: counts, sizes (mm), scaled Jacobian, volume (mm^3) against the exact one."""
    corners = mesh.elements[:, :4]
    dets = jacobians(mesh.nodes, mesh.elements)
    own = volumes(dets)
    edges = np.linalg.norm(np.diff(mesh.nodes[corners[:, EDGES]], axis=2)[:, :, 0], axis=-1)
    scaled = scaled_jacobians(dets)
    radius_ratio = 6 * np.sqrt(2) * signed_volumes(mesh.nodes, corners) / np.sqrt((edges**2).mean(axis=1)) ** 3
    volume = float(own.sum())
    exact = analytic_volume(gel)
    face_edges = np.linalg.norm(mesh.nodes[mesh.faces[:, [0, 1, 2]]] - mesh.nodes[mesh.faces[:, [1, 2, 0]]], axis=-1)
    report = {
        "kind": mesh.kind, "nodes": len(mesh.nodes), "elements": len(mesh.elements), "faces": len(mesh.faces),
        "base_nodes": len(mesh.base), "min_volume": float(own.min()), "max_volume": float(own.max()),
        "min_scaled_jacobian": float(scaled.min()), "min_quality": float(radius_ratio.min()),
        "median_quality": float(np.median(radius_ratio)), "min_edge": float(edges.min()),
        "max_edge": float(edges.max()), "face_edge_median": float(np.median(face_edges)),
        "volume": volume, "exact_volume": exact, "volume_error": volume / exact - 1,
    }  # fmt: skip
    if float(scaled.min()) <= 0:
        raise BadInput(
            f"the mesh has an inverted element (scaled Jacobian {report['min_scaled_jacobian']:.3g}); {ANEW}"
        )
    return report
