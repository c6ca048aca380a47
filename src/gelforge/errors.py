"""The errors that a user of gelforge is meant to read."""


class GelforgeError(Exception):
    """What was given cannot be used.

    The message names what was given, what was seen, and what to do. `main` functions
    print it and exit with 2; nothing else catches it.
    """


class BadInput(GelforgeError):
    """A file, a row, or a parameter that a user wrote is unusable."""


class SolveFailed(GelforgeError):
    """A finite element solve ended without a valid state; carries its evidence."""

    def __init__(self, message: str, evidence: dict | None = None):
        super().__init__(message)
        self.evidence = evidence or {}
