"""The key of a solve: a digest of exactly what changes its result, by which every cache finds it again.

Content and numbers, no names; and no number that the method by which a press is solved does not read.
"""

from collections.abc import Sequence
from dataclasses import asdict, fields
from typing import Any

from gelforge.flow.cache import digest_of_value
from gelforge.flow.params.tables import FeaTable
from gelforge.geometry.gel import gel_shape
from gelforge.mechanics.hexsettings import HexSettings, quality
from gelforge.mechanics.scene import Interface, Scene
from gelforge.mechanics.solvers.auto import SPARE, SolveMethod
from gelforge.mechanics.solvers.ccx import CcxSettings
from gelforge.mechanics.solvers.fidelity import GUIDE

# Of CcxSettings: how long CalculiX may run. A press that it stopped is solved again where it may take longer (stages/fea.py).
NO_RESULT = {"timeout_s"}


def solve_key(frames: Sequence[Scene], shape: Any, how: Any, version: int, at: int = -1) -> str:
    """Key of frame `at` of a press, whose frames share one path.

    shape: what the indenter's surface is, as a digest of it or the numbers that it is built from. how: settings of the
    solver and the content of its mesh, see `settings_of` and `hexahedra_key`. version: of the solver's answers.
    """
    scenes = [frames[0].direct] if len(frames) == 1 else list(frames)
    scene = scenes[at]
    law = [scene.interface.law, scene.interface.contact.coefficient]
    path = [asdict(each.press) for each in scenes] if len(scenes) > 1 else []
    return digest_of_value(
        [version, asdict(scene.press), path, gel_shape(scene.gel), asdict(scene.material), law, shape, how]
    )


def hexahedra_key(settings: HexSettings) -> list:
    """What of a solve on hexahedra changes its result."""
    return ["hex", asdict(settings)]


def settings_of(method: SolveMethod, fea: FeaTable, interface: Interface, mesh: str) -> list:
    """What of [fea] changes the result of a press that is solved by a method.

    mesh: name of its tetrahedra, which has a digest of their content.
    """
    if method.fidelity == "hex":
        return hexahedra_key(quality(method.hexahedra))
    if method.fidelity == "ccx-native":
        return [method.fidelity, mesh]
    ccx = {f.name: getattr(fea, f.name) for f in fields(CcxSettings) if f.name not in NO_RESULT}
    guide = [asdict(quality(GUIDE))] if method.fidelity == "ccx" and not interface.contact.slips else []
    spare = [asdict(quality(SPARE))] if method.fidelity == "ccx" else []
    return [method.fidelity, ccx, mesh, guide, spare]
