"""Reader of nodal tables in CalculiX' .dat files; incomplete or non-finite tables are refused by name."""

import re
from dataclasses import dataclass

import numpy as np

_HEAD = re.compile(r"^ *(\S[^\n]*?) \([^)\n]*\) for set (\S+) and time +(\S+) *$", re.MULTILINE)
_SHORT_EXPONENT = re.compile(r"(\d)([+-]\d{3})(?=\s|$)")  # Fortran drops the E of three-digit exponents


class DatError(Exception):
    """A .dat file without the output that the deck asked for; the message names the table."""


class Unfinished(DatError):
    """The job printed nothing or stopped before the end of its step: CalculiX found no equilibrium."""


@dataclass(frozen=True)
class Table:
    """One printed table: quantity ("displacements", "forces"), set name, time, node ids (n,), values (n, 3)."""

    quantity: str
    set_name: str
    time: float
    nodes: np.ndarray
    values: np.ndarray


def read_dat(text: str) -> list[Table]:
    """All nodal tables of a .dat file in order. A truncated row or a non-number raises DatError."""
    heads = list(_HEAD.finditer(text))
    ends = [head.start() for head in heads[1:]] + [len(text)] * bool(heads)
    return [_table(head, text[head.end() : end]) for head, end in zip(heads, ends, strict=True)]


def _table(head: re.Match[str], body: str) -> Table:
    quantity, set_name = head[1].strip(), head[2]
    words = _SHORT_EXPONENT.sub(r"\1E\2", body).split()
    where = f"table `{quantity}` of set {set_name} at time {head[3]}"
    touching = next((word for word in words if word.count(".") > 1), None)
    if touching:
        raise DatError(
            f"{where} has no space between two columns ({touching}): the output of this build of CalculiX cannot be read"
        )
    # without a final newline, the last number may lack its exponent and be misread
    if len(words) % 4 or not body.endswith("\n"):
        raise DatError(f"{where} ends inside a row: the file is truncated")
    try:
        rows = np.array(words, dtype=float).reshape(-1, 4)
        time = float(head[3])
    except ValueError as error:
        raise DatError(f"{where} holds a value that is not a number ({error})") from error
    return Table(quantity, set_name, time, rows[:, 0].astype(np.int64), rows[:, 1:])


def last_table(tables: list[Table], quantity: str, set_name: str, nodes: np.ndarray, time: float = 1.0) -> np.ndarray:
    """Values (n, 3) of the last table of `quantity` for `set_name`, in the order of `nodes` (n,), one-based.

    Decks with several increments or steps print one table each; only the one at `time` is the
    result. A job that stopped early raises Unfinished; missing rows or non-finite values raise DatError.
    """
    found = [t for t in tables if t.quantity == quantity and t.set_name == set_name]
    where = f"table `{quantity}` of set {set_name}"
    if not found:
        raise Unfinished(f"{where} is not in the file: the job printed nothing, its log says why")
    table = found[-1]
    if abs(table.time - time) > 1e-6:
        raise Unfinished(f"{where} ends at time {table.time:g} of {time:g}: the job stopped early")
    order = np.argsort(table.nodes, kind="stable")
    at = np.searchsorted(table.nodes[order], nodes)
    if len(table.nodes) != len(nodes) or not np.array_equal(table.nodes[order][at.clip(max=len(order) - 1)], nodes):
        raise DatError(
            f"{where} has {len(table.nodes)} rows where {len(nodes)} nodes were asked for:"
            " the file is truncated or belongs to another mesh"
        )
    values = table.values[order][at]
    if not np.isfinite(values).all():
        bad = int(nodes[np.flatnonzero(~np.isfinite(values).all(axis=1))[0]])
        raise DatError(f"{where} is not finite at node {bad}")
    return values
