"""Names of earlier versions that users have in files and scripts, with those of today; the former ones go with the next release."""

import sys
from collections.abc import Mapping
from typing import Any

from gelforge.errors import BadInput

# Former name: name of today; one table for each kind of file.
COMMANDS = {"lineage": "provenance"}  # of `gelforge`; those of make stand in rules/work.mk
COLUMNS = {"remedy": "hint", "rung": "attempt"}  # of tables of results
PROFILE = {"untouched": "nocontact"}  # of a sensor's profile
UNITS = {
    "print_shift_px": "grid_shift_px",
    "print_turn_deg": "grid_turn_deg",
    "missing_dots": "missing_markers",
    "jpeg_share": "jpeg_fraction",
}  # of workflow/rig/units.toml
APPEARANCE = {"dots": "markers"}  # tables of a sensor in workflow/rig/sensors.toml


def notice(former: str, name: str) -> str:
    """The sentence that names what a former name is called now."""
    return f"{former} is called {name} now, and will be gone in the next release"


def with_names_of_today(table: Mapping[str, Any], names: Mapping[str, str], where: str) -> dict[str, Any]:
    """A table of a user's file with each former key under its name of today; each is named on stderr.

    :param names: former name: name of today.
    :param where: file and table, for messages.
    :raises BadInput: where a table has a key under both names.
    """
    for former in names.keys() & table.keys():
        if names[former] in table:
            raise BadInput(f"{where}: {former} and {names[former]} are the same; remove {former}")
        print(f"{where}: {notice(former, names[former])}", file=sys.stderr)
    return {names.get(key, key): value for key, value in table.items()}
