"""What holds sideways between gel and indenter: the base of all contact laws, and the laws by name."""

import pkgutil
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import ClassVar

import numpy as np

from gelforge.errors import BadInput
from gelforge.mechanics.contact import laws as package


@dataclass(frozen=True)
class ContactLaw:
    """A law of the tangential traction; along the normal the indenter only presses.

    sticks: whether points are held where they first touched. slips: whether points may move along the indenter.
    coefficient: the number of a law that has one (`has_coefficient`); it is part of the key of a solve.
    """

    name: ClassVar[str]
    sticks: ClassVar[bool]
    slips: ClassVar[bool]
    has_coefficient: ClassVar[bool] = False
    coefficient: float = 0.0

    @property
    def frictional(self) -> bool:
        """Whether points stick until they slip: a force then depends on all of a point's path, not on its end alone."""
        return self.sticks and self.slips

    def slip_limit(self, depth: np.ndarray, stiffness: float) -> tuple[np.ndarray, np.ndarray]:  # noqa: ARG002
        """Tangential traction (...) MPa at which sticking points slip, and its derivative (...) by depth, MPa/mm.

        depth: (...) mm inside the indenter; depth times stiffness, MPa/mm, is the pressure. None slip unless a law says so.
        """
        return np.full_like(depth, np.inf), np.zeros_like(depth)


class Holding(ContactLaw):
    """Stands for a law with friction in an iteration in which no sticking point may slip."""

    name, sticks, slips = "holding", True, True


@cache
def laws() -> dict[str, type[ContactLaw]]:
    """The contact laws by name: one of each module in `contact/laws`."""
    found: dict[str, type[ContactLaw]] = {}
    for _, name, _ in pkgutil.iter_modules(package.__path__, f"{package.__name__}."):
        classes = (each for each in vars(import_module(name)).values() if isinstance(each, type))
        found |= {law.name: law for law in classes if issubclass(law, ContactLaw) and law.__module__ == name}
    return found


def contact_law(name: str, coefficient: float = 0.0) -> ContactLaw:
    """The law of that name; an unknown one raises BadInput."""
    if name not in laws():
        *others, last = laws()
        raise BadInput(f"interface law {name!r} is unknown; choose {', '.join(others)} or {last}")
    law = laws()[name]
    return law(coefficient) if law.has_coefficient else law()
