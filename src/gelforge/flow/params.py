"""Parameters: workflow/params.toml, overridden by a dataset's values and frozen calibration, and each stage's part.

make runs a stage again when its own parameter file changes, and for no other change of workflow/params.toml. Keys of
solves are digests of the content of these files, so a value is written as it was given: 2 stays 2, and 2.0 stays 2.0.
"""

import hashlib
import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from gelforge.errors import BadInput, nearest
from gelforge.flow.files import digest_of, read_json, read_toml, write_text
from gelforge.flow.layout import STAGES
from gelforge.flow.schema import Place, altered, parse, plain, structured
from gelforge.flow.tables import Params

__all__ = ["Params", "altered", "plain", "read_toml"]  # imported from here, too


def load_params(workflow: Path | str, dataset_toml: Path | str | None = None) -> Params:
    """Read workflow/params.toml, overridden by the [params.*] tables of a dataset and its frozen calibration.

    BadInput is raised for an unknown table or key, a value of another type, a number out of its bounds or not finite,
    a word that is none of the choices, and values that contradict each other.
    """
    given = with_frozen(read_dataset_file(dataset_toml).params, Path(dataset_toml)) if dataset_toml else {}
    params = overlaid(workflow, given, str(dataset_toml or ""))
    if dataset_toml:
        check_law(params.interface.law, Path(dataset_toml))
    return params


def overlaid(workflow: Path | str, given: dict[str, Any], where: str) -> Params:
    """Parameters overridden by the tables `given` of the file `where`; an error names the file that caused it."""
    file = Path(workflow) / "params.toml"
    base = read_toml(file)
    params = parse(Params, base, Place(str(file)))
    return parse(Params, laid_over(base, given), Place(where, ("params",))) if given else params


def laid_over(base: Any, over: Any) -> Any:
    """A table with its values overridden by those of another one, table by table."""
    if not isinstance(base, dict) or not isinstance(over, dict):
        return over
    return base | {key: laid_over(base.get(key), value) for key, value in over.items()}


def read_sensor_tables(workflow: Path | str, data: Path | str) -> dict[str, Any]:
    """Tables of workflow/sensors.toml, and those of data/DATASET/sensors.toml if a dataset brings sensors of its own.

    A sensor that both files define raises BadInput.
    """
    common = Path(workflow) / "sensors.toml"
    tables = read_toml(common)
    return tables | own_tables(Path(data) / "sensors.toml", tables, common)


def read_indenter_tables(workflow: Path | str, data: Path | str, catalogue: str) -> dict[str, Any]:
    """Tables of the dataset's catalogue in workflow/, and of data/DATASET/indenters.toml if a dataset brings its own.

    Each file gives the paths of STL files relative to itself; those returned are all relative to workflow/.
    """
    common, own = Path(workflow) / catalogue, Path(data) / "indenters.toml"
    hint = (
        f"catalogues lie in {workflow}/; indenters of this dataset alone go into {own}, which needs no `catalogue =`"
    )
    tables = read_toml(common, hint)
    brought = own_tables(own, tables, common)
    for table in brought.values():
        if isinstance(table, dict) and isinstance(table.get("file"), str):
            table["file"] = os.path.relpath(own.parent / table["file"], workflow)
    return tables | brought


def own_tables(own: Path, tables: dict[str, Any], common: Path) -> dict[str, Any]:
    """Tables of a dataset's own file, none if it does not exist; a name that `tables` has as well raises BadInput."""
    brought = read_toml(own) if own.exists() else {}
    twice = sorted(set(tables) & set(brought))
    if twice:
        raise BadInput(f"{own}: {common} also defines {', '.join(twice)}; keep each table in one of the two files")
    return brought


@dataclass(frozen=True)
class DatasetFile:
    """data/DATASET/dataset.toml.

    sensor: of rows of the log that name none. gel: on which all presses were made; the sensors' tables say the same,
    or its thickness. catalogue: the indenters' file in workflow/. params: tables that override workflow/params.toml.
    """

    sensor: str | None
    gel: str | None
    catalogue: str
    params: dict[str, Any]


DATASET_KINDS = {"sensor": str, "gel": str, "catalogue": str, "params": dict}


def read_dataset_file(path: Path | str) -> DatasetFile:
    """Read data/DATASET/dataset.toml; an unknown key, or a value of another type, raises BadInput."""
    given = read_toml(path)
    for key, value in given.items():
        if key not in DATASET_KINDS:
            tables = {field.name for field in fields(Params)}
            hint = f"; write [params.{key}]" if key in tables else nearest(key, DATASET_KINDS)
            raise BadInput(f"{path}: {key} is unknown{hint}")
        if not isinstance(value, DATASET_KINDS[key]):
            what = "text" if DATASET_KINDS[key] is str else "tables such as [params.fea]"
            raise BadInput(f"{path}: {key} = {value!r}: give {what}")
    catalogue = given.get("catalogue", "indenters.toml")
    if Path(catalogue).is_absolute() or ".." in Path(catalogue).parts or not catalogue.endswith(".toml"):
        raise BadInput(f"{path}: catalogue = {catalogue!r}: give the name of a .toml file in workflow/")
    return DatasetFile(given.get("sensor"), given.get("gel"), catalogue, given.get("params", {}))


def stl_files(indenters: dict, folder: Path) -> dict[str, Path]:
    """STL files that tables of indenters name, by the table's name, including files that do not exist yet."""
    named = {
        name: table.get("file")
        for name, table in indenters.items()
        if isinstance(table, dict) and table.get("kind") == "stl"
    }
    return {name: folder / file for name, file in named.items() if isinstance(file, str)}


def with_content(indenters: dict, folder: Path) -> dict:
    """Tables of indenters with a digest of each STL file that they name.

    All later stages depend on the digest, because a file that changes under the same name is another shape.
    """
    digests = {name: digest_of(path) for name, path in stl_files(indenters, folder).items() if path.is_file()}
    return {
        name: {**table, "sha256": digests[name]} if name in digests else table for name, table in indenters.items()
    }


# -- frozen calibration: data/DATASET/calibration.toml overrides workflow/params.toml as a dataset's own tables do

FROZEN = "calibration.toml"  # in data/DATASET/, beside dataset.toml
KINDS = {"name": str, "law": str, "presses": list, "params": dict}
# Decimals that are kept: fewer than any posterior resolves, so that another processor freezes the same values.
DIGITS = {"c10": 4, "touch_offset_mm": 3, "compliance_mm_per_n": 4, "shear_compliance_mm_per_n": 4, "mu": 2}
BENCH = {
    "touch_offset_mm": "offset",
    "compliance_mm_per_n": "compliance",
    "shear_compliance_mm_per_n": "shear_compliance",
}


@dataclass(frozen=True)
class Frozen:
    """A frozen calibration.

    law: of the contact. presses: sample_ids that it used. params: tables that override those of params.toml.
    """

    name: str
    law: str
    presses: tuple[str, ...]
    params: dict[str, dict[str, Any]]


def frozen_of(dataset: str, summary: Mapping[str, Any]) -> Frozen:
    """The part of a calibration's summary.json that is frozen."""
    c10, bench = summary["c10"], summary["bench"]
    material = {"c10": round(c10["median"], DIGITS["c10"])} | {
        f"c10_{name}": [round(value, DIGITS["c10"]) for value in c10[name]] for name in ("interval68", "interval95")
    }
    poses = {key: round(bench[name], DIGITS[key]) + 0.0 for key, name in BENCH.items()}
    params = {"material": material, "poses": poses}
    if "mu" in summary["parameters"]:
        params["interface"] = {"mu": round(summary["parameters"]["mu"]["median"], DIGITS["mu"])}
    digest = hashlib.sha256(repr(params).encode()).hexdigest()[:6]
    return Frozen(f"{dataset}-{digest}", summary["law"], tuple(summary["used"]), params)


def write_frozen(path: Path, found: Frozen) -> None:
    """Write the file, whole or not at all."""
    command = f"make freeze DATASET={path.parent.name}"
    lines = [
        f"# What `make calibrate` found from the force readings of the log, rounded. Labels follow it; only `{command}` changes it.",
        f"name = {json.dumps(found.name)}",
        f"law = {json.dumps(found.law)}  # contact law, the same as that of the labels",
        f"presses = {json.dumps(found.presses)}  # presses of the calibration",
    ]
    for table, values in found.params.items():
        lines += ["", f"[params.{table}]", *(f"{key} = {value}" for key, value in values.items())]
    write_text(path, "\n".join(lines) + "\n")


def read_frozen(path: Path) -> Frozen | None:
    """The frozen calibration; None if the file is missing, BadInput if it is not a frozen calibration."""
    if not path.exists():
        return None
    hint = f"run make freeze DATASET={path.parent.name}, or remove it"
    try:
        given = read_toml(path)
    except BadInput as error:
        raise BadInput(f"{error}; {hint}") from error
    if given.keys() != KINDS.keys() or not all(isinstance(given[key], kind) for key, kind in KINDS.items()):
        raise BadInput(f"{path}: is not a frozen calibration, which has the keys {', '.join(KINDS)}; {hint}")
    tables = {"material": {"c10", "c10_interval68", "c10_interval95"}, "poses": set(BENCH), "interface": {"mu"}}
    for table, values in given["params"].items():
        if not isinstance(values, dict) or values.keys() - tables.get(table, set()):
            raise BadInput(
                f"{path}: [params.{table}] has a key that calibration does not set; set it in dataset.toml; {hint}"
            )
    return Frozen(given["name"], given["law"], tuple(str(name) for name in given["presses"]), given["params"])


def with_frozen(given: dict[str, Any], dataset_toml: Path) -> dict[str, Any]:
    """A dataset's own [params.*] and those of its frozen calibration; a value that both set raises BadInput."""
    path = dataset_toml.parent / FROZEN
    found = read_frozen(path)
    if found is None:
        return given
    twice = [f"[params.{table}] {key}" for table, values in found.params.items() for key in values
             if key in (given.get(table) or {})]  # fmt: skip
    if twice:
        raise BadInput(f"{dataset_toml}: {twice[0]} is also set by {path}; remove it here, or remove that file")
    return given | {table: {**given.get(table, {}), **values} for table, values in found.params.items()}


def check_law(law: str, dataset_toml: Path) -> None:
    """Refuse a frozen calibration of another contact law than the labels': its C10 and bench depend on the law."""
    path = dataset_toml.parent / FROZEN
    found = read_frozen(path)
    if found is not None and found.law != law:
        raise BadInput(
            f'{path}: was found under the law "{found.law}", but [interface] law = "{law}": labels would mix two laws; '
            f"remove this file and run make calibrated-labels DATASET={path.parent.name}, or set the law back"
        )


# -- the parameters of each stage


class StageParameters(Params):
    """Parameters of a stage: the tables and keys that it reads (`flow.layout.STAGES`), and its results' version."""

    version: int


def stage_version(folder: Path, name: str) -> int:
    """The version of a stage's results, read from its module's text so that nothing heavy is imported.

    For a stage that solves presses, stage 30's version is added; the sum changes with either, as both only ever rise.
    """
    path = folder / f"{name}.py"
    found = re.search(r"^VERSION = (\d+)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    if not found:
        raise BadInput(f"{path}: has no line `VERSION = n`; a stage needs one, raised when its results change")
    return int(found.group(1)) + (stage_version(folder, "fea") if STAGES[name].solves else 0)


def written_for(params: Params, name: str, version: int) -> dict[str, Any]:
    """The parameters that are written for a stage, as JSON values."""
    every: dict[str, Any] = plain(params)
    found: dict[str, Any] = {"version": version}
    for words in STAGES[name].reads:
        table, _, key = words.partition(".")
        if not key:
            found[table] = every[table]
        elif key in every[table]:
            found[table] = found.get(table, {}) | {key: every[table][key]}
    return found


def parameters_of(params: Params, name: str, version: int) -> StageParameters:
    """The parameters of a stage."""
    return structured(StageParameters, written_for(params, name, version))


def read_parameters(path: Path) -> StageParameters:
    """Read the parameters that the plan checked and wrote for a stage; BadInput if the file cannot be read."""
    try:
        return structured(StageParameters, read_json(path))
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise BadInput(f"{path}: cannot be read ({error}); run make again, the plan writes it again") from error
