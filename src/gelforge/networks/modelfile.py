"""Model files: tensors and one JSON text, read without executing anything."""

import copy
import hashlib
import io
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F
from torch.nn.utils.fusion import fuse_conv_bn_eval

from gelforge.errors import BadInput
from gelforge.flow.layout import command_for
from gelforge.networks.batches import images_to_tensor
from gelforge.networks.dotreader import DotReader
from gelforge.networks.halves import as_floats, halved
from gelforge.networks.inputs import needs_untouched, network_input
from gelforge.networks.modelcheck import MOST_BYTES, check_about, check_pictures, check_tensors, holds_numbers
from gelforge.networks.models import GridNet, build
from gelforge.networks.placereader import PlaceReader
from gelforge.networks.stacking import OF_FORCES, StackedFactor
from gelforge.networks.unrolled import Unrolled, pooled_count
from gelforge.records.image import decode, encode_png
from gelforge.records.regular import file_fault

FORMAT = 4
# Small networks beside a network, by their names in its file, and how each is made for that network.
READERS: dict[str, Callable[[nn.Module], nn.Module]] = {
    "dots": lambda _net: DotReader(),
    "places": lambda _net: PlaceReader(),
    "stacking": lambda net: StackedFactor(OF_FORCES + pooled_count(net)),
}
Net = TypeVar("Net", bound=nn.Module)


@dataclass(frozen=True)
class Trained:
    """A trained network and all that is known about it (`about`, the JSON part of the file).

    untouched: pictures (h, w, 3) uint8 RGB by sensor of its dataset's untouched sensors, where it reads differences.
    dots: the reader of dots beside it, where it has one; about["dots"] says how their totals meet (networks.dotreader).
    places: the reader of how a gel sits, where it has one (networks.placereader).
    stacking: what corrects the normal force that both readers tell, where it was learnt (networks.stacking).
    """

    net: nn.Module
    about: dict
    untouched: dict[str, np.ndarray] = field(default_factory=dict)
    dots: DotReader | None = None
    places: PlaceReader | None = None
    stacking: StackedFactor | None = None

    @property
    def needs_untouched(self) -> bool:
        return needs_untouched(self.about["normalisation"]["reads"])

    @property
    def for_any_sensor(self) -> bool:
        """Whether it learnt from so many sensors that it keeps no picture of any: a new one brings its own."""
        return self.needs_untouched and not self.untouched


class Entry(nn.Module):
    """A network's first convolution, made to read images (n, 3, h, w) in 0..255 as they come from a camera.

    What is linear before it, scales and the difference from the untouched sensor, goes into its weights and into a map
    that is the same for every image: a third of the light nets' time on a CPU.

    :param gain: (3,) factor of each colour. :param constant: (1, channels, h, w), the network's input less what
        depends on the image.
    """

    def __init__(self, convolution: nn.Conv2d, gain: torch.Tensor, constant: torch.Tensor):
        super().__init__()
        self.stride, self.padding = convolution.stride, convolution.padding
        weight = convolution.weight.unflatten(1, (-1, 3)).sum(1) * gain.view(1, 3, 1, 1)
        self.register_buffer("weight", weight.contiguous(memory_format=torch.channels_last))
        self.register_buffer("constant", convolution(constant).contiguous(memory_format=torch.channels_last))

    def forward(self, images):
        return F.conv2d(images, self.weight, None, self.stride, self.padding) + self.constant


def fold_normalisation(net: nn.Module) -> None:
    """Put every batch normalisation of a network in evaluation mode into its convolution, registered just before it."""
    for module in list(net.modules()):
        children = list(module.named_children())
        for (before, convolution), (name, norm) in zip(children, children[1:]):
            if isinstance(norm, nn.BatchNorm2d) and isinstance(convolution, nn.Conv2d):
                setattr(module, before, fuse_conv_bn_eval(convolution, norm))
                setattr(module, name, nn.Identity())


class SensorNet(nn.Module):
    """A network for one sensor, scales inside: images (n, 3, h, w) in 0..255 to forces (n, 3, rows, cols), N per cell.

    :param untouched: picture (h, w, 3) uint8 RGB of that sensor, where the network reads differences; or (n, h, w, 3), one for
        each of n images that are always read together.
    """

    def __init__(self, trained: Trained, untouched: np.ndarray | None = None):
        super().__init__()
        if trained.needs_untouched and untouched is None:
            raise BadInput(
                f"model {trained.about['name']} reads how an image differs from the untouched sensor: give a "
                "picture of it"
            )
        norm = trained.about["normalisation"]
        gain = 1 / (255 * torch.tensor(norm["image_std"]).float())
        # torch's types know neither memory formats nor what families have of their own
        net: Any = copy.deepcopy(trained.net)
        fold_normalisation(net)
        self.net = net.to(memory_format=torch.channels_last)  # a third faster on a CPU
        # the input of a black image is all that does not depend on the image
        pictures = np.zeros((1, *trained.about["image"], 3), np.uint8)
        if untouched is not None and trained.needs_untouched:
            beside = untouched.reshape(-1, *untouched.shape[-3:])
            pictures = np.concatenate([np.zeros_like(beside), beside], axis=3)
        with torch.no_grad():
            constant = network_input(images_to_tensor(pictures), norm)
            for module, name in net.entries():
                setattr(module, name, Entry(getattr(module, name), gain, constant))
        if isinstance(net, GridNet):
            self.net = Unrolled(net)
        self.register_buffer("scale", torch.tensor(norm["label"]).float().view(1, 3, 1, 1))

    def forward(self, images):
        return self.net(images) * self.scale

    def with_pooled(self, images):
        """As `forward`, and what the network sees in each image as a whole, (n, `pooled_count`)."""
        if not isinstance(self.net, Unrolled):
            return self(images), images.new_zeros(len(images), 0)
        told, pooled = self.net.with_pooled(images)
        return told * self.scale, pooled


def predict_images(reader: SensorNet, images, device: str = "cpu") -> np.ndarray:
    """Forces (n, 3, rows, cols) in N per cell of images (n, h, w, 3) uint8 RGB."""
    with torch.inference_mode():
        return reader(_as_tensor(images, device)).cpu().numpy()


def predict_pooled(reader: SensorNet, images: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `predict_images`, and what is seen in each image as a whole, (n, `pooled_count`)."""
    with torch.inference_mode():
        forces, pooled = reader.with_pooled(_as_tensor(images, "cpu"))
        return forces.numpy(), pooled.numpy()


def _as_tensor(images, device: str) -> torch.Tensor:
    """Images (n, h, w, 3) uint8 as a network reads them.

    Channels stay behind each pixel, as a camera gives them and convolutions on a CPU like them.
    """
    return torch.from_numpy(np.require(images, requirements=["C", "W"])).to(device).permute(0, 3, 1, 2).float()


def save_model(path, trained: Trained) -> None:
    """Write a model to exactly `path`; the caller publishes it."""
    tensors = tensors_of(trained.net)
    told = {"format": FORMAT, **trained.about, "sha256": tensor_digest(tensors)}
    parts: dict[str, Any] = {"tensors": tensors}
    for name in READERS:
        reader = getattr(trained, name)
        if reader is not None:
            parts[name] = halved(tensors_of(reader))
            told[name] = trained.about.get(name, {}) | {"sha256": tensor_digest(parts[name])}
    parts["untouched"] = {name: encode(picture) for name, picture in trained.untouched.items()}
    write_tensors({"about": json.dumps(told, sort_keys=True, allow_nan=False), **parts}, path)


def write_tensors(content: dict[str, Any], path: Path) -> None:
    """Write tensors and plain values to exactly `path`; OSError where they cannot be, which torch's own writer does not say."""
    buffer = io.BytesIO()
    torch.save(content, buffer)
    Path(path).write_bytes(buffer.getbuffer())


def tensors_of(net: nn.Module) -> dict[str, torch.Tensor]:
    """A network's tensors by name, as a file keeps them."""
    return {name: value.detach().cpu().contiguous() for name, value in net.state_dict().items()}


def tensor_digest(tensors: dict[str, torch.Tensor]) -> str:
    """SHA-256 of tensors by name: names, types, shapes and bytes."""
    digest = hashlib.sha256()
    for name in sorted(tensors):
        array = tensors[name].numpy()
        digest.update(f"{name} {array.dtype} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def encode(picture: np.ndarray) -> torch.Tensor:
    """A picture (h, w, 3) uint8 RGB as the bytes of a PNG: half the size."""
    return torch.frombuffer(bytearray(encode_png(picture)), dtype=torch.uint8)


def load_model(path) -> Trained:
    """Read a model, in evaluation mode on the CPU.

    Raises BadInput for a file that is missing, cut short, of another kind or format, or whose
    tensors do not fit the network that it describes.
    """
    path = Path(path)
    if not path.exists():
        raise BadInput(f"{path}: no such model; train one with `{command_for('train MODEL=…', path)}`")
    fault = file_fault(path) or ("it is larger than 2 GiB" if path.stat().st_size > MOST_BYTES else None)
    if fault:
        raise BadInput(f"{path}: not a model ({fault}); name the file that make train wrote")
    content = read_tensors(path)
    content = content if isinstance(content, dict) else {}
    about, tensors = content.get("about"), content.get("tensors")
    try:
        about = json.loads("" if about is None else about)
    except (TypeError, ValueError, RecursionError) as error:
        raise BadInput(f"{path}: not a gelforge model of format {FORMAT} ({error}); train it again") from None
    if not isinstance(about, dict) or about.get("format") != FORMAT:
        seen = about.get("format") if isinstance(about, dict) else type(about).__name__
        raise BadInput(f"{path}: not a gelforge model of format {FORMAT} (its format is {seen}); train it again")
    tensors = tensors if isinstance(tensors, dict) else {}
    check_about(about, str(path))
    net = restored(lambda: build(about["model"], about["image"], about["grid"]), tensors, about["sha256"], str(path))
    readers: dict[str, Any] = {
        name: restored(partial(make, net), content.get(name), about[name]["sha256"], f"{path}: {name}")
        for name, make in READERS.items()
        if about.get(name)
    }
    untouched = read_pictures(content.get("untouched"), str(path))
    check_pictures(about, untouched, str(path))
    return Trained(net, about, untouched, **readers)


def restored(make: Callable[[], Net], tensors: Any, digest: str, where: str) -> Net:
    """The network that `make` makes with its tensors, in evaluation mode; BadInput where they are not those of `digest`."""
    check_tensors(make, tensors, where)
    if digest != tensor_digest(tensors):
        raise BadInput(f"{where}: its weights are not those that were trained; the file is damaged: copy it again")
    net = make()
    net.load_state_dict(as_floats(tensors))
    return net.eval()


def read_pictures(pictures, where: str) -> dict[str, np.ndarray]:
    """Pictures (h, w, 3) uint8 RGB of untouched sensors by name, from the bytes that `encode` made."""
    good = isinstance(pictures, dict) and all(
        isinstance(name, str) and holds_numbers(data) and data.dtype == torch.uint8 and data.ndim == 1
        for name, data in pictures.items()
    )
    if not good:
        raise BadInput(f"{where}: its pictures of untouched sensors are none; train the model again")
    remedy = "train the model again"
    return {
        name: decode(data.numpy().tobytes(), f"{where}: untouched {name}", remedy) for name, data in pictures.items()
    }


def read_tensors(path) -> dict:
    """Load a file of torch tensors with torch's weights-only reader, which runs no code of the file."""
    if path.suffix == ".onnx":  # make onnx writes it into a folder beside the model
        home = path.parent.parent if path.parent.name == "onnx" else path.parent
        raise BadInput(
            f"{path}: ONNX is for other programs; gelforge reads the file that it was made from: name {home / path.stem}.pt"
        )
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises a dozen kinds for a damaged file, none of them documented
        raise BadInput(
            f"{path}: cannot be read as tensors ({type(error).__name__}); the file is damaged or holds "
            "code, which is never run: train the model again"
        ) from None


def datasets_of(about: dict[str, Any]) -> list[dict[str, Any]]:
    """What a model's description says of each dataset that it learnt from, its own first."""
    return [about["data"], *about["also"]]


def lessons_of(about: dict[str, Any]) -> list[dict[str, Any]]:
    """As `datasets_of`, and those that what stands above both readers learnt from, where there is such."""
    above = about.get("stacking")
    return [*datasets_of(about), *([above, *above["also"]] if above else [])]


def require_fit(trained: Trained, data, called: str = "") -> None:
    """Raise BadInput if a model cannot be used on a dataset: other grid, image size or sensor.

    called: what people call it, where that is not the name that it was trained under.
    """
    about = trained.about
    called = called or f"model {about['name']}"
    (high, wide), (height, width) = about["image"], data.image_size
    if (high, wide) != (height, width):
        raise BadInput(
            f"{called} reads images of {wide} x {high}, the dataset has {width} x {height}: use a model trained on this size"
        )
    (rows, cols), (of_rows, of_cols) = about["grid"], data.grid
    if (rows, cols) not in ((of_rows, of_cols), (1, 1)):
        raise BadInput(
            f"{called} writes a grid of {rows}x{cols}, the dataset has {of_rows}x{of_cols}: evaluate it on the dataset of its"
            " own RES"
        )
    require_sensor(trained, set(data.names("sensor_id").tolist()))


def require_sensor(trained: Trained, wanted: set[str]) -> None:
    """Raise BadInput if none of the sensors `wanted` belongs to the dataset that a model comes from."""
    if trained.for_any_sensor:
        return
    known = trained.about["known_sensors"]
    if wanted.isdisjoint(known):
        raise BadInput(
            f"model {trained.about['name']} was made for sensors {', '.join(known)}, not for "
            f"{', '.join(sorted(wanted))}: use a model trained on a dataset with that sensor"
        )
