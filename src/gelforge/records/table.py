"""CSV tables of stages and people as rows of text; anything else is refused."""

import contextlib
import csv
import io
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gelforge.errors import BadInput, printable
from gelforge.flow.files import write_csv
from gelforge.records.press import OPTIONAL, parse_number
from gelforge.records.regular import read_text

# Words that end a column's name as its unit, or make a row of units.
UNITS = {
    *("n", "mn", "kn", "g", "gf", "kg", "kgf", "lb", "lbf", "oz", "ozf", "newton", "newtons"),
    *("nm", "nmm", "n_m", "n_mm", "mnm", "s", "ms", "us", "ns", "sec", "seconds", "utc"),
    *("m", "mm", "um", "cm", "in", "inch", "inches", "deg", "degree", "degrees", "rad", "radians"),
}
CLOCK = r"(\d{1,3}:)?\d{1,2}:\d\d([.,]\d+)?$"


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


@dataclass(frozen=True)
class TableRows:
    """Cells of a CSV table's rows by column, and the lines in which the rows stand; hint: what to do about a wrong cell."""

    path: str | Path
    hint: str
    lines: list[int]
    rows: list[dict[str, str]]

    @classmethod
    def read(cls, path: str | Path, hint: str, needed: Sequence[str] = (), what: str = "") -> "TableRows":
        """Read a table with the columns `needed`; blank lines are allowed.

        BadInput if it cannot be read, is empty, has a row of another length, a column twice, or lacks a needed one.
        what: name of its rows where a person wrote them. Lines that begin with # are comments then, cells are stripped,
        and it must have a row, without an empty cell in a needed column.
        """
        found = records(path, read_text(Path(path), hint), hint, comments=bool(what))
        if not found:
            raise BadInput(f"{path}: is empty, without even a header; {hint}")
        header = [name.strip() for name in found[0][1]]
        if other := other_separator(header):
            raise BadInput(f"{path}: {other}; {hint}")
        refuse_twice(path, header)
        table = cls(path, hint, [at for at, _ in found[1:]], [])
        for at, cells in found[1:]:
            if len(cells) != len(header):
                raise BadInput(
                    f"{path}: row {at} has another number of cells than the header, with commas between the cells; {hint}"
                )
            table.rows.append(dict(zip(header, [cell.strip() for cell in cells] if what else cells, strict=True)))
        if missing := [column for column in needed if column not in header]:
            seen = printable(", ".join(header))[:200]
            raise BadInput(f"{path}: column {missing[0]} is missing, seen: {seen}; {hint}")
        if what and not table.rows:
            raise BadInput(f"{path}: holds no {what}; {hint}")
        for at, row in table if what else ():
            if empty := [column for column in needed if not row[column]]:
                raise BadInput(f"{path} line {at}: its {empty[0]} is empty; {hint}")
        return table

    def __iter__(self) -> Iterator[tuple[int, dict[str, str]]]:
        return zip(self.lines, self.rows, strict=True)

    def numbers(self, column: str) -> list[float]:
        """A column as numbers; BadInput names the first cell that is none."""
        found = []
        for at, row in self:
            value, cell = parse_number(row[column]), printable(row[column])[:100]
            if value is None:
                raise BadInput(
                    f"{self.path} line {at}: {column} is {cell!r}, not a number; {cure(cell) or self.hint}"
                )
            found.append(value)
        return found

    def quantity(self, name: str, units: Mapping[str, float], needed: bool) -> tuple[str, list[float]]:
        """The column NAME_UNIT of a quantity, and its values times the unit's factor; ("", []) where it is not needed."""
        header = list(self.rows[0])
        found = [(column, units[unit]) for column in header for unit in units if column.lower() == f"{name}_{unit}"]
        near = [column for column in header if not found and letters(column).partition("_")[0] == name]
        if near and not needed:
            raise BadInput(
                f"{self.path}: column {printable(near[0])[:60]!r} is not read; write it as {name}_UNIT, with a unit of {', '.join(units)}, or give it"
                " another name"
            )
        if len(found) > 1 or (needed and not found):
            raise BadInput(
                f"{self.path}: {len(found)} columns {name}_UNIT, seen: {', '.join(header)}; give one, with a unit of {', '.join(units)}"
            )
        if not found:
            return "", []
        column, factor = found[0]
        return column, [factor * value for value in self.numbers(column)]


def read_table(path: str | Path, hint: str, needed: Sequence[str] = ()) -> list[dict[str, str]]:
    """Rows of a CSV file by column, as `TableRows.read` reads them."""
    return TableRows.read(path, hint, needed).rows


def cure(cell: str) -> str:
    """What to do about a cell that is no number and no time; empty where that is not plain."""
    if re.match(CLOCK, cell):
        return "a time of day or a duration: write seconds in time_s, or date and time in time_utc, as 2026-09-01T12:00:00.000"
    if cell.strip("[]()").lower() in UNITS:
        return "a row of units: remove it; the unit is in the column's name"
    return "write a decimal point" if re.fullmatch(r"[-+]?\d*,\d+", cell) else ""


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
