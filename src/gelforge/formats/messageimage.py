"""Images of ROS 2 messages as RGB: the encodings that cameras write (sensor_msgs/image_encodings.hpp).

Images without colour are refused: a gel's normal force is read from the colours of its three lights.
"""

import io
from collections.abc import Callable

import numpy as np

from gelforge.errors import BadInput
from gelforge.records.image import decode, is_monochrome

# Bytes of a pixel, and cv2's name of the conversion to RGB. In ROS yuv422 is UYVY; Bayer patterns are named by their first
# rows, as OpenCV's newer names are.
ENCODINGS: dict[str, tuple[int, str]] = {
    "rgb8": (3, ""),
    "bgr8": (3, "COLOR_BGR2RGB"),
    "rgba8": (4, "COLOR_RGBA2RGB"),
    "bgra8": (4, "COLOR_BGRA2RGB"),
    **dict.fromkeys(("yuv422", "uyvy"), (2, "COLOR_YUV2RGB_UYVY")),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), (2, "COLOR_YUV2RGB_YUY2")),
    **{f"bayer_{name}8": (1, f"COLOR_Bayer{name.upper()}2RGB") for name in ("rggb", "bggr", "gbrg", "grbg")},
}
MONOCHROME = ("mono", "8UC1", "16UC1", "32FC1")
IN_COLOUR = "record the camera's colour topic"


def picture(said, where: str) -> np.ndarray:
    """An image message as (h, w, 3) uint8 RGB; BadInput names `where` and what cannot be read."""
    image = _compressed(said, where) if hasattr(said, "format") else _raw(said, where)
    if is_monochrome(image):
        raise BadInput(f"{where}: the image has no colours, all three are equal; {IN_COLOUR}")
    return image


def _compressed(said, where: str) -> np.ndarray:
    """sensor_msgs/CompressedImage: `format` is png or jpeg, or as image_transport writes it, `rgb8; jpeg compressed bgr8`."""
    from PIL import Image

    data, what = bytes(said.data), f"{where}: an image of format {said.format!r}"
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
    data, row = np.frombuffer(bytes(said.data), np.uint8), size * said.width
    if not row or said.step < row or len(data) != said.height * said.step:
        raise BadInput(
            f"{where}: an image of {said.width} x {said.height} {encoding} has {len(data)} bytes in rows of {said.step};"
            " it is cut short, record it again"
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
