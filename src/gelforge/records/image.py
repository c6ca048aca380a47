"""The only reader and writer of image files: images are RGB, (height, width, 3) uint8.

Elsewhere, too, images are RGB, unless a docstring says BGR: OpenCV's order, in which frames of films and cameras come
(records.film).

Files come from others, so they are checked before decoding: that it is a regular file, its size in bytes, its width
and height, and that every chunk of a PNG is intact.
"""

import io
import os
import struct
import warnings
import zlib
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput, GelforgeError
from gelforge.flow.files import publish
from gelforge.records.press import SENSOR_TABLES, PressRecord, Rejection, reject
from gelforge.records.regular import bytes_or_fault, read_bytes

PNG = b"\x89PNG\r\n\x1a\n"
KINDS = ("PNG", "JPEG", "BMP", "TIFF", "WEBP", "PPM")
MOST_PIXELS = 4096 * 4096
MOST_BYTES = 256 * 2**20
LEAST_CONTRAST = 16  # levels: a frame of less contrast is dark or covered, and its colours mean nothing
OF_PALETTE = 3  # colour type of a PNG whose pixels are palette indices
PALETTE = "has a palette of at most 256 colours, too few to see the light fall; save it in true colour"
SEVERAL = "holds {} images; save the one that is meant as a file of its own"
HINT = f"give {', '.join(KINDS[:-1])} or {KINDS[-1]}"


def read_image(path: str | Path, size: tuple[int, int] | None = None, hint: str = HINT) -> np.ndarray:
    """A picture file as RGB (height, width, 3) uint8.

    size is the (width, height) it must have. Raises BadInput for a file that is missing, not regular, no image,
    larger than 4096 x 4096 pixels or of another size.
    """
    path = Path(path)
    image = decode(read_bytes(path, hint, MOST_BYTES), str(path), hint)
    if size is not None and (image.shape[1], image.shape[0]) != tuple(size):
        raise BadInput(
            f"{path}: image is {image.shape[1]} x {image.shape[0]} pixels, its sensor has {size[0]} x {size[1]};"
            f" resize it, or correct `image` in {SENSOR_TABLES}"
        )
    return image


def read_logged_image(
    folder: Path, name: str, size: tuple[int, int], hint: str = "restore it, or empty the log's column `image`"
) -> np.ndarray:
    """An image that a log names below its dataset's folder; a path that leads out of it raises BadInput."""
    if not stays_inside(folder, name):
        raise BadInput(f"{folder}/log.csv: image {name!r} points outside the dataset's folder; give a path inside it")
    return read_image(folder / name, size, hint)


def stays_inside(folder: Path, name: str) -> bool:
    """Whether a path in a log stays below its dataset's folder.

    Its first folder may be a link to another disk. Other links, `..` and absolute paths must not lead out.
    """
    parts = Path(name).parts
    try:
        if Path(name).is_absolute() or os.path.normpath(name).startswith(".."):
            return False
        linked = folder / parts[0] if parts else folder
        homes = [folder.resolve(), *([linked.resolve()] if linked.is_dir() else [])]
        return any((folder / name).resolve().is_relative_to(home) for home in homes)
    except (OSError, RuntimeError, ValueError):  # a link that leads to itself, a null character
        return False


def decode(data: bytes, where: str, hint: str = HINT) -> np.ndarray:
    """Bytes of an image file as RGB (height, width, 3) uint8; what cannot be decoded raises BadInput."""
    import cv2

    if not data.startswith(PNG):
        fault = _claim_fault(data)
    else:
        fault, size = _chunk_fault(data)
        fault = fault or _size_fault(size)
    image = None
    if fault is None:
        try:
            image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
        except cv2.error as error:
            fault = f"cannot be read as an image ({error.err})"
    if image is not None and image.dtype != np.uint8:
        raise BadInput(
            f"{where}: holds {8 * image.itemsize} bits a channel; save it with 8, scaled as the sensor shows it"
        )
    if image is None:
        raise BadInput(f"{where}: {fault or 'cannot be read as an image'}; {hint}")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def is_monochrome(image: np.ndarray) -> bool:
    """Whether an RGB image (h, w, 3) uint8 has contrast but no colour, as from a monochrome camera."""
    red = image[..., 0]
    grey = (red == image[..., 1]).all() and (red == image[..., 2]).all()
    return bool(grey and np.ptp(red) > LEAST_CONTRAST)


def _claim_fault(data: bytes) -> str | None:
    """What is wrong with the header of a format other than PNG; Pillow reads headers without decoding."""
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # size and decoding are checked explicitly
            with Image.open(io.BytesIO(data), formats=KINDS) as header:
                several = getattr(header, "n_frames", 1) if header.format in ("TIFF", "WEBP") else 1
                if several > 1:
                    return SEVERAL.format(several)
                return _size_fault(header.size) or (PALETTE if header.mode == "P" else None)
    except Image.DecompressionBombError:
        return "is far larger than 4096 x 4096 pixels"
    except UnidentifiedImageError:
        return "cannot be read as an image (of another kind, or corrupt)" if data else "is empty"
    except (OSError, ValueError, SyntaxError, struct.error) as error:
        return f"cannot be read as an image ({type(error).__name__})"


def _size_fault(size: tuple[int, int]) -> str | None:
    good = 0 < size[0] * size[1] <= MOST_PIXELS
    return None if good else f"has a size of {size[0]} x {size[1]} pixels, at most 4096 x 4096 are read"


def encode_png(image: np.ndarray, compression: int | None = None) -> bytes:
    """An RGB picture (height, width, 3) uint8 as the bytes of a PNG."""
    import cv2

    settings = [] if compression is None else [cv2.IMWRITE_PNG_COMPRESSION, compression]
    return cv2.imencode(".png", cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2BGR), settings)[1].tobytes()


def write_png(path: str | Path, image: np.ndarray, compression: int | None = None) -> None:
    """Write an RGB picture as PNG, whole or not at all."""
    try:
        with publish(path, durable=False) as part:
            part.write_bytes(encode_png(image, compression))
    except OSError as error:
        raise GelforgeError(
            f"{path}: the image could not be written ({error.strerror}); free space or repair the folder"
        ) from error


def encode_jpeg(image: np.ndarray, quality: int) -> bytes:
    """An RGB picture (height, width, 3) uint8 as the bytes of a JPEG of a quality from 1 to 100."""
    import cv2

    settings = [cv2.IMWRITE_JPEG_QUALITY, quality]
    return cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), settings)[1].tobytes()


def as_jpeg(image: np.ndarray, quality: int) -> np.ndarray:
    """An RGB image (height, width, 3) uint8 after JPEG compression at a quality from 1 to 100."""
    return decode(encode_jpeg(image, quality), "an image just coded")


def bad_image(press: PressRecord, file: str, folder: str | Path, size: tuple[int, int] | None) -> Rejection | None:
    """Why a press's image cannot be used; folder: of the dataset. size: the sensor's (width, height), if known."""

    def no(reason: str, hint: str) -> Rejection:
        return reject(press, file, "image", reason, hint)

    if not press.image:
        return no("no image is named", "name its PNG, or set images = false under [params.poses] in dataset.toml")
    if "\x00" in press.image or "\\" in press.image:
        return no("the path holds a character that is not allowed", "write it with forward slashes: images/0001.png")
    path = Path(folder) / press.image
    try:
        path.resolve()
    except (OSError, RuntimeError):
        return no("cannot be read (a link that leads to itself)", "copy the image there, or remove the row")
    if not stays_inside(Path(folder), press.image):
        return no(
            "the path leaves the dataset's folder",
            "copy the image below data/DATASET, or link its folder there, and name it from there",
        )
    data, fault = bytes_or_fault(path, MOST_BYTES)
    if fault:
        return no(f"cannot be read ({fault})", "name it as it is there, capital letters too, or copy it there")
    fault, seen = png_fault(data)
    if fault:
        return no(fault, "copy the file again from the source, as PNG")
    if size is not None and seen != tuple(size):
        return no(
            f"is {seen[0]} x {seen[1]} pixels, the sensor has {size[0]} x {size[1]}",
            f"record at that size, or correct `image` of {press.sensor_id} in {SENSOR_TABLES}",
        )
    return None


def png_fault(data: bytes) -> tuple[str | None, tuple[int, int]]:
    """What is wrong with PNG bytes, or None, and the image's (width, height)."""
    if not data.startswith(PNG):
        return "is not a PNG file" if data else "is empty", (0, 0)
    fault, size = _chunk_fault(data)
    fault = fault or _size_fault(size) or _decode_fault(data)
    if not fault and b"eXIf" in data:  # its orientation may rotate the image by 90 degrees
        height, width, _ = decode(data, "the image").shape
        size = width, height
    return fault, size


def _chunk_fault(data: bytes) -> tuple[str | None, tuple[int, int]]:
    """Check the chunks and their checksums, because decoders accept truncated files (PNG specification, 5.3)."""
    at, size, kind = len(PNG), (0, 0), b""
    while kind != b"IEND":
        if at + 12 > len(data):
            return "is truncated", size
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        body = memoryview(data)[at + 4 : at + 8 + length]
        at += 12 + length
        if at > len(data):
            return "is truncated", size
        if zlib.crc32(body) != struct.unpack(">I", data[at - 4 : at])[0]:
            return "is corrupt: a checksum is wrong", size
        if kind == b"IHDR" and length >= 10:
            width, height = struct.unpack(">II", body[4:12])
            size = width, height
            if body[13] == OF_PALETTE:
                return PALETTE, size
        if kind == b"acTL":  # of an animation, whose first image decoders show
            return SEVERAL.format("several"), size
    return None, size


def _decode_fault(data: bytes) -> str | None:
    import cv2

    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None:
        return "cannot be decoded"
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] not in (3, 4):
        return "is not an 8-bit colour image"
    return None
