"""A calibration that was frozen: data/DATASET/calibration.toml, values that labels are made with until it is frozen anew.

Its values override workflow/params.toml as a dataset's own tables do, so stages read them as any other parameter.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gelforge.errors import BadInput
from gelforge.flow.files import read_toml, write_text

FROZEN = "calibration.toml"  # in data/DATASET/, beside dataset.toml
KINDS = {"name": str, "law": str, "presses": list, "params": dict}
# Digits behind the point of what is kept: less than any posterior tells, so that another processor freezes the same.
DIGITS = {"c10": 4, "touch_offset_mm": 3, "compliance_mm_per_n": 4, "shear_compliance_mm_per_n": 4, "mu": 2}
BENCH = {
    "touch_offset_mm": "offset",
    "compliance_mm_per_n": "compliance",
    "shear_compliance_mm_per_n": "shear_compliance",
}


@dataclass(frozen=True)
class Frozen:
    """A frozen calibration. law: of the contact. presses: sample_ids that it used. params: tables over those of params.toml."""

    name: str
    law: str
    presses: tuple[str, ...]
    params: dict[str, dict[str, Any]]


def frozen_of(dataset: str, summary: Mapping[str, Any]) -> Frozen:
    """What is kept of a calibration's summary.json."""
    c10, bench = summary["c10"], summary["bench"]
    material = {"c10": round(c10["median"], DIGITS["c10"])} | {
        f"c10_{name}": [round(value, DIGITS["c10"]) for value in c10[name]] for name in ("interval68", "interval95")
    }
    poses = {key: round(bench[name], DIGITS[key]) + 0.0 for key, name in BENCH.items()}
    params = {"material": material, "poses": poses}
    if "mu" in summary["parameters"]:
        params["interface"] = {"mu": round(summary["parameters"]["mu"]["median"], DIGITS["mu"])}
    digest = hashlib.sha256(repr(params).encode()).hexdigest()[:6]
    return Frozen(f"{dataset}-{digest}", summary["law"], tuple(summary["used"]), params)


def write_frozen(path: Path, found: Frozen) -> None:
    """Write the file, whole or not at all."""
    command = f"make freeze DATASET={path.parent.name}"
    lines = [
        f"# What `make calibrate` found from the force readings of the log, rounded. Labels follow it; only `{command}` changes it.",
        f"name = {json.dumps(found.name)}",
        f"law = {json.dumps(found.law)}  # of the contact, which labels share",
        f"presses = {json.dumps(found.presses)}  # that it was found from",
    ]
    for table, values in found.params.items():
        lines += ["", f"[params.{table}]", *(f"{key} = {value}" for key, value in values.items())]
    write_text(path, "\n".join(lines) + "\n")


def read_frozen(path: Path) -> Frozen | None:
    """The frozen calibration; None where there is none, and BadInput where the file is none."""
    if not path.exists():
        return None
    hint = f"run make freeze DATASET={path.parent.name}, or remove it"
    try:
        given = read_toml(path)
    except BadInput as error:
        raise BadInput(f"{error}; {hint}") from error
    if given.keys() != KINDS.keys() or not all(isinstance(given[key], kind) for key, kind in KINDS.items()):
        raise BadInput(f"{path}: is no frozen calibration, which holds {', '.join(KINDS)}; {hint}")
    tables = {"material": {"c10", "c10_interval68", "c10_interval95"}, "poses": set(BENCH), "interface": {"mu"}}
    for table, values in given["params"].items():
        if not isinstance(values, dict) or values.keys() - tables.get(table, set()):
            raise BadInput(
                f"{path}: [params.{table}] holds what no calibration finds; set it in dataset.toml; {hint}"
            )
    return Frozen(given["name"], given["law"], tuple(str(name) for name in given["presses"]), given["params"])


def with_frozen(given: dict[str, Any], dataset_toml: Path) -> dict[str, Any]:
    """A dataset's own [params.*] with those of its frozen calibration; a value that both set raises BadInput."""
    path = dataset_toml.parent / FROZEN
    found = read_frozen(path)
    if found is None:
        return given
    twice = [f"[params.{table}] {key}" for table, values in found.params.items() for key in values
             if key in (given.get(table) or {})]  # fmt: skip
    if twice:
        raise BadInput(f"{dataset_toml}: {twice[0]} is set by {path}, too; remove it here, or remove that file")
    return given | {table: {**given.get(table, {}), **values} for table, values in found.params.items()}


def check_law(law: str, dataset_toml: Path) -> None:
    """Refuse a frozen calibration of another contact law than labels have: its C10 and bench belong to that law."""
    path = dataset_toml.parent / FROZEN
    found = read_frozen(path)
    if found is not None and found.law != law:
        raise BadInput(
            f'{path}: was found under the law "{found.law}", but [interface] law = "{law}": labels would mix two laws; '
            f"remove this file and run make calibrated-labels DATASET={path.parent.name}, or set the law back"
        )
