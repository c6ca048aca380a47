"""The no-contact image found in a stream of frames: the mean of the first ones in which nothing moves."""

import itertools
from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.records.film import Film, Frame, open_source, source_name

SETTLING = 8  # frames that a camera takes to set its exposure and colours, at least
STILL = 5  # frames in a row that must be alike
ALIKE = 0.5  # levels by which each may differ from their mean, on average over the image
SMALL = (40, 30)  # px at which frames are compared
FEWEST = SETTLING + STILL  # least number of frames by which the sensor is known to be at rest
MOST = 300  # frames within which a sensor is expected to be at rest


def find_nocontact(frames: Iterable[Frame], name: str) -> tuple[np.ndarray, Iterator[Frame]]:
    """The no-contact image (h, w, 3) uint8 at the start of a stream, colours as in its frames, and the stream from the frames that it is made of.

    Frames before these belong to a camera that had not settled, or to a contact, and are not given back: against this
    image their forces would be wrong. frames: begin while nothing touches the sensor. Raises BadInput where none of the
    first MOST frames are at rest.
    """
    import cv2

    rest, seen = iter(frames), 0
    held: deque[tuple[Frame, np.ndarray]] = deque(maxlen=STILL)  # however large they are, few are kept
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
    """The no-contact image (h, w, 3) uint8 RGB at the start of a film, or of what a camera shows now."""
    name = source_name(video, camera)
    with open_source(video, camera, mode) as (source, _):
        # only the start is looked at, so a film that is cut short serves
        picture, _ = find_nocontact(Film(source, 0, name, None, camera is not None), name)
    return np.ascontiguousarray(picture[:, :, ::-1])
