"""Settings for following a load path, independent of the element type."""

import math
from dataclasses import dataclass

from gelforge.mechanics.material import REFERENCE_C10


@dataclass(frozen=True)
class PathSettings:
    """How the path of a scene is followed on one mesh; residuals are those of free nodes over the contact force.

    size: side of the elements under the press, mm; free points closer to the indenter than this may come to touch.
    penalty, friction_penalty: contact stiffness along the normal and along the surface (Coulomb), times size / C10.
    gauss: order of the contact rule on a face of four nodes; 3 x 3 sticking points would over-constrain the face.
    press_steps, shear_steps: load steps of the two legs (more if Newton's method fails).
    tolerance, final_tolerance: residual within the path and at its end. rough: residual of the contact iterations
    after a path on other elements, sufficient to see which points pull and which press.
    max_iterations: of Newton's method in one solve. most_in_all: in a whole path. max_cuts: how often a load step may
    be halved. settle_rounds: most contact iterations at the end of the path. pull_tolerance: tension allowed at a
    sticking point, as a fraction of the largest pressure.
    press_mm, shear_mm: longest load steps of the two legs under a law with friction, mm. walk_mm: way at the end of a path on
    coarse hexahedra that is walked on this mesh under such a law, more for a deep press
    (`loadpath.fitted`); slide_mm: that of a press that moves sideways by more than it presses, all of whose points slip.
    touched: gap up to which a point counts as having touched on a path on wider hexahedra, in widths of those.
    """

    size: float = 0.7
    penalty: float = 1000.0
    friction_penalty: float = 100.0
    gauss: int = 2
    press_steps: int = 6
    shear_steps: int = 3
    press_mm: float = 0.05
    shear_mm: float = 0.1
    walk_mm: float = 0.1
    slide_mm: float = 0.2
    tolerance: float = 1e-4
    final_tolerance: float = 1e-9
    rough: float = 1e-3
    max_iterations: int = 14
    most_in_all: float = math.inf
    max_cuts: int = 8
    settle_rounds: int = 6
    pull_tolerance: float = 1e-3
    touched: float = 0.0

    @property
    def stiffness(self) -> float:
        """Contact penalty along the normal, MPa/mm."""
        return self.penalty * REFERENCE_C10 / self.size

    @property
    def friction_stiffness(self) -> float:
        """Contact penalty along the surface, MPa/mm."""
        return self.friction_penalty * REFERENCE_C10 / self.size
