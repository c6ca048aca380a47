"""Contact iterations where a path that was followed on another mesh arrives: what pulls is released, what presses sticks."""

from typing import Protocol

import numpy as np

from gelforge.mechanics.pose import Pose


class Arrival(Protocol):
    """A path at its end; masks and places are of its contact points, (...) and (..., 3)."""

    rounds: int

    @property
    def sticking(self) -> np.ndarray:
        """Points that stick (...), bool."""

    def equilibrate(self, pose: Pose) -> None:
        """Find the equilibrium with the present stick points, roughly; raises NoEquilibrium."""

    def touching(self) -> np.ndarray:
        """Points (...) that press and do not stick, bool."""

    def release(self, pose: Pose) -> int:
        """Release the points that pull; how many."""

    def stick(self, points: np.ndarray, places: np.ndarray, pose: Pose) -> None:
        """Let points (...) of bool stick to places (..., 3) of the indenter's frame."""


def iterate_arrival(path: Arrival, places: np.ndarray, pose: Pose, most: int) -> bool:
    """Change each point's contact at most once either way until nothing pulls and all that presses sticks; whether that is so.

    places: (..., 3) where points stick, in the indenter's frame. most: rounds. A point that was released and presses again
    stays loose: it would change for ever.
    """
    stuck = path.sticking.copy()
    for _ in range(most):
        path.rounds += 1
        path.equilibrate(pose)
        new = path.touching() & ~stuck
        stuck |= new
        released = path.release(pose)
        path.stick(new, places, pose)
        if not released and not new.any():
            return True
    return False
