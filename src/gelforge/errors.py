"""Exceptions whose messages are for users, and safe display of foreign text in them."""

from collections.abc import Iterable
from difflib import get_close_matches


def printable(text: object) -> str:
    r"""Text with every non-printable character, such as a terminal's control codes, escaped: a newline as \n.

    Names and cells come from files of others: shown raw, a sample_id could clear the screen or forge a line.
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in str(text))


def nearest(name: str, known: Iterable[str]) -> str:
    """End of a message that refuses a name: the closest known name, if any, and all known names."""
    known = sorted(known)
    close = get_close_matches(name, known, 1)
    return f"; {f'did you mean {close[0]}? Known' if close else 'known'}: {', '.join(known)}"


def unwritable(error: OSError) -> str:
    """Message for a failed write, with a hint; the error of a full disk does not always name the file."""
    where = f"{error.filename}: " if error.filename else ""
    return f"{where}{error.strerror}; free space or permissions"


class GelforgeError(Exception):
    """The input cannot be used.

    The message names the input, what is wrong with it, and what to do; it is shown as `printable`. Commands
    print it and exit with code 2.
    """

    def __str__(self) -> str:
        return printable(super().__str__())


class BadInput(GelforgeError):
    """A file, a row, or a parameter from the user is unusable."""


class SolveFailed(GelforgeError):
    """A finite element solve ended without a valid state; carries its evidence."""

    def __init__(self, message: str, evidence: dict | None = None):
        super().__init__(message)
        self.evidence = evidence or {}
