"""What every parameter of workflow/params.toml may be: kind, unit, bounds. Defaults and their reasons stand there.

A `*` in a name stands for one name that the table itself gives, such as that of a region.
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")
SMALLEST = 1e-12


@dataclass(frozen=True)
class Number:
    """A finite number from `low` to `high`, both allowed; whole: without a fraction."""

    low: float
    high: float
    unit: str = ""
    whole: bool = False

    def fault(self, value: Any) -> str | None:
        """What to give in place of a value; None where it is one."""
        kind, unit = "a whole number" if self.whole else "a number", f" {self.unit}" if self.unit else ""
        told = f"give {kind} from {self.low:g} to {self.high:g}{unit}"
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            return told if not isinstance(value, float) else f"{told}; it must be finite"
        return None if self.low <= value <= self.high and not (self.whole and value % 1) else told


@dataclass(frozen=True)
class Flag:
    """true or false."""

    def fault(self, value: Any) -> str | None:
        """What to give in place of a value; None where it is one."""
        return None if isinstance(value, bool) else "give true or false"


@dataclass(frozen=True)
class Word:
    """One of `choices`; without any, a name, or a text of one line where `free`. empty: "" is one too."""

    choices: tuple[str, ...] = ()
    free: bool = False
    empty: bool = False

    def fault(self, value: Any) -> str | None:
        """What to give in place of a value; None where it is one."""
        if self.choices:
            return None if value in self.choices else f"choose one of {', '.join(self.choices)}"
        if not isinstance(value, str):
            return "give text"
        if self.empty and not value:
            return None
        if self.free:
            return None if value.isprintable() else "give text of one line"
        return None if NAME.fullmatch(value) else "give a name of letters, digits, dots, - and _"


@dataclass(frozen=True)
class Items:
    """A list whose items are all alike: at least `least`, exactly `exactly` where that is given; rising: each above the last."""

    of: "Number | Word"
    least: int = 1
    exactly: int = 0
    rising: bool = False

    def fault(self, value: Any) -> str | None:
        """What to give in place of a value; None where it is one."""
        if not isinstance(value, list):
            return "give a list"
        if self.exactly and len(value) != self.exactly:
            return f"give a list of {self.exactly}"
        if len(value) < self.least:
            return f"give a list of at least {self.least}"
        found = next((fault for item in value if (fault := self.of.fault(item))), None)
        if found:
            return f"in the list, {found}"
        if self.rising and any(b <= a for a, b in zip(value, value[1:], strict=False)):
            return "give a list in which each is larger than the one before"
        return None


@dataclass(frozen=True)
class C10:
    """A stiffness in MPa, or the word that takes the calibrated one."""

    def fault(self, value: Any) -> str | None:
        """What to give in place of a value; None where it is one."""
        good = value == "calibrated" or Number(1e-6, 100.0).fault(value) is None
        return None if good else 'give MPa, such as 0.0725, or "calibrated"'


Spec = Number | Flag | Word | Items | C10

LAWS = Word(("no_slip", "coulomb", "frictionless"))
SEED, THREADS = Number(0, 2**32, whole=True), Number(1, 1e4, whole=True)
SHARE, COUNT, STEPS = Number(0.0, 1.0), Number(1, 1e9, whole=True), Number(1, 1e3, whole=True)
SIZE, LENGTH, LAYERS = Number(0.05, 20.0, "mm"), Number(0.0, 1e3, "mm"), Number(1, 100, whole=True)
SECONDS, TIGHT = Number(SMALLEST, 1e9, "s"), Number(SMALLEST, 1.0)
NU = Number(0.0, 0.4999)

SCHEMA: dict[str, Spec] = {
    "plan.shard_size": Number(1, 1e6, "samples", whole=True),
    "report.embed_mb": Number(0.0, 1e4, "MB"),
    "report.model": Word(empty=True),
    "report.branches": Items(Word(), least=0),
    "train.epochs": Number(1, 1e6, whole=True),
    "train.batch": Number(1, 1e6, "images", whole=True),
    "train.learning_rate": Number(SMALLEST, 1e3),
    "train.schedule": Word(("plateau", "cosine")),
    "train.plateau_factor": Number(SMALLEST, 1.0),
    "train.plateau_patience": Number(0, 1e6, "epochs", whole=True),
    "train.least_rate": Number(0.0, 1e3),
    "train.total_weight": Number(0.0, 1e6),
    "train.total_huber": Number(0.0, 1e6),
    "train.shift_cells": Number(0, 100, "cells", whole=True),
    "train.mirrored_share": SHARE,
    "train.settle_images": Number(1, 1e9, "images", whole=True),
    "train.frozen_share": SHARE,
    "train.seed": SEED,
    "train.threads": THREADS,
    "train.mixed_precision": Flag(),
    "train.checkpoint_seconds": Number(0.0, 1e9, "s"),
    "train.epochs_of.*": Number(0, 1e6, whole=True),
    "train.augment.probability": SHARE,
    "train.augment.noise": SHARE,
    "train.augment.brightness": SHARE,
    "train.augment.contrast": SHARE,
    "train.augment.saturation": SHARE,
    "train.augment.hue": Number(0.0, 0.5, "turns"),
    "evaluate.force_edges": Items(Number(0.0, 1e6, "N"), least=2, rising=True),
    "evaluate.bootstrap": Number(1, 1e7, whole=True),
    "evaluate.seed": SEED,
    "evaluate.threads": THREADS,
    "labels.channels": Items(Word(("force", "displacement", "traction", "traction_deformed"))),
    "labels.largest_outside_share": SHARE,
    "dataset.validation": Number(0.0, 0.9),
    "dataset.test": Number(0.0, 0.9),
    "dataset.unseen_indenters": Items(Word(), least=0),
    "dataset.unseen_sensors": Items(Word(), least=0),
    "dataset.force_edges": Items(Number(0.0, 1e6, "N"), least=0, rising=True),
    "dataset.same_press_mm": LENGTH,
    "dataset.same_press_deg": Number(0.0, 360.0, "degrees"),
    "dataset.seed": SEED,
    "calibrate.law": LAWS,
    "calibrate.compare": Flag(),
    "calibrate.max_presses": Number(1, 1e6, whole=True),
    "calibrate.shear": Flag(),
    "calibrate.friction_nodes": Items(Number(SMALLEST, 100.0), least=0, rising=True),
    "calibrate.reach_mm": LENGTH,
    "calibrate.shear_depths": Items(Number(SMALLEST, 1.0)),
    "calibrate.tail": Number(1.0, 1e6),
    "calibrate.outlier_scales": Number(SMALLEST, 1e6),
    "calibrate.walkers": Number(4, 1e5, whole=True),
    "calibrate.seed": SEED,
    "calibrate.autocorrelation_times": COUNT,
    "calibrate.acceptance": Items(SHARE, exactly=2, rising=True),
    "calibrate.split_rhat": Number(1.0, 10.0),
    "calibrate.max_steps": COUNT,
    "calibrate.solver.size": SIZE,
    "calibrate.solver.layers": LAYERS,
    "calibrate.solver.press_steps": STEPS,
    "calibrate.solver.shear_steps": STEPS,
    "calibrate.solver.final_tolerance": TIGHT,
    "calibrate.refine.on": Flag(),
    "calibrate.refine.size": SIZE,
    "calibrate.refine.layers": LAYERS,
    "calibrate.priors.*.kind": Word(("normal", "lognormal", "halfnormal")),
    "calibrate.priors.*.mean": Number(-1e6, 1e6),
    "calibrate.priors.*.median": Number(SMALLEST, 1e6),
    "calibrate.priors.*.spread": Number(SMALLEST, 1e6),
    "calibrate.priors.*.reason": Word(free=True),
    "calibrate.priors.*.free": Flag(),
    "poses.touch_offset_mm": Number(-10.0, 10.0, "mm"),
    "poses.compliance_mm_per_n": Number(0.0, 10.0, "mm/N"),
    "poses.shear_compliance_mm_per_n": Number(0.0, 10.0, "mm/N"),
    "poses.images": Flag(),
    "poses.deepest_share": TIGHT,
    "poses.farthest_shear_mm": LENGTH,
    "poses.bulge_mm": LENGTH,
    "poses.band_mm": Number(1e-3, 1e3, "mm"),
    "material.c10": C10(),
    "material.nu": NU,
    "interface.law": LAWS,
    "interface.mu": Number(0.0, 1e3),
    "meshes.gel": Word(),
    "meshes.growth": Number(SMALLEST, 10.0),
    "meshes.coarsest_mm": SIZE,
    "meshes.fine_depth_mm": LENGTH,
    "meshes.hold.*": Number(0.0, 10.0),
    "meshes.regions.*": Items(SIZE, exactly=2),
    "fea.fidelity": Word(("hex", "ccx", "ccx-native", "ccx-fine", "auto")),
    "fea.meshes": Items(Word()),
    "fea.fine_meshes": Items(Word()),
    "fea.tolerance": TIGHT,
    "fea.charted.*": Items(Number(0.0, 1e6), exactly=2),
    "fea.hex_quality": Word(("demo", "draft", "label", "fine")),
    "fea.press_steps": STEPS,
    "fea.shear_steps": STEPS,
    "fea.step_mm": Number(1e-3, 1e3, "mm"),
    "fea.stiffness": Number(SMALLEST, 1e9, "C10/mm"),
    "fea.rounds": STEPS,
    "fea.pull_tolerance": TIGHT,
    "fea.penetration_mm": Number(SMALLEST, 1.0, "mm"),
    "fea.residual": TIGHT,
    "fea.timeout_s": SECONDS,
    "forces.noise": Number(0.0, 1.0),
    "forces.base_mismatch": TIGHT,
    "pareto.sensor": Word(),
    "pareto.hex_sizes_mm": Items(SIZE),
    "pareto.hex_layers": Items(LAYERS),
    "pareto.ccx_sizes_mm": Items(SIZE),
    "pareto.load_steps": Items(STEPS),
    "pareto.native_sizes_mm": Items(SIZE, least=0),
    "pareto.native_limit_s": SECONDS,
    "pareto.halved": Items(Word(), least=0),
    "pareto.limit_s": SECONDS,
    "pareto.reference.press_steps": STEPS,
    "pareto.reference.shear_steps": STEPS,
    "pareto.grading.growth": Number(SMALLEST, 10.0),
    "pareto.grading.fine_depth_mm": LENGTH,
    "pareto.regions.*.box": Items(Number(-1e3, 1e3, "mm"), exactly=4),
    "pareto.regions.*.size": SIZE,
    "pareto.regions.*.hold": Number(0.0, 10.0),
    "pareto.quick.scenes": Items(Word()),
    "pareto.quick.hex_sizes_mm": Items(SIZE),
    "pareto.quick.hex_layers": Items(LAYERS),
    "pareto.quick.steps": STEPS,
    "pareto.quick.reference.size": SIZE,
    "pareto.quick.reference.layers": LAYERS,
    "pareto.quick.reference.press_steps": STEPS,
    "stability.depth_mm": Number(SMALLEST, 1e3, "mm"),
    "stability.nu": NU,
    "stability.steps": STEPS,
    "stability.size.*": SIZE,
    "stability.sizes.*": Items(SIZE),
    "stability.layers.*": LAYERS,
    "stability.native_depths_mm": Items(Number(SMALLEST, 1e3, "mm"), least=0),
    "stability.random": Number(0, 1e6, whole=True),
    "stability.seed": SEED,
    "stability.drift": TIGHT,
    "stability.limit_s": SECONDS,
    "stability.native_limit_s": SECONDS,
    "stability.minutes": Number(0.0, 1e9, "minutes"),
    "stability.levels.depth": Items(Number(SMALLEST, 1e3, "mm")),
    "stability.levels.shear": Items(LENGTH),
    "stability.levels.nu": Items(NU),
    "stability.levels.steps": Items(STEPS),
}


def spec_of(name: str) -> Spec | None:
    """The specification of a parameter by its dotted name; None where there is none."""
    if name in SCHEMA:
        return SCHEMA[name]
    for pattern, spec in SCHEMA.items():
        if "*" in pattern:
            head, tail = pattern.split("*")
            middle = name.removeprefix(head).removesuffix(tail)
            whole = name.startswith(head) and name.endswith(tail) and len(name) > len(head) + len(tail)
            if whole and (not tail or "." not in middle):
                return spec
    return None


# What a table's values must fulfil together: name of the table, what holds of a good one, the sentence for others.
Together = tuple[str, Callable[[dict[str, Any]], bool], str]
TOGETHER: tuple[Together, ...] = (
    (
        "dataset",
        lambda t: t["validation"] + t["test"] < 1.0,
        "validation and test together must leave presses to train on",
    ),
    (
        "pareto",
        lambda t: len(t["hex_sizes_mm"]) == len(t["hex_layers"]),
        "hex_sizes_mm and hex_layers must be of one length",
    ),
    (
        "pareto.quick",
        lambda t: len(t["hex_sizes_mm"]) == len(t["hex_layers"]),
        "hex_sizes_mm and hex_layers must be of one length",
    ),
    ("train", lambda t: t["least_rate"] <= t["learning_rate"], "least_rate must not be above learning_rate"),
    ("calibrate", lambda t: t["walkers"] % 2 == 0, "walkers must be an even number"),
)
