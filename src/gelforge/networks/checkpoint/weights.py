"""Weights that a network is fine-tuned from, as safetensors: tensors and metadata, of which nothing is ever executed."""

import json
from pathlib import Path
from typing import Any

from torch import nn

from gelforge.errors import BadInput
from gelforge.networks.models.registry import build
from gelforge.reading.model import KEY
from gelforge.records.regular import file_fault


def save_weights(path: Path, net: nn.Module, metadata: dict[str, Any]) -> None:
    """Write a network's weights and what is known about it to exactly `path`; OSError where it cannot be."""
    from safetensors.torch import save

    tensors = {name: value.detach().cpu().contiguous() for name, value in net.state_dict().items()}
    Path(path).write_bytes(save(tensors, {KEY: json.dumps(metadata, sort_keys=True, allow_nan=False)}))


def load_weights(path: Path) -> tuple[nn.Module, dict[str, Any]]:
    """A network in evaluation mode and what is known about it; BadInput for another file, or tensors that do not fit it."""
    from safetensors import safe_open

    path = Path(path)
    fault = file_fault(path)
    if fault:
        raise BadInput(f"{path}: holds no weights of gelforge ({fault}); train the model again")
    try:
        with safe_open(path, "pt") as stored:
            tensors = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118, it is no dictionary
            metadata = json.loads(stored.metadata()[KEY])
        net = build(metadata["model"], metadata["image"], metadata["grid"])
        net.load_state_dict(tensors)
    except (
        Exception
    ) as error:  # safetensors and torch raise kinds of their own, KeyError and TypeError for a corrupt file
        raise BadInput(
            f"{path}: holds no weights of gelforge that fit the network it describes ({type(error).__name__}); train it again"
        ) from None
    return net.eval(), metadata
