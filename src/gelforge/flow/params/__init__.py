"""Parameters: workflow/params.toml with a dataset's own values laid over it, as typed tables.

`tables` says what each table holds, `schema` reads a table and refuses what has no meaning, `stages` gives each stage
its own part.
"""

import os
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from gelforge.errors import BadInput, nearest
from gelforge.flow.files import digest_of, read_toml
from gelforge.flow.params.frozen import check_law, with_frozen
from gelforge.flow.params.schema import Place, altered, parse, plain
from gelforge.flow.params.stages import parameters_of, read_parameters, stage_version, written_for
from gelforge.flow.params.tables import Params

__all__ = [
    "DatasetFile",
    "Params",
    "altered",
    "load_params",
    "overlaid",
    "parameters_of",
    "plain",
    "read_dataset_file",
    "read_indenter_tables",
    "read_parameters",
    "read_sensor_tables",
    "read_toml",
    "stage_version",
    "written_for",
]  # fmt: skip


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
