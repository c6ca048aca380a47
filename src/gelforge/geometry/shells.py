"""Split a triangle mesh into closed shells, orient them outwards and unite them to the surface seen from outside."""

from collections.abc import Sequence

import numpy as np

from gelforge.errors import BadInput
from gelforge.geometry.triangles import Mesh, boolean, is_watertight, joined, to_meshlab, unique_rows, volume

NEAR_MM = 1e-6  # surfaces closer than this touch
FLAT_RAD = 1e-6  # triangles at a smaller angle about their edge lie on each other
LEAST_MM2 = 1e-9  # a triangle is degenerate if twice its area is not above this
LEAST_MM3 = 1e-6  # a shell that encloses less is a sheet
HINT = "in the program that exported it"


def outer_surface(vertices: np.ndarray, faces: np.ndarray, what: str) -> Mesh:
    """The surface of a body seen from outside: vertices (v, 3) and faces (f, 3) of closed, outward shells.

    The shells may have any orientation. A shell inside another is dropped; shells that overlap or touch are united. A
    shell that is open, one-sided, crosses itself or encloses nothing raises BadInput, which names it and `what`.
    """
    faces = _without_needless(vertices, faces)
    if _half_edges(faces)[2].max() > 2:
        # with orientations corrected, the second split separates shells that touch only along an edge
        faces = split_shells(vertices, _without_copies(faces), what)[1]
    number, turned = split_shells(vertices, faces, what)
    count = number.max() + 1
    shells = [_used(vertices, turned[number == at]) for at in range(count)]
    for at in np.unique(number[_crossing((vertices, turned))]):
        if cut := np.count_nonzero(_crossing(shells[at])):
            raise BadInput(
                f"{_name(at, shells, what)}: {cut} of its triangles cut through each other; repair it {HINT}"
            )
    solid = [at for at in range(count) if volume(*shells[at]) >= LEAST_MM3]
    if not solid:
        raise BadInput(f"{what}: the surface encloses {volume(vertices, turned):.1e} mm^3; export a solid body")
    outer = _used(vertices, turned[np.isin(number, solid)])
    if not _apart([shells[at] for at in solid]):
        outer = _united(outer, what)
    for at in set(range(count)) - set(solid):
        if _beyond(shells[at], outer):
            hint = f"remove it, or give it a thickness, {HINT}"
            raise BadInput(f"{_name(at, shells, what)}: encloses nothing, it is a sheet; {hint}")
    return outer


def split_shells(vertices: np.ndarray, faces: np.ndarray, what: str) -> tuple[np.ndarray, np.ndarray]:
    """Shell number (f,) of each triangle, in the order of the file, and the triangles (f, 3), oriented outwards.

    Where more than two triangles meet in an edge, a shell continues from a triangle to its neighbour around the edge.
    Triangles that lie on each other are paired, so a wall between two touching parts becomes a flat shell of its own.
    Shells that are open, one-sided or folded onto themselves raise BadInput.
    """
    half, edge, count = _half_edges(faces)
    if (count % 2).any():
        _refuse_open(vertices, faces, edge, count, what)
    first, second, flat = _paired(vertices, faces, half, edge, count)
    # the graph has two nodes per triangle, as given and reversed; neighbours are linked where orientations agree
    ahead, n = half[:, 0] < half[:, 1], len(faces)
    same, one, other = ahead[first] == ahead[second], first // 3, second // 3
    label = _connected(2 * n, np.concatenate([one, one + n]), np.concatenate([other + n * same, other + n * ~same]))
    low, high = np.minimum(label[:n], label[n:]), np.maximum(label[:n], label[n:])
    number = _in_order(low)
    if (low == high).any():
        _refuse(
            vertices,
            faces,
            number,
            number[np.argmax(low == high)],
            what,
            "its surface has one side only; make it a solid body",
        )
    turned = np.where((label[:n] == high)[:, None], faces[:, ::-1], faces)
    signs = _volumes(vertices, turned, number)
    folded = number[one[flat]]
    folded = folded[np.abs(signs[folded]) >= LEAST_MM3]
    if len(folded):
        _refuse(
            vertices, faces, number, folded.min(), what, "parts of it lie on each other; unite them into one body"
        )
    return number, np.where((signs[number] < 0.0)[:, None], turned[:, ::-1], turned)


def _volumes(vertices: np.ndarray, faces: np.ndarray, number: np.ndarray) -> np.ndarray:
    """Signed volume of each numbered shell, mm^3."""
    a, b, c = vertices[faces].transpose(1, 0, 2)
    return np.bincount(number, np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0)


def _half_edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The three half edges (3f, 2) of each triangle, the edge index of each (3f,), and half edges per edge (e,)."""
    half = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64)
    key = half.min(axis=1) * (half.max() + 1) + half.max(axis=1)
    _, edge, count = np.unique(key, return_inverse=True, return_counts=True)
    return half, edge, count


def _paired(vertices, faces, half, edge, count) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of half edges (p,), (p,) across which a shell continues; whether their triangles lie on each other."""
    order = np.argsort(edge, kind="stable")
    start = np.cumsum(count) - count
    plain = start[count == 2]
    first, second = [order[plain]], [order[plain + 1]]
    flat = [np.zeros(len(plain), bool)]
    part = _connected(len(faces), first[0] // 3, second[0] // 3)
    for begin, size in zip(start[count > 2], count[count > 2], strict=True):
        ring, close = _around(vertices, faces, half, part, order[begin : begin + size])
        first.append(ring[::2])
        second.append(ring[1::2])
        flat.append(close)
    return np.concatenate(first), np.concatenate(second), np.concatenate(flat)


def _around(vertices, faces, half, part, members: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Half edges (k,) of one edge, consecutive pairs on one shell, and which pairs (k / 2,) lie on each other.

    part: (f,), labels of triangles that ordinary edges connect. If every part has two half edges here, these are the
    pairs. Otherwise triangles are sorted by angle about the edge: pairs are those that lie on each other, or, where
    none do, neighbours that enclose solid according to the orientation of the first.
    """
    of = part[members // 3]
    if (np.unique(of, return_counts=True)[1] == 2).all():
        return members[np.argsort(of, kind="stable")], np.zeros(len(members) // 2, bool)
    a, b = np.sort(half[members[0]])
    along = (vertices[b] - vertices[a]) / np.linalg.norm(vertices[b] - vertices[a])
    aside = vertices[faces[members // 3].sum(axis=1) - a - b] - vertices[a]
    aside = aside - (aside @ along)[:, None] * along
    up = np.cross(along, aside[0])
    angle = np.arctan2(aside @ up / np.linalg.norm(up), aside @ aside[0] / np.linalg.norm(aside[0]))
    order = np.argsort(angle, kind="stable")
    gaps = np.diff(angle[order], append=angle[order[0]] + 2.0 * np.pi)
    shift = int(gaps.argmin()) % 2 if gaps.min() < FLAT_RAD else int(half[members[order[0]], 0] == a)
    return members[np.roll(order, -shift)], np.roll(gaps, -shift)[::2] < FLAT_RAD


def _connected(count: int, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Component label (count,) of each node of a graph with links from `one` to `other`, (k,) each."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    return connected_components(coo_matrix((np.ones(len(one)), (one, other)), shape=(count, count)), directed=False)[
        1
    ]


def _without_needless(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The triangles if closed; else without duplicates, or without degenerate ones too, if that closes them."""
    once = faces[np.sort(unique_rows(np.sort(faces, axis=1))[0])]
    a, b, c = vertices[once].transpose(1, 0, 2)
    wide = once[np.linalg.norm(np.cross(b - a, c - a), axis=1) > LEAST_MM2]
    closed = (kept for kept in (faces, once, wide) if len(kept) and not (_half_edges(kept)[2] % 2).any())
    return next(closed, faces)


def _without_copies(faces: np.ndarray) -> np.ndarray:
    """Triangles without repeated copies of a shell.

    Duplicate triangles that form a closed shell are a copy; others are a wall between parts that touch.
    """
    while True:
        _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
        twice = np.flatnonzero(count > 1)
        if not len(twice):
            return faces
        _, edge, uses = _half_edges(faces[first[twice]])
        of = np.repeat(np.arange(len(twice)), 3)
        label = _connected(len(twice) + len(uses), of, edge + len(twice))[: len(twice)]
        rim = np.unique(label[of[uses[edge] % 2 == 1]])
        copies = first[twice[~np.isin(label, rim)]]
        if not len(copies):
            return faces
        faces = np.delete(faces, copies, axis=0)


def _refuse_open(vertices, faces, edge, count, what: str) -> None:
    """Raise BadInput naming the first shell with edges that belong to an odd number of triangles."""
    of = np.repeat(np.arange(len(faces)), 3)
    number = _in_order(_connected(len(faces) + len(count), of, edge + len(faces))[: len(faces)])
    odd = count[edge] % 2 == 1
    at = number[of[odd]].min()
    edges = len(np.unique(edge[odd & (number[of] == at)]))
    why = f"it is not closed: {edges} edges belong to an odd number of triangles, every edge must belong to two; close holes"
    _refuse(vertices, faces, number, at, what, f"{why} and merge doubled vertices")


def _refuse(vertices, faces, number, at, what: str, why: str) -> None:
    shells = [_used(vertices, faces[number == each]) for each in range(number.max() + 1)]
    raise BadInput(f"{_name(at, shells, what)}: {why} {HINT}")


def _apart(shells: list[Mesh]) -> bool:
    """Whether shells need no union: each is watertight, and their bounding boxes do not meet."""
    low, high = (np.array([of(vertices, axis=0) for vertices, _ in shells]) for of in (np.min, np.max))
    meet = ((low[:, None] <= high + NEAR_MM) & (high[:, None] >= low - NEAR_MM)).all(axis=2)
    return np.count_nonzero(meet) == len(shells) and all(is_watertight(faces) for _, faces in shells)


def _united(surface: Mesh, what: str) -> Mesh:
    """Unite closed outward shells to one surface without inner shells, walls and cavities; BadInput if not closed."""
    vertices, faces = boolean(surface, surface, "union")
    number, turned = split_shells(vertices, faces, what)
    outward = np.flatnonzero(_volumes(vertices, faces, number) > 0.0)
    united = [_used(vertices, turned[number == at]) for at in outward]
    if not all(is_watertight(each) for _, each in united):
        raise BadInput(
            f"{what}: its parts touch in a way that leaves no closed surface; unite them into one body {HINT}"
        )
    return joined(united)


def _crossing(mesh: Mesh) -> np.ndarray:
    """Whether each triangle (f,) cuts through another one."""
    meshes = to_meshlab(mesh)
    meshes.apply_filter("compute_selection_by_self_intersections_per_face")
    return np.asarray(meshes.current_mesh().face_selection_array(), bool)


def signed_distances(points: np.ndarray, mesh: Mesh) -> np.ndarray:
    """Signed distances (n,) mm of points to a closed surface (VTK's closest triangle)."""
    import pyvista

    cloud = pyvista.PolyData(np.ascontiguousarray(points))
    found = cloud.compute_implicit_distance(pyvista.PolyData.from_regular_faces(*mesh))
    return np.asarray(found["implicit_distance"], float)


def _beyond(sheet: Mesh, outer: Mesh) -> bool:
    """Whether corners or centroids of a sheet's triangles lie outside a surface."""
    corners = sheet[0][sheet[1]]
    points = np.concatenate([corners.reshape(-1, 3), corners.mean(axis=1)])
    return bool(signed_distances(points, outer).max() > NEAR_MM)


def _used(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3)


def _in_order(label: np.ndarray) -> np.ndarray:
    """Labels (n,) renumbered from 0 in order of first occurrence."""
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[inverse]


def _name(at: int, shells: Sequence[Mesh], what: str) -> str:
    """Name of a shell in messages; of several, with its number in the file, triangle count and bounding box."""
    if len(shells) == 1:
        return what
    vertices, faces = shells[at]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    place = ", ".join(f"{axis} {a:.4g} to {b:.4g}" for axis, a, b in zip("xyz", low, high, strict=True))
    return f"{what}: shell {at + 1} of {len(shells)} ({len(faces)} triangles, {place} mm)"
