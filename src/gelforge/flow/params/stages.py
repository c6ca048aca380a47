"""What of the parameters each stage reads, as a file of its own.

make makes a stage again when its file changes, and for no other change of workflow/params.toml. Keys of solves are
digests of these files' content, so a value is written as it was given: 2 stays 2, and 2.0 stays 2.0.
"""

import re
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, TypeVar

from gelforge.errors import BadInput
from gelforge.flow.files import read_json
from gelforge.flow.params.schema import ParameterTable, Within, kinds_of, structured
from gelforge.flow.params.tables import (
    CalibrateTable,
    DatasetTable,
    EvaluateTable,
    FeaTable,
    ForcesTable,
    ImagesTable,
    InterfaceTable,
    LabelsTable,
    LawTable,
    MaterialTable,
    MeshesTable,
    Params,
    ParetoTable,
    PoissonTable,
    PosesTable,
    ReportTable,
    StabilityTable,
    TrainTable,
)


class StageParameters(ParameterTable):
    """Tables of one stage, and the version of its results; by itself what a stage is given that reads no table."""

    version: Annotated[int, Within(0, 1e6)]


class ForPoses(StageParameters):
    """What stage 10 reads."""

    poses: PosesTable


class ForImages(StageParameters):
    """What stage 15 reads."""

    poses: ImagesTable


class ForMeshes(StageParameters):
    """What stage 20 reads."""

    meshes: MeshesTable


class ForFea(StageParameters):
    """What stage 30 reads."""

    fea: FeaTable
    interface: InterfaceTable
    material: PoissonTable


class ForForces(StageParameters):
    """What stage 40 reads."""

    forces: ForcesTable
    material: MaterialTable


class ForLabels(StageParameters):
    """What stage 50 reads."""

    labels: LabelsTable


class ForDataset(StageParameters):
    """What stage 60 reads."""

    dataset: DatasetTable
    poses: ImagesTable


class ForTrain(StageParameters):
    """What stage 70 reads."""

    train: TrainTable


class ForEvaluate(StageParameters):
    """What stage 80 reads."""

    evaluate: EvaluateTable


class ForReport(StageParameters):
    """What stage 90 reads."""

    report: ReportTable


class ForCalibrate(StageParameters):
    """What branch calibrate reads."""

    calibrate: CalibrateTable
    material: PoissonTable
    interface: LawTable


class ForPareto(StageParameters):
    """What branch pareto reads."""

    pareto: ParetoTable
    fea: FeaTable
    meshes: MeshesTable
    material: PoissonTable


class ForStability(StageParameters):
    """What branch stability reads."""

    stability: StabilityTable
    fea: FeaTable
    meshes: MeshesTable


@dataclass(frozen=True)
class Source:
    """The type of a stage's parameters, and where its version stands: a module of gelforge.stages.

    solves: whether the branch solves presses as stage 30 does, so that its results change with stage 30's.
    """

    kind: type[StageParameters]
    module: str
    solves: bool = False


# By the name of the file, 00_plan/params/NAME.json.
SOURCES = {
    "poses": Source(ForPoses, "poses"),
    "images": Source(ForImages, "images"),
    "meshes": Source(ForMeshes, "meshes"),
    "fea": Source(ForFea, "fea"),
    "forces": Source(ForForces, "forces"),
    "labels": Source(ForLabels, "labels"),
    "dataset": Source(ForDataset, "dataset"),
    "train": Source(ForTrain, "train"),
    "evaluate": Source(ForEvaluate, "evaluate"),
    "card": Source(StageParameters, "card"),
    "report": Source(ForReport, "report"),
    "calibrate": Source(ForCalibrate, "calibrate", solves=True),
    "pareto": Source(ForPareto, "pareto"),
    "stability": Source(ForStability, "stability", solves=True),
    "pareto_models": Source(StageParameters, "pareto_models"),
}

S = TypeVar("S", bound=StageParameters)


def stage_version(folder: Path, source: Source) -> int:
    """The version of a stage's results, read from its module's text so that nothing heavy is imported.

    Where it solves presses, stage 30's is added: both only ever rise.
    """
    path = folder / f"{source.module}.py"
    found = re.search(r"^VERSION = (\d+)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    if not found:
        raise BadInput(f"{path}: has no line `VERSION = n`; a stage needs one, raised when its results change")
    return int(found.group(1)) + (stage_version(folder, SOURCES["fea"]) if source.solves else 0)


def parameters_of(params: Params, kind: type[S], version: int) -> S:
    """What a stage reads of the parameters, with the version of its results."""
    of: Any = kind
    tables = {
        name: narrowed(getattr(params, name), table) for name, table in kinds_of(of).items() if name != "version"
    }
    return kind(version=version, **tables)


def narrowed(table: ParameterTable, kind: type[ParameterTable]) -> ParameterTable:
    """A table with only the keys of `kind`, which it or a class it is made from has."""
    if type(table) is kind:
        return table
    return kind(**{field.name: getattr(table, field.name) for field in fields(kind)})


def read_parameters(path: Path, kind: type[S]) -> S:
    """Read what the plan checked and wrote for a stage."""
    try:
        return structured(kind, read_json(path))
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise BadInput(f"{path}: cannot be read ({error}); run make again, the plan writes it anew") from error
