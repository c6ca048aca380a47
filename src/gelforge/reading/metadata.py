"""Checks the metadata of a model file before use: the file may come from anyone."""

import sys
from typing import Any

from gelforge.errors import BadInput
from gelforge.records.axes import CHANNELS
from gelforge.records.networkkind import KINDS, kind_of

MOST_SIDE = 4096
MOST = sys.float_info.max  # compared, not converted: an integer in a file may be larger than any float
NUMBER, FROM_ZERO, ABOVE_ZERO = (-MOST, MOST), (0.0, MOST), (sys.float_info.min, MOST)
SIDES = [range(1, MOST_SIDE + 1)] * 2
MOMENTS = [[NUMBER] * 2] * 3
WIDENED = {"unprofiled", "profiled", "sideways"}  # what errors on real sensors widen
ABSENT = object()  # stands for a missing entry; null is an entry


def fits(value: Any, kind: Any) -> bool:
    """Whether a value of a JSON file is of a kind.

    A type is itself, a text from 1 to 200 characters; a range a whole number in it; a pair (low, high) a number from low to
    high; a set one of its texts; a list of one kind any number of it; a longer list one of each; a dictionary a table with
    these entries, beside others; a function itself says.
    """
    match kind:
        case type():
            return isinstance(value, kind) and (not isinstance(value, str) or 0 < len(value) <= 200)
        case range():
            return type(value) is int and value in kind
        case tuple():
            return type(value) in (int, float) and kind[0] <= value <= kind[1]
        case set():
            return isinstance(value, str) and value in kind
        case [one]:
            return isinstance(value, list) and all(fits(part, one) for part in value)
        case list():
            return isinstance(value, list) and len(value) == len(kind) and all(map(fits, value, kind))
        case dict():
            return isinstance(value, dict) and all(fits(value.get(name), one) for name, one in kind.items())
    return bool(kind(value))


def _intervals(value: Any) -> bool:
    if not isinstance(value, dict):
        return False
    total, real = value.get("total") or {}, value.get("real", {})
    named = isinstance(real, dict) and real.keys() <= WIDENED and fits(list(real.values()), [FROM_ZERO])
    return named and (total == {} or fits(total, dict.fromkeys(CHANNELS, [FROM_ZERO] * 3)))


FRAME = {
    "usual_px": FROM_ZERO,
    "pitch_px": lambda value: value == [] or (fits(value, [ABOVE_ZERO] * 2) and value[0] <= value[1]),
    "grid": SIDES,
    "views": [[MOMENTS, MOMENTS]],
}
# Entries of a model's metadata: what each must be, in words and as of `fits`.
ENTRIES: dict[str, tuple[str, Any]] = {
    "name": ("a name", str),
    "sha256": ("the digest of its graph", str),
    "model": ("a table of its network", dict),
    "model.kind": (f"one of {', '.join(KINDS)}", set(KINDS)),
    "train": ("a table", dict),
    "image": (f"[height, width], whole numbers to {MOST_SIDE}", SIDES),
    "grid": (f"[rows, cols], whole numbers to {MOST_SIDE}", SIDES),
    "channels": (f"the order of its forces, {list(CHANNELS)}", lambda value: value == list(CHANNELS)),
    "known_sensors": ("a list of names", [str]),
    "sensors": ("a list of names", [str]),
    "data": ("a table", dict),
    "also": ("a list of tables", [dict]),
    "normalisation": ("a table", dict),
    "normalisation.image_mean": ("three numbers", [NUMBER] * 3),
    "normalisation.image_std": ("three numbers above 0", [ABOVE_ZERO] * 3),
    "normalisation.label": ("three numbers above 0", [ABOVE_ZERO] * 3),
    "answer": (
        "the numbers that its graph answers to a picture",
        lambda value: fits(value, [NUMBER]) and value != [],
    ),
    "frame": ("the view of the cameras that it learnt from", FRAME),
    "intervals": ("a table of three numbers from 0 on, by component", _intervals),
}
OPTIONAL = ("frame", "intervals")


def check_metadata(metadata: Any, where: str) -> None:
    """Raise BadInput for the first entry of a model's metadata that is missing or invalid."""
    for name, (what, kind) in ENTRIES.items():
        value = metadata
        for key in name.split("."):
            value = value.get(key, ABSENT) if isinstance(value, dict) else ABSENT
        if not (value is ABSENT and name in OPTIONAL) and not fits(value, kind):
            seen = "missing" if value is ABSENT else repr(str(value)[:60])
            raise BadInput(f"{where}: {name} is {seen}, it must be {what}; train the model again")
    if kind_of(metadata["model"]).pair and "frame" not in metadata:
        raise BadInput(f"{where}: frame is missing, by which cameras are compared; train the model again")
