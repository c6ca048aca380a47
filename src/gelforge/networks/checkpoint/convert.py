"""Models of an earlier version (.pt, format 4) as what this one reads: their network alone, without what stood beside it."""

import json
from pathlib import Path
from typing import Any

import torch
from torch import nn

from gelforge.errors import BadInput
from gelforge.networks.models.registry import build
from gelforge.records.regular import file_fault

OLD_FORMAT = 4
# What described readers of markers and their fusion, which are gone, and intervals, which held for all of them together.
GONE = ("format", "sha256", "dots", "places", "stacking", "intervals", "both_ways", "start")


def read_old(path: Path) -> tuple[nn.Module, dict[str, Any]]:
    """The network of a .pt file and its metadata in today's words; BadInput for a file that is none."""
    fault = file_fault(path)
    if fault:
        raise BadInput(f"{path}: cannot be read ({fault}); name a model of an earlier version")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
        about = json.loads(content["about"])
        if about["format"] != OLD_FORMAT:
            raise BadInput(
                f"{path}: its format is {about['format']}, only {OLD_FORMAT} can be converted; train it again"
            )
        net = build(about["model"], about["image"], about["grid"])
        net.load_state_dict(content["tensors"])
    except BadInput:
        raise
    except Exception as error:  # torch raises a dozen kinds for a corrupt file, none of them documented
        raise BadInput(
            f"{path}: not a gelforge model of format {OLD_FORMAT} ({type(error).__name__}); train it again"
        ) from None
    metadata = {name: value for name, value in about.items() if name not in GONE}
    before = about.get("start") or {}
    return net.eval(), metadata | {
        "tta": bool(about.get("both_ways")),
        "start": before and before | {"fraction": before["share"]},
    }
