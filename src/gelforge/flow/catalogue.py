"""Catalogues of indenters as tables, with what the files that they name hold; without the shapes themselves."""

from pathlib import Path

from gelforge.flow.files import digest_of


def with_content(indenters: dict, folder: Path) -> tuple[dict, list[Path]]:
    """Tables of indenters with a digest of each STL file they name, and these files, those too that are not there yet.

    A file that changes under its name is another shape: all that follows depends on what is in it.
    """
    found, files = {}, []
    for name, table in indenters.items():
        file = table.get("file") if isinstance(table, dict) and table.get("kind") == "stl" else None
        path = folder / file if isinstance(file, str) else None
        if path is not None:
            files.append(path)
        if path is not None and path.is_file():
            table = {**table, "sha256": digest_of(path)}
        found[name] = table
    return found, files
