"""How much too strong the bench's own hexahedra are, and the factor on their forces that makes up for it.

The bench walks a whole path with Coulomb friction on hexahedra of 0.7 mm: under a large ball their forces are 1 to 3 % too
strong, under edges 5 to 9 %, under sharp corners up to 20 %; sideways forces are half as much too strong. What a mesh adds
belongs to the shape that is pressed, a little to friction and hardly to place, so the force of the hexahedra that labels are
drafted with, over that of the bench's own, gives it for all presses of an indenter.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from gelforge.errors import SolveFailed
from gelforge.flow.files import canonical, kept, read_json, write_json
from gelforge.geometry.gel import Gel
from gelforge.geometry.solids import Indenter, surface_digest
from gelforge.mechanics.hexsettings import HexSettings, quality
from gelforge.mechanics.material import Material
from gelforge.mechanics.mesh.hexmesh import FineBox
from gelforge.mechanics.mesh.meshratio import mesh_ratios
from gelforge.mechanics.scene import Interface, Scene
from gelforge.mechanics.solvers.hex import HexSolver
from gelforge.records.press import Press

FINE = "draft"  # quality of the hexahedra that are believed: within 0.5 % of `label`, at half its time
TURN_DEG = 20.0  # of the indenter against the hexahedra: neither along them nor half-way
MOMENTS = 3  # depths at which the factor is found
DEPTHS = (1.2, 0.6, 0.3)  # mm that are tried in turn for the deepest of them
ASIDE = 0.15  # mm along both sides of the gel, that the last of them is then dragged


@dataclass(frozen=True)
class ForceFactor:
    """Factors on the forces of one indenter.

    depth: (k,) mm below the gel's apex, rising. factor: (k,) of normal force; constant beyond. sideways: of sideways force.
    """

    depth: np.ndarray
    factor: np.ndarray
    sideways: float

    def at(self, depth: float) -> np.ndarray:
        """The factors (3,) of a force at a depth in mm."""
        return np.array([self.sideways, self.sideways, np.interp(depth, self.depth, self.factor)])


def kept_factor(folder: Path, named: str, make: Callable[[], ForceFactor]) -> ForceFactor:
    """The factor kept in `folder` under a name of `name_of`, or a new one, which is kept; processes may share a folder."""
    return kept(folder / f"{named}.json", _read, make, _write)


def _read(path: Path) -> ForceFactor:
    held = read_json(path)
    depth, factor = (np.array(held[name], float) for name in ("depth", "factor"))
    return ForceFactor(depth, factor, float(held["sideways"]))


def _write(path: Path, factor: ForceFactor) -> None:
    values = {"depth": factor.depth.tolist(), "factor": factor.factor.tolist(), "sideways": factor.sideways}
    write_json(path, values)


def name_of(gel: Gel, material: Material, body: Indenter, interface: Interface, settings: HexSettings) -> str:
    """Name of what a factor depends on; of the indenter that is its surface."""
    parts = [
        asdict(gel),
        asdict(material),
        asdict(interface),
        asdict(settings),
        asdict(quality(FINE)),
        MOMENTS,
        DEPTHS,
        ASIDE,
        TURN_DEG,
    ]
    return f"{body.name}-{surface_digest(body, canonical(parts).encode())[:16]}"


def force_factor(
    gel: Gel,
    material: Material,
    body: Indenter,
    interface: Interface,
    settings: HexSettings,
    box_of: Callable[[Press], FineBox | None],
) -> ForceFactor:
    """Factors of one indenter from presses on the gel's apex, the last of them dragged aside where there is friction.

    interface: the law of both solves; where no press has an equilibrium with friction, presses without slip serve. settings:
    the bench's hexahedra, whose fine part under a press is box_of(press). Raises SolveFailed where no press of DEPTHS gives
    both forces.
    """
    laws = (interface, Interface()) if interface.contact.frictional else (interface,)
    for law, deepest in product(laws, DEPTHS):
        depths = deepest * np.arange(1, MOMENTS + 1) / MOMENTS
        presses = [Press(0.0, 0.0, 0.0, 0.0, 0.0, -float(depth), TURN_DEG) for depth in depths]
        if law.contact.sticks:
            presses.append(replace(presses[-1], dx=ASIDE, dy=ASIDE))
        scenes = [Scene(gel, material, body, press, law) for press in presses]
        fine = _forces(scenes, quality(FINE))
        own = _forces(scenes, replace(settings, box=box_of(presses[-1])))
        valid = ((fine[:, 2] < 0) & (own[:, 2] < 0))[:MOMENTS]
        if valid[-1]:
            ratios = mesh_ratios(fine, own)
            normal, dragged = ratios[:MOMENTS][valid, 2], ratios[-1, 0]
            # a press that could not be dragged says nothing of sideways force
            return ForceFactor(depths[valid], normal, float(dragged if np.isfinite(dragged) else normal[-1]))
    raise SolveFailed(
        f"indenter {body.name!r}: no straight press of {', '.join(f'{d:g}' for d in DEPTHS)} mm could be solved on both "
        "meshes, so how much the bench's hexahedra add to its forces is not known; smooth its edges or leave it out"
    )


def _forces(scenes: Sequence[Scene], settings: HexSettings) -> np.ndarray:
    """Forces (k, 3) N of frames of one press; NaN where a frame was not solved."""
    results = HexSolver(settings).solve_frames(scenes)
    return np.array([result.total if result.status.valid else np.full(3, np.nan) for result in results])
