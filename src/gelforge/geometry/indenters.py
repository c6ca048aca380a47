"""The indenter catalogue: tables of a TOML file become rigid bodies."""

import os
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput, nearest
from gelforge.flow.files import digest_of, read_toml
from gelforge.geometry.profiles import (
    Annulus,
    Ellipse,
    Outline,
    Pieces,
    Pierced,
    Rectangle,
    crosses_itself,
    rectangle,
    regular_polygon,
    unit,
)
from gelforge.geometry.solids import Body, Extrusion, LyingCylinder, RoundedPolyhedron, SphericalCap
from gelforge.records.press import PressRecord

DEFAULT = object()
CATALOGUE = Path(__file__).with_name("indenters.toml")  # the installed workflow/indenters.toml


class _Table:
    """One catalogue entry whose keys are taken one by one, so that a misspelt one is noticed."""

    def __init__(self, name: str, table: dict, source, folder=None, kept: Path | None = None):
        self.name, self.source, self._left, self.kept = name, source, dict(table), kept
        self.folder = Path(source).parent if folder is None else Path(folder)

    def fail(self, key: str, value, hint: str):
        raise BadInput(f"{self.source}: indenter {self.name}: {key} = {value!r}; {hint}")

    def take(self, key, default=DEFAULT):
        if key not in self._left and default is DEFAULT:
            raise BadInput(f"{self.source}: indenter {self.name}: `{key}` is missing; this kind of indenter needs it")
        return self._left.pop(key, default)

    def has(self, key) -> bool:
        return key in self._left

    def flag(self, key, default) -> bool:
        value = self.take(key, default)
        if not isinstance(value, bool):
            self.fail(key, value, "write true or false")
        return value

    def number(self, key, default=DEFAULT, low: float = 0.0, high: float = 1000.0) -> float:
        value = self.take(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not low < value < high:
            self.fail(key, value, f"give a number above {low:g} and below {high:g} (mm or degrees)")
        return float(value)

    def whole(self, key, low: float, high: float = 1000.0) -> int:
        value = self.number(key, low=low, high=high)
        if not value.is_integer():
            self.fail(key, value, "give a whole number")
        return int(value)

    def pair(self, key) -> tuple[float, float]:
        value = self.take(key)
        fits = isinstance(value, list) and len(value) == 2 and not any(isinstance(v, bool) for v in value)
        if not fits or not all(isinstance(v, int | float) and 0 < v < 1000 for v in value):
            self.fail(key, value, "give two positive numbers [along x, along y] in mm")
        return float(value[0]), float(value[1])

    def finish(self) -> None:
        if self._left:
            key, value = next(iter(self._left.items()))
            self.fail(key, value, "this kind of indenter has no such key; correct or remove it")


def _sphere(t: _Table, **common) -> Body:
    """A sphere on a shank, or a cap (a lens) if the height is below the radius."""
    radius, height = t.number("diameter") / 2.0, t.number("height")
    if height < radius:
        return SphericalCap(radius=radius, height=height, **common)
    return Extrusion(profile=Ellipse(radius, radius), fillet=radius, height=height, **common)


def _cuboid(t: _Table, **common) -> Body:
    fillet, (sx, sy) = t.number("fillet"), t.pair("size")
    return Extrusion(profile=Rectangle(sx, sy, fillet), fillet=fillet, height=t.number("height"), **common)


def _twin_cuboids(t: _Table, **common) -> Body:
    fillet, (sx, sy), gap = t.number("fillet"), t.pair("size"), t.number("gap")
    shift = (gap + sy) / 2.0
    parts = [Rectangle(sx, sy, fillet, 0.0, y) for y in (-shift, shift)]
    return Extrusion(profile=Pieces(parts), fillet=fillet, height=t.number("height"), **common)


def _cross(t: _Table, **common) -> Body:
    fillet, (wide, long), arm = t.number("fillet"), t.pair("size"), t.number("arm")
    y, a, w, h = t.number("offset", 0.0, low=-1000.0), arm / 2.0, wide / 2.0, long / 2.0
    if a >= w:
        t.fail("arm", arm, f"the arms along y are as wide as the body, {wide:g} mm; make them narrower")
    if abs(y) + a >= h:
        t.fail(
            "offset",
            y,
            f"the arms along x, {arm:g} mm wide, reach the ends of the body, {long:g} mm; move them inwards",
        )
    corners = [
        [-a, -h],
        [a, -h],
        [a, y - a],
        [w, y - a],
        [w, y + a],
        [a, y + a],
        [a, h],
        [-a, h],
        [-a, y + a],
        [-w, y + a],
        [-w, y - a],
        [-a, y - a],
    ]
    return Extrusion(profile=Outline(corners, fillet), fillet=fillet, height=t.number("height"), **common)


def _polygon(t: _Table, **common) -> Body:
    fillet, sides = t.number("fillet"), t.whole("sides", low=2.5)
    corners = regular_polygon(sides, t.number("side"), t.number("first_corner_deg", 0.0, low=-361.0))
    return Extrusion(profile=Outline(corners, fillet), fillet=fillet, height=t.number("height"), **common)


def _outline(t: _Table, **common) -> Body:
    fillet, given = t.number("fillet"), t.take("corners")
    try:
        corners = np.array(given, float)
    except (TypeError, ValueError, OverflowError):
        corners = np.zeros(0)
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3 or not np.isfinite(corners).all():
        t.fail("corners", given, "give at least three corners [x, y] in mm")
    if crosses_itself(corners):
        t.fail("corners", given, "its edges cross or touch; go round the figure once")
    return Extrusion(profile=Outline(corners, fillet), fillet=fillet, height=t.number("height"), **common)


def _triple_triangle(t: _Table, **common) -> Body:
    fillet, side, turn = t.number("fillet"), t.number("side"), t.number("first_corner_deg", 90.0, low=-361.0)
    inner = side / np.sqrt(12.0) - t.number("wall")
    if inner <= 0.0:
        t.fail("wall", side / np.sqrt(12.0) - inner, "the wall leaves no hole; make it thinner")
    hole = regular_polygon(3, inner * np.sqrt(3.0), turn + 180.0)
    outer = Outline(regular_polygon(3, side, turn), fillet)
    return Extrusion(profile=Pierced(outer, hole), fillet=fillet, height=t.number("height"), **common)


def _ellipse(t: _Table, **common) -> Body:
    size = t.pair("size")
    outer = Ellipse(size[0] / 2.0, size[1] / 2.0)
    profile: Ellipse | Annulus = outer
    if t.has("hole"):
        hole = t.pair("hole")
        profile = Annulus(outer, Ellipse(hole[0] / 2.0, hole[1] / 2.0))
    return _rounded(profile, t, **common)


def _cylinder(t: _Table, **common) -> Body:
    radius, hole = t.number("diameter") / 2.0, t.number("hole", 0.0, low=-1e-9) / 2.0
    outer = Ellipse(radius, radius)
    return _rounded(Annulus(outer, Ellipse(hole, hole)) if hole > 0.0 else outer, t, **common)


def _rounded(profile: Ellipse | Annulus, t: _Table, **common) -> Body:
    """The extruded figure; BadInput for a fillet that would meet itself, because the tip would be above z = 0."""
    fillet = t.number("fillet")
    if fillet > profile.widest_fillet + 1e-9:
        raise BadInput(
            f"indenter {common['name']}: fillet {fillet:g} mm is too large: the rounded edge would meet itself; give at most {profile.widest_fillet:g}"
        )
    return Extrusion(profile=profile, fillet=fillet, height=t.number("height"), **common)


def _lying_cylinder(t: _Table, **common) -> Body:
    diameter, length = t.number("diameter"), t.number("length")
    return LyingCylinder(diameter=diameter, length=length, fillet=t.number("fillet"), **common)


def _sloping_cuboid(t: _Table, **common) -> Body:
    size, slope = t.pair("size"), np.tan(np.deg2rad(t.number("slope_deg", high=90.0)))
    deepest = np.deg2rad(t.number("deepest_deg", 0.0, low=-361.0))
    normal = -np.array([slope * np.cos(deepest), slope * np.sin(deepest), 1.0])
    return RoundedPolyhedron(
        outline=rectangle(*size),
        planes=([normal / np.linalg.norm(normal)], [0.0]),
        fillet=t.number("fillet"),
        height=t.number("height"),
        **common,
    )


def _pyramid(t: _Table, **common) -> Body:
    (sx, sy), slope = t.pair("size"), np.tan(np.deg2rad(t.number("slope_deg", high=90.0)))
    normals = np.array([[slope, 0, -1], [-slope, 0, -1], [0, slope, -1], [0, -slope, -1]]) / np.hypot(slope, 1.0)
    levels = np.abs(normals[:, :2]) @ [sx / 2.0, sy / 2.0]
    return RoundedPolyhedron(
        outline=rectangle(sx, sy),
        planes=(normals, levels),
        fillet=t.number("fillet"),
        height=t.number("height"),
        **common,
    )


def _random_solid(t: _Table, **common) -> Body:
    """A convex block of `size` mm at most, its lower side cut by up to four planes that tilt by up to `slope_deg`."""
    size, slope = t.number("size"), t.number("slope_deg", 30.0, high=80.0)
    rng = np.random.default_rng(t.whole("seed", low=-1.0, high=2**31))
    walls = int(rng.integers(3, 8))
    turns = (np.arange(walls) + rng.uniform(-0.3, 0.3, walls) + rng.uniform(0, walls)) * 2 * np.pi / walls
    corners = size / 2.0 * np.column_stack([np.cos(turns), rng.uniform(0.5, 1.0) * np.sin(turns)])  # on an ellipse
    heading, tilt = rng.uniform(0, 2 * np.pi, rng.integers(1, 5)), np.tan(np.deg2rad(slope))
    tilts = tilt * rng.uniform(0.0, 1.0, len(heading))
    normals = unit(-np.column_stack([tilts * np.cos(heading), tilts * np.sin(heading), np.ones(len(heading))]))
    through = np.column_stack(
        [rng.uniform(-0.2, 0.2, (len(heading), 2)) * size, rng.uniform(-0.3, 0.0, len(heading))]
    )
    return RoundedPolyhedron(
        outline=corners,
        planes=(normals, np.einsum("ij,ij->i", normals, through)),
        fillet=t.number("fillet"),
        height=t.number("height"),
        **common,
    )


def _stl(t: _Table, **common) -> Body:
    from gelforge.geometry.sampled import sampled_from_stl

    file, scale = t.take("file"), t.number("scale", 1.0, high=1e5)
    spacing, reach = t.number("spacing", 0.2), t.number("reach", 4.0)
    if not isinstance(file, str):
        t.fail("file", file, "give the path of an STL file, from the catalogue's folder")
    path = Path(os.path.normpath(t.folder / file))
    if not path.is_file():
        t.fail(
            "file",
            file,
            f"there is no file {path}; copy it there, or correct `file`, a path from the folder of this table",
        )
    planned = t.take("sha256", None)
    if planned is not None and planned != digest_of(path):
        t.fail("file", file, f"{path} changed while this was planned; run make again")
    return sampled_from_stl(path, scale=scale, spacing=spacing, reach=reach, folder=t.kept, **common)


KINDS: dict[str, Callable] = {
    "sphere": _sphere,
    "cuboid": _cuboid,
    "twin_cuboids": _twin_cuboids,
    "cross": _cross,
    "polygon": _polygon,
    "outline": _outline,
    "triple_triangle": _triple_triangle,
    "ellipse": _ellipse,
    "cylinder": _cylinder,
    "lying_cylinder": _lying_cylinder,
    "sloping_cuboid": _sloping_cuboid,
    "pyramid": _pyramid,
    "random_solid": _random_solid,
    "stl": _stl,
}


def build(name: str, table: dict, source="indenters.toml", folder=None, kept: Path | None = None) -> Body:
    """The body that one catalogue table describes; lengths in mm, angles in degrees.

    Paths of STL files are relative to `folder`, by default that of the catalogue file `source`. kept: cache folder of
    sampled STL files (`sampled_from_stl`). A faulty table raises BadInput.
    """
    t = _Table(name, table, source, folder, kept)
    kind = t.take("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        t.fail("kind", kind, f"choose one of {', '.join(KINDS)}")
    try:
        body = KINDS[kind](t, name=name, seen=t.flag("seen", True), spare=t.flag("spare", False))
    except BadInput as error:
        if f"indenter {name}" in str(error):
            raise
        raise BadInput(f"{source}: indenter {name}: {error}") from None
    t.finish()
    return body


def _fold_of_sides(t: dict) -> int:
    """Order of rotational symmetry of a figure of `size` along x and y that is mirror symmetric in both."""
    return 4 if t["size"][0] == t["size"][1] else 2


def _fold_of_ellipse(t: dict) -> int:
    return 0 if all(sides[0] == sides[1] for sides in (t["size"], t.get("hole", (0, 0)))) else 2


# Order of the rotational symmetry about the tool's axis, 0: axisymmetric. Kinds that are not listed have 1.
FOLDS: dict[str, Callable[[dict], int]] = {
    "sphere": lambda t: 0,
    "cylinder": lambda t: 0,
    "ellipse": _fold_of_ellipse,
    "cuboid": _fold_of_sides,
    "pyramid": _fold_of_sides,
    "cross": lambda t: 1 if t.get("offset") else _fold_of_sides(t),
    "twin_cuboids": lambda t: 2,
    "lying_cylinder": lambda t: 2,
    "triple_triangle": lambda t: 3,
    "polygon": lambda t: int(t["sides"]),
}


def fold(table: dict) -> int:
    """Order of the rotational symmetry of a table's body about the tool's axis; 0: axisymmetric.

    1 for a table that no body can be built from, because a catalogue may hold such tables if no press uses them.
    """
    try:
        return FOLDS.get(table["kind"], lambda t: 1)(table)
    except (KeyError, IndexError, TypeError, ValueError, OverflowError):
        return 1


def read_catalogue(path) -> dict[str, dict]:
    """The raw tables of a catalogue file by name, not built yet."""
    tables = read_toml(path, "name an existing catalogue of indenters")
    for name, table in tables.items():
        if not isinstance(table, dict):
            raise BadInput(f"{path}: {name} = {table!r} is outside any table; write [{name}] with its `kind`")
    return tables


def load_catalogue(path, names=None, folder=None) -> dict[str, Body]:
    """Indenters by name from a catalogue file, all or those in `names`.

    Paths of STL files are relative to `folder`, by default the catalogue's. Each has distance(points), surface(),
    radius(), name, height (mm), seen (whether networks train on it) and spare (left out of the standard set).
    """
    return build_all(read_catalogue(path), path, names, folder)


def build_all(tables: dict[str, dict], source, names=None, folder=None, kept: Path | None = None) -> dict[str, Body]:
    """The bodies of catalogue tables, all or those in `names`, as from `load_catalogue`. kept: as in `build`."""
    for name in names or ():
        if name not in tables:
            raise BadInput(f"{source}: no indenter named {name!r}{nearest(name, tables)}")
    return {n: build(n, t, source, folder, kept) for n, t in tables.items() if names is None or n in names}


def bodies_of(presses: Iterable[PressRecord], tables: dict[str, dict], workflow: Path, kept: Path) -> dict[str, Body]:
    """Bodies of the presses' indenters by name; STL paths are relative to `workflow`. kept: as in `build`."""
    return build_all(tables, "indenter catalogue", {press.indenter for press in presses}, workflow, kept)
