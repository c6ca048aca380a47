"""What a model file says of itself, checked before anything is made of it: it may come from anyone."""

import math
import sys
from collections.abc import Callable
from typing import Any

from gelforge.errors import BadInput
from gelforge.networks.models.inputs import INPUT_CHANNELS, needs_nocontact
from gelforge.networks.uncertainty.ood import FLOORS, LIMITS
from gelforge.records.axes import CHANNELS
from gelforge.records.networkkind import KINDS, kind_of

MOST_SIDE = 4096
ABSENT = object()  # what a description does not say; null is something that it says


def _numbers(value: Any, count: int | None, above: float = -math.inf) -> bool:
    return (
        isinstance(value, list)
        and (count is None or len(value) == count)
        # compared, not converted: a whole number of a file may be larger than any float
        and all(type(v) in (int, float) and abs(v) <= sys.float_info.max and v > above for v in value)
    )


def _side(value: Any) -> bool:
    return _numbers(value, 2, 0) and all(type(v) is int and v <= MOST_SIDE for v in value)


def _names(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(name, str) and 0 < len(name) <= 200 for name in value)


def _square(value: Any) -> bool:
    return isinstance(value, list) and all(_numbers(row, len(value)) for row in value)


def _tables(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(one, dict) for one in value)


def _half_widths(value: Any) -> bool:
    return (
        isinstance(value, dict)
        and set(value) == set(CHANNELS)
        and all(_numbers(width, 3, -1e-300) for width in value.values())
    )


def _intervals(value: Any) -> bool:
    if value is ABSENT:
        return True
    return isinstance(value, dict) and (not value.get("total") or _half_widths(value["total"]))


def _reads(value: Any) -> bool:
    return isinstance(value, str) and value in INPUT_CHANNELS


def _limit(value: Any) -> bool:
    return value is ABSENT or _numbers([value], 1)


def _pitches(value: Any) -> bool:
    return value is ABSENT or (_numbers(value, 2, 0) and value[0] <= value[1])


# Every part of a model's metadata that use relies on, and what it must be.
PARTS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "name": ("a name", lambda v: isinstance(v, str) and 0 < len(v) <= 200),
    "sha256": ("the digest of its graph", lambda v: isinstance(v, str)),
    "model": ("a table of its network", lambda v: isinstance(v, dict)),
    "model.kind": (f"one of {', '.join(KINDS)}", lambda v: isinstance(v, str) and v in KINDS),
    "model.reads": (f"one of {', '.join(INPUT_CHANNELS)}, or absent", lambda v: v is ABSENT or _reads(v)),
    "train": ("a table", lambda v: isinstance(v, dict)),
    "image": (f"[height, width], whole numbers to {MOST_SIDE}", _side),
    "grid": (f"[rows, cols], whole numbers to {MOST_SIDE}", _side),
    "known_sensors": ("a list of names", _names),
    "sensors": ("a list of names", _names),
    "data": ("a table", lambda v: isinstance(v, dict)),
    "also": ("a list of tables", _tables),
    "normalisation": ("a table", lambda v: isinstance(v, dict)),
    "normalisation.reads": (f"one of {', '.join(INPUT_CHANNELS)}", _reads),
    "normalisation.image_mean": ("three numbers", lambda v: _numbers(v, 3)),
    "normalisation.image_std": ("three numbers above 0", lambda v: _numbers(v, 3, 0)),
    "normalisation.label": ("three numbers above 0", lambda v: _numbers(v, 3, 0)),
    "pitch_px": ("two numbers above 0, the larger last, or absent", _pitches),
    "intervals": ("a table of three numbers from 0 on, by component", _intervals),
    "statistics": ("a table", lambda v: isinstance(v, dict)),
    "statistics.inverse": ("a square of numbers", _square),
    "statistics.threshold": ("a number", lambda v: _numbers([v], 1)),
    "statistics.mean": ("numbers", lambda v: _numbers(v, None)),
    "statistics.spread": ("numbers above 0", lambda v: _numbers(v, None, 0)),
    **{f"statistics.{name}": ("a number, or absent", _limit) for name in LIMITS},
}


def check_metadata(metadata: Any, where: str) -> None:
    """Raise BadInput for the first part of a model's metadata that is missing or cannot be."""
    for name, (what, good) in PARTS.items():
        table, _, key = name.partition(".")
        inside = metadata.get(table, ABSENT) if isinstance(metadata, dict) else None
        value = inside.get(key, ABSENT) if key and isinstance(inside, dict) else inside
        if not good(value):
            seen = "missing" if value is ABSENT else repr(str(value)[:60])
            raise BadInput(f"{where}: {name} is {seen}, it must be {what}; train the model again")
    statistics = metadata["statistics"]
    if not len(statistics["mean"]) == len(statistics["spread"]) == len(statistics["inverse"]) == len(FLOORS):
        raise BadInput(f"{where}: statistics do not have {len(FLOORS)} numbers each; train the model again")
    if needs_nocontact(metadata["normalisation"]["reads"]) and not _numbers(
        [statistics.get("largest_distance")], 1, 0
    ):
        raise BadInput(f"{where}: statistics.largest_distance must be a number above 0; train the model again")
    built, scaled = metadata["model"].get("reads", "image"), metadata["normalisation"]["reads"]
    if built != scaled:
        raise BadInput(
            f"{where}: model.reads is {built!r}, but normalisation.reads {scaled!r}; train the model again"
        )
    if kind_of(metadata["model"]).totals_only and metadata["grid"] != [1, 1]:
        raise BadInput(
            f"{where}: grid is {metadata['grid']}, but its network knows totals only, [1, 1]; train the model again"
        )
