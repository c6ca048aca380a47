"""Measured figures with their goals, as a file and as a table."""

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

from gelforge.errors import BadInput
from gelforge.flow.files import read_json, write_json

ROOT = Path(__file__).resolve().parents[2]

# Folder of the published measurements, images, films and geometry that some benchmarks read.
PUBLISHED_DATA = Path(os.environ.get("GELFORGE_REFERENCE", "../shared/reference"))
MOST_NAMED = 5  # changed files in a message
COMPARE = {"": lambda _value, _goal: True, "<=": operator.le, ">=": operator.ge, "==": operator.eq}


@dataclass(frozen=True)
class Figure:
    """One measured number. compare: "<=", ">=", "==", or "" if there is no goal. goal: the required value."""

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
    """The machine of the measurement: cores and model of the processor."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    model = next((line.split(": ", 1)[1] for line in lines if line.startswith("model name")), platform.machine())
    return f"{os.cpu_count()} cores, {model}"


def changed() -> list[str]:
    """Files that differ from the commit, without results of benchmarks: one run after another changes those."""
    asked = ["git", "status", "--porcelain", "--", ":/", ":!/results/benchmarks"]
    return [line[3:] for line in subprocess.run(asked, cwd=ROOT, capture_output=True, text=True).stdout.splitlines()]


def commit() -> str:
    """The commit of the working tree, with `+` if the tree differs from it."""
    asked = subprocess.run(["git", "describe", "--always"], cwd=ROOT, capture_output=True, text=True)
    return (asked.stdout.strip() or "unknown") + "+" * bool(changed())


def refuse_changes(words: list[str]) -> None:
    """Refuse to measure on a tree with changes if a benchmark's command line writes figures that stay in the repository.

    Such figures are those of a commit. Raises BadInput.
    """
    outs = [words[at + 1] for at, word in enumerate(words[:-1]) if word == "--out"]
    outs += [word.removeprefix("--out=") for word in words if word.startswith("--out=")]
    kept, differ = ROOT / "results" / "benchmarks", changed()
    if differ and any(Path(out).resolve().parent == kept for out in outs):
        named = ", ".join(differ[:MOST_NAMED]) + f" and {len(differ) - MOST_NAMED} more" * bool(differ[MOST_NAMED:])
        raise BadInput(
            f"the working tree differs from its commit ({named}); commit or stash that, or give another --out, because "
            f"figures in {kept.relative_to(ROOT)} are those of a commit"
        )


def table(figures: list[Figure]) -> str:
    """The figures as aligned text; those that miss their goal are marked."""
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
    """Files of gelforge and tests that a module imports, directly or indirectly, and the module itself."""
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
    """Digest of the files of this repository that benchmark `name` imports, and of the parameters; else empty."""
    module = ROOT / "tests" / "benchmarks" / f"{name}.py"
    if not module.exists():
        return ""
    files = [*sources(module), *sorted((ROOT / "workflow").glob("*.toml"))]
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in files)).hexdigest()[:16]


def publish_figures(path, figures: list[Figure], model: str = "", **tables: Any) -> None:
    """Write the figures to `path` (NAME.json) and print them as a table. model: digest of the measured network.

    Earlier figures of other names stay, each with its own date, commit, machine and sources; those of another network
    are removed. tables: further entries of the file.
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
