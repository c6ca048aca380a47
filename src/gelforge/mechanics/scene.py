"""What a fidelity is asked (`Scene`) and what it answers (`Result`)."""

from dataclasses import dataclass, replace

from gelforge.geometry.gel import Gel
from gelforge.geometry.solids import Indenter
from gelforge.mechanics.material import Material
from gelforge.records.press import Press


@dataclass(frozen=True)
class Interface:
    """Law between gel and indenter: "no_slip", "coulomb" (with `mu`) or "frictionless"."""

    law: str = "no_slip"
    mu: float = 0.0


@dataclass(frozen=True)
class Scene:
    """One press: everything a fidelity may look at."""

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
        return straight if self.interface.law == "frictionless" else self
