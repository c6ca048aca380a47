"""Parameters: workflow/*.toml and a dataset's own, cut into one canonical slice per stage."""

import json
import re
import tomllib
from difflib import get_close_matches
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.schema import TOGETHER, spec_of

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


# Keys of dataset.toml beside [params].
DATASET_KEYS = {"sensor", "gel", "catalogue", "params"}
# Parameters that may be of two kinds.
MIXED = {"material.c10"}


def load_params(workflow, dataset_toml=None) -> dict:
    """Read workflow/params.toml with the [params.*] tables of a dataset laid over it.

    A table or key that params.toml does not have is refused, because a misspelt override would otherwise do nothing;
    so is a value of another kind than the one it replaces, or one that has no meaning.
    """
    file = Path(workflow) / "params.toml"
    params = read_toml(file)
    if dataset_toml:
        given = read_toml(dataset_toml)
        for key in given.keys() - DATASET_KEYS:
            raise BadInput(f"{dataset_toml}: {key} is read by nothing{nearest(key, DATASET_KEYS)}")
        overrides = given.get("params", {})
        if not isinstance(overrides, dict):
            raise BadInput(f"{dataset_toml}: params = {overrides!r}; write tables such as [params.fea]")
        overlay(params, overrides, f"{dataset_toml}: params")
    check_values(params, dataset_toml or file)
    return params


def nearest(key: str, known) -> str:
    """The end of a sentence that refuses a name: the known one nearest to it, and all of them."""
    close = get_close_matches(key, known, 1)
    return f"; {f'{close[0]} is meant? ' if close else ''}known here: {', '.join(sorted(known))}"


def overlay(base: dict, over: dict, where: str, path: str = "") -> None:
    """Lay values over parameters; one that `base` does not have, or has of another kind, is refused by its name."""
    for key, value in over.items():
        name = f"{path}.{key}" if path else key
        if key not in base:
            raise BadInput(f"{where}.{key}: no such parameter in workflow/params.toml{nearest(key, base)}")
        if isinstance(base[key], dict) and isinstance(value, dict):
            overlay(base[key], value, f"{where}.{key}", name)
        elif kind_of(value) != kind_of(base[key]) and name not in MIXED:
            raise BadInput(f"{where}.{key} = {value!r}: give {kind_of(base[key])}, such as {base[key]!r}")
        else:
            base[key] = value


def kind_of(value) -> str:
    """What a value of TOML is, in words."""
    kinds = ((bool, "true or false"), (int | float, "a number"), (str, "text"), (list, "a list"), (dict, "a table"))
    return next((words for kind, words in kinds if isinstance(value, kind)), "a time")


def check_values(params: dict, where, path: str = "") -> None:
    """Refuse values that flow.schema does not allow, alone or together with others of their table."""
    for key, value in params.items():
        name = f"{path}.{key}" if path else key
        if isinstance(value, dict):
            check_values(value, where, name)
            for table, holds, sentence in TOGETHER:
                if name == table and not holds(value):
                    raise BadInput(f"{where}: [{table}]: {sentence}")
            continue
        spec = spec_of(name)
        if spec is None:
            raise BadInput(f"{where}: {name} = {value!r}: flow/schema.py does not say what it may be; add it there")
        if fault := spec.fault(value):
            raise BadInput(f"{where}: {name} = {value!r}: {fault}")


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
