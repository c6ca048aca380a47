"""Parameters for tests: those of workflow/params.toml, with some values changed."""

from pathlib import Path
from typing import Any

from gelforge.flow.files import read_json, write_json
from gelforge.flow.layout import Layout
from gelforge.flow.params import Params, laid_over, load_params, parameters_of, plain
from gelforge.flow.schema import ParameterTable, Place, parse

WORKFLOW = Path(__file__).resolve().parents[2] / "workflow"


def place_workflow(folder: Path) -> Path:
    """Link the project's workflow and references into a folder that holds a test's data and results; return it."""
    (folder / "data").mkdir(parents=True, exist_ok=True)
    (folder / "workflow").symlink_to(WORKFLOW)
    (folder / "data/fea_challenge").symlink_to(WORKFLOW.parent / "data/fea_challenge")
    return folder


def parameters(**tables: dict[str, Any]) -> Params:
    """All tables, with some values changed: parameters(fea={"tolerance": 0.1})."""
    return parse(Params, laid_over(plain(load_params(WORKFLOW)), tables), Place("a test"))


def with_values(table: ParameterTable, **values: Any) -> Any:
    """One table with some values changed."""
    return parse(type(table), laid_over(plain(table), values), Place("a test"))


def stage_of(stage: str, **tables: dict[str, Any]) -> Any:
    """Parameters of a stage, with some values changed."""
    return parameters_of(parameters(**tables), stage, 1)


def write_stage(folder: Path, stage: str, **tables: dict[str, Any]) -> Path:
    """Write the parameters of a stage to FOLDER/STAGE.json; return the path."""
    path = Path(folder) / f"{stage}.json"
    write_json(path, plain(stage_of(stage, **tables)))
    return path


def write_used(of: Layout, shard: str = "0000", **tables: dict[str, Any]) -> None:
    """Write the catalogue entries that a shard uses, as the plan does; kinds that are not given stay as they are."""
    path = of.used(shard)
    known = read_json(path) if path.exists() else {"sensors": {}, "indenters": {}, "gels": {}}
    write_json(path, known | tables)
