"""How a solve ended."""

from enum import Enum


class Status(Enum):
    """How a solve ended; the value is a sentence with advice."""

    OK = "The state is in equilibrium, nothing pulls, nothing penetrates."
    NO_CONTACT = "The indenter does not reach the gel on this path; the forces are zero by geometry."
    DIVERGED = "Newton's method found no equilibrium; check depth and position, or choose another method."
    UNSETTLED = "The contact set did not settle; press less deep or choose another method."
    OUT_OF_RANGE = "The press leaves what the gel can represent; check depth and position in the log."
    TOO_COARSE = "The indenter touches the gel between the points at which contact is looked for; press deeper or choose method `label`."
    SOLVER_MISSING = "The solver program was not found; run `make setup` or choose method label."
    UNREADABLE = "The solver's output is truncated or not finite; look at its log and run again."
    DISAGREES = "CalculiX and the solver in process disagree on one equilibrium; install another CalculiX, its numbers cannot be trusted."
    UNBALANCED = "Contact forces and base reactions do not agree; the result cannot be trusted."

    @property
    def valid(self) -> bool:
        return self in (Status.OK, Status.NO_CONTACT)


# Names of the valid ones, for tables whose status column has other values, too, such as a press not yet solved.
VALID = frozenset(status.name for status in Status if status.valid)
