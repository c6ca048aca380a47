"""The tables of workflow/params.toml, key by key: types, units and allowed values.

The purpose of each value, and its reason, stands beside it in workflow/params.toml; a test keeps the two in step.
"""

import re
from dataclasses import fields
from typing import Annotated, Literal, get_args

from annotated_types import MinLen

from gelforge.flow.schema import NAME, RISING, SOME, Number, ParameterTable, Rule, Within

TINY = 1e-12  # lower bound of values that must be above 0
Fraction = Annotated[Number, Within(0.0, 1.0)]
Count = Annotated[int, Within(1, 1e6)]
Whole = Annotated[int, Within(0, 1e6)]
Seed = Annotated[int, Within(0, 2**32)]
Steps = Annotated[int, Within(1, 1000)]
Length = Annotated[Number, Within(TINY, 1e3, "mm")]
Size = Annotated[Number, Within(0.1, 10.0, "mm")]
Seconds = Annotated[Number, Within(TINY, 1e9, "s")]
Finite = Annotated[Number, Within(-1e6, 1e6)]
Positive = Annotated[Number, Within(TINY, 1e9)]
Nu = Annotated[Number, Within(0.0, 0.4999)]
# Bounds of C10, 0.0725 for the nominal gel. They catch values in kPa, which would make forces 1000 times as large.
SOFTEST, STIFFEST = 0.002, 5.0
Stiffness = Annotated[Number, Within(SOFTEST, STIFFEST, "MPa")]
Interval = tuple[Stiffness, Stiffness]
NAMED = "a name of letters, digits, periods, - and _"
Name = Annotated[str, Rule(re.compile(NAME).fullmatch, NAMED)]
Names = tuple[Name, ...]
Line = Annotated[str, Rule(str.isprintable, "text of one line")]
Law = Literal["no_slip", "coulomb", "frictionless"]
Method = Literal["draft", "label", "fine", "ccx", "ccx-contact", "auto"]
METHODS = get_args(Method)
IN_PROCESS = ("draft", "label", "fine")  # qualities of hexahedra: they need neither CalculiX nor tetrahedral meshes
# Methods that "auto" tries in turn, until one states an error within [fea] tolerance.
TAKEN = ("draft", "label", "ccx")
Angle = Annotated[Number, Within(-30.0, 30.0, "degrees")]
Tilt = tuple[Angle, Angle]
FromNone = Annotated[Number, Within(0.0, 1e9)]
# Keys of [fea] that decide which presses are solved twice, and by which stated error "auto" chooses a method; neither
# changes a solve by a named method.
CHOOSING = frozenset({"tolerance", "verify"})
SHIPPED = "shipped"  # name, in targets and parameters, of the network that predict and live use if none is named
# Presses from which a dataset's own network is worth training: its error is then 1.4 N, that of a guess 9 N.
ENOUGH_PRESSES = 500
SHIPPED_IMAGE = (320, 240)  # width and height of the images that the shipped network reads


class PlanTable(ParameterTable):
    """[plan]: how a dataset is cut into shards."""

    shard_size: Count


class ReportTable(ParameterTable):
    """[report]: what the page holds."""

    embed_mb: Annotated[Number, Within(0.0, 1e6, "MB")]
    model: Annotated[str, Rule(re.compile(f"({NAME})?").fullmatch, NAMED)]
    branches: tuple[Literal["calibrate"], ...]


class AugmentTable(ParameterTable):
    """[train.augment]: augmentation of training images."""

    probability: Fraction
    noise: Annotated[Number, Within(0.0, 1.0)]
    brightness: Fraction
    contrast: Fraction
    saturation: Fraction
    hue: Annotated[Number, Within(0.0, 0.5, "turns")]
    misplaced_share: Fraction
    misplaced_px: Annotated[Number, Within(0.0, 1000.0, "px")]
    misplaced_deg: Annotated[Number, Within(0.0, 45.0, "degrees")]
    misplaced_zoom: Fraction
    narrowed_share: Fraction
    narrowed: Fraction


class EpochsTable(ParameterTable):
    """[train.epochs_of]: epochs by kind of network, 0 for [train] epochs."""

    unet: Whole


class TrainingTable(ParameterTable):
    """Training settings of one network: [train], overridden by its model's own values."""

    epochs: Count
    epoch_images: Whole
    batch: Count
    learning_rate: Annotated[Number, Within(TINY, 1e3)]
    total_weight: Annotated[Number, Within(0.0, 1e9)]
    total_huber: Annotated[Number, Within(0.0, 1e9)]
    shift_cells: Annotated[int, Within(0, 1000)]
    mirrored_share: Fraction
    frozen_share: Fraction
    averaged_share: Fraction
    seed: Seed
    threads: Annotated[int, Within(1, 1e4)]
    device: Literal["auto", "cpu", "cuda"]
    checkpoint_seconds: Annotated[Number, Within(0.0, 1e9, "s")]
    augment: AugmentTable

    def fault(self) -> str | None:
        """Weights are averaged while the statistics of batch normalisation still change."""
        if self.averaged_share > self.frozen_share:
            return (
                f"averaged_share = {self.averaged_share} is above frozen_share = {self.frozen_share}: weights are averaged "
                "only where batch normalisation keeps its statistics; lower the one or raise the other"
            )
        return None


class TrainTable(TrainingTable):
    """[train]: training of networks."""

    epochs_of: EpochsTable
    also: Names


class EvaluateTable(ParameterTable):
    """[evaluate]: errors of networks."""

    force_edges: Annotated[tuple[Annotated[Number, Within(0.0, 1e6, "N")], ...], MinLen(2), RISING]
    bootstrap: Annotated[int, Within(1, 1e7)]
    seed: Seed
    threads: Annotated[int, Within(1, 1e4)]


class LabelsTable(ParameterTable):
    """[labels]: what a label holds."""

    channels: Annotated[tuple[Literal["force", "displacement", "traction", "traction_deformed"], ...], SOME]
    largest_outside_share: Fraction

    def fault(self) -> str | None:
        """The first channel is not "force", or a channel is named twice."""
        if self.channels[0] != "force" or len(set(self.channels)) < len(self.channels):
            return f'channels = {list(self.channels)}: name each once, and "force" first'
        return None


class DatasetTable(ParameterTable):
    """[dataset]: which presses train, validate and test."""

    validation: Annotated[Number, Within(0.0, 0.9)]
    test: Annotated[Number, Within(0.0, 0.9)]
    unseen_indenters: Names
    unseen_sensors: Names
    same_press_mm: Length
    same_press_deg: Annotated[Number, Within(TINY, 360.0, "degrees")]
    seed: Seed

    def fault(self) -> str | None:
        """Fractions leave no presses for training."""
        if self.validation + self.test >= 1.0:
            return f"validation = {self.validation} and test = {self.test}: give shares whose sum is below 1"
        return None


class CalibrateSolverTable(ParameterTable):
    """[calibrate.solver]: hexahedra and load steps of the solves behind the emulator."""

    size: Size
    layers: Annotated[int, Within(1, 100)]
    widened: tuple[Annotated[int, Within(1, 99)], ...]
    press_steps: Steps
    shear_steps: Steps
    final_tolerance: Annotated[Number, Within(TINY, 1.0)]

    def fault(self) -> str | None:
        """A number of widened layers is above the one before it, or not below the number of all layers."""
        if list(self.widened) != sorted(self.widened, reverse=True) or any(w >= self.layers for w in self.widened):
            return f"widened = {list(self.widened)}: give numbers below layers = {self.layers}, none above the one before it"
        return None


# Keys of each kind of prior.
PRIOR_KEYS = {
    "normal": ("mean", "spread"),
    "lognormal": ("median", "spread"),
    "halfnormal": ("spread",),
    "cauchy": ("mean", "spread"),
}


class PriorTable(ParameterTable):
    """One table of [calibrate.priors]: the kind of a prior and its numbers, or the value at which it is fixed."""

    kind: Literal["normal", "lognormal", "halfnormal", "cauchy"]
    free: bool | None = None
    fixed: Finite | None = None
    mean: Finite | None = None
    median: Finite | None = None
    spread: Finite | None = None
    reason: Line | None = None

    @property
    def numbers(self) -> dict[str, float]:
        """The given numbers of the prior's kind, by key."""
        given = {key: getattr(self, key) for key in PRIOR_KEYS[self.kind]}
        return {key: value for key, value in given.items() if value is not None}

    def fault(self) -> str | None:
        """A number is missing, the spread is not positive, or the median of a lognormal prior is not."""
        if self.free is False:
            return None
        keys, given = PRIOR_KEYS[self.kind], self.numbers
        missing = [key for key in keys if key not in given]
        if missing:
            return f'{missing[0]} is missing: a prior of kind "{self.kind}" needs {" and ".join(keys)}'
        if given["spread"] <= 0.0:
            said = ", ".join(f"{key} = {value}" for key, value in given.items())
            return f"{said}: the prior has no width; raise `{keys[-1]}`"
        if self.kind.startswith("log") and given[keys[0]] <= 0.0:
            return f"{keys[0]} = {given[keys[0]]}: a logarithmic prior needs a positive one"
        return None


class PriorsTable(ParameterTable):
    """[calibrate.priors]: the prior of each parameter."""

    c10: PriorTable
    offset: PriorTable
    compliance: PriorTable
    shear_compliance: PriorTable
    mu: PriorTable
    tare: PriorTable
    noise: PriorTable
    scatter: PriorTable
    discretisation: PriorTable
    indenter: PriorTable

    def fault(self) -> str | None:
        """C10 is fixed or outside the range of gels, or another parameter is fixed without its value."""
        if self.c10.free is False:
            return "c10: free = false; it is what calibrate finds, so give it a narrow prior where it is known"
        for key in ("mean", "median"):
            value = self.c10.numbers.get(key)
            if value is not None and not SOFTEST <= value <= STIFFEST:
                return f"c10: {key} = {value}: give a number from {SOFTEST:g} to {STIFFEST:g} MPa"
        for name in (field.name for field in fields(self)):
            prior = getattr(self, name)
            if prior.free is False and prior.fixed is None and name != "indenter":
                return f"{name}: free = false needs `fixed`, the value it is held at"
        return None


class CalibrateTable(ParameterTable):
    """[calibrate]: the posterior from a log's forces."""

    max_presses: Count
    friction_nodes: Annotated[tuple[Annotated[Number, Within(TINY, 1e3)], ...], RISING, SOME]
    reach_mm: Annotated[Number, Within(0.0, 10.0, "mm")]
    tail: Annotated[Number, Within(TINY, 1e6)]
    outlier_scales: Positive
    seed: Seed
    autocorrelation_times: Count
    max_steps: Annotated[int, Within(1, 1e9)]
    refine: Literal["none", "draft", "label", "fine"]
    solver: CalibrateSolverTable
    priors: PriorsTable


class PosesTable(ParameterTable):
    """[poses]: how the path of the tip follows from the commanded one, and which presses are rejected."""

    touch_offset_mm: Annotated[Number, Within(-10.0, 10.0, "mm")]
    compliance_mm_per_n: Annotated[Number, Within(0.0, 1.0, "mm/N")]
    shear_compliance_mm_per_n: Annotated[Number, Within(0.0, 1.0, "mm/N")]
    tilt_deg: Tilt
    mounting_tilt_deg: dict[Name, Tilt]
    images: bool
    judge_images: bool
    deepest_share: Annotated[Number, Within(TINY, 1.0)]
    farthest_shear_mm: Annotated[Number, Within(0.0, 1e3, "mm")]
    bulge_mm: Annotated[Number, Within(0.0, 1e3, "mm")]
    band_mm: Annotated[Number, Within(1e-3, 1e3, "mm")]


class MaterialTable(ParameterTable):
    """[material]: the gel, in MPa."""

    nu: Nu
    c10: Stiffness | Literal["calibrated"]
    c10_interval68: Interval | None = None  # of a frozen calibration
    c10_interval95: Interval | None = None


class InterfaceTable(ParameterTable):
    """[interface]: tangential contact law between indenter and gel."""

    law: Law
    mu: Annotated[Number, Within(0.0, 1e3)]
    mu_error: Annotated[Number, Within(0.0, 1e3)]


class FeaTable(ParameterTable):
    """[fea]: finite element solves of presses."""

    method: Method
    tolerance: Annotated[Number, Within(TINY, 1.0)]
    verify: Fraction
    edge_mm: Size
    inside_mm: Size
    press_steps: Steps
    shear_steps: Steps
    step_mm: Length
    stiffness: Positive
    rounds: Steps
    pull_tolerance: Annotated[Number, Within(TINY, 1.0)]
    penetration_mm: Annotated[Number, Within(TINY, 1.0, "mm")]
    contact_mm: Size
    contact_stiffness: Positive
    residual: Annotated[Number, Within(TINY, 1.0)]
    timeout_s: Seconds


class ReferenceTable(ParameterTable):
    """[pareto.reference]: load steps of the reference, and its mesh."""

    press_steps: Steps
    shear_steps: Steps
    size_mm: Size
    edge_mm: Size


Sizes = Annotated[tuple[Annotated[Number, Within(0.1, 10.0, "mm")], ...], SOME]
Layers = Annotated[tuple[Annotated[int, Within(1, 100)], ...], SOME]


def uneven(sizes: tuple[float, ...], layers: tuple[int, ...]) -> str | None:
    """What is wrong if sizes and layers of hexahedra differ in number; None if they do not."""
    if len(sizes) != len(layers):
        return f"hex_sizes_mm has {len(sizes)} sizes and hex_layers {len(layers)}: give each size its layers"
    return None


class ParetoTable(ParameterTable):
    """[pareto]: the chart of speed against accuracy."""

    sensor: Name
    hex_sizes_mm: Sizes
    hex_layers: Layers
    ccx_sizes_mm: Sizes
    load_steps: Annotated[tuple[Annotated[int, Within(1, 1000)], ...], SOME]
    limit_s: Seconds
    reference: ReferenceTable

    def fault(self) -> str | None:
        """Sizes and layers of hexahedra differ in number."""
        return uneven(self.hex_sizes_mm, self.hex_layers)


Engine = Literal["hex", "ccx"]


class LevelsTable(ParameterTable):
    """[stability.levels]: values of each factor that is varied."""

    depth: Annotated[tuple[Annotated[Number, Within(TINY, 4.0, "mm")], ...], SOME]
    shear: Annotated[tuple[Annotated[Number, Within(0.0, 10.0)], ...], SOME]
    tilt: Annotated[tuple[Annotated[Number, Within(0.0, 60.0, "degrees")], ...], SOME]
    ridge: Annotated[tuple[Annotated[Number, Within(0.05, 5.0, "mm")], ...], SOME]
    friction: Annotated[tuple[Annotated[Number, Within(0.0, 100.0)], ...], SOME]
    nu: Annotated[tuple[Annotated[Number, Within(0.0, 0.4999)], ...], SOME]
    steps: Annotated[tuple[Annotated[int, Within(1, 1000)], ...], SOME]


class StabilityTable(ParameterTable):
    """[stability]: the map of where solves converge."""

    depth_mm: Annotated[Number, Within(TINY, 4.0, "mm")]
    nu: Nu
    steps: Steps
    size: dict[Engine, Size]
    sizes: dict[Engine, Sizes]
    layers: dict[str, Annotated[int, Within(1, 100)]]
    random: Whole
    seed: Seed
    drift: Annotated[Number, Within(TINY, 1e3)]
    limit_s: Seconds
    minutes: Annotated[Number, Within(0.0, 1e6, "minutes")]
    levels: LevelsTable

    def fault(self) -> str | None:
        """A solver lacks its sizes, sizes.hex is shorter than sizes.ccx, or a size of hexahedra lacks its layers."""
        for name in ("size", "sizes"):
            needed = ("hex", "ccx")
            lost = [engine for engine in needed if engine not in getattr(self, name)]
            if lost:
                return f"{name}.{lost[0]} is missing: give an element size in mm for {', '.join(needed)}"
        if len(self.sizes["hex"]) < len(self.sizes["ccx"]):
            return f"sizes.hex has fewer sizes than sizes.ccx ({len(self.sizes['ccx'])}): give each its counterpart"
        bare = [size for size in (*self.sizes["hex"], self.size["hex"]) if str(size) not in self.layers]
        if bare:
            return f'layers has no "{bare[0]}": give the layers of each size of hexahedra'
        return None


class Params(ParameterTable):
    """All tables of workflow/params.toml."""

    plan: PlanTable
    report: ReportTable
    train: TrainTable
    evaluate: EvaluateTable
    labels: LabelsTable
    dataset: DatasetTable
    calibrate: CalibrateTable
    poses: PosesTable
    material: MaterialTable
    interface: InterfaceTable
    fea: FeaTable
    pareto: ParetoTable
    stability: StabilityTable
