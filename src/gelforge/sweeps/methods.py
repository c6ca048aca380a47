"""The methods of the chart: those of [fea], solvers at several mesh densities and load steps, and how each is run."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from gelforge.flow.params import StageParameters
from gelforge.flow.tables import IN_PROCESS, METHODS, ParetoTable
from gelforge.mechanics.hexsettings import HexSettings, quality
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.result import Result
from gelforge.mechanics.scene import Scene

WIDER = 1.5  # size of tetrahedra inside the contact over that at its edge, in a density series
REFERENCE, DOUBLED = "reference", "reference-doubled"  # DOUBLED: on elements and load steps of twice the size


@dataclass(frozen=True)
class Method:
    """One point of the chart: name, solver ("hex", "ccx", "auto", REFERENCE) and its own settings.

    size: mm, of hexahedra, or of tetrahedra at the edge of contact; None for a method of [fea] and a reference.
    steps: load steps of the press, half as many of the shear; None for the method's own.
    """

    name: str
    solver: str
    size: float | None = None
    layers: int | None = None
    steps: int | None = None
    doubled: bool = False


LARGE_REFERENCE = Method(REFERENCE, REFERENCE)  # the reference of the large chart


def method_of(name: str) -> Method:
    """A method of [fea], as it stands."""
    return Method(name, "hex" if name in IN_PROCESS else name)


def hex_method(size: float, layers: int, steps: int) -> Method:
    return Method(f"hex-{size:g}-{steps}", "hex", size, layers, steps)


def every_method(pareto: ParetoTable, scene: str) -> list[Method]:
    """The methods of the chart on a scene, cheap ones first, the reference last.

    Mesh density is varied at the first of `load_steps`, load steps at the first of each solver's sizes.
    """
    usual, *others = pareto.load_steps
    sizes = list(zip(pareto.hex_sizes_mm, pareto.hex_layers, strict=True))
    hexahedra = [hex_method(size, layers, usual) for size, layers in sizes]
    hexahedra += [hex_method(*sizes[0], n) for n in others]
    varied = [(size, usual) for size in pareto.ccx_sizes_mm] + [(pareto.ccx_sizes_mm[0], n) for n in others]
    tets = [Method(f"ccx-{size:g}-{n}", "ccx", size, steps=n) for size, n in varied]
    names = [name for name in METHODS if name != "ccx-contact" or scene in pareto.contact_scenes]
    return [*(method_of(name) for name in names), *hexahedra, *tets, LARGE_REFERENCE]


@cache
def warm_up() -> None:
    """Compile or load kernels before time is measured, once per process; forked children inherit them."""
    from gelforge.geometry.gel import Gel
    from gelforge.geometry.indenters import build
    from gelforge.mechanics.material import Material
    from gelforge.mechanics.solvers.hex import solve_hex
    from gelforge.records.press import Press

    ball = build("ball", {"kind": "sphere", "diameter": 15, "height": 10})
    scene = Scene(Gel(), Material(), ball, Press(0, 0, 0, 0, 0, -0.2))
    solve_hex(scene, HexSettings(size=2.0, layers=2, press_steps=1))


def hex_settings(method: Method) -> HexSettings:
    """Settings of a method on hexahedra."""
    if method.name in IN_PROCESS:
        return quality(method.name)
    # no `across`: it would shrink hexahedra under small contacts, but a density series keeps their size
    if method.size is None or method.layers is None or method.steps is None:
        raise ValueError(f"{method.name}: hexahedra of {method.size} mm without their layers and steps")
    return HexSettings(size=method.size, layers=method.layers, press_steps=method.steps,
                              shear_steps=(method.steps + 1) // 2, across=0)  # fmt: skip


def prepare(
    method: Method, scene: Scene, params: StageParameters, work: Path
) -> Callable[[], tuple[Result, GelMesh]]:
    """Set up solvers; the function returned solves the scene. work: an empty folder for CalculiX' files."""
    from gelforge.mechanics.solve import GUIDE, Solvers
    from gelforge.mechanics.solvers.ccx import LONGEST, CcxSettings, CcxSolver, mesh_of
    from gelforge.mechanics.solvers.hex import HexSolver

    if method.name in METHODS and method.solver != "hex":
        solvers = Solvers(work, params.fea)
        return lambda: _with_mesh(solvers.solve(scene, method.name))
    if method.solver == "hex":
        hexahedra = HexSolver(hex_settings(method))
        return lambda: _with_mesh(hexahedra.solve(scene))
    longest = LONGEST
    if method.solver == REFERENCE:
        table, factor = params.pareto.reference, 2 if method.doubled else 1
        sizes = factor * table.edge_mm, factor * table.size_mm
        press_steps, shear_steps = (max(1, count // factor) for count in (table.press_steps, table.shear_steps))
    else:
        if method.size is None or method.steps is None:
            raise ValueError(f"{method.name}: tetrahedra of {method.size} mm without their steps")
        # a density series keeps its size, as with hexahedra
        sizes, longest = (method.size, WIDER * method.size), np.inf
        press_steps, shear_steps = method.steps, (method.steps + 1) // 2
    frame = HexSolver(quality(GUIDE)).coarse_path([scene])[0]
    mesh = mesh_of(scene, frame.path if frame else None, *sizes, longest).mesh()
    usual = CcxSettings.of(params.fea)
    solver = CcxSolver(mesh, work, replace(usual, press_steps=press_steps, shear_steps=shear_steps, step_mm=np.inf))
    return lambda: (solver.solve(scene), mesh)


def _with_mesh(result: Result) -> tuple[Result, GelMesh]:
    """A result with the mesh of its forces; ValueError where nothing was solved."""
    if result.mesh is None:
        raise ValueError(f"nothing was solved: {result.status.value}")
    return result, result.mesh
