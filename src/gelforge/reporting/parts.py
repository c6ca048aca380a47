"""Compact data of single presses for the page: image, maps and gel.

A press is a dict of `image` (JPEG as base64, if any), `arrays` (name, length and unit of each array) and `data`: all
arrays concatenated as deflated little-endian int16 numbers. The page loads parts of PART presses. A part is a line of
JavaScript, because a page opened from disk can load no other kind of file.
"""

import base64
import hashlib
import json
import shutil
import zlib
from pathlib import Path

import numpy as np

from gelforge.records.image import encode_jpeg

PART = 16
PARTS = "parts-"
FULL = 32767
MICRON = 1e-3  # unit of three-dimensional coordinates, mm
MOST_ARROWS = 300
JPEG_QUALITY = 88


def pack(arrays: dict[str, np.ndarray | tuple[np.ndarray, float]]) -> dict:
    """Arrays by name as {"arrays": [[name, length, unit], …], "data": base64}; the default unit fills int16."""
    listed, parts = [], []
    for name, value in arrays.items():
        values, unit = value if isinstance(value, tuple) else (value, _unit(value))
        listed.append([name, int(values.size), unit])
        parts.append(np.clip(np.rint(np.ravel(values) / unit), -FULL, FULL).astype("<i2"))
    return {"arrays": listed, "data": base64.b64encode(zlib.compress(_planes(parts), 6)).decode()}


def _unit(values: np.ndarray) -> float:
    largest = float(np.abs(values).max(initial=0.0))
    return largest / FULL if largest > 0 else 1.0


def _planes(parts) -> bytes:
    """All low bytes, then all high bytes, which deflate to a third less."""
    return np.concatenate([np.empty(0, "<i2"), *parts]).view(np.uint8).reshape(-1, 2).T.tobytes()


def jpeg(image: np.ndarray) -> str:
    """An RGB image (h, w, 3) uint8 as base64 of a JPEG."""
    return base64.b64encode(encode_jpeg(image, JPEG_QUALITY)).decode()


def arrows(points: np.ndarray, force: np.ndarray) -> dict:
    """The MOST_ARROWS largest nodal forces (k, 3) N and their positions (k, 3) mm, as arrays to pack."""
    size = np.linalg.norm(force, axis=1)
    largest = np.argsort(-size)[:MOST_ARROWS]
    largest = largest[size[largest] > 0]
    return {"points": (points[largest], MICRON), "forces": force[largest]}


def part_text(number: int, presses: list[dict]) -> str:
    """A part as a line of JavaScript."""
    return f"gelforgePart({number},{script_json(presses)});"


def script_json(value) -> str:
    """A value as JSON that is safe inside a script element, whatever text it holds."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return text


def in_parts(presses):
    """Yield (number, text) of consecutive parts of an iterable of presses."""
    held, number = [], 0
    for press in presses:
        held.append(press)
        if len(held) == PART:
            yield number, part_text(number, held)
            held, number = [], number + 1
    if held:
        yield number, part_text(number, held)


def place_parts(folder: Path, parts, limit: float) -> tuple[str, list[str]]:
    """Return parts of up to `limit` bytes in total for embedding in the page, or write them beside it.

    Returns the name of the folder of NUMBER.js files beside the page, empty where parts are embedded, and the
    embedded parts. The folder is named by a hash of its content, so that a page opened earlier never loads parts of a
    newer one.
    """
    held, size, digest, made = [], 0, hashlib.sha256(), folder / ".parts"
    shutil.rmtree(made, ignore_errors=True)
    for number, text in parts:
        digest.update(text.encode())
        size += len(text)
        if size <= limit:
            held.append(text)
            continue
        made.mkdir(parents=True, exist_ok=True)
        for early, earlier in enumerate(held):
            (made / f"{early}.js").write_text(earlier, encoding="utf-8")
        held = []
        (made / f"{number}.js").write_text(text, encoding="utf-8")
    if size <= limit:
        return "", held
    name = f"{PARTS}{digest.hexdigest()[:12]}"
    shutil.rmtree(folder / name, ignore_errors=True)
    made.rename(folder / name)
    return name, []


def forget_parts(folder: Path, kept: str) -> None:
    """Remove folders of parts of earlier pages; kept: the folder to keep."""
    for old in folder.glob(f"{PARTS}*"):
        if old.name != kept:
            shutil.rmtree(old)
