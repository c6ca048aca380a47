"""Files of presses: the raw log, its shards, the pose table and rejections; rows are numbered by lines of the log."""

import re
from collections.abc import Iterable
from dataclasses import asdict
from difflib import get_close_matches
from pathlib import Path
from typing import TypeVar

from gelforge.errors import BadInput, printable
from gelforge.flow.files import csv_text, write_csv
from gelforge.flow.layout import command_for
from gelforge.records.press import (
    COLUMNS,
    FORCES,
    INDENTER_TABLES,
    KNOWN,
    OPTIONAL,
    POSE,
    SENSOR_TABLES,
    LoggedPress,
    PosedPress,
    PressRecord,
    RawRow,
    Rejection,
    parse,
    parse_posed,
    reject,
)
from gelforge.records.regular import read_text
from gelforge.records.table import UNITS, letters, other_separator, records, refuse_twice, write_table

P = TypeVar("P", bound=PressRecord)

NAMED = {"mm": ", in mm", "deg": ", in degrees", "n": ", in N", "nm": ", in N m"}
MOST_NOTES = 100  # rows at the top of a file among which a misplaced header is looked for
REJECTION_COLUMNS = ("file", "row", "sample_id", "column", "value", "reason", "hint")
POSED_COLUMNS = ("row", "sample_id", "sensor_id", "gel_id", "indenter", *POSE, *FORCES, "image", "stl")


def read_log(path: str | Path) -> list[RawRow]:
    """Rows of a raw log, each numbered by the line it begins at; blank lines are counted but are no rows.

    Cells are stripped, unknown columns ignored. Raises BadInput for a log without rows or sample_id, with a column
    twice, however spelt, or with a column whose name is close to that of an optional or a missing one.
    """
    return _some(_read(Path(path), KNOWN, needed=("indenter", *POSE)), path)


def read_shard(path: str | Path) -> list[RawRow]:
    """Rows of a shard that `shard_text` wrote, numbered by their lines in the log; reads a log, too."""
    return _some(_read(Path(path), (*KNOWN, "row", "fault")), path)


def shard_text(rows: list[RawRow]) -> str:
    """Rows as the text of a shard's file: their line in the log, their cells, and what is wrong with the row."""
    header = list(dict.fromkeys(name for row in rows for name in row.cells))
    columns = ["row", *header, *["fault"] * any(row.fault for row in rows)]
    return csv_text(
        columns, [{"row": row.row, **row.cells, **({"fault": row.fault} if row.fault else {})} for row in rows]
    )


def _read(
    path: Path,
    known: tuple[str, ...],
    hint: str = "a dataset needs its raw log there",
    needed: tuple[str, ...] = (),
) -> list[RawRow]:
    found = records(path, read_text(path, hint), "workflow/guide/your-data.md describes the log")
    header = _spelt([cell.strip() for cell in found[0][1]], known) if found else []
    if "sample_id" not in header:
        below = [
            at for at, cells in found[1:MOST_NOTES] if "sample_id" in _spelt([cell.strip() for cell in cells], known)
        ]
        if below:
            raise BadInput(f"{path}: its header is in line {below[0]}; remove the lines above it")
    places = _places(path, header, known)
    for name in needed:
        near = get_close_matches(name, sorted(set(header) - set(known)), 1, 0.5) if name not in places else []
        if near:
            seen = printable(near[0])[:100]
            raise BadInput(
                f"{path}: column {name} is missing, which every press needs; rename {seen!r} if it is that"
            )
    return [_row(line, cells, places, len(header)) for line, cells in found[1:]]


def _some(rows: list[RawRow], path: str | Path) -> list[RawRow]:
    if not rows:
        raise BadInput(f"{path}: holds no presses, a header and no rows; log at least one under {', '.join(COLUMNS)}")
    return rows


def _spelt(header: list[str], known: tuple[str, ...]) -> list[str]:
    """A header with known columns in our spelling: Sample_ID, X0 mm and dz-mm are recognised by their letters.

    A column in exactly our spelling takes precedence over others that are similar.
    """
    plain = (re.sub(r"[\s\-]+", "_", name.strip("\ufeff ")).lower() for name in header)
    return [like if like in known and like not in header else name for name, like in zip(header, plain, strict=True)]


def _places(path: Path, header: list[str], known: tuple[str, ...]) -> dict[str, int]:
    """Position of each known column in the header."""
    if "sample_id" not in header:
        seen = printable(", ".join(header))[:200] or "no header"
        hint = other_separator(header) or "workflow/guide/your-data.md lists the columns"
        raise BadInput(f"{path}: column sample_id is missing, so it holds no presses; seen: {seen}; {hint}")
    refuse_twice(path, header, known)
    for name in header:
        if name in known:
            continue
        plain = letters(name)
        meant = next((of for of in (*OPTIONAL, *POSE, *FORCES) if of not in header and _resembles(plain, of)), "")
        if not meant:
            continue
        unit = NAMED.get(meant.rpartition("_")[2], "")
        raise BadInput(
            f"{path}: column {printable(name)[:60]!r} is unknown; write it as {meant}{unit}, or give it another name"
        )
    return {name: header.index(name) for name in header if name in known}


def _resembles(name: str, known: str) -> bool:
    """Whether an unknown column is nearly a known one: its name without unit, with another unit, or misspelt."""
    stem = known.rpartition("_")[0]
    other = name.removeprefix(f"{stem}_")
    return bool(name) and (
        name in (known, stem, known.removesuffix("ing"))
        or (other != name and other in UNITS)
        or sorted(name) == sorted(known)
        or bool(known in OPTIONAL and get_close_matches(name, [known], 1, 0.8))
    )


def _row(line: int, cells: list[str], places: dict[str, int], columns: int) -> RawRow:
    """A record as a row; one with too few cells gets empty ones. places: of known columns, of `columns` in all."""
    whole = cells if len(cells) >= columns else [*cells, *[""] * (columns - len(cells))]
    text = {name: whole[at].strip() for name, at in places.items()}
    number, fault = text.pop("row", ""), text.pop("fault", "")
    if text and all(cell.lower() == name for name, cell in text.items()):
        fault = "second_header"
    elif len(cells) > columns:
        fault = "more_cells"
    elif len(cells) < columns:
        fault = "fewer_cells"
    return RawRow(int(number) if number.isdigit() else line, text, fault)


def write_log(path: str | Path, presses: Iterable[LoggedPress], decimals: dict[str, int] | None = None) -> None:
    """Write presses as a raw log that `read_log` and `parse` read back to the last digit.

    decimals: digits after the point by column; other columns get the shortest text that reads back exactly.
    """
    rows = [press.cells() for press in presses]
    for cells in rows:
        cells |= {name: fixed(float(cells[name]), places) for name, places in (decimals or {}).items() if cells[name]}
    write_table(path, COLUMNS, rows)


def read_presses(path: str | Path) -> list[LoggedPress]:
    """Presses of a log written by a program; a row that cannot be read raises BadInput."""
    presses = []
    for raw in read_log(path):
        press, wrong = parse(raw, str(path))
        if press is None:
            raise BadInput(str(wrong[0]))
        presses.append(press)
    return presses


def write_poses(path: str | Path, presses: Iterable[PosedPress]) -> None:
    """Write a pose table with its presses' line numbers in the log, whole or not at all."""
    write_table(path, POSED_COLUMNS, [{"row": press.row, **press.cells()} for press in presses])


def fixed(value: float, places: int) -> str:
    """A number with so many digits after the point, never a negative zero."""
    text = f"{value:.{places}f}"
    return text if float(text) else f"{0.0:.{places}f}"


def read_poses(path: str | Path) -> list[PosedPress]:
    """Presses of a pose table, numbered by lines of the log; BadInput for one that stage 10 cannot have written."""
    known, hint = (*KNOWN, "row", "stl"), f"run {command_for('poses', path)}"
    return [parse_posed(raw, str(path)) for raw in _read(Path(path), known, hint)]


def without_duplicates(presses: list[P], file: str) -> tuple[list[P], list[Rejection]]:
    """The first press of every sample_id, and a rejection of each later one."""
    first: dict[str, int] = {}
    good, wrong = [], []
    for press in presses:
        if press.sample_id in first:
            hint = f"row {first[press.sample_id]} has it and counts; give every press its own, or remove that row"
            wrong.append(reject(press, file, "sample_id", "an earlier row has the same sample_id", hint))
            continue
        first[press.sample_id] = press.row
        good.append(press)
    return good, wrong


def unknown_names(press: PressRecord, file: str, sensors: Iterable[str], indenters: Iterable[str]) -> list[Rejection]:
    """Rejections of a press whose sensor or indenter is in no table."""
    wrong = []
    for column, name, known, where in (
        ("sensor_id", press.sensor_id, list(sensors), f"no such sensor in {SENSOR_TABLES}"),
        ("indenter", press.indenter, list(indenters), f"no such indenter in {INDENTER_TABLES}"),
    ):
        if name not in known:
            near = get_close_matches(name, known, 1)
            meant = f"; did you mean {near[0]}?" if near else ""
            wrong.append(
                reject(press, file, column, where, f"add it there, or write a name that stands there{meant}")
            )
    return wrong


def write_rejections(path: str | Path, rejections: Iterable[Rejection]) -> None:
    """Write rejections as CSV, whole or not at all."""
    write_csv(path, REJECTION_COLUMNS, [asdict(r) for r in rejections])
