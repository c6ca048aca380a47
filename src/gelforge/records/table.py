"""Tables that a stage or a person wrote, read as rows of text; whatever else lies there is refused."""

import contextlib
import csv
import io
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gelforge.errors import BadInput
from gelforge.flow.files import write_csv
from gelforge.records.press import OPTIONAL
from gelforge.records.regular import read_text


def write_table(path: str | Path, columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> None:
    """Write a table, whole or not at all; optional columns only where a press has one, so that other tables stay as they were."""
    names = [*columns, *(name for name in OPTIONAL if any(row[name] for row in rows))]
    write_csv(path, names, [{name: row[name] for name in names} for row in rows])


class GrowingTable:
    """A CSV file that grows row by row: whatever happens it ends in a whole row, and without any row there is none.

    OSError where a row cannot be written; the table is closed then.
    """

    def __init__(self, path: Path, columns: Sequence[str]):
        self.path, self.count = path, 0
        self._stream = path.open("w", encoding="utf-8", newline="")
        self._whole = 0  # bytes of whole rows
        self._writer = csv.DictWriter(self._stream, columns, lineterminator="\n")
        self._writer.writeheader()

    def add(self, row: Mapping[str, Any]) -> None:
        """Write a row."""
        try:
            self._writer.writerow(row)
            self._stream.flush()
        except OSError:
            self.close()
            raise
        self._whole = os.fstat(self._stream.fileno()).st_size
        self.count += 1

    def close(self) -> None:
        """Close the file behind its last whole row."""
        with contextlib.suppress(OSError):  # what could not be written is cut off
            self._stream.close()
        if not self.path.is_file():  # a device has no rows that can be taken back
            return
        if self.count:
            os.truncate(self.path, self._whole)
        else:
            self.path.unlink()


def read_table(path: str | Path, hint: str) -> list[dict[str, str]]:
    """Rows of a CSV file by column; one that cannot be read, is empty, or has a row of another length raises BadInput."""
    return [row for _, row in numbered_rows(path, hint)]


def numbered_rows(path: str | Path, hint: str, comments: bool = False) -> list[tuple[int, dict[str, str]]]:
    """`read_table` with the number of each row's line in the file, for tables that people write: some lines may be blank.

    comments: whether a line that begins with # is blank, too.
    """
    text = list(io.StringIO(read_text(Path(path), hint), newline=""))
    if comments:
        text = ["\n" if line.startswith("#") else line for line in text]
    top = next((at for at, line in enumerate(text) if line.strip()), 0)
    lines = csv.DictReader(text[top:], restval=None, skipinitialspace=True, strict=True)
    try:
        rows = [(top + lines.line_num, row) for row in lines]
    except csv.Error as error:
        raise BadInput(f"{path}: row {top + lines.line_num}: {error}; {hint}") from error
    if not lines.fieldnames:
        raise BadInput(f"{path}: is empty, not even a header stands in it; {hint}")
    other = other_separator(lines.fieldnames)
    if other:
        raise BadInput(f"{path}: cells are separated by {other!r}; separate them by commas; {hint}")
    for at, row in rows:
        if None in row or None in row.values():
            raise BadInput(
                f"{path}: row {at} has another number of cells than the header, with commas between the cells; {hint}"
            )
    return rows


def other_separator(header: Sequence[str]) -> str:
    """What separates the cells of a table whose header was read as one cell; empty where commas do."""
    return next((mark for mark in ";\t|" if len(header) == 1 and mark in header[0]), "")


def filled_rows(path: Path, columns: Sequence[str], what: str, hint: str) -> list[tuple[int, dict[str, str]]]:
    """Rows of a table that a person wrote, with their lines' numbers; a line that begins with # is none.

    BadInput where a column, all rows or a cell of these columns lack. what: the rows are called so. hint: what to give.
    """
    rows = [
        (number, {name.strip(): cell.strip() for name, cell in row.items()})
        for number, row in numbered_rows(path, hint, comments=True)
    ]
    if not rows:
        raise BadInput(f"{path}: holds no {what}; {hint}")
    missing = [column for column in columns if column not in rows[0][1]]
    if missing:
        seen = ", ".join(rows[0][1])
        raise BadInput(f"{path}: column {missing[0]} is missing, seen: {seen}; {hint}, with commas between the cells")
    for number, row in rows:
        empty = [column for column in columns if not row[column]]
        if empty:
            raise BadInput(f"{path} line {number}: its {empty[0]} is empty; {hint}")
    return rows
