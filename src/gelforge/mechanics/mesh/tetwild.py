"""Tetrahedra inside closed triangles, by pytetwild (fTetWild; Hu et al. 2020, ACM Trans. Graph. 39, 117).

pytetwild runs in a process of its own: it leaves a file in the folder it runs in, and a process that has used it hangs
when a process forked from it uses it again. Its meshes differ a little from run to run, also with one thread.
"""

import io
import signal
import subprocess
import sys
import tempfile
import types
from functools import partial
from importlib.util import find_spec

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import DAMAGED
from gelforge.flow.jobs import die_with_parent

LEFT_OUT = "the methods ccx, ccx-contact and auto, which solve on tetrahedra"


def need_tetwild() -> None:
    """Raise BadInput if pytetwild is not installed."""
    if find_spec("pytetwild") is None:
        raise BadInput(
            f"the package pytetwild is not installed, which leaves out {LEFT_OUT}: pip install '.[mesh]' in a clone of gelforge, or"
            " choose draft, label or fine"
        )


def tetrahedralise(
    what: str, vertices: np.ndarray, faces: np.ndarray, edge_mm: float, apart_mm: float
) -> tuple[np.ndarray, np.ndarray]:
    """Linear tetrahedra inside closed triangles: the nodes (n, 3) mm in use, and elements (e, 4).

    what: the body, for messages. edge_mm: length of edges aimed at. apart_mm: how far the mesh may be from the
    triangles. A body that pytetwild cannot mesh, a process that was killed and a full disk raise BadInput.
    """
    need_tetwild()
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    given = io.BytesIO()
    np.savez(given, vertices=np.asarray(vertices, float), faces=np.asarray(faces, np.int32), edge=edge_mm,
             epsilon=apart_mm / diagonal)  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", __name__, folder]
        ended = subprocess.run(
            command, input=given.getvalue(), capture_output=True, check=False, preexec_fn=partial(die_with_parent, signal.SIGKILL)
        )  # fmt: skip
    if ended.returncode < 0:
        raise BadInput(
            f"{what}: pytetwild was stopped by {signal.Signals(-ended.returncode).name} while it made tetrahedra; if memory ran out,"
            " free some; then run it again"
        )
    try:
        with np.load(io.BytesIO(ended.stdout), allow_pickle=False) as found:
            nodes, tets = found["nodes"], found["tets"]
    except DAMAGED as error:
        said = ended.stderr.decode(errors="replace").strip().splitlines() or ["it said nothing"]
        raise BadInput(
            f"{what}: pytetwild made no tetrahedra ({said[-1][:200]}); free space in {tempfile.gettempdir()} if it is full, check that the"
            " surface is closed and does not cross itself, or solve by draft, label or fine"
        ) from error
    if not len(tets):
        raise BadInput(
            f"{what}: pytetwild found no volume inside; check that the surface is closed, or solve by draft, label or fine"
        )
    used, numbered = np.unique(tets, return_inverse=True)
    return nodes[used].astype(float), numbered.reshape(-1, 4)


def main(folder: str) -> None:
    """Mesh what standard input holds, with `folder` as working folder, and write the mesh to standard output."""
    import os

    # output of the library itself must not get into the mesh
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    with np.load(io.BytesIO(sys.stdin.buffer.read())) as given:
        vertices, faces, edge, epsilon = (
            given["vertices"],
            given["faces"],
            float(given["edge"]),
            float(given["epsilon"]),
        )
    # pytetwild imports pyvista for a function that is not used here, which takes a second
    sys.modules.setdefault("pyvista", types.ModuleType("pyvista"))
    from pytetwild import tetrahedralize

    os.chdir(folder)
    nodes, tets = tetrahedralize(vertices, faces, edge_length_abs=edge, epsilon=epsilon, num_threads=1)
    made = io.BytesIO()
    np.savez(made, nodes=nodes, tets=tets)
    out.write(made.getvalue())
    out.close()


if __name__ == "__main__":
    main(sys.argv[1])
