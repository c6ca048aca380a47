"""STL files of any program: binary or text, in any encoding and with any line ends; other files are named by what they are."""

import codecs
import re
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput, printable
from gelforge.geometry.triangles import Mesh, cleaned, unique_rows
from gelforge.records.regular import read_bytes

HEADER = 84  # bytes before the triangles of a binary file, the last four their number
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
WELD = 1e-6  # of the largest coordinate: some units in the last place of single precision
EXPORT = "export the body again as binary STL"
LFS = "it is a Git LFS pointer, its content was not fetched; run `git lfs pull`"
MARKS = {codecs.BOM_UTF8: "utf-8", codecs.BOM_UTF16_LE: "utf-16-le", codecs.BOM_UTF16_BE: "utf-16-be"}
# How other files begin, in lower case without blanks before; what they are.
KINDS = {
    b"ply": "a PLY file",
    b"off": "an OFF file",
    b"iso-10303-21": "a STEP file",
    b"pk\x03\x04": "a ZIP archive, as 3MF and compressed files are",
    b"\x1f\x8b": "a compressed file (gzip)",
    b"gltf": "a glTF file",
    b"%pdf": "a PDF file",
    b"\x89png": "a picture",
    b"\xff\xd8": "a picture",
    b"# vtk": "a VTK file",
    b"{": "a JSON file",
    b"<": "a page of HTML or XML, as a server sends in place of a file",
}
OBJ = re.compile(rb"^\s*v(\s+-?[\d.]\S*){3}", re.MULTILINE)
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
        raise BadInput(f"{path}: a corner of its triangle {at + 1} is no finite number; {EXPORT}")
    every = np.arange(3 * len(corners)).reshape(-1, 3)
    vertices, faces = cleaned(welded(corners.reshape(-1, 3)) * scale, every)
    if not len(faces):
        raise BadInput(
            f"{path}: all of its triangles shrink to points or lines at scale = {scale:g}; correct the scale"
        )
    return vertices, faces


def welded(points: np.ndarray) -> np.ndarray:
    """Points (n, 3), each moved to the first of those within single precision of it: STL states a corner once a triangle."""
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
    """Corners (f, 3, 3) of a binary file, whatever its header says; None where the bytes are none.

    Some programs append what is theirs.
    """
    count = int.from_bytes(data[HEADER - 4 : HEADER], "little")
    beyond = len(data) - HEADER - RECORD.itemsize * count
    if beyond < 0 or (beyond and (not count or _other_kind(data))):
        return None
    return np.frombuffer(data, RECORD, count, HEADER)["corners"].astype(float)


def _text(data: bytes, where: str) -> np.ndarray:
    """Corners (f, 3, 3) of a text file; BadInput that says what anything else is."""
    mark = next((mark for mark in MARKS if data.startswith(mark)), b"")
    text = data.decode(MARKS.get(mark, "utf-8"), errors="replace").lstrip("\ufeff \t\r\n")
    if text[:5].lower() != "solid":
        raise BadInput(f"{where}: not a readable STL file ({_kind(data)}); {EXPORT}")
    text = NAME.sub("", text)  # which may hold any word
    found = CORNER.findall(text)
    facets, ends = (len(re.findall(rf"\b{word}\b", text, re.IGNORECASE)) for word in ("vertex", "endfacet"))
    if facets != len(found) or len(found) != 3 * ends:
        seen = f"{facets} corners and {ends} ends of triangles"
        raise BadInput(f"{where}: not a readable STL file (text with {seen}, three to one are right); {EXPORT}")
    try:
        return np.array(found, float).reshape(-1, 3, 3)
    except ValueError:
        wrong = next(word for corner in found for word in corner if not _is_number(word))
        raise BadInput(
            f"{where}: not a readable STL file ({printable(wrong)[:50]!r} is no number, write decimals with a point);"
            f" {EXPORT}"
        ) from None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _other_kind(data: bytes) -> str | None:
    """What bytes are by how they begin, in a few words; None where it is unknown."""
    if data.startswith(b"version https://git-lfs"):
        return LFS
    head = data[:100].lstrip(b"\xef\xbb\xbf \t\r\n").lower()
    return next((f"it is {kind}" for start, kind in KINDS.items() if head.startswith(start)), None)


def _kind(data: bytes) -> str:
    """What bytes are that are no STL, in a few words."""
    if not data.strip():
        return "it is empty"
    if kind := _other_kind(data):
        return kind
    if OBJ.search(data[:100_000]):
        return "it is an OBJ file"
    claimed = int.from_bytes(data[HEADER - 4 : HEADER], "little")
    return f"it has {len(data)} bytes where its {claimed} triangles would take {HEADER + RECORD.itemsize * claimed}"
