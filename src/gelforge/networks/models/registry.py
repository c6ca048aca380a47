"""The network families by name: a table of workflow/models.toml to a network with fresh weights.

Every network maps an input (n, channels, height, width), normalised, to (n, 3, rows, cols) in label units of its training
scale. A new family is a file beside this one, one line in `build`, and one in `records/networkkind.py`.
"""

import torch
from torch import nn

from gelforge.errors import BadInput
from gelforge.networks.models.gridnet import GridNet
from gelforge.networks.models.unet import UNet, side_at_top
from gelforge.records.networkkind import kind_of, sizes_of


def build(config: dict, image, grid) -> nn.Module:
    """Build the network that `config` describes, with fresh weights from torch's current seed.

    :param config: one table of workflow/models.toml: `kind` and the sizes of that kind.
    :param image: (height, width) in pixels. :param grid: (rows, cols) of the label.
    """
    sizes = sizes_of(config) | {"channels": 6 if kind_of(config).pair else 3}
    kinds = {"unet": lambda: UNet(grid, **sizes), "grid": lambda: GridNet(image, grid, **sizes)}
    net = kinds[config["kind"]]()
    net.pair = kind_of(config).pair
    if isinstance(net, UNet) and side_at_top(min(image), len(net.down)) < 1:
        raise BadInput(
            f"a U-net of {len(net.down)} widths leaves nothing of an image of {image[1]} x {image[0]}; give it fewer widths or"
            " larger images"
        )
    return net


def parameter_count(net: nn.Module) -> int:
    """Number of trained values in a network."""
    return sum(p.numel() for p in net.parameters())


def begin_as(net: nn.Module, weights: dict[str, torch.Tensor]) -> None:
    """Let a network begin with the weights of another one, which may be a light net of fewer blocks.

    Blocks of its own change nothing at first, so that it reads as the other did before it learns (Chen, Goodfellow and
    Shlens 2016, section 2.3).
    """
    added = {name: value for name, value in net.state_dict().items() if name not in weights}
    silent = {
        name: torch.zeros_like(value)
        for name, value in added.items()
        if name.startswith("context.") or name.endswith(".second_norm.weight")
    }
    net.load_state_dict(weights | added | silent)
