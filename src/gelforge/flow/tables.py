"""The tables of workflow/params.toml, key by key: types, units and allowed values.

The purpose of each value, and its reason, stands beside it in workflow/params.toml; a test keeps the two in step. Values
that nobody has to set for a dataset are constants (`ClassVar`) of the same classes, with their reasons here. They stand in
no parameter file, so a stage's VERSION rises when one changes its results. Keys of solves hold them all the same.
"""

import re
from dataclasses import field, fields
from typing import Annotated, ClassVar, Literal, get_args

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
SHIPPED = "shipped"  # name, in targets and parameters, of the network that predict and live use if none is named
# Presses from which a dataset's own network is worth training: its error is then 1.4 N, that of a guess 9 N.
ENOUGH_PRESSES = 500
SHIPPED_IMAGE = (320, 240)  # width and height of the images that the shipped network reads


# What people set for a dataset; a newcomer sets these and nothing else. `method` is the dial between speed and accuracy
# of labels: with "auto", `tolerance` is the largest error that a label may state.
USUAL = (
    "fea.method", "fea.tolerance", "material.c10", "interface.law", "poses.images", "poses.compliance_mm_per_n",
    "labels.channels", "train.epochs", "train.also", "report.model",
)  # fmt: skip


class PlanTable(ParameterTable):
    """[plan]: how a dataset is cut into shards."""

    shard_size: Count


class ReportTable(ParameterTable):
    """[report]: what the page holds."""

    # Up to this many megabytes, the images, force maps and deformed gels of all presses are embedded in the page. Above
    # that, they are written to files beside the page, which loads them when a press is opened.
    embed_mb: ClassVar[float] = 12.0
    model: Annotated[str, Rule(re.compile(f"({NAME})?").fullmatch, NAMED)]
    branches: tuple[Literal["calibrate"], ...]


class AugmentTable(ParameterTable):
    """[train.augment]: augmentation of training images."""

    probability: Fraction
    # The values of the paper: noise with this standard deviation, in fractions of full scale, is added; brightness,
    # contrast and saturation are multiplied by up to 1 +- these; hue is turned by up to this fraction of the circle.
    noise: ClassVar[float] = 0.05
    brightness: ClassVar[float] = 0.25
    contrast: ClassVar[float] = 0.25
    saturation: ClassVar[float] = 0.25
    hue: ClassVar[float] = 0.1
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
    # Bootstrap resamples of the presses for the 95 % intervals of the errors, and their seed.
    bootstrap: ClassVar[int] = 2000
    seed: ClassVar[int] = 1
    threads: ClassVar[int] = 1


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
    # Presses of one indenter that are closer to each other than this count as one press seen several times (at other
    # depths, by other sensors) and go to the same set, so that no network is tested on a press that it learnt from.
    # Rotations by a symmetry of the indenter count as none: any for a ball, 90 degrees for a square block. Exception:
    # images by unseen sensors are in test sets of their own, whoever else saw the press, because these test the sensor
    # and not the press. A bench repeats a press within some hundredths of a millimetre.
    same_press_mm: ClassVar[float] = 0.05
    same_press_deg: ClassVar[float] = 0.5
    seed: ClassVar[int] = 1

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
    # Under Coulomb's law no load step of the press is longer, mm, as on the coarse path of a label. Half as much
    # takes 1.4 times as long and moves normal forces by up to 0.04 %, sideways ones by 0.2 %.
    press_mm: ClassVar[float] = 0.1

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
    tilt: PriorTable
    origin: PriorTable

    def fault(self) -> str | None:
        """C10 is fixed or outside the range of gels, or another parameter is fixed without its value."""
        if self.c10.free is False:
            return "c10: free = false; it is what calibrate finds, so give it a narrow prior where it is known"
        for key in ("mean", "median"):
            value = self.c10.numbers.get(key)
            if value is not None and not SOFTEST <= value <= STIFFEST:
                return f"c10: {key} = {value}: give a number from {SOFTEST:g} to {STIFFEST:g} MPa"
        for name in (each.name for each in fields(self)):
            prior = getattr(self, name)
            if prior.free is False and prior.fixed is None and name != "indenter":
                return f"{name}: free = false needs `fixed`, the value it is held at"
        return None


class CalibrateTable(ParameterTable):
    """[calibrate]: the posterior from a log's forces."""

    max_presses: Count
    # Under Coulomb's law each press is solved without slip and with the first of these friction coefficients, a sliding
    # one with all of them. Forces at other coefficients are interpolated: within 1 % of solved ones from 0.5 on, 2 % at
    # 0.2.
    friction_nodes: ClassVar[tuple[float, ...]] = (0.25, 0.6)
    # Presses are solved this much deeper than commanded, because touch may have been found too late: five times the
    # spread of the prior of the touch offset.
    reach_mm: ClassVar[float] = 0.15
    # Degrees of freedom of Student's t distribution of the residuals. 4 is close to a normal distribution in its middle,
    # but one gross error in twenty readings does not pull the result.
    tail: ClassVar[float] = 4.0
    # A reading whose residual exceeds this many times its expected scale is listed as an outlier.
    outlier_scales: ClassVar[float] = 4.0
    # Sampling by emcee. The chain ends after this many autocorrelation times (as emcee advises) if its walkers agree. It
    # fails after max_steps steps.
    seed: ClassVar[int] = 1
    autocorrelation_times: ClassVar[int] = 25
    max_steps: ClassVar[int] = 60000
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
    mounting_touch_offset_mm: dict[Name, Annotated[Number, Within(-10.0, 10.0, "mm")]]
    images: bool
    judge_images: bool
    deepest_share: Annotated[Number, Within(TINY, 1.0)]
    farthest_shear_mm: Annotated[Number, Within(0.0, 1e3, "mm")]
    # The gel bulges up beside a deep press. Surfaces of indenters are kept up to this height above the gel's apex, mm,
    # rounded up to a multiple of band_mm, so that presses of similar depth share one surface.
    bulge_mm: ClassVar[float] = 0.5
    band_mm: ClassVar[float] = 0.5


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
    timeout_s: Seconds
    # Load steps of the in-process load path from which CalculiX gets the contact: a point sticks where it first touched.
    # Four and six press steps differ by 0.03 % of the force of a 15 mm sphere at 1 mm, but by 0.6 % at 2 mm, so no press
    # step is longer than step_mm.
    press_steps: ClassVar[int] = 4
    shear_steps: ClassVar[int] = 3
    step_mm: ClassVar[float] = 0.35
    # Contact penalty, multiples of C10 per mm: a press is a thousandth softer than against a perfectly rigid body.
    stiffness: ClassVar[float] = 2000.0
    # Contact iterations: how often the set of touching points may change at the end of the load path.
    rounds: ClassVar[int] = 8
    # In a valid result at most this fraction of the normal force pulls, and no free point lies deeper than this in the
    # indenter, mm; otherwise its status is UNSETTLED.
    pull_tolerance: ClassVar[float] = 2e-3
    penetration_mm: ClassVar[float] = 2e-3
    # "ccx-contact": longest edges of the gel's tetrahedra under the indenter, mm, and contact penalty, multiples of C10
    # per mm, both as FEATS has them. The gel sinks into the indenter by tenths of a millimetre; checks take 0.7 and 1000.
    contact_mm: ClassVar[float] = 1.4
    contact_stiffness: ClassVar[float] = 50.0
    # Largest nodal residual divided by the mean nodal force; contact and base reactions then agree to 1e-7.
    residual: ClassVar[float] = 1e-5


class ReferenceTable(ParameterTable):
    """The chart's reference: load steps, and longest edges of its tetrahedra, mm."""

    # It is checked by a second solve with half as many steps on elements of twice the size.
    press_steps: int = 8
    shear_steps: int = 4
    size_mm: float = 0.5  # under the press
    # Where the contact ends. The force under flat bodies depends mostly on it: it is 0.7 % too large under a fillet of
    # 0.1 mm. With 0.16 mm no equilibrium was found under a sharp edge and in shear.
    edge_mm: float = 0.3


class ParetoTable(ParameterTable):
    """What the chart of speed against accuracy compares: constants, the same for all datasets."""

    sensor: str = "feats_mini"  # in the 24 x 32 cells of whose image forces are compared
    # Sizes of the hexahedra under the press, mm, and the layers of each. The first size is also compared at every number
    # of load steps. The same for CalculiX' tetrahedra.
    hex_sizes_mm: tuple[float, ...] = (0.7, 1.4)
    hex_layers: tuple[int, ...] = (6, 3)
    ccx_sizes_mm: tuple[float, ...] = (1.4, 1.0)
    # Numbers of load steps of the press; the shear takes half as many. Element sizes are compared at the first number.
    load_steps: tuple[int, ...] = (4, 2)
    # CalculiX' own contact takes minutes to a quarter of an hour, so it is charted on these scenes alone.
    contact_scenes: tuple[str, ...] = ("sphere_shallow", "sphere_1mm")
    limit_s: float = 3600.0  # processor time after which any one solve is stopped
    reference: ReferenceTable = ReferenceTable()


class LevelsTable(ParameterTable):
    """Values of each factor that the map of convergence varies."""

    depth: tuple[float, ...] = (0.02, 0.1, 0.5, 1.0, 2.0, 3.5)
    shear: tuple[float, ...] = (0.0, 0.25, 0.5)
    tilt: tuple[float, ...] = (2.0, 20.0)  # slope of a block's lower side, degrees
    ridge: tuple[float, ...] = (0.5, 0.3)  # width of a ridge, mm
    friction: tuple[float, ...] = (0.0, 0.7)  # coefficient, 0 for frictionless
    nu: tuple[float, ...] = (0.45, 0.475, 0.499)
    steps: tuple[int, ...] = (1, 4, 40)


class StabilityTable(ParameterTable):
    """What the map of convergence varies, one factor at a time around one press: constants, the same for all datasets.

    The press is solved by `hex` (method "label") and `ccx` of [fea], and on the finest hexahedra for comparison.
    """

    depth_mm: float = 1.0
    nu: float = 0.475
    steps: int = 4  # load steps while element sizes are varied
    # Element sizes, mm, while load steps are varied; those that are varied, coarse to fine; layers of hexahedra of each.
    size: dict[str, float] = field(default_factory=lambda: {"hex": 0.7, "ccx": 1.4})
    sizes: dict[str, tuple[float, ...]] = field(default_factory=lambda: {"hex": (1.4, 0.7), "ccx": (1.4, 1.0)})
    layers: dict[str, int] = field(default_factory=lambda: {"1.4": 3, "0.7": 6})
    random: int = 6  # combinations of depth, shear, place, body and Poisson's ratio; each is solved three times
    seed: int = 1
    drift: float = 0.05  # a converged solve whose total force differs by more from the finest one drifts
    limit_s: float = 300.0  # processor time after which a solve is stopped
    minutes: float = 240.0  # for one row of the map; cases beyond are marked as not run
    levels: LevelsTable = LevelsTable()


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
    pareto: ClassVar[ParetoTable] = ParetoTable()
    stability: ClassVar[StabilityTable] = StabilityTable()
