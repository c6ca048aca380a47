"""Digests of the code that each stage's results are made by: tests/stage_digests.json, written by `make format`."""

import ast
import hashlib
import json
import re
import sys
from functools import cache
from pathlib import Path

from gelforge.flow.params import SOURCES

ROOT = Path(__file__).resolve().parents[2]
CODE, TABLE = ROOT / "src", ROOT / "tests" / "stage_digests.json"
PYTHON = f"{sys.version_info.major}.{sys.version_info.minor}"  # a tree is written otherwise by another version
STAGES = sorted({of.module for of in SOURCES.values()})


def path_of(module: str) -> Path | None:
    """The file of a module; None where there is none of that name."""
    at = CODE / module.replace(".", "/")
    return next((path for path in (at.with_suffix(".py"), at / "__init__.py") if path.is_file()), None)


@cache
def tree_of(module: str) -> ast.Module:
    """The syntax tree of a module, which has no comments, without docstrings."""
    path = path_of(module)
    tree = ast.parse(path.read_bytes()) if path else ast.Module([], [])
    for node in ast.walk(tree):
        match node:
            case ast.Module() | ast.ClassDef() | ast.FunctionDef() if (
                ast.get_docstring(node, clean=False) is not None
            ):
                node.body = node.body[1:]
    return tree


def imported(tree: ast.AST) -> set[str]:
    """Names that code imports, wherever in it: modules, and what is taken from them."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def imports(module: str) -> set[str]:
    """Modules of the project that a module imports, wherever in it."""
    return {name for name in imported(tree_of(module)) if name.startswith("gelforge.") and path_of(name)}


@cache
def closure(stage: str) -> frozenset[str]:
    """All modules that a stage imports, itself and those of its imports included."""
    found, ahead = set(), [f"gelforge.stages.{stage}"]
    while ahead:
        module = ahead.pop()
        if module not in found:
            found.add(module)
            ahead += imports(module)
    return frozenset(found)


def version_of(stage: str) -> int:
    """VERSION of a stage."""
    return int(re.findall(r"^VERSION = (\d+)$", (CODE / f"gelforge/stages/{stage}.py").read_text(), re.M)[0])


def today() -> dict:
    """The table as the sources are now."""
    modules = sorted(set().union(*map(closure, STAGES)))
    digests = {name: hashlib.sha256(ast.dump(tree_of(name)).encode()).hexdigest()[:12] for name in modules}
    return {"python": PYTHON, "versions": {stage: version_of(stage) for stage in STAGES}, "modules": digests}


def kept() -> dict:
    """The table as it is kept."""
    return json.loads(TABLE.read_text(encoding="utf-8"))


def text() -> str:
    """The table's file as it should be; as it is where the digests are of another Python."""
    if kept()["python"] != PYTHON:
        return TABLE.read_text(encoding="utf-8")
    return json.dumps(today(), indent=1, sort_keys=True) + "\n"


def unsaid() -> dict[str, list[str]]:
    """Modules that changed, by each stage that uses them and whose VERSION is as before."""
    before, now = kept(), today()
    if before["python"] != PYTHON:
        return {}
    names = now["modules"].keys() | before["modules"].keys()
    changed = {name for name in names if now["modules"].get(name) != before["modules"].get(name)}
    same = [stage for stage in STAGES if now["versions"][stage] == before["versions"].get(stage)]
    return {stage: sorted(changed & closure(stage)) for stage in same if changed & closure(stage)}
