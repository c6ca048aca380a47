"""Output of a solver."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.scene import Scene
from gelforge.records.status import Status

BEYOND_CONE = 5e-3  # largest tangential force above Coulomb's limit in a valid result, over the normal force
BALANCE = 1e-6  # relative difference allowed between contact force and base reaction of a valid result


def friction_error_n(evidence: Mapping[str, Any], mu: float, error: float) -> float:
    """Error of the total force, N, where Coulomb's coefficient `mu` is off by `error`; NaN if the solve had another law.

    To first order, while the same points slip: 0 where none does. Of a straight press it is nearly 0, though its
    normal force depends a little on friction.
    """
    if mu <= 0.0 or "friction_n" not in evidence:
        return np.nan
    return float(evidence["friction_n"]) * error / mu


def moment_of_nodes(places: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Moments (n, 3) N mm of forces (n, 3) N at places (n, 3) mm, about the gel's apex.

    The apex is the middle of the gel's undeformed surface and the origin of the gel frame. places: of the deformed gel,
    on which the moments of contact and base are in balance.
    """
    return np.cross(places, forces)


class NoEquilibrium(Exception):
    """Newton's method found no equilibrium; the load stepping retries with a shorter step."""


@dataclass
class Result:
    """State at the end of the path on a gel mesh with n nodes.

    forces: (n, 3) N, contact forces ON the gel (zero off its surface).
    displacement: (n, 3) mm. Contact data stay inside the solvers.
    evidence: plain numbers and strings; the keys every method fills are
    "equilibrium_residual" (relative), "penetration_mm", "pulling_fraction" (of the normal force),
    "base_mismatch" (relative), "newton_iterations", "rounds", "seconds", "load_steps". "peak_mib" is given only by
    solvers that run as a process of their own; "slipping", "beyond_cone" and "friction_n" (`ScenePath.friction`) only
    under Coulomb's law.
    """

    status: Status
    forces: np.ndarray
    displacement: np.ndarray
    evidence: dict = field(default_factory=dict)
    mesh: GelMesh | None = None

    @property
    def total(self) -> np.ndarray:
        """Resultant contact force on the gel, (3,) N."""
        return self.forces.sum(axis=0)

    @property
    def moment(self) -> np.ndarray:
        """Moment of the contact force on the gel about its apex, (3,) N mm; 0 for a failed solve without mesh."""
        if self.mesh is None:
            return np.zeros(3)
        return moment_of_nodes(self.mesh.nodes + self.displacement, self.forces).sum(axis=0)

    @property
    def error_n(self) -> float:
        """90 % bound on the error of the total force's magnitude, N; 0 without contact, NaN if unknown."""
        return 0.0 if self.status is Status.NO_CONTACT else float(self.evidence.get("error_n", np.nan))

    @property
    def error_share(self) -> float:
        """`error_n` over the force's magnitude; 0 without contact, infinite if it is unknown or the solve failed."""
        force = float(np.linalg.norm(self.total))
        if self.status is Status.NO_CONTACT or not self.status.valid or force == 0.0 or np.isnan(self.error_n):
            return 0.0 if self.status is Status.NO_CONTACT else np.inf
        return self.error_n / force

    @property
    def kept_evidence(self) -> dict:
        """The evidence that JSON can hold; numbers that are not finite are left out."""
        kept = {}
        for key, value in self.evidence.items():
            value = value.item() if isinstance(value, np.generic) else value
            try:
                json.dumps(value, allow_nan=False)
            except (TypeError, ValueError):
                continue
            kept[key] = value
        return kept


# Gives the state at the end of the scene's path. Failure is a status with its reason, not an exception.
Solve = Callable[[Scene], Result]
