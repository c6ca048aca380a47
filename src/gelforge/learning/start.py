"""What a network can be fine-tuned from, and on which datasets."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from torch import nn

from gelforge.errors import BadInput
from gelforge.learning.data import Data
from gelforge.learning.export import load_weights
from gelforge.reading.frame import at_scale
from gelforge.reading.markers import markers_in
from gelforge.reading.model import SHIPPED, datasets_of, load_model
from gelforge.records.samplefile import VALIDATION

# Validation presses; weights selected by a single one had five times the errors of the initial weights on others.
FEWEST_JUDGES = 5
FARTHER = 0.05  # fraction by which a new sensor's marker pitch (px) may lie outside the range that a network learnt


@dataclass(frozen=True)
class Start:
    """The network that another one is fine-tuned from, and its metadata."""

    net: nn.Module
    metadata: dict[str, Any]

    def table(self) -> dict[str, Any]:
        """What the metadata of the new network keep: its name, and all that it had learnt."""
        learnt = self.metadata["data"]
        kept = {key: self.metadata[key] for key in ("name", "sha256") if key in self.metadata}
        return kept | {
            "data": learnt["name"],
            "simulated": learnt["simulated"],
            "sensors": self.metadata["sensors"],
            "learnt": datasets_of(self.metadata),
        }


def shipped() -> Start:
    """The network that ships, with the intervals of its model file, which alone knows how it reads real sensors."""
    net, metadata = load_weights(SHIPPED.with_suffix(".safetensors"))
    return Start(net, metadata | {"intervals": load_model(SHIPPED).metadata["intervals"]})


def scales_before(
    metadata: dict[str, Any], model: dict[str, Any], data: Data, norm: dict[str, Any]
) -> dict[str, Any]:
    """Scales for fine-tuning: those that the initial weights expect, with the larger force range of the two datasets.

    metadata: of the network that is fine-tuned. model: table of the new one in workflow/models.toml. norm: scales of
    the new dataset. Raises BadInput as `require_alike`.
    """
    require_alike(metadata, model, data)
    ranges = zip(metadata["normalisation"]["range"], norm["range"], strict=True)
    return metadata["normalisation"] | {"range": [max(pair) for pair in ranges]}


def require_alike(metadata: dict[str, Any], model: dict[str, Any], data: Data) -> None:
    """Raise BadInput if two networks differ in architecture, or the dataset in grid, image size or scale of the gel.

    metadata: of the network that is fine-tuned. model: table of the new one, which may be a light net of more blocks.
    """
    before, name = metadata["model"], metadata["name"]
    differ = sorted(key for key in before.keys() | model.keys() if before.get(key) != model.get(key))
    both = before.keys() == model.keys()
    if both and differ == ["blocks"] and model["kind"] == "grid" and before["blocks"] < model["blocks"]:
        differ = []  # a light net can be made deeper
    if differ:
        values = ", ".join(f"{key} = {model.get(key)!r} here and {before.get(key)!r} in {name}" for key in differ)
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
    """Raise BadInput for too few validation presses to show whether fine-tuning improves a network."""
    count = len(np.unique(data.presses(data.splits[VALIDATION])))
    if count < FEWEST_JUDGES:
        raise BadInput(
            f"{data.folder}: validation has {count} of its presses; at least {FEWEST_JUDGES} are needed to show whether"
            f" fine-tuning improves {metadata['name']}: raise [params.dataset] validation, to 0.25 for a few dozen presses, or log"
            " more"
        )


def require_scale(metadata: dict[str, Any], data: Data) -> None:
    """Raise BadInput if a sensor's marker pitch lies outside the range that a network learnt, widened by FARTHER.

    A fine-tuned network learns pitches just outside that range and then reads images of that scale without zoom.
    """
    if not metadata["frame"]["pitch_px"]:
        return
    low, high = metadata["frame"]["pitch_px"]
    for name, picture in sorted(data.nocontact.items()):
        pitch = markers_in(picture).pitch
        if not at_scale(pitch, ((1 - FARTHER) * low, (1 + FARTHER) * high)):
            raise BadInput(
                f"the markers of sensor {name} are {pitch:.1f} px apart, those that {metadata['name']} learnt from {low:.1f} to"
                f" {high:.1f} px: it cannot be fine-tuned from another scale; choose another MODEL"
            )
