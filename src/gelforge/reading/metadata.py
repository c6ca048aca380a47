"""Checks the metadata of a model file before use: the file may come from anyone."""

import math
import sys
from collections.abc import Callable, Iterable
from typing import Any

from gelforge.errors import BadInput
from gelforge.records.axes import CHANNELS
from gelforge.records.networkkind import KINDS, kind_of

MOST_SIDE = 4096
ABSENT = object()  # stands for a missing entry; null is an entry


def _numbers(value: Any, count: int | None, above: float = -math.inf) -> bool:
    return (
        isinstance(value, list)
        and (count is None or len(value) == count)
        # compared, not converted: an integer in a file may be larger than any float
        and all(type(v) in (int, float) and abs(v) <= sys.float_info.max and v > above for v in value)
    )


def _sides(value: Any) -> bool:
    return _numbers(value, 2, 0) and all(type(v) is int and v <= MOST_SIDE for v in value)


def _text(value: Any) -> bool:
    return isinstance(value, str) and 0 < len(value) <= 200


def _list_of(good: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, list) and all(map(good, value))


def _one_of(names: Iterable[str]) -> tuple[str, Callable[[Any], bool]]:
    known = tuple(names)
    return f"one of {', '.join(known)}", lambda value: isinstance(value, str) and value in known


def _intervals(value: Any) -> bool:
    widths = value.get("total") if isinstance(value, dict) else None
    if not widths:
        return isinstance(value, dict)
    named = isinstance(widths, dict) and set(widths) == set(CHANNELS)
    real = value.get("real", {})
    known = (
        isinstance(real, dict)
        and set(real) <= {"unprofiled", "profiled", "sideways"}
        and _numbers(list(real.values()), None, -1e-300)
    )
    return named and known and all(_numbers(width, 3, -1e-300) for width in widths.values())


def _frame(value: Any) -> bool:
    if not isinstance(value, dict) or not {"usual_px", "pitch_px", "grid", "views"} <= value.keys():
        return False
    pitch, views = value["pitch_px"], value["views"]
    return (
        _numbers([value["usual_px"]], 1, -1e-300)
        and (pitch == [] or (_numbers(pitch, 2, 0) and pitch[0] <= pitch[1]))
        and _sides(value["grid"])
        and isinstance(views, list)
        and all(isinstance(view, list) and len(view) == 2 and all(map(_moments, view)) for view in views)
    )


def _moments(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 3 and all(_numbers(colour, 2) for colour in value)


TABLE = "a table", lambda value: isinstance(value, dict)
POSITIVE = "three numbers above 0", lambda value: _numbers(value, 3, 0)
SIDES = f"whole numbers to {MOST_SIDE}"

# Required entries of a model's metadata: what each must be, and its check.
PARTS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "name": ("a name", _text),
    "sha256": ("the digest of its graph", lambda value: isinstance(value, str)),
    "model": ("a table of its network", TABLE[1]),
    "model.kind": _one_of(KINDS),
    "train": TABLE,
    "image": (f"[height, width], {SIDES}", _sides),
    "grid": (f"[rows, cols], {SIDES}", _sides),
    "channels": (f"the order of its forces, {list(CHANNELS)}", lambda value: value == list(CHANNELS)),
    "known_sensors": ("a list of names", _list_of(_text)),
    "sensors": ("a list of names", _list_of(_text)),
    "data": TABLE,
    "also": ("a list of tables", _list_of(TABLE[1])),
    "normalisation": TABLE,
    "normalisation.image_mean": ("three numbers", lambda value: _numbers(value, 3)),
    "normalisation.image_std": POSITIVE,
    "normalisation.label": POSITIVE,
    "answer": (
        "the numbers that its graph answers to a picture",
        lambda value: _numbers(value, None) and bool(value),
    ),
}
# Optional entries.
OPTIONAL: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "frame": ("the view of the cameras that it learnt from", _frame),
    "intervals": ("a table of three numbers from 0 on, by component", _intervals),
}


def check_metadata(metadata: Any, where: str) -> None:
    """Raise BadInput for the first entry of a model's metadata that is missing or invalid."""
    for name, (what, good) in (PARTS | OPTIONAL).items():
        table, _, key = name.partition(".")
        inside = metadata.get(table, ABSENT) if isinstance(metadata, dict) else None
        value = inside.get(key, ABSENT) if key and isinstance(inside, dict) else inside
        if not (good(value) or (value is ABSENT and name in OPTIONAL)):
            seen = "missing" if value is ABSENT else repr(str(value)[:60])
            raise BadInput(f"{where}: {name} is {seen}, it must be {what}; train the model again")
    if kind_of(metadata["model"]).pair and "frame" not in metadata:
        raise BadInput(f"{where}: frame is missing, by which cameras are compared; train the model again")
