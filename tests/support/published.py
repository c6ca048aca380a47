"""Comparison of indenters and gel with published STEP solids; needs gmsh."""

from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from gelforge.geometry.indenters import read_catalogue

# FEATS' set-up files turn these by 180 degrees about z at 0 degrees (indenterRotZ).
HALF_TURN = ("triangle_10", "triangle_15", "triangle_20")
# Shapes of the catalogue that FEATS did not publish, beside the random solids.
OWN = {
    "wire_2",
    "blade_14",
    "coin_16",
    "washer_12",
    "bolt_head",
    "key",
    "two_pegs",
    "ball_40",
    "ball_60",
    "rod_30",
    "rod_60",
}
CONTACT_MM = 3.0  # compared height above the tip: presses are up to 2 mm deep


def published_names(catalogue: Path) -> set[str]:
    """Names of a catalogue's indenters that represent published ones."""
    return {name for name, table in read_catalogue(catalogue).items() if table.get("kind") != "random_solid"} - OWN


def read_step(path, size_mm: float, per_turn: int = 32) -> dict:
    """Volume (mm^3), centre of mass (3,), surface points (n, 3) and triangles (f, 3) of a STEP file, in mm.

    The points lie on the exact surfaces, at most `size_mm` apart, at least `per_turn` per circle. gmsh runs in its
    own process because it replaces the signal handlers, SIGPIPE's among them, of the process that loads it: a web
    server of a later test would then die silently when a browser closes its connection.
    """
    return _gmsh().submit(_mesh_of_step, path, size_mm, per_turn).result()


@cache
def _gmsh() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(1, mp_context=get_context("spawn"))


def _mesh_of_step(path, size_mm: float, per_turn: int) -> dict:
    import gmsh

    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Verbosity", 0)
        gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
        gmsh.option.setNumber("Mesh.MeshSizeMax", size_mm)
        gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", per_turn)
        gmsh.model.occ.importShapes(str(path))
        gmsh.model.occ.synchronize()
        solids = [tag for _, tag in gmsh.model.getEntities(3)]
        masses = np.array([gmsh.model.occ.getMass(3, tag) for tag in solids])
        centres = np.array([gmsh.model.occ.getCenterOfMass(3, tag) for tag in solids])
        gmsh.model.mesh.generate(2)
        tags, xyz, _ = gmsh.model.mesh.getNodes()
        _, corners = gmsh.model.mesh.getElementsByType(2)
    finally:
        gmsh.finalize()
    index = np.zeros(int(tags.max()) + 1, int)
    index[tags.astype(int)] = np.arange(len(tags))
    return {
        "volume": masses.sum(),
        "centre": masses @ centres / masses.sum(),
        "points": np.reshape(xyz, (-1, 3)),
        "faces": index[np.reshape(corners, (-1, 3)).astype(int)],
    }


def compare_indenter(body, path, sizes_mm=(3.0, 1.0, 0.4), good_mm: float = 0.05) -> dict:
    """Difference between an indenter and a STEP solid that points up.

    The solid is turned by 180 degrees about x (those of HALF_TURN also about z), set on its tip, and shifted in x
    and y so that the centres of mass agree.
    Returns volume_error (relative), surface_mm (largest distance between the surfaces, either way, within CONTACT_MM
    of the tip) and shift_mm (the shift in x and y). A coarse triangulation of the solid can only make the distance
    look larger, so finer ones are tried until it is below `good_mm`.
    """
    for size in sizes_mm:
        found = _compare(body, read_step(path, size))
        if found["surface_mm"] < good_mm:
            break
    return found


def _compare(body, solid) -> dict:
    from gelforge.geometry.triangles import volume

    turn = np.array([-1.0, 1.0, -1.0] if body.name in HALF_TURN else [1.0, -1.0, -1.0])
    points, centre = solid["points"] * turn, solid["centre"] * turn
    vertices, faces = body.surface()
    shift = _centre_of_mass(vertices, faces)[:2] - centre[:2]
    points = points + [*shift, -points[:, 2].min()]
    low, own = points[points[:, 2] < CONTACT_MM], vertices[vertices[:, 2] < CONTACT_MM]
    there = np.abs(body.distance(low)[0]).max()
    back = np.abs(_distance_to(own, points, solid["faces"])).max()
    return {
        "volume_error": volume(vertices, faces) / solid["volume"] - 1.0,
        "surface_mm": float(max(there, back)),
        "shift_mm": shift.tolist(),
    }


def compare_gel_top(gel, path, size_mm: float = 1.5) -> float:
    """Largest distance in z between the gel's top and the STEP solid (its y points out of the gel), mm."""
    points = read_step(path, size_mm)["points"]
    centre = (points.max(axis=0) + points.min(axis=0)) / 2.0
    x, y, z = points[:, 2] - centre[2], points[:, 0] - centre[0], points[:, 1] - points[:, 1].max()
    top = z > gel.rim + 1e-6
    return float(np.abs(gel.top(x[top], y[top]) - z[top]).max())


def step_file(folder, name: str) -> Path:
    """Path of the published solid of a catalogue indenter in the reference folder."""
    return Path(folder) / "feats" / "indenters" / f"{name}.step"


def _centre_of_mass(vertices, faces):
    a, b, c = vertices[faces].transpose(1, 0, 2)
    weight = np.einsum("ij,ij->i", a, np.cross(b, c))
    return weight @ (a + b + c) / (4.0 * weight.sum())


def _distance_to(points, vertices, faces):
    import pyvista

    surface = pyvista.PolyData.from_regular_faces(vertices, faces)
    return np.asarray(pyvista.PolyData(points).compute_implicit_distance(surface)["implicit_distance"])
