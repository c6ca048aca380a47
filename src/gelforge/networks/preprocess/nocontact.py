"""The no-contact image found in a stream of frames: the mean of the first ones in which nothing moves."""

import itertools
from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.networks.preprocess.illumination import SMALL
from gelforge.records.film import frames, open_source, source_name

SETTLING = 8  # frames that a camera takes to set its exposure and colours, at least
STILL = 5  # frames in a row that must be alike
ALIKE = 0.5  # levels by which each may differ from their mean, on average over the picture
FEWEST = SETTLING + STILL  # least number of frames by which the sensor is known to be at rest
WIDEST = 320  # px of frames that are kept, a few hundred of which then fit into memory whatever a camera films
MOST = 300  # frames within which a sensor is expected to be at rest


class StillPicture:
    """Watches frames until the sensor is at rest; then its picture is their mean, which has less noise than any."""

    def __init__(self) -> None:
        self._seen = 0
        self._last: deque[np.ndarray] = deque(maxlen=STILL)
        self._small: deque[np.ndarray] = deque(maxlen=STILL)

    def offer(self, image: np.ndarray) -> np.ndarray | None:
        """Take one more frame (h, w, 3) uint8; the picture as soon as there is one, uint8 of the same shape."""
        import cv2

        self._seen += 1
        self._last.append(image)
        self._small.append(cv2.resize(image, SMALL, interpolation=cv2.INTER_AREA).astype(float))
        if self._seen < FEWEST:
            return None
        small = np.array(self._small)
        if np.abs(small - small.mean(axis=0)).mean(axis=(1, 2, 3)).max() > ALIKE:
            return None
        return np.rint(np.mean(self._last, axis=0, dtype=float)).astype(np.uint8)


def find_nocontact(images: Iterable[np.ndarray], name: str) -> tuple[np.ndarray, Iterator[np.ndarray]]:
    """The no-contact image at the start of a stream, and the stream from its first frame on.

    images: frames (h, w, 3) uint8 that begin while nothing touches the sensor; wider ones are made WIDEST px wide. Raises BadInput where none of the first
    MOST frames are at rest.
    """
    watch, rest = StillPicture(), (narrowed(image) for image in images)
    held: deque[np.ndarray] = deque()
    for image in itertools.islice(rest, MOST):
        held.append(image)
        picture = watch.offer(image)
        if picture is not None:
            return picture, _again(held, rest)
    if len(held) < FEWEST:
        raise BadInput(
            f"{name}: ends after {len(held)} of the {FEWEST} frames that it takes at least to find the no-contact image; give"
            " it with --nocontact"
        )
    raise BadInput(
        f"{name}: no {STILL} frames in a row without movement after the first {SETTLING}, of {len(held)} looked at; let the"
        " film begin with a second in which nothing touches the sensor, or give that picture with --nocontact"
    )


def narrowed(image: np.ndarray) -> np.ndarray:
    """A frame (h, w, 3) uint8 that is at most WIDEST px wide."""
    import cv2

    height, width = image.shape[:2]
    if width <= WIDEST:
        return image
    return cv2.resize(image, (WIDEST, round(height * WIDEST / width)), interpolation=cv2.INTER_AREA)


def _again(held: deque[np.ndarray], rest: Iterator[np.ndarray]) -> Iterator[np.ndarray]:
    """Frames that were looked at, each let go as it is given, and those that follow."""
    while held:
        yield held.popleft()
    yield from rest


def picture_at_rest(video: Path | None, camera: int | None) -> np.ndarray:
    """The no-contact image (h, w, 3) uint8 RGB at the start of a film, or of what a camera shows now."""
    name = source_name(video, camera)
    with open_source(video, camera) as (capture, _):
        # only the start is looked at, so a film that is cut short serves
        picture, _ = find_nocontact(frames(capture, 0, name, None), name)
    return np.ascontiguousarray(picture[:, :, ::-1])
