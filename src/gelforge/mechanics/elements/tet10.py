"""Ten-node tetrahedron as CalculiX' C3D10: displacement only, four integration points."""

from gelforge.mechanics.elements.element import FiniteElement, isoparametric
from gelforge.mechanics.elements.kernels import displacement
from gelforge.mechanics.mesh.tetmesh import GAUSS, gradients

ELEMENT = FiniteElement(
    "tet10", 10, displacement(10, points=4, width=16), isoparametric(gradients(GAUSS), parts=24.0)
)
