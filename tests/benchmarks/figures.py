"""Figures beside their goals, as a file and as a table."""

import operator
import os
import platform
import subprocess
from dataclasses import asdict, dataclass
from pathlib import Path

from gelforge.flow.files import write_json

# Folder of the published measurements, pictures, films and geometry that some benchmarks read.
PUBLISHED_DATA = Path(os.environ.get("GELFORGE_REFERENCE", "../shared/reference"))
COMPARE = {"": operator.eq, "<=": operator.le, ">=": operator.ge, "==": operator.eq}


@dataclass(frozen=True)
class Figure:
    """One measured number; `compare` is "<=", ">=" or "==" and `goal` what was asked for; "" of a note without a goal."""

    name: str
    value: float
    compare: str
    goal: float
    unit: str = ""
    note: str = ""

    @property
    def met(self) -> bool:
        return bool(COMPARE[self.compare](self.value, self.goal))


def machine() -> dict:
    """What the figures were measured on, without naming the machine."""
    return {"cores": os.cpu_count(), "architecture": platform.machine(), "python": platform.python_version()}


def commit() -> str:
    """The commit the working tree stands on, with `+` where it differs."""
    asked = subprocess.run(["git", "describe", "--always", "--dirty=+"], capture_output=True, text=True)
    return asked.stdout.strip() or "unknown"


def table(figures: list[Figure]) -> str:
    """The figures as aligned text, missed ones marked."""
    rows = [
        (" " if f.met else "MISSED", f.name, f"{f.value:.6g}", f"{f.compare} {f.goal:.6g}", f.unit, f.note)
        for f in figures
    ]
    rows.insert(0, ("", "figure", "measured", "goal", "unit", "note"))
    widths = [max(len(row[k]) for row in rows) for k in range(5)]
    return "\n".join(
        "  ".join([*(c.ljust(w) for c, w in zip(row[:5], widths, strict=True)), row[5]]).rstrip() for row in rows
    )


def publish_figures(path, figures: list[Figure], model: str = "", **tables: list[dict]) -> None:
    """Write the figures to `path` (JSON) and print them as a table; model: digest of the network that they are of.

    tables: what is written beside them.
    """
    as_dicts = [{**asdict(f), "value": float(f.value), "goal": float(f.goal), "met": f.met} for f in figures]
    write_json(path, {"figures": as_dicts, "commit": commit(), "machine": machine(), "model": model, **tables})
    print(table(figures), flush=True)
