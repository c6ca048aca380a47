"""Figures beside their goals, as a file and as a table."""

import ast
import hashlib
import operator
import os
import platform
import subprocess
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from gelforge.flow.files import read_json, write_json

ROOT = Path(__file__).resolve().parents[2]

# Folder of the published measurements, pictures, films and geometry that some benchmarks read.
PUBLISHED_DATA = Path(os.environ.get("GELFORGE_REFERENCE", "../shared/reference"))
COMPARE = {"": lambda _value, _goal: True, "<=": operator.le, ">=": operator.ge, "==": operator.eq}


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


def machine() -> str:
    """What the figures were measured on: cores and model of the processor."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    model = next((line.split(": ", 1)[1] for line in lines if line.startswith("model name")), platform.machine())
    return f"{os.cpu_count()} cores, {model}"


def commit() -> str:
    """The commit the working tree stands on, with `+` where it differs."""
    asked = subprocess.run(["git", "describe", "--always", "--dirty=+"], capture_output=True, text=True)
    return asked.stdout.strip() or "unknown"


def table(figures: list[Figure]) -> str:
    """The figures as aligned text, missed ones marked."""
    rows = [
        (
            " " if f.met else "MISSED",
            f.name,
            f"{f.value:.6g}",
            f"{f.compare} {f.goal:.6g}" if f.compare else "",
            f.unit,
            f.note,
        )
        for f in figures
    ]
    rows.insert(0, ("", "figure", "measured", "goal", "unit", "note"))
    widths = [max(len(row[k]) for row in rows) for k in range(5)]
    return "\n".join(
        "  ".join([*(c.ljust(w) for c, w in zip(row[:5], widths, strict=True)), row[5]]).rstrip() for row in rows
    )


def sources(module: Path) -> list[Path]:
    """Files of gelforge and tests that a module imports, wherever in it, and those that these import; itself among them."""
    found, left = {module}, [module]
    while left:
        path = left.pop()
        named: set[str] = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                named |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                named |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        for name in named:
            place = Path(*name.split("."))
            for base in (ROOT / "src" / place, ROOT / place):
                new = {base.with_suffix(".py"), base / "__init__.py"} - found
                left += [one for one in new if one.exists()]
                found |= {one for one in new if one.exists()}
    return sorted(found)


def digest_of_sources(name: str) -> str:
    """Digest of what benchmark `name` imports of this repository, and of the parameters; empty for another name."""
    module = ROOT / "tests" / "benchmarks" / f"{name}.py"
    if not module.exists():
        return ""
    files = [*sources(module), *sorted((ROOT / "workflow").glob("*.toml"))]
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in files)).hexdigest()[:16]


def publish_figures(path, figures: list[Figure], model: str = "", **tables: Any) -> None:
    """Write the figures to `path` (NAME.json) and print them as a table; model: digest of the network that they are of.

    Figures of other parts that were measured before stay, each with the date, commit, machine and sources that it is of;
    those of another network go. tables: what is written beside them.
    """
    print(table(figures), flush=True)
    if path is None:
        return
    run = {"measured": datetime.now(UTC).date().isoformat(), "commit": commit(), "machine": machine(),
           "sources": digest_of_sources(Path(path).stem)}  # fmt: skip
    own = [{**asdict(f), "value": float(f.value), "goal": float(f.goal), "met": f.met, **run} for f in figures]
    before = read_json(path) if Path(path).exists() else {}
    names = {f.name for f in figures}
    kept = [f for f in before.get("figures", []) if f["name"] not in names and before.get("model", "") == model]
    write_json(path, {"figures": [*kept, *own], "model": model, **tables})
