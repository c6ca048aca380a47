"""A network that goes on from another one: what both must have in common, and what it keeps of the other's description."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.networks.canonical import at_scale
from gelforge.networks.data import Data
from gelforge.networks.statistics import widened
from gelforge.records.markers import pitch_of
from gelforge.records.splits import VALIDATION

FEWEST_JUDGES = 5  # presses of validation: chosen by a single one, a network read others five times worse than before
FARTHER = 0.05  # share by which scales may lie beyond those that a network knows, so that it can still learn them


def scales_before(about: dict[str, Any], model: dict[str, Any], data: Data, norm: dict[str, Any]) -> dict[str, Any]:
    """What a network that goes on scales by: as its weights expect, and the range of both datasets.

    about: of the network it goes on from. model: its own table of workflow/models.toml. norm: scales of its own dataset.
    Raises BadInput as `require_alike`.
    """
    require_alike(about, model, data)
    ranges = zip(about["normalisation"]["range"], norm["range"], strict=True)
    return about["normalisation"] | {"range": [max(pair) for pair in ranges]}


def require_alike(about: dict[str, Any], model: dict[str, Any], data: Data) -> None:
    """Raise BadInput where two networks are not of one kind, or the dataset is of another grid, image or scale of the gel.

    about: of the network that is gone on from. model: table of the other one.
    """
    before, name = about["model"], about["name"]
    differ = sorted(key for key in before.keys() | model.keys() if before.get(key) != model.get(key))
    both = before.keys() == model.keys()
    if both and differ == ["blocks"] and model["kind"] == "grid" and before["blocks"] < model["blocks"]:
        differ = []  # a light net can be made deeper
    if differ:
        told = ", ".join(f"{key} = {model.get(key)!r}, there {before.get(key)!r}" for key in differ)
        raise BadInput(f"it cannot go on from {name}, which is another network: {told}; give the same values")
    if [list(data.grid), list(data.image_size)] != [about["grid"], about["image"]]:
        (rows, cols), (high, wide) = about["grid"], about["image"]
        (of_rows, of_cols), (height, width) = data.grid, data.image_size
        raise BadInput(
            f"it cannot go on from {name}: that writes a grid of {rows}x{cols} from images of {wide} x {high}, the dataset"
            f" has {of_rows}x{of_cols} and {width} x {height}; choose another MODEL"
        )
    require_scale(about, data)


def require_judges(about: dict[str, Any], data: Data) -> None:
    """Raise BadInput where too few presses validate to tell whether a network that goes on has become better."""
    count = len(np.unique(data.presses(data.splits[VALIDATION])))
    if count < FEWEST_JUDGES:
        raise BadInput(
            f"{data.folder}: of its presses {count} validate, too few to tell whether a network that goes on from"
            f" {about['name']} becomes better, which takes {FEWEST_JUDGES}: raise [params.dataset] validation, to 0.25 for a few"
            " dozen presses, or log more"
        )


def require_scale(about: dict[str, Any], data: Data) -> None:
    """Raise BadInput for a dataset of a sensor at another scale than those that a network learnt from.

    It learns scales a little beyond them; its pictures are read as they are from then on.
    """
    if "pitch_px" not in about:
        return
    low, high = about["pitch_px"]
    for name, picture in sorted(data.nocontact.items()):
        pitch = pitch_of(picture)
        if not at_scale(pitch, ((1 - FARTHER) * low, (1 + FARTHER) * high)):
            raise BadInput(
                f"the dots of sensor {name} are {pitch:.1f} px apart, those that {about['name']} learnt from {low:.1f} to"
                f" {high:.1f} px: it cannot go on from another scale; choose another MODEL"
            )


def known_before(
    about: dict[str, Any], images: Iterable[np.ndarray], pairs: dict[str, float], learnt: bool
) -> dict[str, Any]:
    """What is kept of the description of the network that training began with: too few new pictures tell it anew.

    Limits are as wide as the new pictures (h, w, 3) uint8 want them, where the other's are narrower. pairs: limits that are
    set on these pictures beside untouched ones. learnt: whether the network has other weights now, of whose errors the
    other's intervals say nothing.
    """
    kept = ("dots", "places") if learnt else ("dots", "places", "intervals")
    limits = widened(about["statistics"], images, pairs)
    return {"statistics": limits} | {key: about[key] for key in kept if key in about}
