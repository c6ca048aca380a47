"""Coulomb's law of dry friction."""

import numpy as np

from gelforge.mechanics.contact.law import ContactLaw


class Coulomb(ContactLaw):
    """Points stick until the tangential traction reaches the coefficient of friction times the pressure."""

    name, sticks, slips, has_coefficient = "coulomb", True, True, True

    def slip_limit(self, depth: np.ndarray, stiffness: float) -> tuple[np.ndarray, np.ndarray]:
        """The coefficient times the pressure."""
        slope = self.coefficient * stiffness
        return slope * depth, np.full_like(depth, slope)
