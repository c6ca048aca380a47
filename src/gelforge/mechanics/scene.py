"""What a fidelity is asked (`Scene`) and what it answers (`Result`)."""

import json
from dataclasses import dataclass, field, replace

import numpy as np

from gelforge.geometry.gel import Gel
from gelforge.geometry.solids import Indenter
from gelforge.records.press import Press
from gelforge.records.status import Status

BALANCE = 1e-6  # of its size, by which the contact force of a valid result may differ from the base's reaction
REFERENCE_C10 = 0.0725  # MPa; every solve runs at this value, forces scale with C10 at fixed Poisson's ratio


@dataclass(frozen=True)
class Material:
    """Neo-Hookean solid, W = C10 (I1bar - 3) + (J - 1)^2 / D1 (CalculiX manual, *HYPERELASTIC).

    nu is Poisson's ratio at small strain. C10 is that of every solve, because all forces are proportional to it: what
    a gel's own C10 makes of them is one factor on the solved ones.
    """

    nu: float = 0.475

    @property
    def shear_modulus(self) -> float:
        return 2.0 * REFERENCE_C10

    @property
    def bulk_modulus(self) -> float:
        return 2.0 * self.shear_modulus * (1.0 + self.nu) / (3.0 * (1.0 - 2.0 * self.nu))

    @property
    def d1(self) -> float:
        return 2.0 / self.bulk_modulus


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
        """A scene with the same end that is reached straight down, where nothing tells by which way: without friction.

        Flat bodies that are dragged without friction stick in load steps in which the points at their edges come and go.
        """
        straight = replace(self, press=self.press.straight_there)
        return straight if self.interface.law == "frictionless" else self


class NoEquilibrium(Exception):
    """Newton's method stopped without a state; the load stepping answers with a shorter step."""


@dataclass
class Result:
    """State at the end of the path on a gel mesh with n nodes.

    forces: (n, 3) N, contact forces ON the gel (zero off its surface).
    displacement: (n, 3) mm. pressure/anchor data stay inside the fidelities.
    evidence: plain numbers and strings; the keys every fidelity fills are
    "equilibrium_residual" (relative), "penetration_mm", "pulling_fraction" (of the normal force),
    "base_mismatch" (relative), "newton_iterations", "rounds", "seconds", "peak_mib", "load_steps".
    """

    status: Status
    forces: np.ndarray
    displacement: np.ndarray
    evidence: dict = field(default_factory=dict)

    @property
    def total(self) -> np.ndarray:
        """Resultant contact force on the gel, (3,) N."""
        return self.forces.sum(axis=0)

    @property
    def kept_evidence(self) -> dict:
        """What of the evidence JSON can hold; numbers that are not finite are left out."""
        kept = {}
        for key, value in self.evidence.items():
            value = value.item() if isinstance(value, np.generic) else value
            try:
                json.dumps(value, allow_nan=False)
            except (TypeError, ValueError):
                continue
            kept[key] = value
        return kept
