"""A small family of tetrahedral gel meshes, by region and density: names, sizes, and which one serves a press where."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import read_json
from gelforge.flow.layout import command_for
from gelforge.flow.tables import IN_PROCESS, FeaTable, MeshesTable
from gelforge.geometry import touch
from gelforge.geometry.gel import Gel, load_gel
from gelforge.mechanics.mesh import meshstore
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.hexname import HexMeshName, is_hex_mesh_name
from gelforge.mechanics.mesh.meshstore import MeshSource
from gelforge.mechanics.mesh.moved import farthest, moved, reach, way_to
from gelforge.mechanics.scene import Scene

MESHES_KEPT = 8  # meshes that a loader has at hand
SPACING, NEAR = 0.25, 0.05  # mm: between points of the top at which a press is looked at, and what counts as touched
# Elements across a contact that a region's coarser mesh must have: under the 1.5 mm wall of a tube or a tilted edge (2 to 4
# mm by touch.width_of) those of 0.45 mm are 2 to 4 % too stiff, those of 0.3 mm 0.3 to 1.4 %.
ACROSS = 10
_PLACED = re.compile(r"(.+)@(-?\d+(?:\.\d+)?):(-?\d+(?:\.\d+)?)")
_NAME = re.compile(r"(ccx)-([a-z]+)-(\d+(?:\.\d+)?)")


@dataclass(frozen=True)
class MeshName:
    """What a tetrahedral mesh is: engine ("ccx"), region, element size in mm."""

    engine: str
    region: str
    size: float

    @classmethod
    def parse(cls, text: str) -> "MeshName":
        """Read ccx-REGION-SIZE, such as ccx-centre-0.7."""
        match = _NAME.fullmatch(text)
        if not match or float(match[3]) < 0.1:
            raise BadInput(
                f"mesh name {text!r} is none; write ccx-REGION-SIZE, such as ccx-centre-0.7 (size >= 0.1 mm)"
            )
        return cls(match[1], match[2], float(match[3]))


def mesh_names(fea: FeaTable) -> list[str]:
    """Names of the meshes that the [fea] table asks for, in its order; hexahedra are built where they are needed."""
    return [] if fea.method in IN_PROCESS else [f"ccx-{kind}" for kind in fea.meshes]


def required_meshes(fea: FeaTable, meshes: MeshesTable) -> list[str]:
    """`mesh_names` of the [fea] table, whose regions [meshes] must know."""
    names = mesh_names(fea)
    for name in names:
        region(MeshName.parse(name), meshes)
    return names


def region(name: MeshName, meshes: MeshesTable) -> tuple[float, float]:
    """Half extents (x, y) in mm of a mesh's fine region."""
    if name.region not in meshes.regions:
        raise BadInput(f"mesh region {name.region!r} is unknown; [meshes.regions] has {', '.join(meshes.regions)}")
    half = meshes.regions[name.region]
    return float(half[0]), float(half[1])


def sizing(half: tuple[float, float], size: float, meshes: MeshesTable) -> Callable[[np.ndarray], np.ndarray]:
    """Edge length (n,) mm wanted at points (n, 3) of the flat pad: `size` in the region, growing away from it."""

    def at(points: np.ndarray) -> np.ndarray:
        out = np.maximum(np.abs(points[:, :2]) - half, 0.0)
        below = np.maximum(-points[:, 2] - meshes.fine_depth_mm, 0.0)
        away = np.sqrt((out**2).sum(axis=1) + below**2)
        return np.clip(size + meshes.growth * away, size, max(size, meshes.coarsest_mm))

    return at


def make_mesh(name: MeshName, gel: Gel, meshes: MeshesTable) -> tuple[GelMesh, dict]:
    """The mesh that ships of this gel and these sizes, or else a new one; and its report."""
    from gelforge.mechanics.mesh.tetmesh import gel_mesh, mesh_report

    half = region(name, meshes)
    key = meshstore.recipe(asdict(name), half, gel, meshes)
    if path := meshstore.find(meshstore.SHIPPED, key):
        return GelMesh.load(path), read_json(path.with_suffix(".json"))
    at, hold = sizing(half, name.size, meshes), meshes.hold.get(name.region, 0.0)
    mesh = gel_mesh(gel, at, longest=(lambda points: hold * at(points)) if hold else None)
    report = {"half_mm": list(half), "reach_mm": list(reach(mesh, gel, half)), "gel": gel.name, "recipe": key}
    return mesh, asdict(name) | report | mesh_report(mesh, gel)


def load_mesh(folder: Path | str, name: str) -> GelMesh:
    """The mesh of that name: rebuilt where it is of hexahedra, else read from the folder 20_meshes.

    Every reader of meshes by name comes here. A name that means nothing or whose file is missing raises BadInput.
    """
    if is_hex_mesh_name(name):
        return HexMeshName.parse(name).mesh()
    path, (own, way) = mesh_file(folder, name), unplaced(name)
    if not any(way):
        return GelMesh.load(path)
    report = _report(folder, own)
    if any(abs(far) > most for far, most in zip(way, report["reach_mm"], strict=True)):
        raise BadInput(
            f"mesh name {name!r}: its fine part cannot go that far, see reach_mm in {own}.json;"
            f" run {command_for('fea', path)} again"
        )
    return moved(GelMesh.load(path), load_gel(report["gel"]), tuple(report["half_mm"]), way)


def placed(name: str, way: tuple[float, float]) -> str:
    """The name of a mesh whose fine part is moved by `way` (x, y) mm: NAME@X:Y, or NAME where it lies in the middle."""
    return f"{name}@{way[0]:g}:{way[1]:g}" if any(way) else name


def unplaced(name: str) -> tuple[str, tuple[float, float]]:
    """The name of the mesh of stage 20 behind a name of `placed`, and how its fine part is moved."""
    match = _PLACED.fullmatch(name)
    return (match[1], (float(match[2]), float(match[3]))) if match else (name, (0.0, 0.0))


def mesh_file(folder: Path | str, name: str) -> Path:
    """Path of the mesh of stage 20 behind a name; one that is not there raises BadInput."""
    return _file(folder, f"{unplaced(name)[0]}.npz")


def _file(folder: Path | str, name: str) -> Path:
    path = Path(folder) / name
    if not path.exists():
        raise BadInput(f"{path}: a mesh of this name or its report is missing; run {command_for('meshes', path)}")
    return path


def _report(folder: Path | str, name: str) -> dict:
    """The report of a mesh that stage 20 wrote beside it (`make_mesh`)."""
    return dict(read_json(_file(folder, f"{name}.json")))


def mesh_loader(folder: Path | str) -> Callable[[str], GelMesh]:
    """`load_mesh` of one folder, which keeps the MESHES_KEPT meshes last used."""
    return lru_cache(maxsize=MESHES_KEPT)(partial(load_mesh, folder))


class MeshFamily:
    """The named tetrahedral meshes that presses may take, in a folder 20_meshes; each is read when first asked for.

    source: what a mesh is copied or made from when a press first takes it. None: all lie in the folder by their names, and
    one that is missing raises BadInput.
    """

    def __init__(self, folder: Path | str, names: list[str], source: MeshSource | None = None) -> None:
        self.folder, self.names, self.source = Path(folder), names, source
        self.reports: dict[str, dict] = {}
        self._files: dict[str, str] = {}
        if source is None:
            for name in names:
                mesh_file(folder, name)  # reported now if it is missing, not at the first press that needs it
                self.report(name)
        self.load = mesh_loader(self.folder)

    def file(self, name: str) -> str:
        """The name by which a mesh lies in the folder, which it does from then on."""
        if name not in self._files:
            self._files[name] = self.source.fetch(name, self.folder).stem if self.source else name
        return self._files[name]

    def report(self, name: str) -> dict:
        """What `make_mesh` reports of a mesh, which lies in the folder from then on."""
        if name not in self.reports:
            self.reports[name] = _report(self.folder, self.file(name))
        return self.reports[name]

    def half(self, name: str) -> tuple[float, float]:
        """Half extents (x, y) of a mesh's fine part, mm."""
        if self.source:
            return region(MeshName.parse(name), self.source.meshes)
        x, y = self.report(name)["half_mm"]
        return x, y

    def size(self, name: str) -> float:
        """Element size of a mesh, mm."""
        return MeshName.parse(name).size


@dataclass(frozen=True)
class Footprint:
    """The undeformed top that a press touches: from low (x, y) to high (x, y), and its width (touch.width_of), mm."""

    low: tuple[float, float]
    high: tuple[float, float]
    width: float


def footprint(scene: Scene) -> Footprint | None:
    """What of the top comes within NEAR of the indenter on its path; None if nothing does."""
    points, shape = touch.under_path(scene.gel, scene.indenter, scene.press, SPACING)
    met = touch.touched(scene.indenter, scene.press, points, NEAR)
    if not met.any():
        return None
    low, high = (end(points[met, :2], axis=0).tolist() for end in (np.min, np.max))
    return Footprint(tuple(low), tuple(high), touch.width_of(met.reshape(shape), touch.spacing_of(points, shape)))


def choose_mesh(scene: Scene, family: MeshFamily) -> str:
    """Name of the mesh for one press: that of the smallest region that holds the footprint, moved there if need be.

    Of a region's meshes the coarsest that has ACROSS elements across the contact, or its finest. Where no region holds
    the footprint, the widest does, in the middle. Only meshes that may be it are made.
    """
    foot = footprint(scene)
    for name in candidates(scene, family, foot):
        way = _way(family.half(name), family.report(name)["reach_mm"], foot)
        if way is not None:
            return placed(family.file(name), way)
    return family.file(_widest(family, foot)[0])


def first_candidate(scene: Scene, family: MeshFamily) -> str:
    """The mesh that a press takes most likely, found without making any."""
    foot = footprint(scene)
    return next(candidates(scene, family, foot), _widest(family, foot)[0])


def candidates(scene: Scene, family: MeshFamily, foot: Footprint | None) -> Iterator[str]:
    """Meshes whose fine part may hold a footprint, the best first: by the area of their region, then by size."""
    for names in _by_area(family):
        for name in _by_size(names, foot, family):
            half = family.half(name)
            if _way(half, farthest(scene.gel, half), foot) is not None:
                yield name


def _by_area(family: MeshFamily) -> list[list[str]]:
    """Names of the meshes of each area, the smallest area first; BadInput where there are none."""
    if not family.names:
        command = command_for("meshes", family.folder)
        raise BadInput(f"{family.folder}: no mesh was asked for; add one to [fea] meshes and run `{command}`")
    areas: dict[float, list[str]] = {}
    for name in family.names:
        areas.setdefault(float(np.prod(family.half(name))), []).append(name)
    return [names for _, names in sorted(areas.items())]


def _by_size(names: list[str], foot: Footprint | None, family: MeshFamily) -> list[str]:
    """The coarsest mesh that has ACROSS elements across the contact first, then finer ones, then those that are too coarse."""
    most = foot.width / ACROSS if foot else np.inf
    return sorted(
        names, key=lambda n: (family.size(n) > most, family.size(n) if family.size(n) > most else -family.size(n))
    )


def _widest(family: MeshFamily, foot: Footprint | None) -> list[str]:
    return _by_size(_by_area(family)[-1], foot, family)


def _way(half: Sequence[float], far: Sequence[float], foot: Footprint | None) -> tuple[float, float] | None:
    """How a fine part of half extents `half` that goes `far` at most goes to hold a footprint, mm; None where it cannot."""
    if foot is None:
        return 0.0, 0.0
    x, y = (way_to(foot.low[axis], foot.high[axis], half[axis], far[axis]) for axis in (0, 1))
    return None if x is None or y is None else (x, y)
