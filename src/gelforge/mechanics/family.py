"""A small family of tetrahedral gel meshes, by region and density: names, sizes, and which one serves a press where."""

import re
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import read_json
from gelforge.flow.layout import command_for
from gelforge.flow.params.tables import IN_PROCESS, FeaTable, MeshesTable
from gelforge.geometry import touch
from gelforge.geometry.gel import Gel, load_gel
from gelforge.mechanics.hex.bricks import Bricks, is_bricks
from gelforge.mechanics.mesh import GelMesh
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.tet.moved import moved, reach, way_to

KEPT = 8  # meshes that a loader has at hand
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
    """Names of the meshes that the [fea] table asks for, in its order; bricks are built where they are needed."""
    if fea.fidelity in IN_PROCESS:
        return []
    return [f"ccx-{kind}" for kind in (fea.fine_meshes if fea.fidelity == "ccx-fine" else fea.meshes)]


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
    """Build one mesh and its report."""
    from gelforge.mechanics.tet.tetmesh import gel_mesh, quality

    half = region(name, meshes)
    mesh = gel_mesh(gel, sizing(half, name.size, meshes), hold=meshes.hold.get(name.region, 0.0))
    told = {"half_mm": list(half), "reach_mm": list(reach(mesh, gel, half)), "gel": gel.name}
    return mesh, asdict(name) | told | quality(mesh, gel)


def load_mesh(folder: Path | str, name: str) -> GelMesh:
    """The mesh of that name: rebuilt where it is of bricks, else read from the folder 20_meshes.

    Every reader of meshes by name comes here. A name that means nothing or whose file is missing raises BadInput.
    """
    if is_bricks(name):
        return Bricks.parse(name).mesh()
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
    """What stage 20 tells of a mesh beside it (`make_mesh`)."""
    return dict(read_json(_file(folder, f"{name}.json")))


def mesh_loader(folder: Path | str) -> Callable[[str], GelMesh]:
    """`load_mesh` of one folder, which keeps the KEPT meshes last used."""
    return lru_cache(maxsize=KEPT)(partial(load_mesh, folder))


class MeshFamily:
    """The named tetrahedral meshes of a folder 20_meshes; each is read when first asked for.

    reports: of each mesh, what `make_mesh` tells. A mesh or report that is missing raises BadInput.
    """

    def __init__(self, folder: Path | str, names: list[str]) -> None:
        self.folder = Path(folder)
        for name in names:
            mesh_file(folder, name)  # told now if it is missing, not at the first press that needs it
        self.reports = {name: _report(folder, name) for name in names}
        self.load = mesh_loader(self.folder)


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
    the footprint, the widest does, in the middle.
    """
    reports = family.reports
    if not reports:
        told = command_for("meshes", family.folder)
        raise BadInput(f"{family.folder}: no mesh was asked for; add one to [fea] meshes and run `{told}`")
    foot = footprint(scene)
    areas = {name: float(np.prod(report["half_mm"])) for name, report in reports.items()}
    ways = {name: _way(report, foot) for name, report in reports.items()}
    holding = {name: way for name, way in ways.items() if way is not None}
    if not holding:
        holding = {name: (0.0, 0.0) for name, area in areas.items() if area == max(areas.values())}
    smallest = min(areas[name] for name in holding)
    sizes = {name: reports[name]["size"] for name in holding if areas[name] == smallest}
    wanted = foot.width / ACROSS if foot else np.inf
    fine = [name for name, size in sizes.items() if size <= wanted] or [min(sizes, key=lambda n: sizes[n])]
    chosen = max(fine, key=lambda name: sizes[name])
    return placed(chosen, holding[chosen])


def _way(report: dict, foot: Footprint | None) -> tuple[float, float] | None:
    """How the fine part of a mesh with this report goes to hold a footprint; None where it cannot."""
    if foot is None:
        return 0.0, 0.0
    half, far = report["half_mm"], report["reach_mm"]
    x, y = (way_to(foot.low[axis], foot.high[axis], half[axis], far[axis]) for axis in (0, 1))
    return None if x is None or y is None else (x, y)
