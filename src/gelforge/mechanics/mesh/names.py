"""Gel meshes by name: a name holds everything that a mesh is built from but the gel's base mesh, so no press needs a file.

Tetrahedra of a press: the gel, the digest of its base mesh (`basemesh`), two sizes and a raster of the contact.
Hexahedra: see `hexname`.
"""

import base64
import binascii
import math
import re
import zlib
from dataclasses import dataclass

import numpy as np

from gelforge.errors import BadInput
from gelforge.geometry.gel import load_gel
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.hexname import HexMeshName, is_hex_mesh_name
from gelforge.mechanics.mesh.tetmesh import Sizes, bisected, from_flat

PREFIX = "tet@"
FORM = f"{PREFIX}GEL:BASE:EDGE_MM:INSIDE_MM:PIXEL_MM:X_MIN:Y_MIN:ROWS:COLUMNS:RASTER"
_NUMBERS = re.compile(r"[-+.0-9e]+")
SMALLEST_MM, PIXEL_MM = 0.02, 1e-4  # least edge length and pixel; smaller ones are taken for a mistake
MOST_PIXELS = 1 << 20


@dataclass(frozen=True)
class Contact:
    """Contact of a press, seen from above: square pixels of `pixel` mm; the first one's corner is at `low` (x, y) mm.

    rows, columns: number of pixels along x and y. bits: `numpy.packbits` of the pixels, row by row.
    """

    pixel: float
    low: tuple[float, float]
    rows: int
    columns: int
    bits: bytes

    @classmethod
    def of(cls, mask: np.ndarray, pixel: float, low: tuple[float, float]) -> "Contact":
        """Contact of the pixels `mask` (rows, columns), bool."""
        rows, columns = mask.shape
        return cls(pixel, low, rows, columns, np.packbits(mask).tobytes())

    @property
    def mask(self) -> np.ndarray:
        """The pixels, (rows, columns) bool."""
        bits = np.unpackbits(np.frombuffer(self.bits, np.uint8), count=self.rows * self.columns)
        return bits.reshape(self.rows, self.columns).astype(bool)


@dataclass(frozen=True)
class TetMeshName:
    """Parameters from which `mesh` builds a gel's tetrahedra; the gel by its name (`geometry.gel.load_gel`).

    base: digest of the gel's base mesh.
    """

    gel: str
    base: str
    edge_mm: float
    inside_mm: float
    contact: Contact

    @property
    def name(self) -> str:
        """The name that `parse` reads."""
        c = self.contact
        numbers = (self.edge_mm, self.inside_mm, c.pixel, *c.low)
        text = base64.urlsafe_b64encode(zlib.compress(c.bits, 9)).decode().rstrip("=")
        return ":".join([PREFIX + self.gel, self.base, *(f"{number + 0.0:.6g}" for number in numbers), str(c.rows), str(c.columns), text])  # fmt: skip

    @classmethod
    def parse(cls, name: str) -> "TetMeshName":
        """Parse a name of the form `FORM`; any other raises BadInput."""
        gel, *texts = name.removeprefix(PREFIX).split(":")
        try:
            digest, *texts, raster = texts
            if not all(_NUMBERS.fullmatch(text) for text in texts):
                raise ValueError("its numbers cannot be read")
            edge, inside, pixel, x, y = map(float, texts[:-2])
            rows, columns = map(int, texts[-2:])
            sizes = (edge, inside, pixel)
            if not (
                all(map(math.isfinite, (*sizes, x, y)))
                and min(edge, inside) >= SMALLEST_MM
                and pixel >= PIXEL_MM
                and min(rows, columns) > 0
            ):
                raise ValueError("its numbers are out of range")
            if rows * columns > MOST_PIXELS:
                raise ValueError(f"its raster has more than {MOST_PIXELS} pixels")
            unpacker = zlib.decompressobj()
            bits = unpacker.decompress(base64.urlsafe_b64decode(raster + "=" * (-len(raster) % 4)), MOST_PIXELS)
            if len(bits) != -(-rows * columns // 8):
                raise ValueError(f"its raster does not have {rows} x {columns} pixels")
        except (ValueError, binascii.Error, zlib.error) as error:
            raise BadInput(
                f"mesh name {name!r} is not valid: {error}; the form is {FORM}; run make fea again"
            ) from error
        return cls(gel, digest, edge, inside, Contact(pixel, (x, y), rows, columns, bits))

    def mesh(self) -> GelMesh:
        """Build the mesh: the base mesh of the gel, bisected at the edge of contact and inside it."""
        from gelforge.mechanics.mesh.basemesh import base_of  # of presses by CalculiX alone

        gel, c = load_gel(self.gel), self.contact
        base = base_of(gel)
        if base.digest != self.base:
            raise BadInput(
                f"gel {self.gel}: its mesh is {base.digest} now, and this press was solved on mesh {self.base}; run make fea"
            )
        return from_flat(gel, *bisected(base.nodes, base.tets, Sizes.at(gel, c.mask, c.pixel, c.low, self.edge_mm, self.inside_mm)))  # fmt: skip


def load_mesh(name: str) -> GelMesh:
    """Build the mesh of a name, hexahedra in milliseconds, tetrahedra in 0.2 s; other names raise BadInput."""
    if is_hex_mesh_name(name):
        return HexMeshName.parse(name).mesh()
    if name.startswith(PREFIX):
        return TetMeshName.parse(name).mesh()
    raise BadInput(f"mesh name {name!r} starts with neither hex@ nor {PREFIX}; run make fea again")
