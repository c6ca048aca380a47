"""Parameters: workflow/params.toml, overridden by a dataset's values, and each stage's part.

make runs a stage again when its own parameter file changes, and for no other change of workflow/params.toml. Keys of
solves are digests of the content of these files, so a value is written as it was given: 2 stays 2, and 2.0 stays 2.0.
"""

import os
import re
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from gelforge.errors import BadInput, nearest
from gelforge.flow.files import digest_of, read_json, read_toml
from gelforge.flow.layout import STAGES
from gelforge.flow.schema import Place, altered, parse, plain, structured
from gelforge.flow.tables import Params

__all__ = ["Params", "altered", "plain", "read_toml"]  # imported from here, too


def load_params(workflow: Path | str, dataset_toml: Path | str | None = None) -> Params:
    """Read workflow/params.toml, overridden by the [params.*] tables of a dataset.

    What a calibration found is read by the stages that follow it (`flow.calibration`).

    BadInput is raised for an unknown table or key, a value of another type, a number out of its bounds or not finite,
    a word that is none of the choices, and values that contradict each other.
    """
    given = read_dataset_file(dataset_toml).params if dataset_toml else {}
    return overlaid(workflow, given, str(dataset_toml or ""))


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


# -- the parameters of each stage


class StageParameters(Params):
    """Parameters of a stage: the tables and keys that it reads (`flow.layout.STAGES`), and its results' version.

    calibration: path of the calibration that the stage follows, relative to the project, if any.
    """

    version: int
    calibration: str | None = None


def stage_version(folder: Path, name: str) -> int:
    """The version of a stage's results, read from its module's text so that nothing heavy is imported.

    For a stage that solves presses, stage 30's version is added; the sum changes with either, as both only ever rise.
    """
    path = folder / f"{name}.py"
    found = re.search(r"^VERSION = (\d+)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    if not found:
        raise BadInput(f"{path}: has no line `VERSION = n`; a stage needs one, raised when its results change")
    return int(found.group(1)) + (stage_version(folder, "fea") if STAGES[name].solves else 0)


def written_for(params: Params, name: str, version: int, calibration: str = "") -> dict[str, Any]:
    """The parameters that are written for a stage, as JSON values. calibration: path of the one that labels follow."""
    every: dict[str, Any] = plain(params)
    found: dict[str, Any] = {"version": version}
    if calibration and STAGES[name].calibrated:
        found["calibration"] = calibration
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
