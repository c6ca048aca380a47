"""How finely hexahedra solve a scene: settings, and the named qualities."""

from dataclasses import dataclass, replace

from gelforge.errors import BadInput
from gelforge.mechanics.extrapolate import Convergence
from gelforge.mechanics.mesh.hexmesh import SMALLEST, FineBox
from gelforge.mechanics.path.pathsettings import PathSettings

# Residual over contact force of a path that only leads to the fine hexahedra. It is far below what their answer needs, because
# which released points at its end turns on it: at 1e-4 a second thread let ten more points go under a pyramid, 0.2 % of force.
COARSE_TOLERANCE = 1e-6
FLATNESS = 1.6  # height over width that hexahedra of the uppermost layer have at most under a small contact
# What a path on coarse hexahedra brought so close to the indenter, in widths of a coarse hexahedron, has touched: between the
# points where the coarse contact sticks, its faces cut corners. Five times as much also holds points beside the contact: up to
# 6 % more force on wide shallow contacts and thin gels. Tetrahedra have twelve points a face, of which it holds too many.
TOUCHED = 0.01
WIDEST = 0.15  # of the gel's height, hexahedra under the press


@dataclass(frozen=True)
class Nested:
    """How the path is followed on coarser hexahedra, of which only the end is solved on the fine ones.

    factor: their size in that of the fine ones. layers, widened, growth: theirs (see HexSettings). press_steps, shear_steps:
    load steps of the path. convergence: what both sizes say of the force (mechanics.extrapolate); None: nothing. One factor on all
    nodal forces of a press: balance and direction stay as they are; displacement is the fine hexahedra' own, whose base
    reaction is that much larger.
    """

    factor: float = 2.0
    layers: int = 3
    widened: tuple[int, ...] = ()
    growth: float = 2.5
    press_steps: int = 6
    shear_steps: int = 3
    convergence: Convergence | None = None


@dataclass(frozen=True)
class HexSettings(PathSettings):
    """How finely a scene is solved, and how its path is followed.

    size: side of the hexahedra under the press, mm; smaller where the contact is under `across` of them wide (0: never), and
    at most WIDEST of the gel's height.
    layers, layer_ratio: hexahedra through the height, and how many times as thick as the uppermost the lowest is.
    thin_below, steepness: where hexahedra under the press are as small as `thin_below` mm, those of the uppermost layer are
    at most FLATNESS times as high as wide, each layer is up to `steepness` times as thick as the one above, and layers are
    added (0: nowhere).
    widened: how many of the lowest layers have hexahedra twice as wide, how many of these hexahedra four times as wide, and so on.
    growth, largest: by what factor, and up to what side in mm, hexahedra grow away from the press.
    box: fixed fine part (FineBox) in place of one that follows the press.
    nested: how the path is followed on coarser hexahedra first; None: on these. With Coulomb friction it is always on these,
    because a point's force depends on all of its slip.
    """

    across: int = 0
    layers: int = 6
    widened: tuple[int, ...] = ()
    layer_ratio: float = 3.0
    thin_below: float = 0.0
    steepness: float = 1.6
    growth: float = 1.5
    largest: float = 2.0
    touched: float = TOUCHED
    box: FineBox | None = None
    nested: Nested | None = None

    def with_steps(self, finer: int) -> "HexSettings":
        """The same with so many times as many load steps, on coarse hexahedra as well."""
        n = self.nested
        more = n and replace(n, press_steps=finer * n.press_steps, shear_steps=finer * n.shear_steps)
        return replace(self, press_steps=finer * self.press_steps, shear_steps=finer * self.shear_steps, nested=more)

    @property
    def coarse(self) -> "HexSettings":
        """Settings of the path on coarser hexahedra."""
        n = self.nested or Nested()
        return replace(
            self, size=n.factor * self.size, layers=n.layers, widened=n.widened, growth=n.growth, nested=None, tolerance=COARSE_TOLERANCE,
            final_tolerance=COARSE_TOLERANCE, press_steps=n.press_steps, shear_steps=n.shear_steps,
            thin_below=n.factor * self.thin_below, steepness=self.steepness**n.factor,
        )  # fmt: skip


# Chosen on the 16 scenes of workflow/scenes.toml, by error against CalculiX on fine tetrahedra.
# - Layers of nearly equal height (ratio 2) are better than a thin top one: at five layers a ratio of 6 errs by 2 to 3 % in
#   total force, 2 by 1 to 2 %.
# - On a thin gel hexahedra wider than WIDEST of its height, wider still below, are up to 4 % too soft.
# - A hexahedron's face bends too little for 3 x 3 points to stick: 2 x 2 halve the error of flat and sharp indenters.
# - Under a contact a millimetre or two across, layers of half a millimetre err by up to 12 %: there the uppermost ones are
#   thinner, and what the coarse hexahedra add is right to 1 % where their layers are those of the fine ones, two in one.
# - Below the upper layers wide hexahedra do: the same errors in 0.7 (label) and 0.6 (draft) of the time. At least two layers
#   must be fine: one alone, on wide faces, doubles the error of the cells.
# - Three press steps cost under 0.6 % of the force with stick points at first touch (12 % where a step ends, one step).
QUALITIES = {
    "draft": HexSettings(
        size=0.45, across=15, layers=6, widened=(4, 2), layer_ratio=2.0, thin_below=SMALLEST, growth=2.2, largest=4.0,
        press_steps=3, shear_steps=2, nested=Nested(widened=(1,), press_steps=4, shear_steps=2,
            convergence=Convergence(smooth=0.32, edge=0.64, width=0.18, height=-0.48, spread=0.21, floor=0.004, cells=0.45)),
    ),
    "label": HexSettings(
        size=0.35, across=20, layers=5, widened=(2,), layer_ratio=2.0, thin_below=SMALLEST, growth=2.2, largest=4.0,
        press_steps=4, shear_steps=2, nested=Nested(press_steps=10, shear_steps=4,
            convergence=Convergence(smooth=0.46, small=-0.11, corner=0.47, spread=0.12, floor=0.002, cells=0.25)),
    ),
    "fine": HexSettings(size=0.3, across=24, layers=8, press_steps=6, shear_steps=3),
}  # fmt: skip


def quality(name: str) -> HexSettings:
    """The settings of that name, one of QUALITIES; an unknown one raises BadInput."""
    if name not in QUALITIES:
        raise BadInput(f"quality {name!r} of hexahedra is unknown; choose one of {', '.join(QUALITIES)}")
    return QUALITIES[name]
