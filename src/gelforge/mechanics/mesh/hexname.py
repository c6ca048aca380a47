"""Hexahedral meshes by name: a name holds all numbers that a mesh is built from, so no press needs a mesh file."""

import math
from dataclasses import astuple, dataclass
from itertools import pairwise

from gelforge.errors import BadInput
from gelforge.geometry.gel import load_gel
from gelforge.mechanics.mesh.hexmesh import FineBox, HexMesh, build_mesh

PREFIX = "hex@"
FORM = f"{PREFIX}GEL:X_MIN:X_MAX:Y_MIN:Y_MAX:SIZE:LAYERS:LAYER_RATIO:GROWTH:LARGEST[:WIDENED...]"
MOST_ELEMENTS = 2e6  # a name that asks for more is taken for a mistake


@dataclass(frozen=True)
class HexMeshName:
    """Arguments of `hexmesh.build_mesh` for a gel; lengths in mm, the gel by its name (`geometry.gel.load_gel`).

    box: the fine part. layers: hexahedra through the height. layer_ratio: thickness of the lowest over the uppermost.
    growth, largest: factor by which, and side up to which, hexahedra grow away from the box.
    widened: see stepped.planes_of; names of meshes without wide layers omit it.
    """

    gel: str
    box: FineBox
    layers: int
    layer_ratio: float
    growth: float
    largest: float
    widened: tuple[int, ...] = ()

    @property
    def name(self) -> str:
        """The name that `parse` reads, with all digits, so that its mesh is the same to the last bit."""
        numbers = (*astuple(self.box), self.layers, self.layer_ratio, self.growth, self.largest, *self.widened)
        return ":".join([PREFIX + self.gel, *(_text(number) for number in numbers)])

    @classmethod
    def parse(cls, name: str) -> "HexMeshName":
        """Parse a name of the form `FORM`; any other raises BadInput."""
        gel, *texts = name.removeprefix(PREFIX).split(":")
        try:
            numbers = [float(text) for text in texts]
            x_min, x_max, y_min, y_max, size, layers, ratio, growth, largest, *widened = numbers
        except ValueError as error:
            raise _wrong(name, f"its numbers cannot be read ({error})") from error
        sound = all(map(math.isfinite, numbers)) and x_min < x_max and y_min < y_max and min(size, largest) > 0
        falling = all(a >= b >= 1 for a, b in pairwise([layers - 1, *widened]))
        if not (sound and layers >= 1 and ratio > 0 and growth >= 1 and falling):
            raise _wrong(name, "its numbers are out of range")
        found = cls(
            gel,
            FineBox(x_min, x_max, y_min, y_max, size),
            int(layers),
            ratio,
            growth,
            largest,
            tuple(map(int, widened)),
        )
        if found.name != name:
            raise _wrong(name, f"it would be written {found.name}")
        found._check_size()
        return found

    def mesh(self) -> HexMesh:
        """Build the mesh, within milliseconds; an unusable gel or box raises BadInput."""
        shape = self.layers, self.layer_ratio, self.growth, self.largest, self.widened
        return build_mesh(load_gel(self.gel), self.box, *shape)

    def _check_size(self) -> None:
        """Raise BadInput if the mesh would be too large, or its fine part lies beside the gel."""
        gel, box, count = load_gel(self.gel), self.box, float(self.layers)
        for side, low, high in ((gel.width, box.x_min, box.x_max), (gel.length, box.y_min, box.y_max)):
            fine = min(high, side / 2) - max(low, -side / 2)
            if fine <= 0.0:
                raise _wrong(self.name, "its fine part lies beside the gel")
            # a fine part narrower than `size` is one hexahedron wide; beyond it, each is wider by the factor `growth`
            size, growth = min(box.size, fine), self.growth - 1.0
            beside = (side - fine) / size
            grown = math.log1p(growth * beside) / math.log1p(growth) if growth > 0.0 else beside
            count *= fine / size + 2.0 * grown + side / self.largest + 4.0
        if count > MOST_ELEMENTS:
            raise _wrong(self.name, f"it asks for more than {MOST_ELEMENTS:.0g} elements")


def is_hex_mesh_name(name: str) -> bool:
    """Whether a mesh name is one of hexahedra."""
    return name.startswith(PREFIX)


def _text(number: float) -> str:
    # no negative zero: equal meshes have one name
    return repr(float(number) + 0.0).removesuffix(".0")


def _wrong(name: str, why: str) -> BadInput:
    return BadInput(f"mesh name {name!r} is not valid: {why}; the form is {FORM}; run make fea again")
