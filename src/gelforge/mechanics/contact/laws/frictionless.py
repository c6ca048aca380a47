"""No friction."""

import numpy as np

from gelforge.mechanics.contact.law import ContactLaw


class Frictionless(ContactLaw):
    """Points slide freely: the indenter only presses."""

    name, sticks, slips = "frictionless", False, True

    def slip_limit(self, depth: np.ndarray, stiffness: float) -> tuple[np.ndarray, np.ndarray]:
        """Zero."""
        none = np.zeros_like(depth * stiffness)
        return none, none
