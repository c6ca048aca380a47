"""Layout of results/DATASET: every folder, and every file name that more than one module uses.

make needs targets by name, so rules/*.mk spell them too; a test checks that each folder there is one of these. The
module imports only the standard library, because every step of a run imports it.
"""

import csv
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, overload

from gelforge.errors import BadInput
from gelforge.flow.files import names_in

PLAN, POSES, IMAGES, MESHES, FEA, FORCES = "00_plan", "10_poses", "15_images", "20_meshes", "30_fea", "40_forces"
LABELS, DATASET, TRAIN, EVALUATE, REPORT = "50_labels", "60_dataset", "70_train", "80_evaluate", "90_report"
CALIBRATE, PARETO, PARETO_MODELS, STABILITY = "calibrate", "pareto", "pareto_models", "stability"
LOGS, METRICS = "logs", "metrics"
SURFACES = "surfaces"  # in 00_plan: measured surfaces of STL files, by a digest of their content
SAMPLES, ESTIMATE, EXPORT, FEATS, LOOK, DECK = "samples", "estimate", "export", "feats", "look", "deck"


@dataclass(frozen=True)
class Stage:
    """A stage or branch, named after its module in gelforge.stages.

    folder: of its results. reads: parameter tables, or single values TABLE.KEY, that its parameter file holds.
    solves: whether it solves presses as stage 30 does, so that its results change with stage 30's version.
    calibrated: whether it follows the dataset's calibration, where there is one.
    """

    folder: str
    reads: tuple[str, ...] = ()
    solves: bool = False
    calibrated: bool = False


STAGES = {
    "poses": Stage(POSES, ("poses",), calibrated=True),
    "images": Stage(IMAGES, ("poses",), calibrated=True),
    "meshes": Stage(MESHES),
    "fea": Stage(FEA, ("fea", "interface", "material.nu"), calibrated=True),
    "forces": Stage(FORCES, ("material",), calibrated=True),
    "labels": Stage(LABELS, ("labels",)),
    "dataset": Stage(DATASET, ("dataset", "poses.images", "poses.judge_images")),
    "train": Stage(TRAIN, ("train",)),
    "evaluate": Stage(EVALUATE, ("evaluate",)),
    "card": Stage(EVALUATE),
    "report": Stage(REPORT, ("report",)),
    "calibrate": Stage(
        CALIBRATE,
        (
            "calibrate",
            "material.nu",
            "material.c10",
            "interface.law",
            "poses.deepest_share",
            "poses.farthest_shear_mm",
            "poses.tilt_deg",
            "poses.mounting_tilt_deg",
        ),
        solves=True,
    ),
    "plots": Stage(CALIBRATE),
    "pareto": Stage(PARETO, ("fea", "material.nu")),
    "stability": Stage(STABILITY, ("fea",), solves=True),
    "pareto_models": Stage(PARETO_MODELS),
}
TABLES = ("sensors", "indenters", "gels", "chart")  # files of catalogue entries beside the stages' parameters
FOLDERS = (
    PLAN,
    *dict.fromkeys(stage.folder for stage in STAGES.values()),
    LOGS,
    METRICS,
    SAMPLES,
    ESTIMATE,
    EXPORT,
    FEATS,
    LOOK,
    DECK,
)
OF_SHARDS = (POSES, FEA, FORCES, LABELS)  # stages that write one file per shard
SHARD_DIGITS = 4
PYTHON = ".venv/bin/python"  # that of make's recipes, in the project's folder
LOGGED = "logged"  # column of the shard table: 1 for a sample of the log, 0 for one whose row is gone from the log


def shard_name(number: int) -> str:
    """The name of a shard's files by its number, such as 0001."""
    return f"{number:0{SHARD_DIGITS}d}"


def planned_shards(folder: Path) -> list[str]:
    """Sorted names of the planned shards, from the folder 00_plan/shards."""
    return [name.removesuffix(".csv") for name in names_in(folder, ".csv")]


def place_in(target: Path) -> str:
    """Which of the planned shards a stage's file is of, as "  [3 of 8]"; "" for others."""
    root = dataset_folder(target)
    names = planned_shards(Layout(root).shards) if root and target.relative_to(root).parts[0] in OF_SHARDS else []
    return f"  [{names.index(target.stem) + 1} of {len(names)}]" if target.stem in names else ""


def mirror(target: Path, kind: str, suffix: str) -> Path:
    """Path of the log or the metrics of a target: results/DATASET/KIND/STAGE/stem.suffix."""
    root = dataset_folder(target) or target.parent
    return (root / kind / target.relative_to(root)).with_suffix(suffix)


def dataset_folder(path: Path) -> Path | None:
    """results/DATASET of a file, None if it lies elsewhere; other folders of its path may be named `results`, too."""
    parts = path.parts
    found = [at for at, part in enumerate(parts[:-2]) if part == "results"]
    of_stage = [at for at in found if parts[at + 2] in FOLDERS]
    return Path(*parts[: (of_stage or found)[-1] + 2]) if found else None


def command_for(goal: str, path: Path | str) -> str:
    """What a person types to make a goal for a file's dataset; without DATASET=… make would take the default one."""
    root = dataset_folder(Path(path))
    return f"make {goal}" if root is None else Layout(root).command(goal)


def beside(out: Path, ending: str) -> Path:
    """The file next to a stage's result with the same stem and another ending ("": the folder of that name).

    out: NAME.json, or NAME.json.part, its name while it is written.
    """
    return out.with_name(Path(out.name.removesuffix(".part")).stem + ending)


def command_of(target: Path) -> list[str]:
    """The command that writes a file of results/DATASET, as its record keeps it; BadInput if none does."""
    root = dataset_folder(target)
    made = [file for file in vars(Layout).values() if isinstance(file, File) and file.by]
    for file in made:
        pattern = re.sub(r"\\{\w+\\}", "([^/]+)", re.escape(file.pattern))
        if root and (words := re.fullmatch(pattern, str(target.relative_to(root)))):
            return [PYTHON, "-m", *f"gelforge.{file.by}".split(), str(root), *words.groups(), "--part"]
    raise BadInput("no stage writes a file of this name; `make help` lists what can be made")


def log_of(target: Path) -> Path:
    """The log of a target."""
    return mirror(target, LOGS, ".log")


def metrics_of(target: Path) -> Path:
    """The record of a target: what it read and what it cost."""
    return mirror(target, METRICS, ".json")


class File:
    """A file below results/DATASET by the pattern of its name: `of.fea("0000")` is results/DATASET/30_fea/0000.csv.

    by: module of gelforge, and its sub-command, that make runs to write it; "" for files that are no targets of make.
    shared: it is that of the dataset also for a sample that `make sample` took through all stages.
    """

    def __init__(self, pattern: str, by: str = "", shared: bool = False) -> None:
        self.pattern, self.by, self.shared = pattern, by, shared
        self.words = re.findall(r"{(\w+)}", pattern)

    def __call__(self, of: "Layout", *words: str) -> Path:
        """The path for the words of the pattern, in their order."""
        if len(words) != len(self.words):
            raise TypeError(f"{self.pattern}: give {', '.join(self.words) or 'no words'}, not {words}")
        root = of.dataset_root if self.shared else of.root
        return root / self.pattern.format(**dict(zip(self.words, words, strict=True)))

    @overload
    def __get__(self, of: None, owner: type) -> "File": ...
    @overload
    def __get__(self, of: "Layout", owner: type) -> Callable[..., Path]: ...
    def __get__(self, of: "Layout | None", owner: type) -> "File | Callable[..., Path]":
        return self if of is None else partial(self, of)


class Folder(File):
    """A path below results/DATASET whose name holds no words: `of.params`."""

    def __get__(self, of: Any, owner: type) -> Any:
        return self if of is None else self(of)


@dataclass(frozen=True)
class Layout:
    """Paths below one folder results/DATASET."""

    root: Path

    def command(self, goal: str) -> str:
        """What a person types to make a goal of this dataset."""
        return f"make {goal} DATASET={self.root.name}"

    def folder(self, stage: str) -> Path:
        """A folder of FOLDERS."""
        return self.root / stage

    @property
    def dataset_root(self) -> Path:
        """results/DATASET: for a sample or a pilot below it the folder of its dataset, else this folder."""
        return dataset_folder(self.root / PLAN) or self.root

    @property
    def base(self) -> Path:
        """The folder in which data, results and workflow lie."""
        return self.dataset_root.parent.parent

    @property
    def workflow(self) -> Path:
        """Folder of the project's tables; paths of STL files are relative to it, and meshes are kept in it."""
        return self.base / "workflow"

    @property
    def data(self) -> Path:
        """Folder of the dataset's inputs: data/DATASET."""
        return self.base / "data" / self.dataset_root.name

    @property
    def log(self) -> Path:
        """The raw log."""
        return self.data / "log.csv"

    @property
    def ccx(self) -> Path:
        """File that names CalculiX' program, or says `none`; without it there is none."""
        return self.base / ".venv/ccx.path"

    @property
    def references(self) -> Path:
        """Folder of the references of the chart's scenes, which all datasets share."""
        return self.base / "data" / "fea_challenge"

    # -- files and folders, by the words that their names hold

    plan = File(f"{PLAN}/plan.mk", "stages.plan")  # lists of words, such as shards, that make reads
    params = Folder(f"{PLAN}/params")  # parameters of each stage, NAME.json
    parameters = File(f"{PLAN}/params/{{name}}.json")  # of a stage, or catalogue entries that the dataset uses
    shards = Folder(f"{PLAN}/shards")
    shard_table = Folder(f"{PLAN}/shards.csv")  # the shard of every sample
    shard = File(f"{PLAN}/shards/{{shard}}.csv")  # raw rows
    used = File(f"{PLAN}/shards/{{shard}}.json")  # catalogue entries that a shard uses: sensors, indenters, gels
    pictures = File(f"{PLAN}/shards/{{shard}}.pictures.json")  # digests of its images, repeated ones
    beside = File(f"{PLAN}/beside/{{name}}.json")  # digests of files beside the log, by kind
    poses = File(f"{POSES}/{{shard}}.csv", "stages.poses")
    rejected = File(f"{POSES}/{{shard}}.rejected.csv")
    images = File(f"{IMAGES}/images.json", "stages.images")
    meshes = Folder(MESHES, shared=True)  # base meshes of gels
    mesh = File(f"{MESHES}/{{gel}}.npz", "stages.meshes", shared=True)
    fea = File(f"{FEA}/{{shard}}.csv", "stages.fea")  # how each press was solved, and the key of its solve
    forces = File(f"{FORCES}/{{shard}}.npz", "stages.forces")
    labels = File(f"{LABELS}/{{resolution}}/{{shard}}.npz", "stages.labels")
    dataset = File(f"{DATASET}/{{resolution}}")  # folder of the arrays to train on
    dataset_table = File(f"{DATASET}/{{resolution}}/dataset.json", "stages.dataset")  # written after its arrays
    network = File(f"{TRAIN}/{{resolution}}/{{model}}.onnx", "stages.train")  # weights and curve lie beside it
    curve = File(f"{TRAIN}/{{resolution}}/{{model}}.curve.png")
    evaluation = File(f"{EVALUATE}/{{resolution}}/{{model}}.json", "stages.evaluate")  # plots and card lie beside it
    card = File(f"{EVALUATE}/{{resolution}}/{{model}}.card.md", "stages.card")
    report = File(f"{REPORT}/{{resolution}}-{{model}}.html", "stages.report")  # of no network: "none"
    chart_scene = File(f"{PARETO}/scenes/{{name}}.json", "stages.pareto scene")
    chart = File(f"{PARETO}/pareto.json", "stages.pareto chart")
    network_chart = File(f"{PARETO_MODELS}/{{resolution}}.json", "stages.pareto_models")
    stability_row = File(f"{STABILITY}/rows/{{row}}.json", "stages.stability row")
    stability_map = File(f"{STABILITY}/map.json", "stages.stability map")
    feats = File(f"{FEATS}/{{resolution}}/normalization_gelforge.npy", "commands.feats export")  # after the labels
    calibration = File(f"{CALIBRATE}/summary.json", "stages.calibrate", shared=True)  # also of samples
    followed = File(f"{CALIBRATE}/followed.toml", "commands.freeze follow", shared=True)  # values that labels follow
    plots = File(f"{CALIBRATE}/plots.json", "stages.plots")  # captions of the pictures of the posterior beside it
    surfaces = Folder(f"{PLAN}/{SURFACES}", shared=True)  # measured surfaces of STL files, by digest
    logs = Folder(LOGS)
    metrics = Folder(METRICS)

    @property
    def solves(self) -> Path:
        """Folder of all solves, by key: of all datasets, or the one that SOLVES=folder names."""
        return Path(os.environ.get("GELFORGE_SOLVES") or self.dataset_root.parent / "solves")

    def lesson(self, resolution: str) -> Path:
        """Arrays that another dataset's network learns from, too: `dataset`, at 1x1 if total forces were imported."""
        only_totals = (self.data / "labels/1x1.npz").exists()
        return self.dataset("1x1" if only_totals else resolution)

    def names(self) -> list[str]:
        """Sorted names of the planned shards."""
        return planned_shards(self.shards)

    def shard_of(self, sample_id: str) -> str:
        """Name of the planned shard that holds a sample; BadInput if none does."""
        if not self.shard_table.exists():
            raise BadInput(f"{self.shard_table}: not there, so nothing was planned; run {self.command('poses')}")
        with self.shard_table.open(newline="", encoding="utf-8") as stream:
            found = next((row for row in csv.DictReader(stream) if row["sample_id"] == sample_id), None)
        if found is None or found.get(LOGGED) == "0":
            raise self.not_logged(sample_id)
        return shard_name(int(found["shard"]))

    def not_logged(self, sample_id: str) -> BadInput:
        """The error for a sample that no planned shard holds."""
        return BadInput(
            f"sample {sample_id!r} is not in the log of {self.root.name}; ID=… takes a sample_id of "
            f"data/{self.root.name}/log.csv; for another dataset add DATASET=…"
        )

    def sample(self, sample_id: str) -> "Layout":
        """The layout of one sample that `make sample` took through all stages."""
        return Layout(self.root / SAMPLES / sample_id)
