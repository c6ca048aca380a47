"""The table of stage 30: how each press was solved, one row per press.

What a solve cost stands in its record in the store, so that the same solve gives the same bytes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.layout import command_for
from gelforge.records.press import FORCES, N_M, parse_number
from gelforge.records.status import Status
from gelforge.records.table import read_table, write_table

EVIDENCE = (
    "attempt", "rounds", "newton_iterations", "load_steps", "equilibrium_residual", "base_mismatch", "penetration_mm",
    "pulling_fraction", "engine_difference", "extrapolated", "error_n", "cells_error_n", "slipping", "friction_error_n",
)  # fmt: skip
NAMES = ("sample_id", "status", "reason", "method", "mesh", "key")
COLUMNS = (*NAMES, *FORCES, *EVIDENCE)


@dataclass(frozen=True)
class Solved:
    """How one press was solved.

    total: force on the gel, (3,) N at the reference C10; moment: about its apex, (3,) N mm. key: of its record in the store of solves. evidence:
    diagnostics of the solve, cells by the names of EVIDENCE.
    """

    sample_id: str
    status: Status
    reason: str
    method: str
    mesh: str
    key: str
    total: tuple[float, float, float]
    evidence: dict[str, object]
    press_id: str = ""
    moment: tuple[float, float, float] = (math.nan, math.nan, math.nan)

    def number(self, name: str) -> float:
        """A number of the evidence, NaN if the solve gave none."""
        value = parse_number(str(self.evidence.get(name, "")))
        return math.nan if value is None else value

    def cells(self) -> dict[str, object]:
        """One row of the table."""
        row: dict[str, object] = {name: getattr(self, name) for name in NAMES} | {"status": self.status.name}
        wrench = (*self.total, *(N_M * moment for moment in self.moment))
        row |= dict(zip(FORCES, (f"{value:.6g}" for value in wrench), strict=True))
        return row | {name: self.evidence.get(name, "") for name in EVIDENCE} | {"press_id": self.press_id}


def write_solves(path: str | Path, solves: Sequence[Solved]) -> None:
    """Write the table, whole or not at all."""
    write_table(path, COLUMNS, [solve.cells() for solve in solves])


def _force(text: str) -> float | None:
    """A force of a table; a failed solve may have none."""
    return math.nan if text in ("", "nan") else parse_number(text)


def read_solves(path: str | Path) -> list[Solved]:
    """Read what `write_solves` wrote; anything else raises BadInput."""
    found, hint = [], f"delete it and run {command_for('fea', path)}"
    for at, row in enumerate(read_table(path, hint), 2):
        forces = [_force(row.get(name) or "") for name in FORCES]
        state = row.get("status") or ""
        if state not in Status.__members__ or None in forces or not row.get("sample_id"):
            raise BadInput(f"{path}: row {at} is not a solve of stage 30; {hint}")
        x, y, z, *moment = (math.nan if force is None else force for force in forces)
        mx, my, mz = (value / N_M for value in moment)
        names = {name: row.get(name) or "" for name in NAMES if name != "status"}
        evidence: dict[str, object] = {name: row.get(name) or "" for name in EVIDENCE}
        found.append(Solved(**names, status=Status[state], total=(x, y, z), evidence=evidence,
                            press_id=row.get("press_id") or "", moment=(mx, my, mz)))  # fmt: skip
    return found
