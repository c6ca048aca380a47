"""What a calibration found, and how the stages that follow it read it.

Labels follow the posterior of their log (`results/DATASET/calibrate/summary.json`) if the dataset sets
`[material] c10 = "calibrated"`. If there is a frozen calibration, `data/DATASET/calibration.toml`, they follow that
instead: its values do not move when rows are added. Stages read the one or the other from one file of one form,
`results/DATASET/calibrate/followed.toml`, which is the same before and after `make freeze`.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gelforge.errors import BadInput
from gelforge.flow.files import DAMAGED, read_json, read_toml, write_text
from gelforge.flow.layout import Layout, command_for
from gelforge.flow.params import StageParameters, laid_over
from gelforge.flow.schema import Place, altered, parse, plain
from gelforge.flow.tables import Params

FROZEN = "calibration.toml"  # in data/DATASET/, beside dataset.toml
KINDS = {"name": str, "law": str, "presses": list, "params": dict}
# Decimals that are kept: fewer than any posterior resolves, so that another processor finds the same values.
DIGITS = {
    "c10": 4,
    "touch_offset_mm": 3,
    "compliance_mm_per_n": 4,
    "shear_compliance_mm_per_n": 4,
    "mu": 2,
    "mu_error": 2,
    "tilt_deg": 1,
}
BENCH = {
    "touch_offset_mm": "offset",
    "compliance_mm_per_n": "compliance",
    "shear_compliance_mm_per_n": "shear_compliance",
}
INTERVALS = ("interval68", "interval95")
SET = {
    "material": {"c10", *(f"c10_{name}" for name in INTERVALS)},
    "poses": {*BENCH, "tilt_deg", "mounting_tilt_deg", "mounting_touch_offset_mm"},
    "interface": {"mu", "mu_error"},
}


STATED = {"tilt_deg", "mounting_tilt_deg"}  # keys of [poses] that a dataset may set although it is calibrated


@dataclass(frozen=True)
class CalibratedValues:
    """What a calibration found, rounded.

    law: of the contact. presses: sample_ids that it used. params: tables that override those of params.toml.
    """

    name: str
    law: str
    presses: tuple[str, ...]
    params: dict[str, dict[str, Any]]


def found_in(dataset: str, summary: Mapping[str, Any]) -> CalibratedValues:
    """The values of a calibration's summary.json that labels follow."""
    c10, bench = summary["c10"], summary["bench"]
    material = {"c10": round(c10["median"], DIGITS["c10"])} | {
        f"c10_{name}": [round(value, DIGITS["c10"]) for value in c10[name]] for name in INTERVALS
    }
    poses = {key: round(bench[name], DIGITS[key]) + 0.0 for key, name in BENCH.items()}
    params = {"material": material, "poses": poses | of_mountings(bench["mountings"], bench["stated_tilt_deg"])}
    if "mu" in summary["parameters"]:
        mu = summary["parameters"]["mu"]
        low, high = mu["interval95"]
        params["interface"] = {
            "mu": round(mu["median"], DIGITS["mu"]),
            "mu_error": round((high - low) / 2, DIGITS["mu_error"]),
        }
    digest = hashlib.sha256(repr(params).encode()).hexdigest()[:6]
    return CalibratedValues(f"{dataset}-{digest}", summary["law"], tuple(summary["used"]), params)


def of_mountings(found: Mapping[str, Mapping], stated: Mapping[str, Any]) -> dict[str, Any]:
    """Values of [poses] for the mountings that a calibration found: tilt, and touch offsets where there are several.

    stated: tilts that the dataset states itself, by mounting, which stay. Of several mountings the tilt of rows that name
    none holds for these rows alone: a named one whose tilt was not found has none.
    """
    tilts = {name: [round(angle, DIGITS["tilt_deg"]) + 0.0 for angle in one["tilt_deg"]]
             for name, one in found.items() if "tilt_deg" in one}  # fmt: skip
    unnamed = {"tilt_deg": tilts.pop("")} if "" in tilts else {}
    if len(found) == 1:
        return unnamed or ({"tilt_deg": next(iter(tilts.values()))} if tilts else {})
    named = [name for name in found if name]
    offsets = {name: round(found[name]["offset"], DIGITS["touch_offset_mm"]) + 0.0 for name in named}
    none = {name: [0.0, 0.0] for name in named} if unnamed else {}
    tilts = {**none, **stated, **tilts}
    return {"mounting_touch_offset_mm": offsets} | ({"mounting_tilt_deg": tilts} if tilts else {}) | unnamed


def write_values(path: Path, found: CalibratedValues) -> None:
    """Write the values of a calibration, whole or not at all."""
    lines = [
        "# What `make calibrate` found from the force readings of the log, rounded. Labels follow it; only `make freeze` changes it.",
        f"name = {json.dumps(found.name)}",
        f"law = {json.dumps(found.law)}  # contact law, the same as that of the labels",
        f"presses = {json.dumps(found.presses)}  # presses of the calibration",
    ]
    for table, values in found.params.items():
        lines += ["", f"[params.{table}]", *(f"{key} = {_toml(value)}" for key, value in values.items())]
    write_text(path, "\n".join(lines) + "\n")


def _toml(value: Any) -> str:
    """A number, a list or a table of these as TOML."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {one}" for key, one in value.items()) + "}"
    return str(value)


def read_values(path: Path) -> CalibratedValues:
    """What `write_values` wrote: a frozen calibration, or the one that labels follow; BadInput if the file is none."""
    hint = f"run make freeze DATASET={path.parent.name}, or remove it" if path.name == FROZEN else "run make again"
    try:
        given = read_toml(path)
    except BadInput as error:
        raise BadInput(f"{error}; {hint}") from error
    if given.keys() != KINDS.keys() or not all(isinstance(given[key], kind) for key, kind in KINDS.items()):
        raise BadInput(f"{path}: is not a calibration, which has the keys {', '.join(KINDS)}; {hint}")
    for table, values in given["params"].items():
        if not isinstance(values, dict) or values.keys() - SET.get(table, set()):
            raise BadInput(
                f"{path}: [params.{table}] has a key that calibration does not set; set it in dataset.toml; {hint}"
            )
    return CalibratedValues(
        given["name"], given["law"], tuple(str(name) for name in given["presses"]), given["params"]
    )


def read_posterior(path: Path) -> CalibratedValues:
    """What a calibration found, from its summary.json; BadInput with the reason if it failed or cannot be read."""
    again = f"run `{command_for('calibrate', path)}`"
    if not path.exists():
        raise BadInput(f"{path}: is missing, and labels follow it; {again} first")
    try:
        summary = read_json(path)
        if reason := summary.get("failed"):
            raise BadInput(
                f"{path}: the calibration that labels should follow failed: {reason}; correct that, or set"
                " [params.material] c10 to a number in dataset.toml"
            )
        return found_in(Layout(path.parents[1]).root.name, summary)
    except (*DAMAGED, AttributeError) as error:
        raise BadInput(f"{path}: is not the summary of a calibration ({error!r}); {again}") from error


def calibration_of(params: Params, dataset_toml: Path, posterior: Path) -> Path | None:
    """The calibration that labels follow, None for none; BadInput if it contradicts the dataset's own parameters.

    posterior: path of the dataset's summary.json, which need not exist yet.
    """
    frozen, asked = dataset_toml.parent / FROZEN, params.material.c10 == "calibrated"
    if not frozen.exists():
        return posterior if asked else None
    found = read_values(frozen)
    if found.law != params.interface.law:
        raise BadInput(
            f'{frozen}: was found under the law "{found.law}", but [interface] law = "{params.interface.law}": labels would'
            f" mix two laws; remove this file and run make calibrate freeze DATASET={frozen.parent.name}, or set the law back"
        )
    parse(Params, laid_over(plain(params), found.params), Place(str(frozen), ("params",)))
    return frozen


def refuse_twice(given: Mapping[str, Any], dataset_toml: Path, calibration: Path | None) -> None:
    """Refuse values of a dataset's own tables `given` that its calibration sets as well; BadInput."""
    frozen = calibration is not None and calibration.name == FROZEN and calibration.exists()
    found = read_values(calibration).params if calibration and frozen else {}
    for table, keys in SET.items() if calibration else ():
        own = given.get(table) or {}
        # a calibration finds no tilt of a mounting whose tilt is stated
        keys = keys - (STATED - found.get(table, {}).keys())
        twice = sorted(key for key in keys & own.keys() if own[key] != "calibrated")
        if twice:
            raise BadInput(
                f"{dataset_toml}: [params.{table}] {twice[0]} is also set by {calibration}, which labels follow; remove it"
                " here, or follow no calibration"
            )


def calibrated(read: StageParameters, base: Path) -> StageParameters:
    """Parameters of a stage with the values of the calibration that it follows. base: the project's folder."""
    if not read.calibration:
        return read
    values = read_values(base / read.calibration).params
    tables = {name: altered(getattr(read, name), **{key: _frozen_list(value) for key, value in of.items()})
              for name, of in values.items() if hasattr(read, name)}  # fmt: skip
    return altered(read, **tables)


def _frozen_list(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _frozen_list(one) for name, one in value.items()}
    return tuple(value) if isinstance(value, list) else value
