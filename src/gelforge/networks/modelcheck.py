"""What a model file says of itself, checked before anything is built from it: it may come from anyone."""

import math
import sys
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import torch

from gelforge.errors import BadInput
from gelforge.networks.inputs import INPUT_CHANNELS, needs_untouched
from gelforge.networks.statistics import FLOORS, LIMITS
from gelforge.records.axes import CHANNELS
from gelforge.records.networkkind import KINDS, kind_of

MOST_SIDE = 4096
# Of a model's file, and of its network: a file of a few bytes may say that all numbers of a large tensor are the same.
MOST_BYTES = 2**31
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


def _dots(value: Any) -> bool:
    if value is ABSENT or value is None:
        return True
    return (
        isinstance(value, dict)
        and _numbers(value.get("weight"), 3, -1e-300)
        and max(value["weight"]) <= 1
        and isinstance(value.get("sha256"), str)
        and _half_widths(value.get("apart"))
    )


def _places(value: Any) -> bool:
    if value is ABSENT or value is None:
        return True
    texts = isinstance(value, dict) and all(isinstance(value.get(name), str) for name in ("sha256", "data"))
    return texts and type(value.get("pictures")) is int


def _stacking(value: Any) -> bool:
    if value is ABSENT or value is None:
        return True
    texts = isinstance(value, dict) and all(
        isinstance(value.get(name), str) for name in ("sha256", "name", "version")
    )
    return texts and _tables(value.get("also"))


def _reads(value: Any) -> bool:
    return isinstance(value, str) and value in INPUT_CHANNELS


def _limit(value: Any) -> bool:
    return value is ABSENT or _numbers([value], 1)


def _pitches(value: Any) -> bool:
    return value is ABSENT or (_numbers(value, 2, 0) and value[0] <= value[1])


# Every part of a model's description that use relies on, and what it must be.
PARTS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "name": ("a name", lambda v: isinstance(v, str) and 0 < len(v) <= 200),
    "sha256": ("the digest of its weights", lambda v: isinstance(v, str)),
    "model": ("a table of its network", lambda v: isinstance(v, dict)),
    "model.kind": (f"one of {', '.join(KINDS)}", lambda v: isinstance(v, str) and v in KINDS),
    "model.reads": (f"one of {', '.join(INPUT_CHANNELS)}, or absent", lambda v: v is ABSENT or _reads(v)),
    "train": ("a table", lambda v: isinstance(v, dict)),
    "both_ways": ("true or false, or absent", lambda v: v is ABSENT or isinstance(v, bool)),
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
    "dots": ("a table of weights from 0 to 1, three numbers by component, and a digest", _dots),
    "places": ("a table of the data, how many pictures, and a digest", _places),
    "stacking": ("a table of the data, of other data and a digest", _stacking),
    "statistics": ("a table", lambda v: isinstance(v, dict)),
    "statistics.inverse": ("a square of numbers", _square),
    "statistics.threshold": ("a number", lambda v: _numbers([v], 1)),
    "statistics.mean": ("numbers", lambda v: _numbers(v, None)),
    "statistics.spread": ("numbers above 0", lambda v: _numbers(v, None, 0)),
    **{f"statistics.{name}": ("a number, or absent", _limit) for name in LIMITS},
}


def check_about(about: Any, where: str) -> None:
    """Raise BadInput for the first part of a model's description that is missing or cannot be."""
    for name, (what, good) in PARTS.items():
        table, _, key = name.partition(".")
        inside = about.get(table, ABSENT) if isinstance(about, dict) else None
        value = inside.get(key, ABSENT) if key and isinstance(inside, dict) else inside
        if not good(value):
            seen = "missing" if value is ABSENT else repr(str(value)[:60])
            raise BadInput(f"{where}: {name} is {seen}, it must be {what}; train the model again")
    statistics = about["statistics"]
    if not len(statistics["mean"]) == len(statistics["spread"]) == len(statistics["inverse"]) == len(FLOORS):
        raise BadInput(f"{where}: statistics do not have {len(FLOORS)} numbers each; train the model again")
    if needs_untouched(about["normalisation"]["reads"]) and not _numbers([statistics.get("largest_distance")], 1, 0):
        raise BadInput(f"{where}: statistics.largest_distance must be a number above 0; train the model again")
    built, scaled = about["model"].get("reads", "image"), about["normalisation"]["reads"]
    if built != scaled:
        raise BadInput(
            f"{where}: model.reads is {built!r}, but normalisation.reads {scaled!r}; train the model again"
        )
    if kind_of(about["model"]).totals_only and about["grid"] != [1, 1]:
        raise BadInput(
            f"{where}: grid is {about['grid']}, but its network knows totals only, [1, 1]; train the model again"
        )


def holds_numbers(value: Any) -> bool:
    """Whether a value is a tensor with numbers of its own in memory, as training saves them: not sparse, empty or traced."""
    return (
        isinstance(value, torch.Tensor)
        and value.layout == torch.strided
        and value.device.type == "cpu"
        and not value.requires_grad
    )


def kept_as(dtype: torch.dtype) -> tuple[torch.dtype, ...]:
    """What a tensor of a network may be in its file: the same, or half as precise (networks.halves)."""
    return (torch.float32, torch.float16) if dtype == torch.float32 else (dtype,)


def check_tensors(make: Callable[[], torch.nn.Module], tensors: Any, where: str) -> None:
    """Raise BadInput unless the tensors are finite and those of the network that `make` makes, which costs no memory yet."""
    try:
        with torch.device("meta"):
            wanted = make().state_dict()
    except BadInput as error:
        raise BadInput(f"{where}: its network cannot be built ({error}); train the model again") from None
    if (size := sum(like.nbytes for like in wanted.values())) > MOST_BYTES:
        raise BadInput(f"{where}: its network takes {size >> 20} MiB, no model may take 2 GiB; train the model again")
    if not isinstance(tensors, dict) or set(tensors) != set(wanted):
        seen: Iterable[Any] = tensors if isinstance(tensors, dict) else ()
        odd = sorted(map(str, set(wanted) ^ set(seen)))[:3]
        raise BadInput(f"{where}: the tensors do not fit the network it describes ({', '.join(odd)}); train it again")
    for name, like in wanted.items():
        tensor = tensors[name]
        plain = holds_numbers(tensor)
        if not plain or tensor.shape != like.shape or tensor.dtype not in kept_as(like.dtype):
            seen_as = (
                f"{tensor.dtype} {tuple(tensor.shape)}" if plain else f"a {type(tensor).__name__} without numbers"
            )
            raise BadInput(
                f"{where}: the tensors do not fit the network it describes ({name} is {seen_as}, not {like.dtype}"
                f" {tuple(like.shape)}); train it again"
            )
        if tensor.is_floating_point() and not torch.isfinite(tensor).all():
            raise BadInput(
                f"{where}: {name} holds NaN or infinity, so every force would be none; train the model again"
            )


def check_pictures(about: dict[str, Any], untouched: dict[str, np.ndarray], where: str) -> None:
    """Raise BadInput for pictures of untouched sensors of another size than the images the network reads."""
    for name, picture in untouched.items():
        if list(picture.shape[:2]) != about["image"]:
            raise BadInput(
                f"{where}: its picture of the untouched sensor {name} has {picture.shape[0]} x {picture.shape[1]} pixels,"
                f" its images {about['image'][0]} x {about['image'][1]}; train the model again"
            )
