"""Parameters: workflow/*.toml and a dataset's own, cut into one canonical slice per stage."""

import json
import re
import tomllib
from pathlib import Path

from gelforge.errors import BadInput

# What of params.toml each stage reads. A dotted name is one key of a table. make rebuilds a stage
# when its slice changes and for no other change of the file.
SLICES = {
    "poses": ["poses"],
    "meshes": ["meshes"],
    "fea": ["fea", "interface", "material.nu"],
    "forces": ["forces", "material"],
    "labels": ["labels"],
    "dataset": ["dataset"],
    "train": ["train"],
    "evaluate": ["evaluate"],
    "report": ["report"],
    "calibrate": ["calibrate", "material.nu"],
    "pareto": ["pareto", "fea", "meshes", "material.nu"],
    "pareto_meshes": ["pareto.regions", "pareto.grading", "meshes"],
    "stability": ["stability", "fea", "meshes"],
}


def read_toml(path) -> dict:
    """Read a TOML file; a syntax error names file and place."""
    path = Path(path)
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise BadInput(f"{path}: not found; see README.md for what a dataset and workflow/ must hold") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: not valid TOML: {error}") from error


def load_params(workflow, dataset_toml=None) -> dict:
    """Read workflow/params.toml with the [params.*] tables of a dataset laid over it.

    A table or key that params.toml does not have is refused, because a misspelt override
    would otherwise do nothing.
    """
    params = read_toml(Path(workflow) / "params.toml")
    overrides = read_toml(dataset_toml).get("params", {}) if dataset_toml else {}
    overlay(params, overrides, f"{dataset_toml}: params")
    return params


def overlay(base: dict, over: dict, where: str) -> None:
    """Lay values over parameters; one that `base` does not have is refused, as `where` names it."""
    for key, value in over.items():
        if key not in base:
            known = ", ".join(sorted(base))
            raise BadInput(f"{where}.{key}: no such parameter in workflow/params.toml; known here: {known}")
        if isinstance(base[key], dict) and isinstance(value, dict):
            overlay(base[key], value, f"{where}.{key}")
        else:
            base[key] = value


def stage_version(source, stage: str) -> int:
    """Return VERSION of a stage's module, read as text so that nothing heavy is imported."""
    path = Path(source) / f"{stage}.py"
    found = re.search(r"^VERSION = (\d+)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    if not found:
        raise BadInput(f"{path}: has no line `VERSION = n`; a stage needs one, raised when its results change")
    return int(found.group(1))


def cut_slice(params: dict, stage: str, version: int) -> dict:
    """Return what `stage` reads of `params`, with its module's version."""
    cut = {"version": version}
    for name in SLICES[stage]:
        table, _, key = name.partition(".")
        if table not in params:
            raise BadInput(f"workflow/params.toml: table [{table}] is missing; stage {stage} reads it")
        if key and key not in params[table]:
            raise BadInput(f"workflow/params.toml: {name} is missing; stage {stage} reads it")
        if key:
            cut.setdefault(table, {})[key] = params[table][key]
        else:
            cut[table] = params[table]
    return cut


def canonical(value) -> str:
    """One text per value: sorted keys, no comments, exact floats."""
    return json.dumps(value, indent=1, sort_keys=True, ensure_ascii=False) + "\n"
