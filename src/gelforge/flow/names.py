"""Words of TOML files that rules must know while make reads them: `python names.py workflow`, one KIND:WORD a line.

Only the standard library and no other module: make runs it each time it starts.
"""

import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

WORD = re.compile(r"[a-z0-9_]+")  # of a network; the plan refuses another name


def tables(path: Path) -> dict[str, Any]:
    """Tables of a TOML file; ValueError names it."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path}: not valid TOML: {error}") from error


def words(workflow: Path) -> Iterator[str]:
    """Lines KIND:WORD, read:all first.

    network: all networks. tuned: those that start from the shipped network. beside: those that read a no-contact image.
    shape: files of indenters' shapes.
    """
    yield "read:all"
    for name, table in tables(workflow / "models.toml").items():
        if WORD.fullmatch(name) and isinstance(table, dict):
            yield f"network:{name}"
            if "start" in table:
                yield f"tuned:{name}"
            if table.get("reads", "image") != "image":
                yield f"beside:{name}"
    for table in tables(workflow / "indenters.toml").values():
        file = table.get("file") if isinstance(table, dict) else None
        if isinstance(file, str) and len(file.split()) == 1:
            yield f"shape:{workflow / file}"


if __name__ == "__main__":
    try:
        print("\n".join(words(Path(sys.argv[1]))))
    except (OSError, ValueError) as error:
        sys.exit(f"error: {error}")
