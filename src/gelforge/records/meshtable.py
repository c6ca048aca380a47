"""The table of stage 20: the mesh of each press of a shard, empty where it is solved on hexahedra."""

from pathlib import Path

from gelforge.flow.layout import command_for
from gelforge.records.table import read_table

COLUMNS = ("sample_id", "mesh")


def read_meshes(path: Path) -> dict[str, str]:
    """Name of the mesh of each sample, as `mechanics.mesh.family.load_mesh` takes it."""
    rows = read_table(path, f"delete it and run {command_for('meshes', path)}")
    return {row.get("sample_id") or "": row.get("mesh") or "" for row in rows}
