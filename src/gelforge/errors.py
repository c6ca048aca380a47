"""The errors that a user of gelforge is meant to read, and how text of others is shown in them."""

from collections.abc import Iterable
from difflib import get_close_matches


def printable(text: object) -> str:
    r"""Text with every character that a terminal would obey, or not show, written as its escape: a newline as \n.

    Names and cells come from files of others: shown raw, a sample_id could clear the screen or forge a line.
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in str(text))


def nearest(name: str, known: Iterable[str]) -> str:
    """The end of a sentence that refuses a name: the known one nearest to it, and all of them."""
    known = sorted(known)
    close = get_close_matches(name, known, 1)
    return f"; {f'{close[0]} is meant? ' if close else ''}known here: {', '.join(known)}"


def unwritable(error: OSError) -> str:
    """What a disk or a folder that takes nothing says, and what to do; a full disk does not always name the file."""
    where = f"{error.filename}: " if error.filename else ""
    return f"{where}{error.strerror}; free space or permissions"


class GelforgeError(Exception):
    """What was given cannot be used.

    The message names what was given, what was seen, and what to do; it is shown as `printable`. `main`
    functions print it and exit with 2; nothing else catches it.
    """

    def __str__(self) -> str:
        return printable(super().__str__())


class BadInput(GelforgeError):
    """A file, a row, or a parameter that a user wrote is unusable."""


class SolveFailed(GelforgeError):
    """A finite element solve ended without a valid state; carries its evidence."""

    def __init__(self, message: str, evidence: dict | None = None):
        super().__init__(message)
        self.evidence = evidence or {}
