"""Parameters: workflow/params.toml with a dataset's own values and its frozen calibration laid over it, and what each stage is given.

make makes a stage again when its file of parameters changes, and for no other change of workflow/params.toml. Keys of solves are digests
of these files' content, so a value is written as it was given: 2 stays 2, and 2.0 stays 2.0.
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

__all__ = ["Params", "altered", "plain", "read_toml"]  # beside what stands here


def load_params(workflow: Path | str, dataset_toml: Path | str | None = None) -> Params:
    """Read workflow/params.toml with the [params.*] tables of a dataset and its frozen calibration laid over it.

    What has no meaning raises BadInput: a table or key that there is not, another kind of value, a number out of its
    bounds or not finite, a word that is none of the choices, values that cannot go together.
    """
    given = with_frozen(read_dataset_file(dataset_toml).params, Path(dataset_toml)) if dataset_toml else {}
    params = overlaid(workflow, given, str(dataset_toml or ""))
    if dataset_toml:
        check_law(params.interface.law, Path(dataset_toml))
    return params


def overlaid(workflow: Path | str, given: dict[str, Any], where: str) -> Params:
    """Parameters with tables of `where` laid over them; the file that is at fault is the one that is named."""
    file = Path(workflow) / "params.toml"
    base = read_toml(file)
    params = parse(Params, base, Place(str(file)))
    return parse(Params, laid_over(base, given), Place(where, ("params",))) if given else params


def laid_over(base: Any, over: Any) -> Any:
    """A table with the values of another one in place of its own."""
    if not isinstance(base, dict) or not isinstance(over, dict):
        return over
    return base | {key: laid_over(base.get(key), value) for key, value in over.items()}


def read_sensor_tables(workflow: Path | str, data: Path | str) -> dict[str, Any]:
    """Tables of workflow/sensors.toml, and those of data/DATASET/sensors.toml where a dataset brings sensors of its own.

    A sensor that both name raises BadInput: what is known of it stands in one place.
    """
    common = Path(workflow) / "sensors.toml"
    tables = read_toml(common)
    return tables | own_tables(Path(data) / "sensors.toml", tables, common)


def read_indenter_tables(workflow: Path | str, data: Path | str, catalogue: str) -> dict[str, Any]:
    """Tables of the dataset's catalogue in workflow/, and of data/DATASET/indenters.toml where a dataset brings its own.

    STL files are named from the file whose table names them; here all paths start at workflow/.
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
    """Tables of a dataset's own file, none where there is none; a name that the common tables have, too, raises BadInput."""
    brought = read_toml(own) if own.exists() else {}
    twice = sorted(set(tables) & set(brought))
    if twice:
        raise BadInput(f"{own}: {', '.join(twice)} stands in {common}, too; remove one of the two tables")
    return brought


@dataclass(frozen=True)
class DatasetFile:
    """data/DATASET/dataset.toml.

    sensor: of rows of the log that name none. gel: on which all presses were made; the sensors' own say the same, or its
    thickness. catalogue: the indenters' file in workflow/. params: tables laid over those of workflow/params.toml.
    """

    sensor: str | None
    gel: str | None
    catalogue: str
    params: dict[str, Any]


DATASET_KINDS = {"sensor": str, "gel": str, "catalogue": str, "params": dict}


def read_dataset_file(path: Path | str) -> DatasetFile:
    """Read data/DATASET/dataset.toml; a key that nothing reads, or of another kind, raises BadInput."""
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
    """STL files that tables of indenters name, by the table's name, those too that are not there yet."""
    named = {
        name: table.get("file")
        for name, table in indenters.items()
        if isinstance(table, dict) and table.get("kind") == "stl"
    }
    return {name: folder / file for name, file in named.items() if isinstance(file, str)}


def with_content(indenters: dict, folder: Path) -> dict:
    """Tables of indenters with a digest of each STL file that they name.

    A file that changes under its name is another shape: all that follows depends on what is in it.
    """
    digests = {name: digest_of(path) for name, path in stl_files(indenters, folder).items() if path.is_file()}
    return {
        name: {**table, "sha256": digests[name]} if name in digests else table for name, table in indenters.items()
    }


# -- a calibration that was frozen: data/DATASET/calibration.toml overrides workflow/params.toml as a dataset's own tables do

FROZEN = "calibration.toml"  # in data/DATASET/, beside dataset.toml
KINDS = {"name": str, "law": str, "presses": list, "params": dict}
# Digits behind the point of what is kept: less than any posterior tells, so that another processor freezes the same.
DIGITS = {"c10": 4, "touch_offset_mm": 3, "compliance_mm_per_n": 4, "shear_compliance_mm_per_n": 4, "mu": 2}
BENCH = {
    "touch_offset_mm": "offset",
    "compliance_mm_per_n": "compliance",
    "shear_compliance_mm_per_n": "shear_compliance",
}


@dataclass(frozen=True)
class Frozen:
    """A frozen calibration. law: of the contact. presses: sample_ids that it used. params: tables over those of params.toml."""

    name: str
    law: str
    presses: tuple[str, ...]
    params: dict[str, dict[str, Any]]


def frozen_of(dataset: str, summary: Mapping[str, Any]) -> Frozen:
    """What is kept of a calibration's summary.json."""
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
        f"law = {json.dumps(found.law)}  # of the contact, which labels share",
        f"presses = {json.dumps(found.presses)}  # that it was found from",
    ]
    for table, values in found.params.items():
        lines += ["", f"[params.{table}]", *(f"{key} = {value}" for key, value in values.items())]
    write_text(path, "\n".join(lines) + "\n")


def read_frozen(path: Path) -> Frozen | None:
    """The frozen calibration; None where there is none, and BadInput where the file is none."""
    if not path.exists():
        return None
    hint = f"run make freeze DATASET={path.parent.name}, or remove it"
    try:
        given = read_toml(path)
    except BadInput as error:
        raise BadInput(f"{error}; {hint}") from error
    if given.keys() != KINDS.keys() or not all(isinstance(given[key], kind) for key, kind in KINDS.items()):
        raise BadInput(f"{path}: is no frozen calibration, which holds {', '.join(KINDS)}; {hint}")
    tables = {"material": {"c10", "c10_interval68", "c10_interval95"}, "poses": set(BENCH), "interface": {"mu"}}
    for table, values in given["params"].items():
        if not isinstance(values, dict) or values.keys() - tables.get(table, set()):
            raise BadInput(
                f"{path}: [params.{table}] holds what no calibration finds; set it in dataset.toml; {hint}"
            )
    return Frozen(given["name"], given["law"], tuple(str(name) for name in given["presses"]), given["params"])


def with_frozen(given: dict[str, Any], dataset_toml: Path) -> dict[str, Any]:
    """A dataset's own [params.*] with those of its frozen calibration; a value that both set raises BadInput."""
    path = dataset_toml.parent / FROZEN
    found = read_frozen(path)
    if found is None:
        return given
    twice = [f"[params.{table}] {key}" for table, values in found.params.items() for key in values
             if key in (given.get(table) or {})]  # fmt: skip
    if twice:
        raise BadInput(f"{dataset_toml}: {twice[0]} is set by {path}, too; remove it here, or remove that file")
    return given | {table: {**given.get(table, {}), **values} for table, values in found.params.items()}


def check_law(law: str, dataset_toml: Path) -> None:
    """Refuse a frozen calibration of another contact law than labels have: its C10 and bench belong to that law."""
    path = dataset_toml.parent / FROZEN
    found = read_frozen(path)
    if found is not None and found.law != law:
        raise BadInput(
            f'{path}: was found under the law "{found.law}", but [interface] law = "{law}": labels would mix two laws; '
            f"remove this file and run make calibrated-labels DATASET={path.parent.name}, or set the law back"
        )


# -- what each stage is given


class StageParameters(Params):
    """What a stage is given: of all parameters those tables and keys that it reads (`flow.layout.STAGES`), and the version of its results."""

    version: int


def stage_version(folder: Path, name: str) -> int:
    """The version of a stage's results, read from its module's text so that nothing heavy is imported.

    Where it solves presses, stage 30's is added: both only ever rise.
    """
    path = folder / f"{name}.py"
    found = re.search(r"^VERSION = (\d+)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    if not found:
        raise BadInput(f"{path}: has no line `VERSION = n`; a stage needs one, raised when its results change")
    return int(found.group(1)) + (stage_version(folder, "fea") if STAGES[name].solves else 0)


def written_for(params: Params, name: str, version: int) -> dict[str, Any]:
    """What is written for a stage of the parameters, as JSON has it."""
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
    """What a stage is given of the parameters."""
    return structured(StageParameters, written_for(params, name, version))


def read_parameters(path: Path) -> StageParameters:
    """Read what the plan checked and wrote for a stage."""
    try:
        return structured(StageParameters, read_json(path))
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise BadInput(f"{path}: cannot be read ({error}); run make again, the plan writes it anew") from error
