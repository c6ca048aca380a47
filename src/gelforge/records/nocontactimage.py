"""The no-contact image found in a stream of frames: the mean of the first ones in which nothing moves."""

import itertools
from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.records.film import Film, Frame, open_source, source_name

SETTLING = 8  # fewest frames that a camera takes to set its exposure and colours
STILL = 5  # consecutive frames that must be alike
ALIKE = 0.5  # grey levels; largest mean absolute difference of each of these frames from their mean
SMALL = (40, 30)  # px; size at which frames are compared
FEWEST = SETTLING + STILL  # fewest frames that show whether the sensor is at rest
MOST = 300  # frames within which a sensor is expected to be at rest


def find_nocontact(frames: Iterable[Frame], name: str) -> tuple[np.ndarray, Iterator[Frame]]:
    """The no-contact image (h, w, 3) uint8 at the start of a stream, colours in its order, and the stream after it.

    The returned stream begins with the frames that the image is the mean of. Earlier frames are dropped: they show a
    contact, or come from a camera that had not settled, and their forces relative to this image would be wrong.
    frames: begin without contact. Raises BadInput if the sensor is not at rest within the first MOST frames.
    """
    import cv2

    rest, seen = iter(frames), 0
    held: deque[tuple[Frame, np.ndarray]] = deque(maxlen=STILL)  # few, because frames may be large
    for frame in itertools.islice(rest, MOST):
        seen += 1
        held.append((frame, cv2.resize(frame.image, SMALL, interpolation=cv2.INTER_AREA).astype(float)))
        if seen < FEWEST:
            continue
        small = np.array([one for _, one in held])
        if np.abs(small - small.mean(axis=0)).mean(axis=(1, 2, 3)).max() <= ALIKE:
            kept = [one for one, _ in held]
            return _mean([one.image for one in kept]), itertools.chain(kept, rest)
    if seen < FEWEST:
        raise BadInput(
            f"{name}: ends after {seen} of the {FEWEST} frames that it takes at least to find the no-contact image; give it"
            " with --nocontact"
        )
    raise BadInput(
        f"{name}: no {STILL} frames in a row without movement after the first {SETTLING}, of {seen} looked at; let the"
        " film begin with a second in which nothing touches the sensor, or give that image with --nocontact"
    )


def _mean(images: list[np.ndarray]) -> np.ndarray:
    """The mean of images (h, w, 3) uint8, which has less noise than any of them."""
    total = np.zeros(images[0].shape, np.uint16)
    for image in images:
        total += image
    return ((total + len(images) // 2) // len(images)).astype(np.uint8)


def nocontact_of(video: Path | None, camera: int | None, mode: tuple[int, int] | None = None) -> np.ndarray:
    """The no-contact image (h, w, 3) uint8 RGB at the start of a film or from a camera; BadInput if none is found."""
    name = source_name(video, camera)
    with open_source(video, camera, mode) as (source, _):
        # only the start is read, so a truncated film is good enough
        picture, _ = find_nocontact(Film(source, 0, name, None, camera is not None), name)
    return np.ascontiguousarray(picture[:, :, ::-1])
