"""Versions of the programs that numbers depend on, as they are installed for this process.

Only the standard library, and no more than a look into folders, because every step of a run asks for it.
"""

import os
import sys
from collections.abc import Iterable

PROGRAMS = ("gelforge", "numpy", "scipy", "numba", "torch")


def installed(programs: Iterable[str] = PROGRAMS) -> dict[str, str]:
    """Version of each program, by its name at PyPI, that is installed; pip keeps it in the name of a folder beside it."""
    wanted = {program.replace("-", "_"): program for program in programs}
    found: dict[str, str] = {}
    for place in sys.path:
        try:
            names = os.listdir(place)
        except OSError:
            continue
        for name in names:
            program, _, version = name.removesuffix(".dist-info").partition("-")
            if name.endswith(".dist-info") and program in wanted:
                found.setdefault(wanted[program], version)
    return found
