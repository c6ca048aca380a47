"""The methods on the chart: a fidelity with its mesh and its load steps, and how each is run."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from gelforge.flow.params.stages import ForPareto, ForStability
from gelforge.flow.params.tables import IN_PROCESS, FeaTable, ParetoTable, QuickTable
from gelforge.mechanics.hexsettings import HexSettings, quality
from gelforge.mechanics.mesh.family import MeshFamily, load_mesh
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.meshstore import MeshSource
from gelforge.mechanics.result import Result
from gelforge.mechanics.scene import Scene
from gelforge.sweeps import references as meshes

LABEL_METHODS = ("hex", "ccx", "auto")
REFERENCE, DOUBLED = "ccx-fine", "ccx-fine-doubled"  # DOUBLED: on elements and load steps of twice the size


@dataclass(frozen=True)
class Method:
    """One point of the chart: name, fidelity, and the settings that make it differ from others.

    size: mm, of hexahedra or of the density's tetrahedra; None where the fea stage's own are used, or a named quality.
    steps: load steps of the press, half as many of the shear; None for those of the fea stage.
    """

    name: str
    fidelity: str
    size: float | None = None
    layers: int | None = None
    steps: int | None = None
    doubled: bool = False


LARGE_REFERENCE = Method(REFERENCE, REFERENCE)  # what the large chart stands against


def hex_method(size: float, layers: int, steps: int) -> Method:
    return Method(f"hex-{size:g}-{steps}", "hex", size, layers, steps)


def quality_method(quality: str) -> Method:
    """The in-process solver at a quality that [fea] need not name."""
    return Method(f"hex-{quality}-quality", "hex")


def every_method(pareto: ParetoTable, hex_quality: str) -> list[Method]:
    """The methods of the whole chart, cheap ones first, the reference last.

    Mesh density is varied at the first of `load_steps`, load steps at the first of each engine's sizes. The quality
    of [fea] is the method hex-label.
    """
    from gelforge.mechanics.hexsettings import QUALITIES

    usual, *others = pareto.load_steps
    label = [Method(f"{name}-label", name) for name in LABEL_METHODS]
    sizes = list(zip(pareto.hex_sizes_mm, pareto.hex_layers, strict=True))
    hexahedra = [hex_method(size, layers, usual) for size, layers in sizes]
    hexahedra += [hex_method(*sizes[0], n) for n in others]
    varied = [(size, usual) for size in pareto.ccx_sizes_mm] + [(pareto.ccx_sizes_mm[0], n) for n in others]
    tets = [Method(f"ccx-{size:g}-{n}", "ccx", size, steps=n) for size, n in varied]
    native = [Method(f"ccx-native-{size:g}", "ccx-native", size) for size in pareto.native_sizes_mm]
    qualities = [quality_method(quality) for quality in QUALITIES if quality != hex_quality]
    return [*qualities, *label, *hexahedra, *tets, *native, LARGE_REFERENCE]


def quick_methods(quick: QuickTable, with_ccx: bool, reference_kept: bool) -> list[Method]:
    """Methods of the small chart; its reference is the last: the large chart's where it is kept, else fine hexahedra."""
    steps, fine = quick.steps, quick.reference
    sizes = zip(quick.hex_sizes_mm, quick.hex_layers, strict=True)
    found = [hex_method(size, layers, steps) for size, layers in sizes]
    found += [Method(f"{name}-label", name) for name in (("hex", "ccx") if with_ccx else ("hex",))]
    hexahedra = hex_method(fine.size, fine.layers, fine.press_steps)
    return [*found, LARGE_REFERENCE if reference_kept else hexahedra]


@cache
def warm_up() -> None:
    """Compile or load kernels before the clock runs, once a process; one that it forks has them already."""
    from gelforge.geometry.gel import Gel
    from gelforge.geometry.indenters import build
    from gelforge.mechanics.hexsettings import HexSettings
    from gelforge.mechanics.material import Material
    from gelforge.mechanics.solvers.hex import solve_hex
    from gelforge.records.press import Press

    ball = build("ball", {"kind": "sphere", "diameter": 15, "height": 10})
    scene = Scene(Gel(), Material(), ball, Press(0, 0, 0, 0, 0, -0.2))
    solve_hex(scene, HexSettings(size=2.0, layers=2, press_steps=1))


def prepare(
    method: Method,
    scene: Scene,
    folder: Path,
    params: ForPareto | ForStability,
    work: Path,
) -> Callable[[], tuple[Result, GelMesh]]:
    """Read meshes and set up solvers, which many presses share; the function returned solves the scene.

    folder: meshes. work: an empty folder for CalculiX' files.
    """
    if method.fidelity == "hex" and method.name != "hex-label":
        return _prepare_hex(method, scene, params.fea)
    if method.size is None and method.fidelity in LABEL_METHODS:
        return _prepare_label(method, scene, folder, params, work)
    if method.fidelity == "ccx-native":
        return _prepare_native(method, scene, folder, params, work)
    if method.fidelity == REFERENCE:
        return _prepare_reference(method, scene, params, work)
    return _prepare_ccx(method, scene, folder, params, work)


def hex_settings(method: Method, fea: FeaTable) -> HexSettings:
    """Settings of a method that runs the in-process solver; `fea` is the table of the fea stage."""
    if method.size is None:
        named = method.name.removeprefix("hex-").removesuffix("-quality")
        return quality(fea.hex_quality if method.name == "hex-label" else named)
    # `across` would shrink the hexahedra under small contacts: a density series holds their size
    if method.layers is None or method.steps is None:
        raise ValueError(f"{method.name}: hexahedra of {method.size} mm without their layers and steps")
    return HexSettings(size=method.size, layers=method.layers, press_steps=method.steps,
                              shear_steps=(method.steps + 1) // 2, across=0)  # fmt: skip


def _prepare_hex(method, scene, fea):
    from gelforge.mechanics.solvers.hex import HexSolver

    solver = HexSolver(hex_settings(method, fea))

    def run():
        result = solver.solve(scene)
        return result, result.mesh

    return run


def _prepare_label(method, scene, folder, params, work):
    from gelforge.mechanics.solvers.fidelity import Solvers

    names = [] if method.fidelity in IN_PROCESS else meshes.label_meshes(params)
    source = MeshSource(scene.gel, params.meshes)
    solvers = Solvers(MeshFamily(folder, names, source), work, params.fea)

    def run():
        result = solvers.solve(scene, method.fidelity)
        return result, solvers.family.load(result.evidence["mesh"])

    return run


def _prepare_native(method, scene, folder, params, work):
    from gelforge.mechanics.solvers.ccx_native import solve_native

    mesh = load_mesh(folder, meshes.density_mesh(scene, folder, params, method.size))
    return lambda: (solve_native(scene, mesh, work / "native", params.fea.timeout_s), mesh)


def _prepare_reference(method, scene, params, work):
    table, factor = params.pareto.reference, 2 if method.doubled else 1
    mesh = meshes.reference_mesh(scene, params, method.doubled)
    press_steps, shear_steps = (max(1, count // factor) for count in (table.press_steps, table.shear_steps))
    return _solve_ccx(scene, mesh, press_steps, shear_steps, params, work)


def _prepare_ccx(method, scene, folder, params, work):
    mesh = load_mesh(folder, meshes.density_mesh(scene, folder, params, method.size))
    return _solve_ccx(scene, mesh, method.steps, (method.steps + 1) // 2, params, work)


def _solve_ccx(scene, mesh, press_steps, shear_steps, params, work):
    from gelforge.mechanics.solvers.ccx import CcxSettings, CcxSolver

    usual = CcxSettings.of(params.fea)
    solver = CcxSolver(mesh, work, replace(usual, press_steps=press_steps, shear_steps=shear_steps, step_mm=np.inf))
    return lambda: (solver.solve(scene), mesh)
