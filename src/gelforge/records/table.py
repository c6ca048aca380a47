"""Tables that a stage wrote, read as rows of text; whatever else lies there is refused."""

import csv
import io
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.renamed import COLUMNS
from gelforge.records.regular import read_text


def read_table(path: str | Path, hint: str) -> list[dict[str, str]]:
    """Rows of a CSV file by column; one that cannot be read, is empty, or has a row of another length raises BadInput."""
    return [row for _, row in numbered_rows(path, hint)]


def numbered_rows(path: str | Path, hint: str) -> list[tuple[int, dict[str, str]]]:
    """`read_table` with the number of each row's line in the file, for tables that people write: some lines may be blank."""
    lines = csv.DictReader(io.StringIO(read_text(Path(path), hint), newline=""), restval=None, skipinitialspace=True)
    try:
        lines.fieldnames = [COLUMNS.get(name, name) for name in lines.fieldnames or ()]
        rows = [(lines.line_num, row) for row in lines]
    except csv.Error as error:
        raise BadInput(f"{path}: row {lines.line_num}: {error}; {hint}") from error
    if not lines.fieldnames:
        raise BadInput(f"{path}: is empty, not even a header stands in it; {hint}")
    for at, row in rows:
        if None in row or None in row.values():
            raise BadInput(
                f"{path}: row {at} has another number of cells than the header, with commas between the cells; {hint}"
            )
    return rows
