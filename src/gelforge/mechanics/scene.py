"""What a solver is asked: one press, from the gel to the contact law."""

from dataclasses import dataclass, replace

import numpy as np

from gelforge.geometry.gel import Gel
from gelforge.geometry.solids import Indenter
from gelforge.mechanics.contact.law import ContactLaw, Coulomb, Frictionless, NoSlip, contact_law
from gelforge.mechanics.material import Material
from gelforge.records.press import Press


@dataclass(frozen=True)
class Interface:
    """Contact law between gel and indenter: its name (`contact.law.LAWS`), and the coefficient of one that has one."""

    law: str = NoSlip.name
    mu: float = 0.0

    @classmethod
    def of_friction(cls, mu: float) -> "Interface":
        """The law of a coefficient of friction: none at 0 or below, no slip at infinity, between them Coulomb's."""
        if mu <= 0.0:
            return cls(Frictionless.name)
        return cls(NoSlip.name) if np.isinf(mu) else cls(Coulomb.name, float(mu))

    @property
    def contact(self) -> ContactLaw:
        """The law itself; a name that is none raises BadInput."""
        return contact_law(self.law, self.mu)


@dataclass(frozen=True)
class Scene:
    """One press: everything a method may look at."""

    gel: Gel
    material: Material
    indenter: Indenter
    press: Press
    interface: Interface = Interface()

    @property
    def direct(self) -> "Scene":
        """A scene with the same end that is reached straight down, where nothing depends on the way: without friction.

        Flat bodies that are dragged without friction stick in load steps in which the points at their edges come and go.
        """
        straight = replace(self, press=self.press.straight_there)
        return self if self.interface.contact.sticks else straight
