"""Contact laws, which limit the tangential traction between gel and indenter, by name."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gelforge.errors import BadInput


@dataclass(frozen=True)
class ContactLaw:
    """A law of the tangential traction; along the normal the indenter can push but not pull.

    sticks: whether points stick where they first touched. slips: whether points may move along the indenter.
    coefficient: of friction, for laws with `has_coefficient`; it is part of the key of a solve.
    """

    name: ClassVar[str]
    sticks: ClassVar[bool]
    slips: ClassVar[bool]
    has_coefficient: ClassVar[bool] = False
    coefficient: float = 0.0

    @property
    def frictional(self) -> bool:
        """Whether points stick and may slip: the force then depends on a point's whole path, not on its end alone."""
        return self.sticks and self.slips

    def slip_limit(self, depth: np.ndarray, stiffness: float) -> tuple[np.ndarray, np.ndarray]:  # noqa: ARG002
        """Tangential traction (...) MPa at which sticking points slip, and its derivative (...) by depth, MPa/mm.

        depth: (...) mm inside the indenter; depth times stiffness, MPa/mm, is the pressure. By default the limit is
        infinite.
        """
        return np.full_like(depth, np.inf), np.zeros_like(depth)


class Holding(ContactLaw):
    """Replaces a law with friction in Newton iterations in which no sticking point may slip."""

    name, sticks, slips = "holding", True, True


class Coulomb(ContactLaw):
    """Dry friction: points slip once the tangential traction reaches the friction coefficient times the pressure."""

    name, sticks, slips, has_coefficient = "coulomb", True, True, True

    def slip_limit(self, depth: np.ndarray, stiffness: float) -> tuple[np.ndarray, np.ndarray]:
        """The coefficient times the pressure."""
        slope = self.coefficient * stiffness
        return slope * depth, np.full_like(depth, slope)


class Frictionless(ContactLaw):
    """Points slide freely: no tangential traction."""

    name, sticks, slips = "frictionless", False, True

    def slip_limit(self, depth: np.ndarray, stiffness: float) -> tuple[np.ndarray, np.ndarray]:
        """Zero."""
        none = np.zeros_like(depth * stiffness)
        return none, none


class NoSlip(ContactLaw):
    """Each point sticks where it first touched until it is pulled off (assumption of the FEATS paper)."""

    name, sticks, slips = "no_slip", True, False


LAWS: dict[str, type[ContactLaw]] = {law.name: law for law in (Coulomb, Frictionless, NoSlip)}


def contact_law(name: str, coefficient: float = 0.0) -> ContactLaw:
    """Return the law of that name; an unknown name raises BadInput."""
    if name not in LAWS:
        *others, last = LAWS
        raise BadInput(f"interface law {name!r} is unknown; choose {', '.join(others)} or {last}")
    law = LAWS[name]
    return law(coefficient) if law.has_coefficient else law()
