"""Second-order tetrahedra: bisection of a gel's base mesh at the edge of a press' contact, and mesh quality.

At the edge of contact, displacement varies as the square root of the distance, so the force of a flat body depends
most on the element size there.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np

from gelforge.errors import BadInput
from gelforge.geometry.gel import Gel
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.hexmesh import round_corners

EDGES = np.array([[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]])  # midside order of C3D10
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])  # corners, outward for a positive tetrahedron
# In units of the longest edge wanted there: radius around the edge of contact within which edges are shortest;
# distance beside the contact, and depth below it, within which edges are as long as inside it.
RIM, BESIDE, DEEP = 0.25, 0.25, 0.33
RIM_GROWTH, GROWTH = 1.0, 0.6  # growth of edge length beyond that, mm per mm
FLAT = 1e-9  # of the gel's height: tolerance for a node of the flat box to lie on its top or base
EXACT = 256  # width, in pixels, of the margin around a contact within which distances to it are exact
_LENGTHS = 1e8  # squared lengths are compared as integer multiples of 1e-8 mm^2, so that rounding decides nothing


@dataclass(frozen=True)
class Sizes:
    """Longest edges wanted around a contact, mm.

    away: (nx, ny), signed distance to the edge of contact, negative inside, on a grid of spacing `pixel` that begins
    at `low` (x, y). edge, inside: longest edges at the edge of contact and inside it.
    """

    away: np.ndarray
    low: tuple[float, float]
    pixel: float
    edge: float
    inside: float

    @classmethod
    def at(
        cls, gel: Gel, mask: np.ndarray, pixel: float, low: tuple[float, float], edge: float, inside: float
    ) -> "Sizes":
        """Sizes around a contact of pixels `mask` (rows, columns); the first one's corner is at `low` (x, y) mm."""
        from scipy.ndimage import distance_transform_edt

        rim = [
            tuple(min(EXACT, int(np.ceil(max(0.0, free) / pixel)) + 1) for free in (start + side / 2, side / 2 - start - pixel * count))
            for start, side, count in zip(low, (gel.width, gel.length), mask.shape, strict=True)
        ]  # fmt: skip
        whole = np.pad(mask, rim)
        within = distance_transform_edt(whole) if mask.any() else np.zeros(whole.shape)
        beyond = distance_transform_edt(~whole) if mask.any() else np.full(whole.shape, np.inf)
        # the edge lies half a pixel from the centres of the pixels on either side of it
        away = pixel * np.where(whole, 0.5 - within, beyond - 0.5)
        x, y = (start - pixel * before[0] + pixel / 2 for start, before in zip(low, rim, strict=True))
        return cls(away, (x, y), pixel, edge, inside)


def bisected(nodes: np.ndarray, tets: np.ndarray, sizes: Sizes) -> tuple[np.ndarray, np.ndarray]:
    """Bisect tetrahedra (e, 4) at their longest edges until these are as short as wanted and the mesh conforms.

    Longest-edge bisection (Rivara 1984, Int. J. Numer. Methods Eng. 20, 745-756), which does not degrade shapes.
    """
    return _bisected(
        nodes, tets.astype(np.int64), sizes.away, np.array(sizes.low), sizes.pixel, sizes.edge, sizes.inside
    )


@numba.njit(cache=True)
def _longest(x, y, z, away, low, pixel, edge, inside):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Longest edge wanted at a point of the box, mm."""
    u, v = (x - low[0]) / pixel, (y - low[1]) / pixel
    i, j = min(max(round(u), 0), away.shape[0] - 1), min(max(round(v), 0), away.shape[1] - 1)
    s = away[i, j]
    if max(abs(u - i), abs(v - j)) > 0.5:  # outside the grid of distances
        s += pixel * np.hypot(u - i, v - j)
    at_edge = edge + RIM_GROWTH * max(np.hypot(abs(s), z) - RIM * edge, 0.0)
    around = inside + GROWTH * np.hypot(max(s - BESIDE * inside, 0.0), max(-z - DEEP * inside, 0.0))
    return min(at_edge, around)


@numba.njit(cache=True)
def _slot(keys, a, b):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Slot of the edge between nodes a and b in a hash table of edges, occupied or free, and its key."""
    key = (min(a, b) << 32) | max(a, b)
    size = len(keys)
    # Fibonacci hashing (Knuth, The Art of Computer Programming 3, section 6.4)
    at = ((key * 7046029254386353131) >> 20) & (size - 1)
    while keys[at] != -1 and keys[at] != key:
        at = (at + 1) & (size - 1)
    return at, key


@numba.njit(cache=True)
def _bisected(start, first, away, low, pixel, edge, inside):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    nodes = np.empty((4 * len(start) + 1024, 3))
    nodes[: len(start)] = start
    count = len(start)
    # sweeps over `tets` until nothing changes; one half replaces a bisected tetrahedron, the other is appended
    tets = np.empty((4 * len(first) + 1024, 4), np.int64)
    tets[: len(first)] = first
    n = len(first)
    keys, middles, filled = np.full(1 << 16, -1, np.int64), np.empty(1 << 16, np.int64), 0
    changed = True
    while changed:
        changed = False
        at = 0
        while at < n:
            best, best_key, best_a, best_b, marked = -1, -1, 0, 0, False
            for a in range(3):
                for b in range(a + 1, 4):
                    p, q = tets[at, a], tets[at, b]
                    u, v = min(p, q), max(p, q)
                    squared = 0.0
                    for axis in range(3):
                        squared += (nodes[u, axis] - nodes[v, axis]) ** 2
                    length = int(squared * _LENGTHS + 0.5)
                    slot, key = _slot(keys, p, q)
                    marked = marked or keys[slot] == key
                    if length > best or (length == best and key > best_key):
                        best, best_key, best_a, best_b = length, key, a, b
            p, q = tets[at, best_a], tets[at, best_b]
            if not marked:
                x, y, z = (nodes[p] + nodes[q]) / 2
                marked = np.sqrt(best / _LENGTHS) > _longest(x, y, z, away, low, pixel, edge, inside)
            if not marked:
                at += 1
                continue
            changed = True
            slot, key = _slot(keys, p, q)
            if keys[slot] != key:
                if count == len(nodes):
                    more = np.empty((2 * len(nodes), 3))
                    more[:count] = nodes
                    nodes = more
                nodes[count] = (nodes[min(p, q)] + nodes[max(p, q)]) / 2
                keys[slot], middles[slot] = key, count
                count += 1
                filled += 1
                if 2 * filled > len(keys):
                    old_keys, old_middles = keys, middles
                    keys, middles = np.full(2 * len(keys), -1, np.int64), np.empty(2 * len(keys), np.int64)
                    for old in range(len(old_keys)):
                        if old_keys[old] != -1:
                            new, _ = _slot(keys, old_keys[old] >> 32, old_keys[old] & 0xFFFFFFFF)
                            keys[new], middles[new] = old_keys[old], old_middles[old]
                    slot, _ = _slot(keys, p, q)
            if n == len(tets):
                wider = np.empty((2 * len(tets), 4), np.int64)
                wider[:n] = tets
                tets = wider
            tets[n] = tets[at]
            tets[at, best_a] = middles[slot]  # examined again next, as `at` stays
            tets[n, best_b] = middles[slot]
            n += 1
    return nodes[:count].copy(), tets[:n].copy()


def orient(nodes: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """The tetrahedra (e, 4) with nodes reordered so that every volume is positive."""
    tets = tets.copy()
    flip = signed_volumes(nodes, tets) < 0
    tets[flip, :2] = tets[flip, 1::-1]
    return tets


def signed_volumes(nodes: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Volume of each straight tetrahedron, (e,) mm^3, positive in CalculiX' node order."""
    a, b, c, d = (nodes[tets[:, i]] for i in range(4))
    return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6


def from_flat(gel: Gel, nodes: np.ndarray, tets: np.ndarray) -> GelMesh:
    """GelMesh of second-order tetrahedra from linear ones (e, 4) of the gel's box, nodes (n, 3) mm mapped to the gel.

    Corners of the outline are rounded and each column is stretched between base and `gel.top`: every node of the top,
    midsides included, lies on the exact surface, unless `straighten` had to move it.
    """
    top, bottom = (np.abs(nodes[:, 2] - z) < FLAT * gel.height for z in (0.0, -gel.height))
    x, y = round_corners(nodes[:, 0], nodes[:, 1], gel.width / 2, gel.length / 2, gel.corner_radius)
    nodes = np.column_stack([x, y, nodes[:, 2]])
    tets = orient(nodes, tets)
    corners = tets[:, FACES].reshape(-1, 3)
    faces, base = corners[top[corners].all(axis=1)], corners[bottom[corners].all(axis=1)]
    nodes, elements, middle = second_order(nodes, tets)
    nodes[:, 2] = bend(gel, nodes)
    untangle(nodes, elements)
    straighten(nodes, elements)
    sides = [middle(faces[:, [a, b]]) for a, b in ((0, 1), (1, 2), (2, 0))]
    faces = np.column_stack([faces, *sides]).astype(np.int32)
    bonded = np.unique(
        np.concatenate([base.ravel(), *(middle(base[:, [a, b]]) for a, b in ((0, 1), (1, 2), (2, 0)))])
    )
    nodes[bonded, 2] = -gel.height
    return GelMesh("tet10", nodes, elements, faces, bonded.astype(np.int32))


def second_order(
    nodes: np.ndarray, tets: np.ndarray
) -> tuple[np.ndarray, np.ndarray, Callable[[np.ndarray], np.ndarray]]:
    """Add midside nodes: nodes (n, 3), elements (e, 10), and a function from corner pairs (m, 2) to midsides (m,)."""

    def keyed(pairs: np.ndarray) -> np.ndarray:
        return pairs.min(axis=-1).astype(np.int64) * len(nodes) + pairs.max(axis=-1)

    keys, inverse = np.unique(keyed(tets[:, EDGES]), return_inverse=True)
    ends = np.column_stack(np.divmod(keys, len(nodes)))
    elements = np.concatenate([tets, len(nodes) + inverse.reshape(-1, 6)], axis=1).astype(np.int32)
    return (
        np.concatenate([nodes, nodes[ends].mean(axis=1)]), elements,
        lambda pairs: len(nodes) + np.searchsorted(keys, keyed(pairs)),
    )  # fmt: skip


def untangle(nodes: np.ndarray, elements: np.ndarray, least: float = 0.03, sweeps: int = 20) -> None:
    """Move inner corners of elements (e, 10) whose straight shape is worse than `least`, in place, to where it is best.

    Where the gel's surface is steep, a node just below it may get beyond the straight face of the element above. Tried
    are places on the way to the middle of its neighbours, and on either side of its flattest element's opposite face.
    """
    tets = elements[:, :4]
    faces, count = np.unique(np.sort(tets[:, FACES].reshape(-1, 3), axis=1), axis=0, return_counts=True)
    inner = np.ones(len(nodes), bool)
    inner[faces[count == 1]] = False
    for _ in range(sweeps):
        flat = tets[shapes(nodes, tets) < least]
        todo = np.unique(flat[inner[flat]])
        if not len(todo):
            return
        for node in todo:
            around = np.flatnonzero((tets == node).any(axis=1))
            own, place = tets[around], nodes[node].copy()
            middle = nodes[np.setdiff1d(own, node)].mean(axis=0)
            flattest = own[int(np.argmin(shapes(nodes, own)))]
            a, b, c = nodes[flattest[flattest != node]]
            away = np.cross(b - a, c - a)
            # as far as the opposite face is wide, on either side of it
            aims = (middle, *(place + side * away / np.sqrt(np.linalg.norm(away)) for side in (1.0, -1.0)))
            tried = [place + part * (aim - place) for aim in aims for part in np.linspace(0.0, 1.0, 9)]
            found = []
            for nodes[node] in tried:
                found.append(shapes(nodes, own).min())
            nodes[node] = tried[int(np.argmax(found))]
            ends, middles = elements[around][:, EDGES], elements[around][:, 4:]
            moved = (ends == node).any(axis=2)
            nodes[middles[moved]] = nodes[ends[moved]].mean(axis=1)


def straighten(nodes: np.ndarray, elements: np.ndarray, least: float = 0.1) -> None:
    """Move midsides of elements (e, 10) with a scaled Jacobian below `least` to the middle of their edges, in place.

    Where the gel's surface is steep within one edge, curving that edge onto the surface inverts the element.
    """
    while True:
        bowed = elements[scaled_jacobians(jacobians(nodes, elements)) < least]
        middles = nodes[bowed[:, EDGES]].mean(axis=2)
        if np.array_equal(nodes[bowed[:, 4:]], middles):
            return
        nodes[bowed[:, 4:]] = middles


def bend(gel: Gel, nodes: np.ndarray) -> np.ndarray:
    """Heights z of the nodes after each column of the flat box is stretched between base and `gel.top`."""
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
    """Smallest of each element's `jacobians` (e, 14) over its largest, (e,); 0 or less where it is inverted."""
    return dets.min(axis=1) / np.maximum(dets.max(axis=1), 1e-300)


def volumes(dets: np.ndarray) -> np.ndarray:
    """Volume of each curved element, (e,) mm^3, from its `jacobians` (e, 14), by CalculiX' integration rule."""
    return dets[:, 10:].mean(axis=1) / 6.0


def analytic_volume(gel: Gel) -> float:
    """Volume under `gel.top` above the base, mm^3, by the midpoint rule over the outline."""
    step = 0.05
    x = (np.arange(round(gel.width / step)) + 0.5) * step - gel.width / 2
    y = (np.arange(round(gel.length / step)) + 0.5) * step - gel.length / 2
    xx, yy = np.meshgrid(x, y, indexing="ij")
    return float((gel.top(xx, yy) + gel.height)[gel.inside(xx, yy)].sum() * step**2)


def shapes(nodes: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Shape of straight tetrahedra (e, 4): 1 for a regular one, 0 for a flat one, negative if inverted."""
    edges = np.linalg.norm(np.diff(nodes[tets[:, EDGES]], axis=2)[:, :, 0], axis=-1)
    return 6 * np.sqrt(2) * signed_volumes(nodes, tets) / np.sqrt((edges**2).mean(axis=1)) ** 3


def mesh_report(mesh: GelMesh, gel: Gel) -> dict:
    """Counts, sizes (mm), scaled Jacobian and volume (mm^3) of a C3D10 mesh; BadInput if an element is inverted."""
    corners = mesh.elements[:, :4]
    dets = jacobians(mesh.nodes, mesh.elements)
    own = volumes(dets)
    edges = np.linalg.norm(np.diff(mesh.nodes[corners[:, EDGES]], axis=2)[:, :, 0], axis=-1)
    scaled = scaled_jacobians(dets)
    shape = shapes(mesh.nodes, corners)
    volume = float(own.sum())
    exact = analytic_volume(gel)
    face_edges = np.linalg.norm(mesh.nodes[mesh.faces[:, [0, 1, 2]]] - mesh.nodes[mesh.faces[:, [1, 2, 0]]], axis=-1)
    report = {
        "kind": mesh.kind, "nodes": len(mesh.nodes), "elements": len(mesh.elements), "faces": len(mesh.faces),
        "base_nodes": len(mesh.base), "min_volume": float(own.min()), "max_volume": float(own.max()),
        "min_scaled_jacobian": float(scaled.min()), "min_quality": float(shape.min()),
        "median_quality": float(np.median(shape)), "min_edge": float(edges.min()),
        "max_edge": float(edges.max()), "face_edge_median": float(np.median(face_edges)),
        "volume": volume, "exact_volume": exact, "volume_error": volume / exact - 1,
    }  # fmt: skip
    if float(scaled.min()) <= 0:
        raise BadInput(
            f"gel {gel.name}: its mesh has an inverted element (scaled Jacobian {report['min_scaled_jacobian']:.3g}); its edges fall"
            " too steeply for tetrahedra, so solve presses on it by hexahedra"
        )
    return report
