"""Frames of a camera or a video file."""

import mmap
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.records.regular import file_fault


@contextmanager
def open_source(video: Path | None, camera: int | None) -> Iterator[tuple[Any, int]]:
    """Hold a video file or a camera open: OpenCV's capture and the frames announced, 0 if unknown.

    Raises BadInput for what cannot be opened. However the block ends, the camera is free for others afterwards.
    """
    import cv2

    fault = file_fault(video) if video is not None else None
    if fault:
        told = "no such video" if fault.startswith("No such file") else f"cannot be read as a video ({fault})"
        raise BadInput(f"{video}: {told}; name an AVI or MP4 file")
    # of a damaged film OpenCV's decoder tells thousands of lines, `frames` one
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    source = cv2.VideoCapture(str(video)) if camera is None else cv2.VideoCapture(camera)
    if not source.isOpened():
        what = (
            f"{video}: cannot be opened as a video{without_index(video)}; convert it to AVI or MP4"
            if video is not None
            else (f"camera {camera} cannot be opened; `ls /dev/video*` lists those there are")
        )
        raise BadInput(what)
    try:
        yield source, int(max(0, source.get(cv2.CAP_PROP_FRAME_COUNT))) if video is not None else 0
    finally:
        source.release()


def without_index(video: Path) -> str:
    """What tells of an MP4 that lacks its index, which is written last; empty for any other file."""
    with video.open("rb") as stream:
        if stream.read(8)[4:] != b"ftyp":
            return ""
        with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            lacks = data.find(b"moov") < 0
    return " (its index, moov, is missing: the recording was not ended, or the file is cut short)" if lacks else ""


def rate_of(source: Any) -> float:
    """Frames a second of an open film, 25 where it does not say."""
    import cv2

    return float(source.get(cv2.CAP_PROP_FPS)) or 25.0


def source_name(video: Path | None, camera: int | None) -> str:
    """What a film or camera is called in messages."""
    return f"camera {camera}" if video is None else str(video)


def frames(source: Any, announced: int, name: str, limit: int | None) -> Iterator[np.ndarray]:
    """Yield frames (h, w, 3) BGR until the source or `limit` ends; BadInput if it ends before it should."""
    count = 0
    while limit is None or count < limit:
        good, frame = source.read()
        if not good:
            break
        count += 1
        yield frame
    expected = min(announced, limit) if limit is not None else announced
    if count == 0 or count < expected:
        raise BadInput(
            f"{name}: ended after {count} of {expected or 'an unknown number of'} frames; the file is cut "
            f"short or damaged: use --frames {count} to take what there is"
            if count
            else f"{name}: holds no frame that can be decoded"
        )
