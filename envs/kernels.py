"""Compile what solves need, in two processes side by side, so that numba keeps it beside the sources.

Usage: envs/kernels.py STAMP. Without it each process that solves first compiles for 10 to 30 s.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np


def hexahedra() -> None:
    """All that a press by `draft` and its label call."""
    import gelforge

    gelforge.label(gelforge.solve("triangle_10", 0.3, method="draft"))


def tetrahedra() -> None:
    """What CalculiX' method calls beside it, on one tetrahedron that stands on three bonded nodes."""
    from gelforge.mechanics.elements.element import ELEMENTS
    from gelforge.mechanics.mesh.gelmesh import GelMesh
    from gelforge.mechanics.mesh.tetmesh import Sizes, bisected, second_order
    from gelforge.mechanics.path.equilibrium import System

    corners, first = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), np.arange(4)[None]
    bisected(corners, first, Sizes(np.full((2, 2), 9.0), (0.0, 0.0), 1.0, 9.0, 9.0))
    nodes, elements, _ = second_order(corners, first)
    faces = elements[:, [0, 1, 3, 4, 8, 7]].astype(np.int32)
    mesh = GelMesh("tet10", nodes, elements, faces, np.arange(3, dtype=np.int32))
    system, solid, u = System(mesh), ELEMENTS["tet10"].on(mesh.nodes, mesh.cells), np.zeros_like(nodes)
    solid.internal_forces(u, 1.0, 20.0, np.zeros_like(nodes))
    solid.tangent(u, 1.0, 20.0, 1.0, system.base, system.width, system.values)
    solid.smallest_ratios(u)


KINDS = {"hexahedra": hexahedra, "tetrahedra": tetrahedra}

if __name__ == "__main__":
    if sys.argv[1] in KINDS:
        KINDS[sys.argv[1]]()
    else:
        print("compiling the solver")
        both = [subprocess.Popen([sys.executable, sys.argv[0], kind]) for kind in KINDS]
        codes = [one.wait() for one in both]  # waits for each, even if one fails
        if any(codes):
            sys.exit(1)
        Path(sys.argv[1]).touch()
