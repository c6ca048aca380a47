"""A hexahedral mesh by its name, which holds the few numbers it is built from: no press needs a mesh file of its own."""

import math
from dataclasses import astuple, dataclass
from itertools import pairwise

from gelforge.errors import BadInput
from gelforge.geometry.gel import load_gel
from gelforge.mechanics.mesh.hexmesh import FineBox, HexMesh, build_mesh

PREFIX = "hex@"
FORM = f"{PREFIX}GEL:X_MIN:X_MAX:Y_MIN:Y_MAX:SIZE:LAYERS:LAYER_RATIO:GROWTH:LARGEST[:WIDENED...]"
MOST_ELEMENTS = 2e6  # a name that asks for more is a mistake, not a mesh


@dataclass(frozen=True)
class HexMeshName:
    """What `hexmesh.build_mesh` builds a gel's mesh from; lengths in mm, the gel by its name (`geometry.gel.load_gel`).

    box: the fine part. layers: hexahedra through the height, the lowest `layer_ratio` times as thick as the uppermost.
    growth, largest: by what factor, and up to what side, hexahedra grow away from the box. widened: see stepped.planes_of;
    a name of a mesh without wide layers ends before it.
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
        """The name that `parse` reads; numbers in full, so that the mesh built from it is the same to the last bit."""
        numbers = (*astuple(self.box), self.layers, self.layer_ratio, self.growth, self.largest, *self.widened)
        return ":".join([PREFIX + self.gel, *(_text(number) for number in numbers)])

    @classmethod
    def parse(cls, name: str) -> "HexMeshName":
        """Read a name of the form `FORM`; any other raises BadInput."""
        gel, *texts = name.removeprefix(PREFIX).split(":")
        try:
            numbers = [float(text) for text in texts]
            x_min, x_max, y_min, y_max, size, layers, ratio, growth, largest, *widened = numbers
        except ValueError as error:
            raise _wrong(name, f"its numbers cannot be read ({error})") from error
        sound = all(map(math.isfinite, numbers)) and x_min < x_max and y_min < y_max and min(size, largest) > 0
        falling = all(a >= b >= 1 for a, b in pairwise([layers - 1, *widened]))
        if not (sound and layers >= 1 and ratio > 0 and growth >= 1 and falling):
            raise _wrong(name, "its numbers make no mesh")
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
        """Build the mesh, within milliseconds; a gel or a box that makes none raises BadInput."""
        shape = self.layers, self.layer_ratio, self.growth, self.largest, self.widened
        return build_mesh(load_gel(self.gel), self.box, *shape)

    def _check_size(self) -> None:
        """Raise BadInput where building the mesh would take for ever, or its fine part lies beside the gel."""
        gel, box, count = load_gel(self.gel), self.box, float(self.layers)
        for side, low, high in ((gel.width, box.x_min, box.x_max), (gel.length, box.y_min, box.y_max)):
            fine = min(high, side / 2) - max(low, -side / 2)
            if fine <= 0.0:
                raise _wrong(self.name, "its fine part lies beside the gel")
            # a fine part narrower than its hexahedra is one hexahedron wide; from there they grow by a factor each
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
    # no minus before zero: equal meshes have one name
    return repr(float(number) + 0.0).removesuffix(".0")


def _wrong(name: str, why: str) -> BadInput:
    return BadInput(f"mesh name {name!r} is none of hexahedra, {FORM}: {why}; run make fea again")
