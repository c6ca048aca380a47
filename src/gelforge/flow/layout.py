"""Layout of results/DATASET: every folder, and every file name that more than one module uses.

make needs targets by name, so rules/*.mk spell them too; a test checks that each folder there is one of these. The
module imports only the standard library, because every step of a run imports it.
"""

import csv
import os
from dataclasses import dataclass
from pathlib import Path

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
    "images": Stage(IMAGES, ("poses.images", "poses.judge_images")),
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
        ),
        solves=True,
    ),
    "pareto": Stage(PARETO, ("pareto", "fea", "material.nu")),
    "stability": Stage(STABILITY, ("stability", "fea"), solves=True),
    "pareto_models": Stage(PARETO_MODELS),
}
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


def log_of(target: Path) -> Path:
    """The log of a target."""
    return mirror(target, LOGS, ".log")


def metrics_of(target: Path) -> Path:
    """The record of a target: what it read and what it cost."""
    return mirror(target, METRICS, ".json")


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
    def references(self) -> Path:
        """Folder of the references of the chart's scenes, which all datasets share."""
        return self.base / "data" / "fea_challenge"

    def plan(self) -> Path:
        """Lists of words, such as shards, that make reads."""
        return self.root / PLAN / "plan.mk"

    @property
    def params(self) -> Path:
        """Folder of each stage's parameters, NAME.json."""
        return self.root / PLAN / "params"

    def parameters(self, name: str) -> Path:
        """Parameters of a stage, or the catalogue entries that the dataset uses (sensors, indenters, gels)."""
        return self.params / f"{name}.json"

    @property
    def surfaces(self) -> Path:
        """Folder of the measured surfaces of STL files, by a digest of their content."""
        return self.dataset_root / PLAN / SURFACES

    @property
    def shards(self) -> Path:
        """Folder of the planned shards' raw rows."""
        return self.root / PLAN / "shards"

    @property
    def shard_table(self) -> Path:
        """Table that gives the shard of every sample."""
        return self.root / PLAN / "shards.csv"

    def shard(self, name: str) -> Path:
        """Raw rows of a shard."""
        return self.shards / f"{name}.csv"

    def used(self, name: str) -> Path:
        """The catalogue entries that a shard uses: its sensors, indenters and gels."""
        return self.shards / f"{name}.json"

    def pictures(self, name: str) -> Path:
        """Digests of a shard's pictures, and its rows whose picture is also that of another press."""
        return self.shards / f"{name}.pictures.json"

    def beside(self, name: str) -> Path:
        """Digests of files that lie beside the log: nocontact, rows (splits and truth), or imported labels of a resolution."""
        return self.root / PLAN / "beside" / f"{name}.json"

    def poses(self, shard: str) -> Path:
        """Pose table of a shard."""
        return self.root / POSES / f"{shard}.csv"

    def rejected(self, shard: str) -> Path:
        """Rows of a shard that stage 10 rejected."""
        return self.root / POSES / f"{shard}.rejected.csv"

    def images(self) -> Path:
        """What stage 15 found in the images of the log."""
        return self.root / IMAGES / "images.json"

    @property
    def meshes(self) -> Path:
        """Folder of the gels' base meshes; samples share those of their dataset."""
        return self.dataset_root / MESHES

    def mesh(self, gel: str) -> Path:
        """Base mesh of a gel."""
        return self.meshes / f"{gel}.npz"

    def fea(self, shard: str) -> Path:
        """Table of a shard's solves."""
        return self.root / FEA / f"{shard}.csv"

    @property
    def solves(self) -> Path:
        """Folder of all solves, by key: of all datasets, or the one that SOLVES=folder names."""
        return Path(os.environ.get("GELFORGE_SOLVES") or self.dataset_root.parent / "solves")

    def checked(self, shard: str) -> Path:
        """Folder of a shard's presses that a second method verified."""
        return self.root / FEA / shard

    def forces(self, shard: str) -> Path:
        """Nodal forces of a shard."""
        return self.root / FORCES / f"{shard}.npz"

    def labels(self, resolution: str, shard: str) -> Path:
        """Labels of a shard."""
        return self.root / LABELS / resolution / f"{shard}.npz"

    def dataset(self, resolution: str) -> Path:
        """Folder of the arrays to train on."""
        return self.root / DATASET / resolution

    def lesson(self, resolution: str) -> Path:
        """Arrays that another dataset's network learns from, too: `dataset`, at 1x1 if total forces were imported."""
        only_totals = (self.data / "labels/1x1.npz").exists()
        return self.dataset("1x1" if only_totals else resolution)

    def dataset_table(self, resolution: str) -> Path:
        """What the arrays of a resolution hold, written after them."""
        return self.dataset(resolution) / "dataset.json"

    def network(self, resolution: str, model: str) -> Path:
        """A trained network; its weights and its learning curve lie beside it with the same stem."""
        return self.root / TRAIN / resolution / f"{model}.onnx"

    def evaluation(self, resolution: str, model: str) -> Path:
        """Errors of a network; its plots, card and predictions lie beside it with the same stem."""
        return self.root / EVALUATE / resolution / f"{model}.json"

    def card(self, resolution: str, model: str) -> Path:
        """The model card of a network."""
        return self.root / EVALUATE / resolution / f"{model}.card.md"

    def curve(self, resolution: str, model: str) -> Path:
        """Plot of a network's learning curve."""
        return self.root / TRAIN / resolution / f"{model}.curve.png"

    def report(self, resolution: str, model: str) -> Path:
        """The report page of a grid and a network, "none" for a dataset without images."""
        return self.root / REPORT / f"{resolution}-{model}.html"

    def calibration(self) -> Path:
        """Summary of the posterior; samples and pilots share that of their dataset."""
        return self.dataset_root / CALIBRATE / "summary.json"

    def chart_scene(self, name: str) -> Path:
        """A scene solved by every method."""
        return self.root / PARETO / "scenes" / f"{name}.json"

    def chart(self) -> Path:
        """The chart of all scenes and methods."""
        return self.root / PARETO / "pareto.json"

    def network_chart(self, resolution: str) -> Path:
        """The chart of networks."""
        return self.root / PARETO_MODELS / f"{resolution}.json"

    def stability_row(self, row: str) -> Path:
        """The cases of one factor of the branch stability."""
        return self.root / STABILITY / "rows" / f"{row}.json"

    def stability_map(self) -> Path:
        """All cases of the branch stability."""
        return self.root / STABILITY / "map.json"

    def feats(self, resolution: str) -> Path:
        """The normalisation file of labels in FEATS' layout, written after them."""
        return self.root / FEATS / resolution / "normalization_gelforge.npy"

    @property
    def logs(self) -> Path:
        """Folder of all logs."""
        return self.root / LOGS

    @property
    def metrics(self) -> Path:
        """Folder of all records."""
        return self.root / METRICS

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
