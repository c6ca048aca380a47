"""Gel meshes by their names, which hold all that they are built from: no press needs a mesh file.

Tetrahedra of a press: the gel, two sizes and a raster of what it touches. Hexahedra: see `hexname`.
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
from gelforge.mechanics.mesh.tetmesh import Sizes, base_tets, bisected, from_flat

PREFIX = "tet@"
FORM = f"{PREFIX}GEL:EDGE_MM:INSIDE_MM:PIXEL_MM:X_MIN:Y_MIN:ROWS:COLUMNS:RASTER"
_NUMBERS = re.compile(r"[-+.0-9e]+")
SMALLEST_MM, PIXEL_MM = 0.02, 1e-4  # edge length, and pixel; less is a mistake, not a mesh
MOST_PIXELS = 1 << 20


@dataclass(frozen=True)
class Contact:
    """What a press touches, seen from above: square pixels of `pixel` mm whose first corner lies at `low` (x, y) mm.

    rows, columns: pixels along x and y. bits: `numpy.packbits` of them, row by row.
    """

    pixel: float
    low: tuple[float, float]
    rows: int
    columns: int
    bits: bytes

    @classmethod
    def of(cls, mask: np.ndarray, pixel: float, low: tuple[float, float]) -> "Contact":
        """From pixels (rows, columns) of bool."""
        rows, columns = mask.shape
        return cls(pixel, low, rows, columns, np.packbits(mask).tobytes())

    @property
    def mask(self) -> np.ndarray:
        """The pixels, (rows, columns) bool."""
        bits = np.unpackbits(np.frombuffer(self.bits, np.uint8), count=self.rows * self.columns)
        return bits.reshape(self.rows, self.columns).astype(bool)


@dataclass(frozen=True)
class TetMeshName:
    """What `mesh` builds a gel's tetrahedra from; the gel by its name (`geometry.gel.load_gel`)."""

    gel: str
    edge_mm: float
    inside_mm: float
    contact: Contact

    @property
    def name(self) -> str:
        """The name that `parse` reads."""
        c = self.contact
        numbers = (self.edge_mm, self.inside_mm, c.pixel, *c.low)
        text = base64.urlsafe_b64encode(zlib.compress(c.bits, 9)).decode().rstrip("=")
        return ":".join([PREFIX + self.gel, *(f"{number + 0.0:.6g}" for number in numbers), str(c.rows), str(c.columns), text])  # fmt: skip

    @classmethod
    def parse(cls, name: str) -> "TetMeshName":
        """Read a name of the form `FORM`; any other raises BadInput."""
        gel, *texts = name.removeprefix(PREFIX).split(":")
        try:
            *texts, raster = texts
            if not all(_NUMBERS.fullmatch(text) for text in texts):
                raise ValueError("not all of its numbers are numbers")
            edge, inside, pixel, x, y = map(float, texts[:-2])
            rows, columns = map(int, texts[-2:])
            sizes = (edge, inside, pixel)
            if not (
                all(map(math.isfinite, (*sizes, x, y)))
                and min(edge, inside) >= SMALLEST_MM
                and pixel >= PIXEL_MM
                and min(rows, columns) > 0
            ):
                raise ValueError("its numbers make no mesh")
            if rows * columns > MOST_PIXELS:
                raise ValueError(f"its raster has more than {MOST_PIXELS} pixels")
            unpacker = zlib.decompressobj()
            bits = unpacker.decompress(base64.urlsafe_b64decode(raster + "=" * (-len(raster) % 4)), MOST_PIXELS)
            if len(bits) != -(-rows * columns // 8):
                raise ValueError("its raster is none of so many rows and columns")
        except (ValueError, binascii.Error, zlib.error) as error:
            raise BadInput(
                f"mesh name {name!r} is none of tetrahedra, {FORM}: {error}; run make fea again"
            ) from error
        return cls(gel, edge, inside, Contact(pixel, (x, y), rows, columns, bits))

    def mesh(self) -> GelMesh:
        """Build the mesh: the base mesh of the gel, bisected at the edge of contact and inside it."""
        gel, c = load_gel(self.gel), self.contact
        return from_flat(gel, *bisected(*base_tets(gel), Sizes.at(gel, c.mask, c.pixel, c.low, self.edge_mm, self.inside_mm)))  # fmt: skip


def load_mesh(name: str) -> GelMesh:
    """The mesh of a name: of hexahedra within milliseconds, of tetrahedra in a fifth of a second; other names raise BadInput."""
    if is_hex_mesh_name(name):
        return HexMeshName.parse(name).mesh()
    if name.startswith(PREFIX):
        return TetMeshName.parse(name).mesh()
    raise BadInput(f"mesh name {name!r} is none; run make fea again")
