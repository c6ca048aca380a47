"""The one interface to everything that solves a scene."""

from collections.abc import Callable

from gelforge.mechanics.result import Result
from gelforge.mechanics.scene import Scene

# State at the end of the scene's path. Failure is a status with its reason, not an exception.
Solve = Callable[[Scene], Result]
