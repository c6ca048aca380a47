"""The store of solves: records and arrays by a key of all inputs, shared by shards, datasets and people.

KEY.json is the record of a solve, published after KEY.npz, its arrays: forces and displacements of the nodes of the
gel's surface and, for a press solved by CalculiX, what its deck is written from. A file is published whole, so several
processes may write one store.
"""

from pathlib import Path
from typing import Any

from gelforge.flow.files import digest_of, publish, record_of, write_json

COST = ("seconds", "cpu_seconds", "peak_mib")  # of a solve, in its evidence


class SolveStore:
    """Solves in one folder. Records hold `status`, `reason`, `method`, `mesh`, `total`, `evidence`, `deck`."""

    def __init__(self, folder: Path | str):
        self.folder = Path(folder)

    def arrays(self, key: str) -> Path:
        """File of a solve's arrays, which only a valid solve has."""
        return self.folder / f"{key}.npz"

    def record(self, key: str) -> dict[str, Any] | None:
        """The record of a solve; None if there is none, or if it or its arrays are not as they were written."""
        record = record_of(self.folder / f"{key}.json", key) if key else None
        if record is None or not isinstance(record.get("sha256"), str):
            return None
        path = self.arrays(key)
        whole = not record["sha256"] or (path.is_file() and digest_of(path) == record["sha256"])
        return record if whole else None

    def cost(self, key: str) -> dict[str, float]:
        """What a solve cost when it was made, by the names COST, as far as its record says."""
        found = (record_of(self.folder / f"{key}.json", key) or {}).get("evidence", {}) if key else {}
        return {name: found[name] for name in COST if name in found}

    def publish(self, key: str, record: dict[str, Any], arrays: dict[str, Any]) -> dict[str, Any]:
        """Write a solve, its record last; return the record."""
        self.folder.mkdir(parents=True, exist_ok=True)
        if arrays:
            import numpy as np  # questions about a sample start without it

            with publish(self.arrays(key)) as part:
                np.savez_compressed(part, **arrays)
        found = {**record, "key": key, "sha256": digest_of(self.arrays(key)) if arrays else ""}
        write_json(self.folder / f"{key}.json", found)
        return found
