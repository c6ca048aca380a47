"""A small family of tetrahedral gel meshes, by region and density: names, sizes, and which one serves a press."""

import re
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import read_json
from gelforge.flow.params.tables import IN_PROCESS, FeaTable, MeshesTable
from gelforge.geometry import touch
from gelforge.geometry.gel import Gel
from gelforge.mechanics.hex.bricks import Bricks, is_bricks
from gelforge.mechanics.mesh import GelMesh
from gelforge.mechanics.scene import Scene

KEPT = 8  # meshes that a loader has at hand
SPACING, NEAR = 0.25, 0.05  # mm: between points of the top at which a press is looked at, and what counts as touched
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
    return mesh, asdict(name) | {"half_mm": list(half), "gel": gel.name} | quality(mesh, gel)


def load_mesh(folder: Path | str, name: str) -> GelMesh:
    """The mesh of that name: rebuilt where it is of bricks, else read from the folder 20_meshes.

    Every reader of meshes by name comes here. A name that means nothing or whose file is missing raises BadInput.
    """
    if is_bricks(name):
        return Bricks.parse(name).mesh()
    return GelMesh.load(mesh_file(folder, name))


def mesh_file(folder: Path | str, name: str) -> Path:
    """Path of a mesh of stage 20; one that is not there raises BadInput."""
    path = Path(folder) / f"{name}.npz"
    if not path.exists():
        raise BadInput(f"{path}: a mesh of this name is missing; run make meshes")
    return path


def mesh_loader(folder: Path | str) -> Callable[[str], GelMesh]:
    """`load_mesh` of one folder, which keeps the KEPT meshes last used."""
    return lru_cache(maxsize=KEPT)(partial(load_mesh, folder))


class MeshFamily:
    """The named tetrahedral meshes of a folder 20_meshes; each is read when first asked for."""

    def __init__(self, folder: Path | str, names: list[str]) -> None:
        self.folder = Path(folder)
        self.reports = {}
        for name in names:
            if not (self.folder / f"{name}.npz").exists() or not (self.folder / f"{name}.json").exists():
                raise BadInput(f"{self.folder / name}.npz or its report .json is missing; run `make meshes`")
            self.reports[name] = read_json(self.folder / f"{name}.json")
        self.load = mesh_loader(self.folder)


def footprint(scene: Scene) -> np.ndarray | None:
    """Largest |x|, |y| (mm) of the undeformed top within NEAR of the indenter on its path; None if none."""
    points, _ = touch.under_path(scene.gel, scene.indenter, scene.press, SPACING)
    met = touch.touched(scene.indenter, scene.press, points, NEAR)
    return np.abs(points[met, :2]).max(axis=0) if met.any() else None


def choose_mesh(scene: Scene, family: MeshFamily) -> str:
    """Name of the mesh for one press: the finest whose region holds the footprint, else the widest."""
    report = family.reports
    if not report:
        raise BadInput(f"{family.folder}: no mesh was asked for; add one to [fea] meshes and run `make meshes`")
    reach = footprint(scene)
    holding = [n for n in report if reach is None or np.all(reach <= report[n]["half_mm"])]
    if holding:
        return min(holding, key=lambda n: (report[n]["size"], report[n]["nodes"]))
    return max(report, key=lambda n: (np.prod(report[n]["half_mm"]), -report[n]["size"]))
