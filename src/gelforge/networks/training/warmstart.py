"""Fine-tuning: what a network and the one whose weights it begins with must have in common."""

from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.networks.data.arrays import Data
from gelforge.networks.preprocess.scale import at_scale
from gelforge.records.markers import pitch_of
from gelforge.records.splits import VALIDATION

FEWEST_JUDGES = 5  # presses of validation: chosen by a single one, a network read others five times worse than before
FARTHER = 0.05  # fraction by which scales may lie beyond those that a network knows, so that it can still learn them


def scales_before(
    metadata: dict[str, Any], model: dict[str, Any], data: Data, norm: dict[str, Any]
) -> dict[str, Any]:
    """What a network that is fine-tuned scales by: as its weights expect, and the range of both datasets.

    metadata: of the network it is fine-tuned from. model: its own table of workflow/models.toml. norm: scales of its own dataset.
    Raises BadInput as `require_alike`.
    """
    require_alike(metadata, model, data)
    ranges = zip(metadata["normalisation"]["range"], norm["range"], strict=True)
    return metadata["normalisation"] | {"range": [max(pair) for pair in ranges]}


def require_alike(metadata: dict[str, Any], model: dict[str, Any], data: Data) -> None:
    """Raise BadInput where two networks are not of one kind, or the dataset is of another grid, image or scale of the gel.

    metadata: of the network that is fine-tuned. model: table of the other one.
    """
    before, name = metadata["model"], metadata["name"]
    differ = sorted(key for key in before.keys() | model.keys() if before.get(key) != model.get(key))
    both = before.keys() == model.keys()
    if both and differ == ["blocks"] and model["kind"] == "grid" and before["blocks"] < model["blocks"]:
        differ = []  # a light net can be made deeper
    if differ:
        values = ", ".join(f"{key} = {model.get(key)!r}, there {before.get(key)!r}" for key in differ)
        raise BadInput(
            f"it cannot be fine-tuned from {name}, which is another network: {values}; give the same values"
        )
    if [list(data.grid), list(data.image_size)] != [metadata["grid"], metadata["image"]]:
        (rows, cols), (high, wide) = metadata["grid"], metadata["image"]
        (of_rows, of_cols), (height, width) = data.grid, data.image_size
        raise BadInput(
            f"it cannot be fine-tuned from {name}: that writes a grid of {rows}x{cols} from images of {wide} x {high}, the dataset"
            f" has {of_rows}x{of_cols} and {width} x {height}; choose another MODEL"
        )
    require_scale(metadata, data)


def require_judges(metadata: dict[str, Any], data: Data) -> None:
    """Raise BadInput where too few presses validate to show whether a network that is fine-tuned has become better."""
    count = len(np.unique(data.presses(data.splits[VALIDATION])))
    if count < FEWEST_JUDGES:
        raise BadInput(
            f"{data.folder}: of its presses {count} validate, too few to show whether a network that is fine-tuned from"
            f" {metadata['name']} becomes better, which takes {FEWEST_JUDGES}: raise [params.dataset] validation, to 0.25 for a few"
            " dozen presses, or log more"
        )


def require_scale(metadata: dict[str, Any], data: Data) -> None:
    """Raise BadInput for a dataset of a sensor at another scale than those that a network learnt from.

    It learns scales a little beyond them; its pictures are read as they are from then on.
    """
    if "pitch_px" not in metadata:
        return
    low, high = metadata["pitch_px"]
    for name, picture in sorted(data.nocontact.items()):
        pitch = pitch_of(picture)
        if not at_scale(pitch, ((1 - FARTHER) * low, (1 + FARTHER) * high)):
            raise BadInput(
                f"the markers of sensor {name} are {pitch:.1f} px apart, those that {metadata['name']} learnt from {low:.1f} to"
                f" {high:.1f} px: it cannot be fine-tuned from another scale; choose another MODEL"
            )
