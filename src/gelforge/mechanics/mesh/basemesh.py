"""The base mesh of a gel: tetrahedra of its flat box by pytetwild, made once; each press bisects it.

pytetwild's meshes differ from run to run, so a base mesh is kept: by the flow in results/DATASET/20_meshes/GEL.npz, in
Python in memory or in a folder of the user's choice. The digest of its content stands in mesh names and solve keys.
"""

import hashlib
import json
import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.cli import MESHES
from gelforge.flow.files import DAMAGED, canonical, publish
from gelforge.geometry.gel import Gel, gel_shape
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.tetmesh import from_flat, mesh_report, orient, signed_volumes

EDGE_MM = 2.8  # length of the edges of a base mesh
# How far pytetwild's mesh may be from the box: the first of the box's diagonal, at most the second of its height.
APART, APART_HEIGHT = 1e-3, 1e-2
SNAP = 2.0  # nodes nearer to a side than this many times that distance are moved onto it
TRIES = 3  # most builds until one fills the box and is good enough
LEAST_JACOBIAN = 0.3  # scaled Jacobian of the worst element of a good mesh
SUFFIX = ".npz"


@dataclass(frozen=True)
class BaseMesh:
    """Tetrahedra (e, 4) of a gel's flat box, nodes (n, 3) mm: sharp corners, top at z = 0.

    shape: the gel's `gel_shape` as canonical JSON. report: size and quality of the mesh bent to the gel, and the
    processor seconds that it took.
    """

    nodes: np.ndarray
    tets: np.ndarray
    shape: str
    report: dict

    @property
    def digest(self) -> str:
        """Digest of the mesh, of its numbers alone."""
        parts = (self.nodes.tobytes(), self.tets.tobytes(), self.shape.encode())
        return hashlib.sha256(b"\0".join(parts)).hexdigest()[:16]

    def bent(self, gel: Gel) -> GelMesh:
        """The mesh with the gel's shape, not bisected."""
        return from_flat(gel, self.nodes, self.tets)

    def write(self, path: Path) -> None:
        """Write the mesh, whole or not at all."""
        about = json.dumps({"shape": self.shape, "report": self.report, "digest": self.digest})
        with publish(path) as part, part.open("wb") as stream:
            np.savez_compressed(stream, nodes=self.nodes, tets=self.tets, about=np.array(about))


def shape_text(gel: Gel) -> str:
    """What a gel's base mesh depends on, as text; equal for equal gels, so numbers are all written as floats."""
    shape = gel_shape(gel)
    return canonical({key: float(value) if isinstance(value, int) else value for key, value in shape.items()})


def build(gel: Gel) -> BaseMesh:
    """Make the base mesh of a gel, in 1 to 2 s; BadInput if its edges fall too steeply for tetrahedra."""
    from gelforge.mechanics.mesh.tetwild import tetrahedralise  # only stage 20 builds meshes

    began = _seconds()
    half = np.array([gel.width / 2, gel.length / 2])
    low, high = np.array([*-half, -gel.height]), np.array([*half, 0.0])
    apart = min(APART * float(np.linalg.norm(high - low)), APART_HEIGHT * gel.height)
    vertices = np.array([*product(*zip(low, high, strict=True))])
    faces = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
                      [1, 5, 7], [1, 7, 3]])  # fmt: skip
    best: BaseMesh | None = None
    failed = ""
    for _ in range(TRIES):
        nodes, tets = tetrahedralise(f"gel {gel.name}", vertices, faces, EDGE_MM, apart)
        tets = orient(nodes, tets)
        for axis, side in ((axis, ends[axis]) for axis in range(3) for ends in (low, high)):
            nodes[np.abs(nodes[:, axis] - side) < SNAP * apart, axis] = side
        own = signed_volumes(nodes, tets)
        if own.min() <= 0.0 or abs(own.sum() / np.prod(high - low) - 1.0) > 1e-9:
            failed = "its tetrahedra do not fill the box"
            continue
        made = BaseMesh(nodes, tets.astype(np.int32), shape_text(gel), {})
        try:
            report = mesh_report(made.bent(gel), gel)
        except BadInput as error:
            failed = str(error)
            continue
        made.report.update(report)
        if best is None or report["min_scaled_jacobian"] > best.report["min_scaled_jacobian"]:
            best = made
        if report["min_scaled_jacobian"] >= LEAST_JACOBIAN:
            break
    if best is None:
        raise BadInput(
            f"gel {gel.name}: no mesh of {TRIES} by pytetwild is usable ({failed}); give the gel less steep edges, or solve presses on it"
            " by draft, label or fine"
        )
    best.report["cpu_seconds"] = round(_seconds() - began, 3)
    return best


def _seconds() -> float:
    """Processor seconds of this process and of its finished children."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def read(path: Path, gel: Gel, hint: str) -> BaseMesh:
    """The base mesh in a file; BadInput for a file that is cut, was changed, or is that of another gel.

    hint: what to do then, as a sentence's end.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            about = json.loads(str(file["about"]))
            found = BaseMesh(file["nodes"], file["tets"], about["shape"], about["report"])
        sound = found.digest == about["digest"]
    except DAMAGED as error:
        raise BadInput(f"{path}: is no whole mesh file ({type(error).__name__}); {hint}") from error
    if not sound:
        raise BadInput(f"{path}: was changed since it was written; {hint}")
    if found.shape != shape_text(gel):
        raise BadInput(f"{path}: is the mesh of another gel than {gel.name}, or of an earlier shape of it; {hint}")
    return found


_asked: ContextVar[Path | None] = ContextVar("folder of base meshes", default=None)
_known: dict[tuple[Path | None, str], BaseMesh] = {}


def base_of(gel: Gel) -> BaseMesh:
    """The base mesh of a gel.

    In the flow it is read from its folder, and BadInput says how to make a missing one. In Python it is made when first
    asked for, and kept in the folder of `meshes_in`, or else in memory.
    """
    folder, shape = _asked.get(), shape_text(gel)
    of_flow = os.environ.get(MESHES) if folder is None else None
    at = (Path(of_flow) if of_flow else folder, shape)
    if at not in _known:
        if at[0] is None:
            _known[at] = build(gel)
        else:
            _known[at] = _of_flow(at[0], gel) if of_flow else _in_folder(at[0], gel)
    return _known[at]


def _of_flow(folder: Path, gel: Gel) -> BaseMesh:
    path, again = folder / f"{gel.name}{SUFFIX}", f"run make meshes DATASET={folder.parent.name}"
    if not path.exists():
        raise BadInput(f"{path}: gel {gel.name} has no mesh yet; {again}")
    return read(path, gel, f"remove it and {again}")


def _in_folder(folder: Path, gel: Gel) -> BaseMesh:
    path = folder / f"{gel.name}{SUFFIX}"
    if not path.exists():
        build(gel).write(path)
    return read(path, gel, "remove it: it is then made again")


def use_meshes_of(folder: Path) -> None:
    """From now on take base meshes from a folder of the flow, in this process and in those that it starts."""
    os.environ[MESHES] = str(folder.absolute())


@contextmanager
def meshes_in(folder: Path | str | None) -> Iterator[None]:
    """While the block runs keep base meshes in a folder, making missing ones; None changes nothing."""
    reset = _asked.set(Path(folder).absolute() if folder is not None else _asked.get())
    try:
        yield
    finally:
        _asked.reset(reset)
