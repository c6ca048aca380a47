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
    image = _decoded(data)
    if isinstance(image, str):
        raise BadInput(f"{where}: {image}; {hint}")
    return image


def _decoded(data: bytes, colour: bool = False) -> np.ndarray | str:
    """Bytes of an image file as RGB (height, width, 3) uint8, or what is wrong with them; colour: grey ones are wrong."""
    import cv2

    fault, mode = _checked(data)
    if fault:
        return fault
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    except cv2.error as error:
        return f"cannot be read as an image ({error.err})"
    if image is None:
        return "cannot be decoded"
    if image.dtype != np.uint8:
        return f"holds {8 * image.itemsize} bits a channel; save it with 8, scaled as the sensor shows it"
    if colour and mode not in ("RGB", "RGBA"):
        return "is not an 8-bit colour image"
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def is_monochrome(image: np.ndarray) -> bool:
    """Whether an RGB image (h, w, 3) uint8 has contrast but no colour, as from a monochrome camera."""
    red = image[..., 0]
    grey = (red == image[..., 1]).all() and (red == image[..., 2]).all()
    return bool(grey and np.ptp(red) > LEAST_CONTRAST)


def _checked(data: bytes) -> tuple[str, str]:
    """What is wrong with the header of an image file or the checksums of a PNG, and its mode; nothing is decoded."""
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # size and decoding are checked explicitly
            with Image.open(io.BytesIO(data), formats=KINDS) as header:
                several = getattr(header, "n_frames", 1) if header.format in ("PNG", "TIFF", "WEBP") else 1
                if several > 1:
                    return SEVERAL.format(several), header.mode
                if header.mode == "P":
                    return PALETTE, header.mode
                width, height = header.size
                if not 0 < width * height <= MOST_PIXELS:
                    return f"has a size of {width} x {height} pixels, at most 4096 x 4096 are read", header.mode
                if header.format == "PNG":
                    header.verify()  # decoders accept truncated files
                return "", header.mode
    except Image.DecompressionBombError:
        return "is far larger than 4096 x 4096 pixels", ""
    except UnidentifiedImageError:
        return "cannot be read as an image (of another kind, or corrupt)" if data else "is empty", ""
    except (OSError, ValueError, SyntaxError, struct.error) as error:
        return f"is truncated or corrupt ({error})", ""


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
    """What is wrong with PNG bytes, or None, and the image's (width, height) as its orientation shows it."""
    if not data.startswith(PNG):
        return "is not a PNG file" if data else "is empty", (0, 0)
    image = _decoded(data, colour=True)
    return (image, (0, 0)) if isinstance(image, str) else (None, (image.shape[1], image.shape[0]))
