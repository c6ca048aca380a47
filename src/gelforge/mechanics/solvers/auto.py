"""Fidelity `auto`: the cheapest method whose benchmarked errors meet the tolerances."""

from dataclasses import dataclass, field

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.params.tables import WAYS, FeaTable
from gelforge.mechanics.scene import Scene
from gelforge.mechanics.solvers.contactclass import contact_class

SPARE = "label"  # quality of those that solve a press for which `ccx` finds no valid state


@dataclass(frozen=True)
class SolveMethod:
    """How a press is solved: a fidelity, the quality of hexahedra where they solve it, and why they were chosen.

    why: what goes into the evidence of its result, class of contact and name of the way; empty where nothing was chosen.
    """

    fidelity: str
    hexahedra: str
    why: dict[str, str] = field(default_factory=dict)


def method_of(scene: Scene, fidelity: str, settings: FeaTable) -> SolveMethod:
    """How a press that ends in `scene` is solved."""
    if fidelity != "auto":
        return SolveMethod(fidelity, settings.hex_quality if fidelity == "hex" else SPARE)
    kind = contact_class(scene)
    name = cheapest(kind, settings)
    engine, _, hexahedra = name.partition("-")
    return SolveMethod(engine, hexahedra or SPARE, {"class": kind or "no contact", "way": name})


def charted_errors(kind: str, settings: FeaTable) -> dict[str, np.ndarray]:
    """Worst benchmarked error of total force and of the cells, and cost (3,), by method, on contacts of a class's shape.

    Of all classes of this shape, because a class alone rests on one to five scenes; of all there are for a shape without any.
    """
    charted = settings.charted
    shape, _, _ = kind.partition("_")
    rows = [row for name, row in charted.items() if name.startswith(f"{shape}_")] or list(charted.values())
    return {way: np.max([row[way] for row in rows], axis=0) for way in WAYS if all(way in row for row in rows)}


def cheapest(kind: str | None, settings: FeaTable) -> str:
    """The cheapest of WAYS whose benchmarked worst errors on this class of contact meet both tolerances.

    None: nothing touches, and the cheapest will say so.
    """
    if kind is None:
        return WAYS[0]
    limits = np.array([settings.tolerance, settings.cell_tolerance])
    worst = charted_errors(kind, settings)
    meeting = {way: found[2] for way, found in worst.items() if (found[:2] <= limits).all()}
    if not meeting:
        raise BadInput(
            f"no charted way of solving meets tolerance = {limits[0]:g} and cell_tolerance = {limits[1]:g} on contacts "
            f"of class {kind}; raise them or name a fidelity in [fea]"
        )
    return min(meeting, key=lambda way: meeting[way])
