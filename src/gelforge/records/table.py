"""CSV tables of stages and people as rows of text; anything else is refused."""

import contextlib
import csv
import io
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gelforge.errors import BadInput, printable
from gelforge.flow.files import write_csv
from gelforge.records.press import OPTIONAL
from gelforge.records.regular import read_text


def write_table(path: str | Path, columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> None:
    """Write a table, whole or not at all; OPTIONAL columns only if a row has a value in them."""
    filled = [name for name in OPTIONAL if any(row.get(name) for row in rows)]
    cells = [
        {**{name: row[name] for name in columns}, **{name: row.get(name, "") for name in filled}} for row in rows
    ]
    write_csv(path, [*columns, *filled], cells)


class GrowingTable:
    """A CSV file that grows row by row; after `close` it ends with a complete row, and without rows it is removed.

    OSError if a row cannot be written; the table is then closed.
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
        """Close the file after its last complete row."""
        with contextlib.suppress(OSError):  # an incomplete row is cut off below
            self._stream.close()
        if not self.path.is_file():  # a device cannot be truncated
            return
        if self.count:
            os.truncate(self.path, self._whole)
        else:
            self.path.unlink()


def read_table(path: str | Path, hint: str) -> list[dict[str, str]]:
    """Rows of a CSV file by column; BadInput if it cannot be read, is empty, or has a row of another length."""
    return [row for _, row in numbered_rows(path, hint)]


def numbered_rows(path: str | Path, hint: str, comments: bool = False) -> list[tuple[int, dict[str, str]]]:
    """`read_table` with each row's line number, for tables that people write; blank lines are allowed.

    comments: whether lines that begin with # count as blank.
    """
    found = records(path, read_text(Path(path), hint), hint, comments)
    if not found:
        raise BadInput(f"{path}: is empty, without even a header; {hint}")
    header = [name.strip() for name in found[0][1]]
    if other := other_separator(header):
        raise BadInput(f"{path}: {other}; {hint}")
    refuse_twice(path, header)
    for at, cells in found[1:]:
        if len(cells) != len(header):
            raise BadInput(
                f"{path}: row {at} has another number of cells than the header, with commas between the cells; {hint}"
            )
    return [(at, dict(zip(header, cells, strict=True))) for at, cells in found[1:]]


def records(path: str | Path, text: str, hint: str, comments: bool = False) -> list[tuple[int, list[str]]]:
    """Line and cells of each record of a CSV file, blank lines skipped.

    BadInput if it is not strict CSV, or if a quoted cell goes on in the next line: as a rule a lone quotation mark, which
    swallows the rows up to the next one. comments: whether lines that begin with # count as blank.
    """
    lines = ("\n" if comments and line.startswith("#") else line for line in io.StringIO(text, newline=""))
    reader, found, at = csv.reader(lines, skipinitialspace=True, strict=True), [], 1
    try:
        for cells in reader:
            if reader.line_num > at:
                raise csv.Error(f"a quotation mark opens a cell that ends in line {reader.line_num}")
            found += [(at, cells)] if cells else []
            at = reader.line_num + 1
    except csv.Error as error:
        raise BadInput(
            f"{path}: row {at}: {error}; close each quotation mark that opens a cell, double those within it, and quote cells that hold"
            f" a comma; {hint}"
        ) from error
    return found


def letters(name: str) -> str:
    """A column's name by its letters and digits alone: Fz [N], FZ-N and fz_n are one name."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


def refuse_twice(path: str | Path, header: Sequence[str], names: Sequence[str] = ()) -> None:
    """BadInput if a column occurs twice in a header, by its `letters`. names: of the columns that count, all if empty."""
    plain = [letters(name) for name in header]
    for name in names or header:
        same = [one for one, like in zip(header, plain, strict=True) if like and like == letters(name)]
        if len(same) > 1:
            spelt = f" ({printable(', '.join(same))[:100]})" if len(set(same)) > 1 else ""
            raise BadInput(
                f"{path}: column {printable(name)[:60]} occurs {len(same)} times in the header{spelt}; keep one of them"
            )


def other_separator(header: Sequence[str]) -> str:
    """What to do about another separator than a comma, in a header that was read as one cell; empty if there is none."""
    mark = next((mark for mark in ";\t|" if len(header) == 1 and mark in header[0]), "")
    return mark and f"cells are separated by {mark!r}; separate them by commas, and write decimals with a point"


def filled_rows(path: Path, columns: Sequence[str], what: str, hint: str) -> list[tuple[int, dict[str, str]]]:
    """Rows of a table that a person wrote, with their line numbers; lines that begin with # are comments.

    BadInput if there are no rows, or if a column or a cell in it is missing. what: name of the rows in messages.
    hint: what to provide.
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
