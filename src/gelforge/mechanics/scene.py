"""Input of a solver: one press, from the gel to the contact law."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gelforge.geometry.gel import Gel
from gelforge.geometry.solids import Indenter
from gelforge.mechanics.contact.law import ContactLaw, Coulomb, Frictionless, NoSlip, contact_law
from gelforge.mechanics.material import Material
from gelforge.records.press import Press

FRICTION, FRICTION_ERROR = (
    0.7,
    0.2,
)  # coefficient between indenter and gel where no calibration gives one, and its error


@dataclass(frozen=True)
class Interface:
    """Contact law between gel and indenter: its name in `contact.law.LAWS`, and its coefficient if it has one."""

    law: str = NoSlip.name
    mu: float = 0.0

    @classmethod
    def of_friction(cls, mu: float) -> "Interface":
        """The law for a friction coefficient: frictionless at 0 or below, no slip at infinity, else Coulomb."""
        if mu <= 0.0:
            return cls(Frictionless.name)
        return cls(NoSlip.name) if np.isinf(mu) else cls(Coulomb.name, float(mu))

    @property
    def contact(self) -> ContactLaw:
        """The law itself; an unknown name raises BadInput."""
        return contact_law(self.law, self.mu)


@dataclass(frozen=True)
class PosedFile:
    """STL of an indenter's surface in the gel frame at the beginning of a press, as stage 10 writes it."""

    path: Path
    press: Press


@dataclass(frozen=True)
class Scene:
    """One press: all input that a solver may use. posed: file of the indenter's surface, if there is one."""

    gel: Gel
    material: Material
    indenter: Indenter
    press: Press
    interface: Interface = Interface()
    posed: PosedFile | None = None

    @property
    def direct(self) -> "Scene":
        """A scene with the same end, reached straight down if the path does not matter, which is without friction.

        Newton's method stalls when a flat body is dragged without friction: points at its edges keep entering and
        leaving contact.
        """
        straight = replace(self, press=self.press.straight_there)
        return self if self.interface.contact.sticks else straight
