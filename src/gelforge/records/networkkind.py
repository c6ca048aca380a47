"""The kinds of networks, and what is known of each before one is built; their layers are in networks.models."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gelforge.errors import BadInput

LIMITS = {"width": (1, 4096), "widths": (1, 4096), "blocks": (0, 64)}  # least and most of what sizes are built
MOST_LEVELS = 16  # numbers of a size that is a list
BESIDES = ("kind", "note", "train", "start")  # what a network's table says beside its sizes


@dataclass(frozen=True)
class NetworkKind:
    """What is known of a kind of network.

    sizes: by name, int for one that is a whole number, list for one that is a list of them. pair: whether it reads an image
    beside a no-contact image, or the image alone. image_seconds: of a processor, measured, that an image takes in one epoch
    of training. colour: in charts, a name that matplotlib knows.
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
    """What is known of the kind of a network by its table of workflow/models.toml; BadInput where there is no such kind."""
    name = model.get("kind")
    if not isinstance(name, str) or name not in KINDS:
        raise BadInput(f"unknown kind of network {str(name)[:60]!r}: use one of {', '.join(sorted(KINDS))}")
    return KINDS[name]


def sizes_of(model: Mapping[str, Any]) -> dict[str, Any]:
    """The sizes of a network by its table; BadInput for one that its kind has not, or that no network is built of."""
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
