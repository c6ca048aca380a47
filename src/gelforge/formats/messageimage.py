"""Decode images and video in messages to RGB (sensor_msgs/image_encodings.hpp, Foxglove's schemas).

Images without colour are refused, because networks read normal force from the colours of the gel's three lights.
"""

import base64
import io
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.records.image import decode, is_monochrome

# Bytes of a pixel, and cv2's name of the conversion to RGB. In ROS yuv422 is UYVY. Bayer patterns are named after
# their first two rows, as in OpenCV's newer names.
ENCODINGS: dict[str, tuple[int, str]] = {
    "rgb8": (3, ""),
    "bgr8": (3, "COLOR_BGR2RGB"),
    "rgba8": (4, "COLOR_RGBA2RGB"),
    "bgra8": (4, "COLOR_BGRA2RGB"),
    **dict.fromkeys(("yuv422", "uyvy"), (2, "COLOR_YUV2RGB_UYVY")),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), (2, "COLOR_YUV2RGB_YUY2")),
    **{f"bayer_{name}8": (1, f"COLOR_Bayer{name.upper()}2RGB") for name in ("rggb", "bggr", "gbrg", "grbg")},
}
# Formats of foxglove.CompressedVideo, and FFmpeg's names of their codecs.
FILMS = {
    "h264": "h264",
    "h265": "hevc",
    "vp9": "vp9",
    "av1": "av1",
}
MONOCHROME = ("mono", "8UC1", "16UC1", "32FC1")
IN_COLOUR = "record the camera's colour topic"


def pictures(said: Iterable[Any], wanted: set[int], where: str) -> Iterator[tuple[int, np.ndarray]]:
    """Yield (index, image (h, w, 3) uint8 RGB) of the wanted messages of a topic; indices count from 0.

    Each message of a video holds one frame, whose decoding needs the earlier ones (Foxglove's schema
    CompressedVideo).
    """
    decoder: Any = None
    for at, each in enumerate(said):
        codec = FILMS.get(getattr(each, "format", None) or "")
        if codec:
            decoder = decoder or _decoder(codec)
            yield from ((k, image) for k, image in _frames(decoder, at, bytes_of(each.data), where) if k in wanted)
        elif at in wanted:
            yield at, picture(each, f"{where}, message {at + 1}")
    if decoder is not None:
        yield from ((k, image) for k, image in _frames(decoder, -1, None, where) if k in wanted)


def _decoder(codec: str) -> Any:
    import av

    decoder: Any = av.CodecContext.create(codec, "r")
    decoder.thread_count = 1
    return decoder


def _frames(decoder: Any, at: int, data: bytes | None, where: str) -> Iterator[tuple[int, np.ndarray]]:
    """Decode a message, or flush where `data` is None; yield frames with the index of the message that holds them."""
    import av

    packet = None
    if data is not None:
        packet = av.Packet(data)
        packet.pts = at
    try:
        found = decoder.decode(packet)
    except av.error.FFmpegError as error:
        raise BadInput(
            f"{where}, message {at + 1}: no frame of {decoder.name} can be decoded ({error.strerror}); a recording must begin with a"
            " keyframe"
        ) from error
    for frame in found:
        yield int(frame.pts), frame.to_ndarray(format="rgb24")


def bytes_of(data: Any) -> bytes:
    """A field of a message as bytes; JSON holds it as base64."""
    return base64.b64decode(data) if isinstance(data, str) else bytes(data)


def picture(said, where: str) -> np.ndarray:
    """An image message as (h, w, 3) uint8 RGB; BadInput, which names `where`, if unreadable or without colour."""
    image = _compressed(said, where) if hasattr(said, "format") else _raw(said, where)
    if is_monochrome(image):
        raise BadInput(f"{where}: the image has no colour, its three channels are equal; {IN_COLOUR}")
    return image


def _compressed(said, where: str) -> np.ndarray:
    """sensor_msgs/CompressedImage: `format` is png or jpeg, or as image_transport writes it, `rgb8; jpeg compressed bgr8`."""
    from PIL import Image

    data, what = bytes_of(said.data), f"{where}: an image of format {said.format!r}"
    if "compressedDepth" in said.format:
        raise BadInput(f"{what} holds depth; {IN_COLOUR}")
    image = decode(data, what, "record PNG or JPEG")
    with Image.open(io.BytesIO(data)) as header:
        mode = header.mode
    if mode in ("1", "L", "LA", "F") or mode.startswith("I"):
        hint = "record it before it is compressed, or debayered" if "bayer" in said.format else IN_COLOUR
        raise BadInput(f"{what} is monochrome; {hint}")
    return image


def _raw(said, where: str) -> np.ndarray:
    """sensor_msgs/Image."""
    import cv2

    encoding = getattr(said, "encoding", None)
    if encoding not in ENCODINGS:
        mono = str(encoding).startswith(MONOCHROME)
        hint = IN_COLOUR if mono else "republish it as bgr8 (image_proc, or a cv_bridge node)"
        raise BadInput(
            f"{where}: encoding {encoding!r} {'is monochrome' if mono else 'is not read'}; {hint}: {', '.join(ENCODINGS)}"
        )
    size, name = ENCODINGS[encoding]
    data, row = np.frombuffer(bytes_of(said.data), np.uint8), size * said.width
    if not row or said.step < row or len(data) != said.height * said.step:
        raise BadInput(
            f"{where}: an image of {said.width} x {said.height} {encoding} has {len(data)} bytes in rows of {said.step};"
            " it is cut short; record it again"
        )
    pixels = data.reshape(said.height, said.step)[:, :row].reshape(said.height, said.width, size)
    pixels = np.ascontiguousarray(pixels[..., 0] if size == 1 else pixels)
    convert: Callable = cv2.cvtColor
    try:
        return convert(pixels, getattr(cv2, name)) if name else pixels
    except cv2.error as error:
        raise BadInput(
            f"{where}: an image of {said.width} x {said.height} cannot be {encoding} ({error.err}); record it as bgr8"
        ) from error
