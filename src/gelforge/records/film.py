"""Frames of a camera or a video file, each with its own time."""

import os
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from gelforge.errors import BadInput, printable
from gelforge.records.regular import file_fault

# Path turns the two slashes of an address into one.
NETWORK = tuple(f"{kind}:/" for kind in ("rtsp", "rtsps", "rtmp", "http", "https", "udp", "tcp", "srt", "rtp"))
STILL_S = 2.0  # a camera that gives no other frame for so long stands still
EBML, SEGMENT = b"\x1a\x45\xdf\xa3", b"\x18\x53\x80\x67"  # IDs at the start of Matroska and WebM files (RFC 9559)


@contextmanager
def open_source(
    video: Path | None, camera: int | None, mode: tuple[int, int] | None = None
) -> Iterator[tuple[Any, int]]:
    """Hold a video file or a camera open: OpenCV's capture, and the number of frames by the header, 0 if unknown.

    mode: (width, height) that a camera is set to. Raises BadInput for what cannot be opened or set. The source is
    released however the block ends.
    """
    import cv2

    if video is not None and str(video).startswith(NETWORK):
        raise BadInput(
            f"{video}: a network stream is not read; record it to a file first (`ffmpeg -i ADDRESS -c copy film.mp4`), or use a camera of"
            " this machine"
        )
    if video is not None and not _is_utf8(video):
        raise BadInput(
            f"{printable(str(video))}: the path has a byte that is no UTF-8, which the decoder cannot open; rename the file or its folder"
        )
    fault = file_fault(video) if video is not None else None
    if fault:
        fault = "no such video" if fault.startswith("No such file") else f"cannot be read as a video ({fault})"
        camera_there = f", or the camera by --camera {video}" if str(video).startswith("/dev/v") else ""
        raise BadInput(f"{video}: {fault}; name an AVI or MP4 file{camera_there}")
    # silent, because OpenCV's decoder prints thousands of lines about a corrupt film and `Film` raises one error
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    # of a camera that is not there OpenCV prints two warnings before the sentence below
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)
    source = cv2.VideoCapture(str(video)) if camera is None else cv2.VideoCapture(camera)
    if not source.isOpened():
        what = (
            f"{video}: cannot be opened as a video; if its recording was ended, convert it to AVI or MP4"
            if video is not None
            else (f"camera {camera} cannot be opened; `ls /dev/video*` lists those there are")
        )
        raise BadInput(what)
    try:
        if mode is not None and camera is not None:
            set_mode(source, mode, source_name(video, camera))
        yield source, int(max(0, source.get(cv2.CAP_PROP_FRAME_COUNT))) if video is not None else 0
    finally:
        source.release()


def _is_utf8(path: Path) -> bool:
    try:
        str(path.absolute()).encode()
    except UnicodeEncodeError:
        return False
    return True


def set_mode(source: Any, mode: tuple[int, int], name: str) -> None:
    """Set a camera's width and height; BadInput if it gives another size."""
    got = asked_for(source, mode)
    if got != mode:
        raise BadInput(
            f"{name}: was asked for {mode[0]} x {mode[1]} and gives {got[0]} x {got[1]}; `gelforge camera` with its number"
            " lists its modes"
        )


def asked_for(source: Any, mode: tuple[int, int]) -> tuple[int, int]:
    """The (width, height) that an open source uses after a request; a driver takes the nearest that it has."""
    import cv2

    # motion JPEG, because USB is too slow for large uncompressed images
    source.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
    source.set(cv2.CAP_PROP_FRAME_WIDTH, mode[0])
    source.set(cv2.CAP_PROP_FRAME_HEIGHT, mode[1])
    return int(source.get(cv2.CAP_PROP_FRAME_WIDTH)), int(source.get(cv2.CAP_PROP_FRAME_HEIGHT))


def rate_of(source: Any) -> float:
    """Frames per second of an open film, 25 if it states none."""
    import cv2

    return float(source.get(cv2.CAP_PROP_FPS)) or 25.0


def source_name(video: Path | None, camera: int | None) -> str:
    """Name of a film or camera in messages."""
    return f"camera {camera}" if video is None else str(video)


@dataclass(frozen=True)
class Frame:
    """One frame: its number from 0, seconds since the first one, and its image (h, w, 3) uint8 BGR."""

    number: int
    time_s: float
    image: np.ndarray


class Film:
    """Frames of an open source, to be iterated over once; `taken` counts those read so far.

    source, announced: from `open_source`. limit: most frames to read. camera: whether times are those of this
    computer's clock. path: of a film.
    """

    def __init__(
        self, source: Any, announced: int, name: str, limit: int | None, camera: bool, path: Path | None = None
    ) -> None:
        self.name, self.camera, self.rate, self.taken = name, camera, rate_of(source), 0
        self._source, self._limit, self._path = source, limit, path
        self._announced = announced
        self._shown: np.ndarray | None = None
        self._since = 0.0

    def __iter__(self) -> Iterator[Frame]:
        """Yield frames until the source or the limit ends; BadInput if a film ends early or frames change their size."""
        first = last = 0.0
        size: tuple[int, ...] = ()
        while self._limit is None or self.taken < self._limit:
            good, image = self._source.read()
            if not good:
                break
            size = size or image.shape
            if image.shape != size:
                raise BadInput(
                    f"{self.name}: frames changed from {size[1]} x {size[0]} to {image.shape[1]} x {image.shape[0]} after"
                    f" {self.taken} frames; set the size before, and start again"
                )
            now = self._clock()
            if self.camera and self._repeats(image, now):
                continue
            if not self.taken:
                first = last = now
            elif not now > last:  # a film without times, or with a repeated one
                now = last + 1.0 / self.rate
            last = now
            self.taken += 1
            yield Frame(self.taken - 1, now - first, image)
        self._check_whole(last)

    def _repeats(self, image: np.ndarray, now: float) -> bool:
        """Whether a camera gave its last frame again; BadInput once it has given no other for STILL_S.

        No two frames of a real camera are equal in all pixels, because of its noise.
        """
        if self._shown is None or not (
            np.array_equal(image[::16], self._shown[::16]) and np.array_equal(image, self._shown)
        ):
            self._shown, self._since = image, now
            return False
        if now - self._since > STILL_S:
            raise BadInput(
                f"{self.name}: has given the same frame for {now - self._since:.0f} s, after {self.taken} frames: it stands still; unplug it, plug it in"
                " again and start again"
            )
        return True

    def _clock(self) -> float:
        """Time of the frame just read, s."""
        import cv2

        return time.perf_counter() if self.camera else 1e-3 * self._source.get(cv2.CAP_PROP_POS_MSEC)

    def _check_whole(self, last: float) -> None:
        """BadInput if no frame was read, or fewer than announced; last: time of the last one in the film, s."""
        expected = self._announced if self._limit is None else min(self._announced, self._limit)
        if self.taken == 0:
            raise BadInput(f"{self.name}: holds no frame that can be decoded")
        # files without an index announce duration times mean rate instead of the true number of frames
        ended = last + 2.0 / self.rate >= self._announced / self.rate
        if self.taken < expected and not ended and not (self._path and is_whole_matroska(self._path)):
            raise BadInput(
                f"{self.name}: ended after {self.taken} of {expected} frames; the file is cut short or corrupt: use --frames"
                f" {self.taken} to take what there is"
            )


def numbered(images: Iterable[np.ndarray]) -> Iterator[Frame]:
    """Images (h, w, 3) uint8 as frames of a film of 25 frames per second."""
    return (Frame(number, number / 25.0, image) for number, image in enumerate(images))


def frames(source: Any, announced: int, name: str, limit: int | None) -> Iterator[np.ndarray]:
    """Images (h, w, 3) BGR of an open film, as `Film` yields them."""
    return (frame.image for frame in Film(source, announced, name, limit, camera=False))


def is_whole_matroska(path: Path) -> bool:
    """Whether a file is Matroska or WebM and at least as long as its segment states."""
    try:
        with path.open("rb") as stream:
            if stream.read(4) != EBML:
                return False
            stream.seek(_ebml_size(stream) or 0, os.SEEK_CUR)
            if stream.read(4) != SEGMENT:
                return False
            size = _ebml_size(stream)
            return size is not None and path.stat().st_size >= stream.tell() + size
    except (OSError, IndexError, ValueError):
        return False


def _ebml_size(stream: BinaryIO) -> int | None:
    """The next element's size (RFC 8794, 4), of 1 to 8 bytes; None if it is unknown, as while recording."""
    head = stream.read(1)
    length = 9 - head[0].bit_length()
    value = int.from_bytes(bytes([head[0] ^ (1 << (8 - length))]) + stream.read(length - 1), "big")
    return None if value == (1 << (7 * length)) - 1 else value
