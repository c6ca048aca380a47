"""STL files of any program: binary whatever their header says, or text with any line ends."""

import re
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput, printable
from gelforge.geometry.triangles import Mesh, cleaned, unique_rows
from gelforge.records.regular import read_bytes

HEADER = 84  # bytes before the triangles of a binary file; the last four are the number of triangles
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
WELD = 1e-6  # fraction of the largest coordinate: some units in the last place of single precision
EXPORT = "export the body again as binary STL"
NAME = re.compile(r"\b(?:end)?solid\b.*?(?=\bfacet\b|[\r\n]|$)", re.IGNORECASE)
CORNER = re.compile(r"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)


def read_stl(path, scale: float = 1.0) -> Mesh:
    """A binary or text STL file as one mesh with coincident corners merged, in mm after `scale`."""
    data = read_bytes(Path(path), EXPORT)
    corners = _binary(data)
    if corners is None:
        corners = _text(data, str(path))
    if not len(corners):
        raise BadInput(f"{path}: holds no triangles; {EXPORT}")
    if not np.isfinite(corners).all():
        at = int(np.argmin(np.isfinite(corners).all(axis=(1, 2))))
        raise BadInput(f"{path}: its triangle {at + 1} has a coordinate that is not a finite number; {EXPORT}")
    every = np.arange(3 * len(corners)).reshape(-1, 3)
    vertices, faces = cleaned(welded(corners.reshape(-1, 3)) * scale, every)
    if not len(faces):
        raise BadInput(
            f"{path}: all of its triangles shrink to points or lines at scale = {scale:g}; correct the scale"
        )
    return vertices, faces


def welded(points: np.ndarray) -> np.ndarray:
    """Points (n, 3), each moved to the first one within WELD of it: STL repeats corners for every triangle."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    first, inverse = unique_rows(points)
    unique = points[first]
    pairs = cKDTree(unique).query_pairs(WELD * np.abs(unique).max(initial=0.0), output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(unique),) * 2)
    _, first, group = np.unique(
        connected_components(links, directed=False)[1], return_index=True, return_inverse=True
    )
    return unique[first[group]][inverse]


def _binary(data: bytes) -> np.ndarray | None:
    """Corners (f, 3, 3) of a binary file, to which some programs append data of their own; None for other bytes."""
    count = int.from_bytes(data[HEADER - 4 : HEADER], "little")
    beyond = len(data) - HEADER - RECORD.itemsize * count
    if beyond < 0 or (beyond and not count):
        return None
    return np.frombuffer(data, RECORD, count, HEADER)["corners"].astype(float)


def _text(data: bytes, where: str) -> np.ndarray:
    """Corners (f, 3, 3) of a text file; BadInput for anything else."""
    text = data.decode(errors="replace").lstrip("\ufeff \t\r\n")
    if text[:5].lower() != "solid":
        count = int.from_bytes(data[HEADER - 4 : HEADER], "little")
        raise BadInput(
            f"{where}: not a readable STL file (no text that begins with solid, and {len(data)} bytes where {count} triangles"
            f" would take {HEADER + RECORD.itemsize * count}); {EXPORT}"
        )
    text = NAME.sub("", text)  # a name may hold any word
    found = CORNER.findall(text)
    facets, ends = (len(re.findall(rf"\b{word}\b", text, re.IGNORECASE)) for word in ("vertex", "endfacet"))
    if facets != len(found) or len(found) != 3 * ends:
        seen = f"{facets} corners and {ends} ends of triangles"
        raise BadInput(
            f"{where}: not a readable STL file (text with {seen}; each triangle must have three corners of three numbers);"
            f" {EXPORT}"
        )
    try:
        return np.array(found, float).reshape(-1, 3, 3)
    except ValueError:
        wrong = next(word for corner in found for word in corner if not _is_number(word))
        raise BadInput(
            f"{where}: not a readable STL file ({printable(wrong)[:50]!r} is not a number; write decimals with a point);"
            f" {EXPORT}"
        ) from None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
