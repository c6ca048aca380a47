"""Settings for solving a scene on hexahedra, and the named qualities."""

from dataclasses import dataclass, replace

from gelforge.errors import BadInput
from gelforge.mechanics.extrapolate import Convergence
from gelforge.mechanics.mesh.hexmesh import SMALLEST, FineBox
from gelforge.mechanics.path.pathsettings import PathSettings

# Residual over contact force of a coarse path. It is far tighter than the fine solution needs, because the points
# released at its end depend on it: at 1e-4 a second thread released ten more under a pyramid, 0.2 % of the force.
COARSE_TOLERANCE = 1e-6
FLATNESS = 1.6  # largest height over width of hexahedra in the top layer under a small contact
# Gap, in widths of a coarse hexahedron, up to which a point counts as having touched on a coarse path: between the
# points that stick, the faces of the coarse mesh cut corners. Five times as much also makes points beside the contact
# stick: up to 6 % more force on wide shallow contacts and thin gels. Not for tetrahedra: too many of their twelve
# points per face would stick.
TOUCHED = 0.01
WIDEST = 0.15  # of the gel's height: largest side of hexahedra under the press


@dataclass(frozen=True)
class Nested:
    """Settings of a path on coarser hexahedra, of which only the end is solved on the fine ones.

    factor: size of the coarse hexahedra over that of the fine ones. layers, widened, growth: as in HexSettings.
    press_steps, shear_steps: load steps of the path; press_mm: longest one of the press under a law with friction.
    convergence: extrapolation of the force from both sizes
    (mechanics.extrapolate); None: none. It multiplies all nodal forces of a press by one factor, so balance and
    direction stay; displacements are not changed, and their base reaction is the force without that factor.
    """

    factor: float = 2.0
    layers: int = 3
    widened: tuple[int, ...] = ()
    growth: float = 2.5
    press_steps: int = 6
    shear_steps: int = 3
    press_mm: float = 0.1
    convergence: Convergence | None = None


@dataclass(frozen=True)
class HexSettings(PathSettings):
    """Mesh and path settings of a scene on hexahedra.

    size: side of the hexahedra under the press, mm; smaller if the contact is narrower than `across` of them (0:
    never), and at most WIDEST of the gel's height.
    layers, layer_ratio: hexahedra through the height, and thickness of the lowest layer over that of the uppermost.
    thin_below, steepness: if hexahedra under the press are `thin_below` mm wide or less, those of the top layer are
    at most FLATNESS times as high as wide, each layer is at most `steepness` times as thick as the one above, and
    layers are added as needed (thin_below = 0: never).
    widened: number of low layers with hexahedra twice as wide; of these, number with four times as wide, and so on.
    growth, largest: factor by which, and side in mm up to which, hexahedra grow away from the press.
    box: fixed fine part (FineBox) in place of one that follows the press.
    nested: settings of a path on coarser hexahedra, of which only the end is solved on these (with Coulomb friction
    after a walk, see `walk_mm`); None: the whole path is followed on these.
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
        """The same settings with `finer` times as many load steps, on coarse hexahedra as well."""
        n = self.nested
        more = n and replace(n, press_steps=finer * n.press_steps, shear_steps=finer * n.shear_steps)
        return replace(self, press_steps=finer * self.press_steps, shear_steps=finer * self.shear_steps, nested=more)

    @property
    def coarse(self) -> "HexSettings":
        """Settings of the path on coarser hexahedra."""
        n = self.nested or Nested()
        return replace(
            self, size=n.factor * self.size, layers=n.layers, widened=n.widened, growth=n.growth, nested=None, tolerance=COARSE_TOLERANCE,
            final_tolerance=COARSE_TOLERANCE, press_steps=n.press_steps, shear_steps=n.shear_steps, press_mm=n.press_mm,
            thin_below=n.factor * self.thin_below, steepness=self.steepness**n.factor,
        )  # fmt: skip


# Chosen on the 16 scenes of workflow/scenes.toml, by error against CalculiX on fine tetrahedra.
# - Layers of nearly equal height (ratio 2) are better than a thin top one: with five layers, the error of the total
#   force is 2 to 3 % at a ratio of 6, and 1 to 2 % at a ratio of 2.
# - On a thin gel, hexahedra wider than WIDEST of its height, and wider still in lower layers, are up to 4 % too soft.
# - A hexahedron's face cannot bend enough for 3 x 3 sticking points: 2 x 2 halve the error of flat and sharp bodies.
# - Under a contact one or two millimetres across, layers of half a millimetre have errors of up to 12 %: there the
#   top layers are thinner, and extrapolation is right to 1 % if each coarse layer is as thick as two fine ones.
# - Wide hexahedra in the lower layers give the same errors in 0.7 (label) and 0.6 (draft) of the time. At least two
#   layers must be fine: a single one, on wide faces, doubles the error of the forces per cell.
# - Three press steps change the force by under 0.6 % if points stick where they first touched (12 % for one step
#   after which points stick where it ended).
QUALITIES = {
    "draft": HexSettings(
        size=0.45, across=15, layers=6, widened=(4, 2), layer_ratio=2.0, thin_below=SMALLEST, growth=2.2, largest=4.0,
        press_steps=3, shear_steps=2, nested=Nested(widened=(1,), press_steps=4, shear_steps=2,
            convergence=Convergence(smooth=0.36, edge=0.38, height=-0.8, spread=0.15, doubt=0.2, floor=0.004, cells=0.45)),
    ),
    "label": HexSettings(
        size=0.35, across=20, layers=5, widened=(2,), layer_ratio=2.0, thin_below=SMALLEST, growth=2.2, largest=4.0,
        press_steps=4, shear_steps=2, nested=Nested(press_steps=10, shear_steps=4,
            convergence=Convergence(smooth=0.52, small=-0.2, edge=0.34, spread=0.12, doubt=0.08, floor=0.003, cells=0.25)),
    ),
    "fine": HexSettings(size=0.3, across=24, layers=8, press_steps=6, shear_steps=3),
}  # fmt: skip


def quality(name: str) -> HexSettings:
    """The settings of that name, one of QUALITIES; an unknown name raises BadInput."""
    if name not in QUALITIES:
        raise BadInput(f"quality {name!r} of hexahedra is unknown; choose one of {', '.join(QUALITIES)}")
    return QUALITIES[name]
