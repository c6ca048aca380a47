"""The file that predicts: an ONNX graph with its metadata inside, as JSON of `metadata_props`. Nothing of it is executed.

A model may be a chain of graphs (`metadata["stages"]`, in the order in which they run): NAME.onnx holds the last one and the
metadata of all, NAME.STAGE.onnx beside it each of the others. Every graph is given what its inputs name, from what
`networks.preprocess.pair` prepares and what the graphs before it returned (networks.inference.predictor).
"""

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gelforge.errors import BadInput
from gelforge.flow.layout import beside, command_for
from gelforge.networks.checkpoint.metadata import check_metadata
from gelforge.networks.models.inputs import needs_nocontact
from gelforge.records.regular import read_bytes

FORMAT = 5
LAST = "forces"  # the stage that every model ends with
KEY = b"gelforge"  # of the metadata among `metadata_props`
PROPERTY, BYTES = (
    14,
    2,
)  # number of that field of ONNX' ModelProto, and protobuf's type of a field that states its length
MOST_BYTES = 2**31
CONVERT = "gelforge convert {path}"


@dataclass(frozen=True)
class ForceModel:
    """A model to predict with: what is known about it, and ONNX graphs by the name of their stage, in the order of use."""

    metadata: dict[str, Any]
    stages: dict[str, bytes]

    @property
    def needs_nocontact(self) -> bool:
        """Whether it reads a picture beside a no-contact image of the same sensor."""
        return needs_nocontact(self.metadata["normalisation"]["reads"])


def digest_of_graph(graph: bytes) -> str:
    """SHA-256 of a graph without metadata."""
    return hashlib.sha256(graph).hexdigest()


def with_digests(metadata: dict[str, Any], stages: dict[str, bytes]) -> dict[str, Any]:
    """Metadata as a file of these graphs holds it."""
    digests = {name: digest_of_graph(graph) for name, graph in stages.items()}
    return metadata | {"format": FORMAT, "stages": list(stages), "sha256": digests}


def save_model(path: Path, model: ForceModel) -> None:
    """Write a model to exactly `path`, and the graphs before its last one beside it; the caller publishes it."""
    metadata = with_digests(model.metadata, model.stages)
    text = json.dumps(metadata, sort_keys=True, allow_nan=False)
    for name, graph in model.stages.items():
        if name == LAST:
            Path(path).write_bytes(graph + _property(text.encode()))
        else:
            beside(Path(path), f".{name}.onnx").write_bytes(graph)


def load_model(path: Path | str) -> ForceModel:
    """Read a model and check its metadata and the digests of its graphs.

    Raises BadInput for a file that is missing, cut short, changed, or of another kind or format.
    """
    path = Path(path)
    refuse_other_kinds(path)
    hint = f"train one with `{command_for('train MODEL=…', path)}`"
    graph, text = split_metadata(read_bytes(path, hint, MOST_BYTES), str(path))
    try:
        metadata = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path}: not a gelforge model ({error}); train it again") from None
    if not isinstance(metadata, dict) or metadata.get("format") != FORMAT:
        seen = metadata.get("format") if isinstance(metadata, dict) else type(metadata).__name__
        raise BadInput(f"{path}: not a gelforge model of format {FORMAT} (its format is {seen}); train it again")
    check_metadata(metadata, str(path))
    stages = {name: _stage(path, name, graph) for name in metadata["stages"]}
    for name, found in stages.items():
        if metadata["sha256"].get(name) != digest_of_graph(found):
            raise BadInput(
                f"{path}: its graph `{name}` is not the one that was trained; the file is corrupt: copy it again"
            )
    return ForceModel(metadata, stages)


def refuse_other_kinds(path: Path) -> None:
    """BadInput for a model of an earlier version and for weights, with the command that converts it or the file to name."""
    if path.suffix == ".pt":
        command = CONVERT.format(path=path)
        raise BadInput(
            f"{path}: is a model of an earlier version; convert it once with `{command}`, which needs gelforge[train]"
        )
    if path.suffix == ".safetensors":
        raise BadInput(f"{path}: holds weights for further training; name {path.with_suffix('.onnx')} beside it")


def _stage(path: Path, name: str, last: bytes) -> bytes:
    return last if name == LAST else read_bytes(beside(path, f".{name}.onnx"), f"copy it beside {path}", MOST_BYTES)


def _varint(value: int) -> bytes:
    found = bytearray()
    while value > 0x7F:
        found.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*found, value])


def _field(number: int, content: bytes) -> bytes:
    return _varint(number << 3 | BYTES) + _varint(len(content)) + content


def _property(text: bytes) -> bytes:
    """One entry of metadata_props: protobuf allows fields in any order, so it goes behind a graph that was written."""
    return _field(PROPERTY, _field(1, KEY) + _field(2, text))


def split_metadata(content: bytes, where: str) -> tuple[bytes, str]:
    """A file's graph and the text of its metadata; BadInput for what is no ONNX file of gelforge."""
    try:
        for start, number, value in _fields(content):
            if number == PROPERTY:
                entry = {key: part for _, key, part in _fields(value)}
                if entry.get(1) == KEY:
                    return content[:start], entry[2].decode()
    except (IndexError, KeyError, ValueError):
        pass
    raise BadInput(
        f"{where}: not a gelforge model (an ONNX file with its metadata); name the file that make train wrote"
    )


def _fields(content: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Place, number and content of the fields of a protobuf message; numbers have none. ValueError for what is none."""
    at = 0
    while at < len(content):
        start = at
        tag, at = _read_varint(content, at)
        size, at = _read_varint(content, at)
        if tag & 7 != BYTES:
            if tag & 7:
                raise ValueError(tag)
            yield start, tag >> 3, b""
            continue
        if at + size > len(content):
            raise ValueError(size)
        yield start, tag >> 3, content[at : at + size]
        at += size


def _read_varint(content: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = content[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at
        if shift > 63:
            raise ValueError(shift)


def datasets_of(metadata: dict[str, Any]) -> list[dict[str, Any]]:
    """What a model's metadata says of each dataset that it learnt from, its own first."""
    return [metadata["data"], *metadata["also"]]


def fingerprint(metadata: dict[str, Any]) -> str:
    """Identity of a model: digests of its graphs."""
    return "-".join(metadata["sha256"][name][:16] for name in metadata["stages"])


def require_sensor(model: ForceModel, required: set[str]) -> None:
    """Raise BadInput if none of the sensors `required` belongs to the dataset that a model of one picture comes from."""
    known = model.metadata["known_sensors"]
    if not model.needs_nocontact and required.isdisjoint(known):
        raise BadInput(
            f"model {model.metadata['name']} was made for sensors {', '.join(known)}, not for "
            f"{', '.join(sorted(required))}: use a model trained on a dataset with that sensor"
        )
