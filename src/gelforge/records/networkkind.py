"""The kinds of networks, and what is known of each before one is built; their layers are in networks.models."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gelforge.errors import BadInput


@dataclass(frozen=True)
class NetworkKind:
    """What is known of a kind of network.

    totals_only: whether it knows total force alone, which it writes as a grid of one cell. image_seconds: of a processor,
    measured, that an image takes in one epoch of training. colour: in charts, a name that matplotlib knows.
    """

    totals_only: bool
    image_seconds: float
    colour: str


KINDS = {
    "unet": NetworkKind(totals_only=False, image_seconds=0.042, colour="tab:blue"),
    "unet_single": NetworkKind(totals_only=False, image_seconds=0.12, colour="tab:purple"),
    "resnet": NetworkKind(totals_only=True, image_seconds=0.08, colour="tab:orange"),
    "grid": NetworkKind(totals_only=False, image_seconds=0.014, colour="tab:green"),
}


def kind_of(model: Mapping[str, Any]) -> NetworkKind:
    """What is known of the kind of a network by its table of workflow/models.toml; BadInput where there is no such kind."""
    name = model.get("kind")
    if not isinstance(name, str) or name not in KINDS:
        raise BadInput(f"unknown kind of network {name!r}: use one of {', '.join(sorted(KINDS))}")
    return KINDS[name]
