"""The kinds of networks and their properties, without torch; their layers are in learning.nets."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gelforge.errors import BadInput

LIMITS = {"width": (1, 4096), "widths": (1, 4096), "blocks": (0, 64)}  # least and largest allowed sizes
MOST_LEVELS = 16  # most numbers in a size that is a list
BESIDES = ("kind", "note", "train", "start")  # keys of a network's table that are no sizes


@dataclass(frozen=True)
class NetworkKind:
    """Properties of a kind of network.

    sizes: by name, int for a whole number, list for a list of them. pair: whether it reads a no-contact image beside
    the image. image_seconds: measured CPU time per training image and epoch, s. colour: in charts, a name of
    matplotlib's.
    """

    sizes: Mapping[str, type]
    pair: bool
    image_seconds: float
    colour: str


KINDS = {
    "unet": NetworkKind({"widths": list}, pair=False, image_seconds=0.042, colour="tab:blue"),
    "grid": NetworkKind({"width": int, "blocks": int}, pair=True, image_seconds=0.014, colour="tab:green"),
}


def kind_of(model: Mapping[str, Any]) -> NetworkKind:
    """The kind of a network, from its table of workflow/models.toml; BadInput for an unknown kind."""
    name = model.get("kind")
    if not isinstance(name, str) or name not in KINDS:
        raise BadInput(f"unknown kind of network {str(name)[:60]!r}: use one of {', '.join(sorted(KINDS))}")
    return KINDS[name]


def sizes_of(model: Mapping[str, Any]) -> dict[str, Any]:
    """The sizes of a network, from its table; BadInput for one that its kind does not have or outside LIMITS."""
    known = kind_of(model).sizes
    sizes = {name: value for name, value in model.items() if name not in BESIDES}
    for name, value in sizes.items():
        if name not in known:
            raise BadInput(
                f"a network of kind {model['kind']} has no {name[:60]!r}: its sizes are {', '.join(known)}"
            )
        least, most = LIMITS[name]
        of_one = known[name] is int
        numbers = [value] if of_one else value
        built = isinstance(numbers, list) and 0 < len(numbers) <= MOST_LEVELS
        if not built or not all(type(number) is int and least <= number <= most for number in numbers):
            required = "a whole number" if of_one else f"a list of 1 to {MOST_LEVELS} whole numbers"
            raise BadInput(f"{name} is {str(value)[:60]!r}, it must be {required} from {least} to {most}")
    return sizes
