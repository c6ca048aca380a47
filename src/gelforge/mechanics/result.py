"""What a solver answers."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.scene import Scene
from gelforge.records.status import Status

BALANCE = 1e-6  # of its size, by which the contact force of a valid result may differ from the base's reaction


class NoEquilibrium(Exception):
    """Newton's method stopped without a state; the load stepping answers with a shorter step."""


@dataclass
class Result:
    """State at the end of the path on a gel mesh with n nodes.

    forces: (n, 3) N, contact forces ON the gel (zero off its surface).
    displacement: (n, 3) mm. Contact data stay inside the solvers.
    evidence: plain numbers and strings; the keys every method fills are
    "equilibrium_residual" (relative), "penetration_mm", "pulling_fraction" (of the normal force),
    "base_mismatch" (relative), "newton_iterations", "rounds", "seconds", "load_steps". "peak_mib" is that of
    a solver which is a process of its own; presses that are solved in one process have no peaks of their own.
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
    def error_n(self) -> float:
        """By how much the size of the total force may be off, N: nine of ten are within it; NaN where nothing says so."""
        return 0.0 if self.status is Status.NO_CONTACT else float(self.evidence.get("error_n", np.nan))

    @property
    def error_share(self) -> float:
        """`error_n` over the size of the force; 0 where nothing touches, infinite where nothing was solved or said."""
        force = float(np.linalg.norm(self.total))
        if self.status is Status.NO_CONTACT or not self.status.valid or force == 0.0 or np.isnan(self.error_n):
            return 0.0 if self.status is Status.NO_CONTACT else np.inf
        return self.error_n / force

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


# State at the end of the scene's path. Failure is a status with its reason, not an exception.
Solve = Callable[[Scene], Result]
