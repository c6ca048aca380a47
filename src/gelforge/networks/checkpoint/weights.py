"""Files that training resumes or is fine-tuned from: tensors and plain values as safetensors, of which nothing is ever executed."""

import json
from pathlib import Path
from typing import Any

import torch
from torch import nn

from gelforge.errors import BadInput
from gelforge.networks.models.registry import build
from gelforge.records.regular import file_fault

TENSOR, PAIRS = "tensor", "pairs"  # how what JSON lacks is encoded in it
CONTENT = "content"


def write_tree(content: dict[Any, Any], path: Path) -> None:
    """Write nested dictionaries and lists of tensors and plain values to exactly `path`; OSError where it cannot be."""
    from safetensors.torch import save

    tensors: dict[str, torch.Tensor] = {}
    text = json.dumps(_encoded(content, tensors))
    Path(path).write_bytes(save(tensors, {CONTENT: text}))


def read_tree(path: Path) -> dict[Any, Any]:
    """What `write_tree` wrote; BadInput for any other file."""
    from safetensors import safe_open

    path = Path(path)
    fault = file_fault(path)
    try:
        if fault is None:
            with safe_open(path, "pt") as stored:
                tensors = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118, it is no dictionary
                content = _decoded(json.loads(stored.metadata()[CONTENT]), tensors)
            if isinstance(content, dict):
                return content
    except Exception as error:  # safetensors raises its own kinds, KeyError and TypeError for a corrupt file
        fault = type(error).__name__
    raise BadInput(f"{path}: holds no weights of gelforge ({fault or 'another content'}); train the model again")


def _encoded(value: Any, tensors: dict[str, torch.Tensor]) -> Any:
    if isinstance(value, torch.Tensor):
        name = f"t{len(tensors)}"
        tensors[name] = value.detach().cpu().contiguous().clone()
        return {TENSOR: name}
    if isinstance(value, dict):
        return {PAIRS: [[key, _encoded(one, tensors)] for key, one in value.items()]}
    if isinstance(value, list | tuple):
        return [_encoded(one, tensors) for one in value]
    return value


def _decoded(value: Any, tensors: dict[str, torch.Tensor]) -> Any:
    if isinstance(value, dict):
        if TENSOR in value:
            return tensors[value[TENSOR]]
        return {key: _decoded(one, tensors) for key, one in value[PAIRS]}
    return [_decoded(one, tensors) for one in value] if isinstance(value, list) else value


def tensors_of(net: nn.Module) -> dict[str, torch.Tensor]:
    """A network's tensors by name, on the CPU."""
    return {name: value.detach().cpu().contiguous() for name, value in net.state_dict().items()}


def save_weights(path: Path, net: nn.Module, metadata: dict[str, Any]) -> None:
    """Write a network's weights and what is known about it to exactly `path`."""
    write_tree({"metadata": metadata, "tensors": tensors_of(net)}, path)


def load_weights(path: Path) -> tuple[nn.Module, dict[str, Any]]:
    """A network in evaluation mode and what is known about it; BadInput where its tensors do not fit what the file describes."""
    content = read_tree(path)
    try:
        metadata = content["metadata"]
        net = build(metadata["model"], metadata["image"], metadata["grid"])
        net.load_state_dict(content["tensors"])
    except (KeyError, TypeError, RuntimeError, AttributeError) as error:
        raise BadInput(
            f"{path}: its weights do not fit the network that it describes ({type(error).__name__}); train it again"
        ) from None
    return net.eval(), metadata
