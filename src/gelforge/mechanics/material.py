"""The gel's material."""

from dataclasses import dataclass

REFERENCE_C10 = 0.0725  # MPa, in every solve: forces are proportional to C10 at fixed Poisson's ratio


@dataclass(frozen=True)
class Material:
    """Neo-Hookean solid, W = C10 (I1bar - 3) + (J - 1)^2 / D1 (CalculiX manual, *HYPERELASTIC).

    nu is Poisson's ratio at small strain. C10 is REFERENCE_C10 in every solve: forces are proportional to it, so the
    C10 of a particular gel is one factor on the solved forces.
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
