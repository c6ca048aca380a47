"""Films: with a constant frame rate by OpenCV, and with a variable one, as Matroska and MP4, byte by byte."""

import struct
from pathlib import Path

import cv2
import numpy as np

from gelforge.records.film import frames, open_source


def frames_of(path: Path) -> list[np.ndarray]:
    """All frames (h, w, 3) uint8 RGB of a film, whatever number it announces; BadInput if it has none."""
    with open_source(path, None) as (source, _announced):
        return [np.ascontiguousarray(frame[..., ::-1]) for frame in frames(source, 0, str(path), None)]


def write_film(path: Path, images, rate: float = 25.0) -> Path:
    """Images (h, w, 3) uint8 BGR as a film of constant frame rate: motion JPEG in .avi, MPEG-4 in .mp4."""
    writer, kind = None, "mp4v" if Path(path).suffix == ".mp4" else "MJPG"
    for image in images:
        if writer is None:
            writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*kind), rate, image.shape[1::-1])
        writer.write(np.ascontiguousarray(image))
    writer.release()
    return path


def write_matroska(path: Path, images, times_ms, quality: int = 95, duration_ms: float | None = None) -> Path:
    """Images (h, w, 3) uint8 BGR as motion JPEG in Matroska (RFC 9559), each with its time, one cluster per frame."""
    images = list(images)
    height, width = images[0].shape[:2]
    last = times_ms[-1] + np.median(np.diff(times_ms))
    info = element(
        0x1549A966, element(0x2AD7B1, whole(10**6)) + element(0x4489, struct.pack(">d", duration_ms or last))
    )
    video = element(0xE0, element(0xB0, whole(width)) + element(0xBA, whole(height)))
    track = element(0xD7, whole(1)) + element(0x73C5, whole(1)) + element(0x83, whole(1)) + element(0x86, b"V_MJPEG")
    clusters = b"".join(
        element(
            0x1F43B675, element(0xE7, whole(int(time))) + element(0xA3, b"\x81\x00\x00\x80" + jpeg(image, quality))
        )
        for image, time in zip(images, times_ms, strict=True)
    )
    body = info + element(0x1654AE6B, element(0xAE, track + video)) + clusters
    path.write_bytes(element(0x1A45DFA3, element(0x4282, b"matroska")) + element(0x18538067, body))
    return path


def jpeg(image, quality: int) -> bytes:
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def whole(value: int) -> bytes:
    return struct.pack(">Q", value)


def element(name: int, body: bytes) -> bytes:
    return name.to_bytes((name.bit_length() + 7) // 8, "big") + (len(body) | 1 << 56).to_bytes(8, "big") + body


def write_mp4(path: Path, images, steps_ms) -> Path:
    """Images as MPEG-4 in MP4, each shown for one of `steps_ms`, whose mean must be OpenCV's 100 ms per frame."""
    content = write_film(path, images, 10.0).read_bytes()
    at = content.index(b"mdhd") + 4
    (scale,) = struct.unpack(">I", content[at + 12 : at + 16])
    entries = b"".join(struct.pack(">II", 1, round(step * scale / 1000)) for step in steps_ms)
    table = struct.pack(">II", 0, len(steps_ms)) + entries
    path.write_bytes(with_box(content, (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stts"), table))
    return path


def with_box(content: bytes, names: tuple[bytes, ...], body: bytes) -> bytes:
    """MP4's nested boxes with a new body in the innermost of `names`; moov must follow the data it points to."""
    at, found = 0, b""
    while at < len(content):
        size, name = struct.unpack(">I4s", content[at : at + 8])
        inner = content[at + 8 : at + size]
        if name == names[0]:
            inner = with_box(inner, names[1:], body) if len(names) > 1 else body
        found += struct.pack(">I4s", len(inner) + 8, name) + inner
        at += size
    return found
