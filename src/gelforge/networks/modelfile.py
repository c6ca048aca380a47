"""Model files: tensors and one JSON text, read without executing anything."""

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import nn

from gelforge.errors import BadInput
from gelforge.networks.inputs import needs_untouched
from gelforge.networks.models import build

FORMAT = 2
KEYS = ("name", "model", "train", "image", "grid", "known_sensors", "sensors", "data", "normalisation", "statistics")


@dataclass(frozen=True)
class Trained:
    """A trained network and all that is known about it (`about`, the JSON part of the file).

    untouched: pictures (h, w, 3) uint8 RGB by sensor of its dataset's untouched sensors, where it reads differences.
    """

    net: nn.Module
    about: dict
    untouched: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def needs_untouched(self) -> bool:
        return needs_untouched(self.about["normalisation"]["reads"])


class Reader(nn.Module):
    """A network for one sensor, scales inside: images (n, 3, h, w) in 0..255 to forces (n, 3, rows, cols), N per cell.

    :param untouched: picture (h, w, 3) uint8 RGB of that sensor, where the network reads differences.
    """

    def __init__(self, trained: Trained, untouched: np.ndarray | None = None):
        super().__init__()
        if trained.needs_untouched and untouched is None:
            raise BadInput(
                f"model {trained.about['name']} reads how an image differs from the untouched sensor: give a "
                "picture of it"
            )
        norm = trained.about["normalisation"]
        mean, std = torch.tensor(norm["image_mean"]), torch.tensor(norm["image_std"])
        self.reads = norm["reads"]
        self.net = trained.net.to(memory_format=torch.channels_last)  # a third faster on a CPU
        self.register_buffer("gain", (1 / (255 * std)).float().view(1, 3, 1, 1))
        self.register_buffer("offset", (-mean / std).float().view(1, 3, 1, 1))
        self.register_buffer("scale", torch.tensor(norm["label"]).float().view(1, 3, 1, 1))
        if trained.needs_untouched:
            self.register_buffer("untouched", torch.from_numpy(untouched.copy()).permute(2, 0, 1)[None].float())

    def forward(self, images):
        return self.against(images, self.untouched if needs_untouched(self.reads) else None)

    def against(self, images, untouched):
        """The same with another picture (1, 3, h, w) in 0..255 of the untouched sensor."""
        parts = []
        if self.reads != "difference":
            parts.append(images * self.gain + self.offset)
        if untouched is not None:
            parts.append((images - untouched) * self.gain)
        return self.net(torch.cat(parts, 1) if len(parts) > 1 else parts[0]) * self.scale


def save_model(path, trained: Trained) -> None:
    """Write a model to exactly `path`; the caller publishes it."""
    tensors = {name: value.detach().cpu().contiguous() for name, value in trained.net.state_dict().items()}
    about = json.dumps({"format": FORMAT} | trained.about, sort_keys=True, allow_nan=False)
    pictures = {name: encode(picture) for name, picture in trained.untouched.items()}
    torch.save({"about": about, "tensors": tensors, "untouched": pictures}, path)


def encode(picture: np.ndarray) -> torch.Tensor:
    """A picture (h, w, 3) uint8 RGB as the bytes of a PNG: half the size."""
    import cv2

    return torch.from_numpy(cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))[1].ravel())


def decode(content: torch.Tensor) -> np.ndarray:
    """The picture (h, w, 3) uint8 RGB that `encode` was given; ValueError if the bytes are none."""
    import cv2

    picture = cv2.imdecode(content.numpy(), cv2.IMREAD_COLOR)
    if picture is None:
        raise ValueError("a picture of an untouched sensor is damaged")
    return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)


def load_model(path) -> Trained:
    """Read a model, in evaluation mode on the CPU.

    Raises BadInput for a file that is missing, cut short, of another kind or format, or whose
    tensors do not fit the network that it describes.
    """
    import cv2

    path = Path(path)
    if not path.exists():
        raise BadInput(f"{path}: no such model; train one with `make train MODEL=…`")
    content = read_tensors(path)
    try:
        about = json.loads(content["about"])
        missing = [key for key in KEYS if key not in about]
        if about.get("format") != FORMAT or missing:
            raise KeyError(f"format {about.get('format')}, missing {missing}")
        tensors = content["tensors"]
        untouched = {name: decode(picture) for name, picture in content["untouched"].items()}
    except (KeyError, TypeError, ValueError, AttributeError, cv2.error) as error:
        raise BadInput(f"{path}: not a gelforge model of format {FORMAT} ({error}); train it again") from None
    net = build(about["model"], about["image"], about["grid"])
    try:
        net.load_state_dict(tensors)
    except (RuntimeError, AttributeError, TypeError) as error:
        first = str(error).splitlines()[0]
        raise BadInput(f"{path}: the tensors do not fit the network it describes ({first}); train it again") from None
    return Trained(net.eval(), about, untouched)


def read_tensors(path) -> dict:
    """Load a file of torch tensors with torch's weights-only reader, which runs no code of the file."""
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises a dozen kinds for a damaged file, none of them documented
        raise BadInput(
            f"{path}: cannot be read as tensors ({type(error).__name__}); the file is damaged or holds "
            "code, which is never run: train the model again"
        ) from None


def require_fit(trained: Trained, data) -> None:
    """Raise BadInput if a model cannot be used on a dataset: other grid, image size or sensor."""
    about = trained.about
    if tuple(about["image"]) != tuple(data.image_size):
        raise BadInput(
            f"model {about['name']} reads images of {about['image']}, the dataset has "
            f"{list(data.image_size)}: use a model trained on this size"
        )
    if tuple(about["grid"]) not in (tuple(data.grid), (1, 1)):
        raise BadInput(
            f"model {about['name']} writes a grid of {about['grid']}, the dataset has {list(data.grid)}: "
            "evaluate it on the dataset of its own RES"
        )
    require_sensor(trained, set(data.names("sensor_id").tolist()))


def require_sensor(trained: Trained, wanted: set[str]) -> None:
    """Raise BadInput if none of the sensors `wanted` belongs to the dataset that a model comes from."""
    known = trained.about["known_sensors"]
    if wanted.isdisjoint(known):
        raise BadInput(
            f"model {trained.about['name']} was made for sensors {', '.join(known)}, not for "
            f"{', '.join(sorted(wanted))}: use a model trained on a dataset with that sensor"
        )
