"""Add a contact law: Coulomb's friction up to the shear strength of the gel's skin, beside the laws that come with gelforge.

CONTRIBUTING.md says how `[interface] law` of workflow/params.toml chooses it. Each of the three presses takes half a minute or so.
"""

import numpy as np

from gelforge.geometry.gel import load_gel
from gelforge.geometry.indenters import CATALOGUE, load_catalogue
from gelforge.mechanics.contact.law import LAWS, ContactLaw
from gelforge.mechanics.hexsettings import quality
from gelforge.mechanics.material import Material
from gelforge.mechanics.scene import Interface, Scene
from gelforge.mechanics.solvers.hex import HexSolver
from gelforge.records.press import Press

STRENGTH = 0.02  # MPa


class Orowan(ContactLaw):
    """Points stick until the traction reaches the coefficient times the pressure, or STRENGTH where that is less."""

    name, sticks, slips, has_coefficient = "orowan", True, True, True

    def slip_limit(self, depth, stiffness):
        """Traction in MPa at which points slip that are `depth` mm inside the indenter, and its derivative."""
        limit, slope = self.coefficient * stiffness * depth, np.full_like(depth, self.coefficient * stiffness)
        return np.minimum(limit, STRENGTH), np.where(limit < STRENGTH, slope, 0.0)


LAWS[Orowan.name] = Orowan

sphere = load_catalogue(CATALOGUE, ["sphere_10"])["sphere_10"]
totals = {}
press = Press(x0=0.0, y0=0.0, z0=0.0, dx=0.3, dy=0.0, dz=-0.5, rot_deg=0.0)  # mm and degrees
for law in ("no_slip", "coulomb", "orowan"):
    scene = Scene(load_gel("gelsight_mini"), Material(), sphere, press, Interface(law, 0.8))
    totals[law] = HexSolver(quality("draft")).solve(scene).total  # N on the gel
    print(f"{law:8s}: x {totals[law][0]:+.3f}, z {totals[law][2]:+.3f} N")
