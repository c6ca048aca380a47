"""Images of ROS 2 messages: the encodings that cameras write come as RGB, images without colour are refused."""

from types import SimpleNamespace

import cv2
import numpy as np

from gelforge.formats.messageimage import picture
from tests.support.recordings import coloured, png, raw
from tests.support.refused import refused


def mosaic(image, pattern):
    """An image (h, w, 3) as a Bayer sensor sees it, whose first rows are `pattern`, such as rggb."""
    colours = np.array(["rgb".index(letter) for letter in pattern]).reshape(2, 2)
    which = np.tile(colours, (image.shape[0] // 2, image.shape[1] // 2))
    return np.take_along_axis(image, which[..., None], 2)[..., 0]


def packed(image, first_chroma):
    """An image as packed YUV 4:2:2 (ITU-R BT.601, video range), chroma first or luma first."""
    red, green, blue = (image[..., k].astype(float) / 255 for k in range(3))
    luma = 16 + 65.481 * red + 128.553 * green + 24.966 * blue
    u = 128 - 37.797 * red - 74.203 * green + 112 * blue
    v = 128 + 112 * red - 93.786 * green - 18.214 * blue
    chroma = np.stack([u[:, ::2], v[:, ::2]], 2).reshape(luma.shape)
    pair = (chroma, luma) if first_chroma else (luma, chroma)
    return np.rint(np.stack(pair, 2)).astype(np.uint8)


def with_alpha(image):
    return np.dstack([image, np.full(image.shape[:2], 128, np.uint8)])


def padded(image):
    """Rows with eight bytes behind them, as some drivers align them."""
    return np.hstack([image.reshape(240, -1), np.full((240, 8), 77, np.uint8)])


def jpeg(image):
    return cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 98])[1].tobytes()


RAW = {
    "rgb8": raw,
    "bgr8": lambda image: raw(image[..., ::-1], "bgr8"),
    "rgba8": lambda image: raw(with_alpha(image), "rgba8", 4),
    "bgra8": lambda image: raw(with_alpha(image[..., ::-1]), "bgra8", 4),
    "rgb8 with padded rows": lambda image: raw(padded(image), step=968),
    "yuv422 with padded rows": lambda image: raw(padded(packed(image, True)), "yuv422", step=648),
    **{name: lambda image, name=name: raw(packed(image, True), name, 2) for name in ("yuv422", "uyvy")},
    **{name: lambda image, name=name: raw(packed(image, False), name, 2) for name in ("yuv422_yuy2", "yuyv")},
    **{
        f"bayer_{name}8": lambda image, name=name: raw(mosaic(image, name), f"bayer_{name}8", 1)
        for name in ("rggb", "bggr", "gbrg", "grbg")
    },
    "png": png,
    "jpeg": lambda image: {"format": "jpeg", "data": jpeg(image)},
    "image_transport jpeg": lambda image: {"format": "rgb8; jpeg compressed bgr8", "data": jpeg(image)},
    "image_transport png": lambda image: png(image) | {"format": "bgr8; png compressed bgr8"},
}


def test_encodings_that_cameras_write_are_read():
    image = coloured()
    for encoding, make in RAW.items():
        seen = picture(SimpleNamespace(**make(image)), "it").astype(int)
        lossless = encoding.startswith(("rgb", "bgr", "png", "image_transport png"))
        assert np.abs(seen - image)[2:-2, 2:-2].max() <= (0 if lossless else 4), encoding


def grey_png():
    return cv2.imencode(".png", coloured()[..., 0])[1].tobytes()


REFUSED = {
    "mono8": (lambda: raw(coloured()[..., 0], "mono8", 1), "monochrome; record the camera's colour topic"),
    "mono16": (lambda: raw(coloured()[..., 0].astype(np.uint16), "mono16", 2), "monochrome; record the camera's"),
    "grey as rgb8": (
        lambda: raw(np.repeat(coloured()[..., :1], 3, 2)),
        "no colour.*record the camera's colour topic",
    ),
    "grey png": (lambda: {"format": "mono8; png compressed ", "data": grey_png()}, "monochrome; record the camera's"),
    "bayer png": (lambda: {"format": "bayer_rggb8; png compressed ", "data": grey_png()}, "record it before"),
    "depth": (
        lambda: {"format": "16UC1; compressedDepth png", "data": grey_png()},
        "depth; record the camera's colour",
    ),
    "16 bits": (lambda: raw(coloured(), "bayer_rggb16", 2), "is not read; republish it as bgr8"),
    "nothing": (lambda: raw(coloured(), "", 3), "is not read; republish it as bgr8"),
    "cut": (lambda: raw(coloured()[:200]), "cut short"),
    "no width": (lambda: raw(coloured(), width=0), "cut short"),
    "half a pair": (lambda: raw(coloured()[:, :319, :2], "yuv422", 2, width=319), "record it as bgr8"),
    "other bytes": (lambda: {"format": "jpeg", "data": b"h264 or anything"}, "record PNG or JPEG"),
}


def test_images_that_say_no_forces_are_refused_with_what_to_do():
    where = "a.mcap: topic x, message 1"
    for made, said in REFUSED.values():
        refused(rf"(?s){where}.*{said}", picture, SimpleNamespace(**made()), where)


def test_a_dark_frame_is_no_monochrome_camera():
    """Many cameras begin with one."""
    dark = raw(np.full((240, 320, 3), 3, np.uint8))
    assert picture(SimpleNamespace(**dark), "it").max() == 3
