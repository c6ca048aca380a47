"""Data of the page's explorer: the table of presses, the data of each press, and what all of them share."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.flow.layout import POSES, Layout
from gelforge.geometry.gel import Gel, load_gel
from gelforge.geometry.stlfile import read_stl
from gelforge.mechanics.mesh.names import load_mesh
from gelforge.records.forcefile import ForceFile
from gelforge.records.labelfile import read_labels
from gelforge.records.press import POSE, TILT, Press
from gelforge.records.rowfile import map_array
from gelforge.reporting.parts import MICRON, arrows, jpeg, pack

SPACING_MM = 0.35  # spacing of the grid on which the gel's surface is drawn, for every mesh
MOST_FACES = 1500  # most triangles of an indenter in the page


@dataclass(frozen=True)
class Explorer:
    """Reads the data of single presses.

    rows: the table of presses.press_rows. samples: row of samples.csv, counted from 0, by sample_id. predictions:
    arrays of records.predictionfile, or None. gel: all gels of the dataset have its outline and dome; their thickness
    may differ.
    """

    results: Path
    resolution: str
    rows: list[dict]
    samples: dict[str, int]
    gel: Gel
    predictions: dict | None = None

    @cached_property
    def images(self) -> np.ndarray:
        """Pictures (n, height, width, 3) uint8 of the dataset, mapped from disk."""
        return map_array(Layout(self.results).dataset(self.resolution) / "images.npy")

    @cached_property
    def resampler(self):
        """A function from mesh name to `Resampler`, with a cache of the last used."""
        return lru_cache(maxsize=16)(lambda name: Resampler(load_mesh(name), self.gel))

    @cached_property
    def predicted(self) -> dict[str, int]:
        """Row of the predictions by sample_id."""
        return {} if self.predictions is None else {str(n): i for i, n in enumerate(self.predictions["sample_id"])}

    def presses(self) -> Iterator[dict]:
        """Data of each press for the page, in the order of the rows."""
        shard, opened = None, Shard()
        for row in self.rows:
            if row["shard"] != shard:
                shard = row["shard"]
                opened = Shard.read(self.results, self.resolution, shard)
            yield self.press(row, opened)

    def press(self, row: dict, shard: "Shard") -> dict:
        """Image, maps, gel and forces of one press; missing ones are left out."""
        packed: dict[str, Any] = {}
        if row["status"] == "REJECTED":  # its sample_id may be that of another press
            return pack(packed)
        if row["id"] in shard.labels:
            packed["label"] = shard.labels[row["id"]]
        if self.predictions is not None and row["id"] in self.predicted:
            packed["network"] = self.predictions["forces"][self.predicted[row["id"]]].astype(np.float32)
        if mesh := shard.mesh(row["id"]):
            resampler = self.resampler(mesh)
            sample = shard.sample(row["id"], resampler.nodes)
            if len(sample.nodes):
                packed["gel"] = (resampler(sample.displacement), MICRON)
                packed |= arrows(resampler.places + sample.displacement, sample.force)
        found = self.samples.get(row["id"])
        return ({"image": jpeg(self.images[found])} if found is not None else {}) | pack(packed)

    def shared(self) -> dict:
        """Shared data: the gel's undeformed surface, the thickness of each gel, and the indenters at the origin."""
        rows, columns, points = grid_points(self.gel)
        gels = sorted({row["gel"] for row in self.rows if row.get("gel")})
        return {
            "gel": {"rows": rows, "columns": columns, "width": self.gel.width, "length": self.gel.length,
                    "height": self.gel.height} | pack({"points": (points, MICRON)}),
            "heights": {name: load_gel(name).height for name in gels},
            "indenters": {name: self.indenter(row) for name, row in self.deepest().items()},
        }  # fmt: skip

    def deepest(self) -> dict[str, dict]:
        """The press of each indenter whose tip ends lowest: its stored surface reaches highest above the tip."""
        found: dict[str, dict] = {}
        for row in self.rows:
            if row.get("indenter") and row.get("stl"):
                best = found.setdefault(row["indenter"], row)
                if row["z0_mm"] + row["dz_mm"] < best["z0_mm"] + best["dz_mm"]:
                    found[row["indenter"]] = row
        return found

    def indenter(self, row: dict) -> dict:
        """Simplified surface of the indenter of a press, in the indenter's own frame: packed points and faces."""
        points, faces = few_faces(*read_stl(Layout(self.results).folder(POSES) / row["stl"]))
        rotation, tip = Press(*(row[name] for name in (*POSE, *TILT))).pose(0.0, 0.0)
        own = (points - tip) @ rotation
        return pack({"points": (own, MICRON), "faces": (faces, 1)})


def few_faces(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A surface with at most about MOST_FACES triangles."""
    if len(faces) <= MOST_FACES:
        return points, faces
    import pyvista as pv

    body = pv.PolyData.from_regular_faces(points, faces)
    small = body.decimate(1 - MOST_FACES / len(faces))
    return np.asarray(small.points), small.regular_faces


@dataclass(frozen=True)
class Shard:
    """Labels and gels of one shard by sample_id; empty where its stages have not run."""

    labels: dict = field(default_factory=dict)
    gels: dict[str, int] = field(default_factory=dict)
    forces: ForceFile | None = None

    @classmethod
    def read(cls, results: Path, resolution: str, shard: str) -> "Shard":
        """Read what stages 40 and 50 made of a shard."""
        of = Layout(results)
        labels, forces, gels = {}, of.forces(shard), {}
        path = of.labels(resolution, shard)
        if path.exists():
            found = read_labels(path)
            each = zip(found.sample_id.tolist(), found.label, found.status, strict=True)
            labels = {name: label for name, label, status in each if status.valid}
        if not forces.exists():
            return cls(labels)
        with ForceFile(forces) as file:
            gels = {str(name): at for at, name in enumerate(file.sample_id)}
            for array in ("node", "force", "surface_ptr", "displacement"):
                getattr(file, array)  # read while the file is open
        return cls(labels, gels, file)

    def mesh(self, name: str) -> str:
        """Name of the mesh that one sample's forces belong to; empty where it has none."""
        return str(self.forces.mesh[self.gels[name]]) if self.forces is not None and name in self.gels else ""

    def sample(self, name: str, nodes: np.ndarray):
        """Forces and displacements of one sample."""
        if self.forces is None:
            raise ValueError("no forces were read of this shard")
        return self.forces.sample(self.gels[name], nodes)


@lru_cache(maxsize=4)
def grid_points(gel: Gel) -> tuple[int, int, np.ndarray]:
    """Rows along x, columns along y, and the points (rows * columns, 3) of the undeformed top, mm."""
    rows, columns = round(gel.width / SPACING_MM) + 1, round(gel.length / SPACING_MM) + 1
    x = np.linspace(-gel.width / 2, gel.width / 2, rows)
    y = np.linspace(-gel.length / 2, gel.length / 2, columns)
    x, y = (axis.ravel() for axis in np.meshgrid(x, y, indexing="ij"))
    return rows, columns, np.column_stack([x, y, gel.top(x, y)])


class Resampler:
    """Interpolates displacements from a mesh's surface nodes to the grid of a gel.

    mesh: GelMesh, whose surface is a height field over x and y. Midside nodes of tetrahedra are used like corner
    nodes.
    """

    def __init__(self, mesh, gel: Gel):
        from scipy.spatial import Delaunay

        self.nodes = mesh.surface_nodes
        self.places = mesh.nodes[self.nodes]
        flat = self.places[:, :2]
        triangles = Delaunay(flat)
        points = grid_points(gel)[2][:, :2] * (1 - 1e-6)
        found = triangles.find_simplex(points)
        affine = triangles.transform[found]
        part = np.einsum("gij,gj->gi", affine[:, :2], points - affine[:, 2])
        self.corners = triangles.simplices[found]
        weight = np.column_stack([part, 1 - part.sum(axis=1)])
        # Grid points beyond the rounded corners of the outline do not move.
        self.weight = np.where((found >= 0)[:, None], np.nan_to_num(weight), 0.0)

    def __call__(self, displacement: np.ndarray) -> np.ndarray:
        """Interpolate displacements (s, 3) mm of the surface nodes to the grid (g, 3)."""
        return np.einsum("gk,gkj->gj", self.weight, displacement[self.corners])
