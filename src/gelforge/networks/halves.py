"""Weights of the small networks beside a network in half precision, as its file keeps them: half the size.

They are rounded when training ends, so that a file reads back as what was trained.
"""

from typing import TypeVar

import torch
from torch import nn

Net = TypeVar("Net", bound=nn.Module)


def rounded(net: Net) -> Net:
    """The network with its weights, but not its biases and scales, rounded to half precision, in place."""
    with torch.no_grad():
        for value in net.parameters():
            if value.ndim > 1:
                value.copy_(value.half())
    return net


def halved(tensors: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Tensors of a `rounded` network as its file keeps them."""
    return {name: value.half() if value.ndim > 1 else value for name, value in tensors.items()}


def as_floats(tensors: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Tensors of a file with those in half precision in single precision."""
    return {name: value.float() if value.dtype == torch.float16 else value for name, value in tensors.items()}
