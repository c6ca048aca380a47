"""Catalogues of indenters as tables, with what the files that they name hold; without the shapes themselves."""

from pathlib import Path

from gelforge.flow.files import digest_of


def stl_files(indenters: dict, folder: Path) -> dict[str, Path]:
    """STL files that tables of indenters name, by the table's name, those too that are not there yet."""
    named = {
        name: table.get("file")
        for name, table in indenters.items()
        if isinstance(table, dict) and table.get("kind") == "stl"
    }
    return {name: folder / file for name, file in named.items() if isinstance(file, str)}


def with_content(indenters: dict, folder: Path) -> dict:
    """Tables of indenters with a digest of each STL file that they name.

    A file that changes under its name is another shape: all that follows depends on what is in it.
    """
    digests = {name: digest_of(path) for name, path in stl_files(indenters, folder).items() if path.is_file()}
    return {
        name: {**table, "sha256": digests[name]} if name in digests else table for name, table in indenters.items()
    }
