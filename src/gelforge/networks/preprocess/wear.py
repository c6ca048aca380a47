"""Markers that are missing in the image or in the no-contact image alone: found by their darkness, and painted over in the other.

A network takes a marker that is missing in one image alone for a large motion or a bright contact: one of 63 changes a force by a
tenth, eight double it. Missing in both, it changes nothing.
"""

from collections.abc import Sequence

import numpy as np

from gelforge.networks.preprocess.markertracks import MarkerTracker, Tracks

PRINTED = 15  # levels by which a marker is darker than what surrounds it
LEFT = (
    0.35  # of that darkness: below, the marker is gone. Of 1638 markers of real presses of a ball the least has 0.65
)
APPEARED = 0.6  # of the darkness of the other markers: a place without a marker that is darker now has got one
SEEN_WITHIN = (2, 4)  # px at half size around a marker's place: in the no-contact image, and where it is followed to
WIDER = 0.75  # of a marker's diameter: radius of what is painted


def grey_of(colours: Sequence[np.ndarray]) -> np.ndarray:
    """Mean (h, w) uint8 of the three colours (h, w) uint8 of an image."""
    import cv2

    red, green, blue = colours
    total = np.add(red, green, dtype=np.uint16)
    total += blue
    return cv2.convertScaleAbs(total, alpha=1 / 3)


def darkness_of(grey: np.ndarray) -> np.ndarray:
    """By how many levels a grey image (h, w) uint8 is darker than its surroundings a marker's width away, (h / 2, w / 2) uint8.

    Markers of a dozen pixels are as well seen at half the size, at a sixth of the time.
    """
    import cv2

    small = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    side = max(3, round(25 * small.shape[1] / 320) | 1)
    return cv2.morphologyEx(small, cv2.MORPH_BLACKHAT, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)))


def places_in(tracks: Tracks, markers: MarkerTracker) -> np.ndarray:
    """Where markers are followed to, (n, 2) px; one that is lost is expected to have moved as the median of the others."""
    usual = np.median(tracks.motion[tracks.found], axis=0) if tracks.found.any() else np.zeros(2)
    return markers.points + np.where(tracks.found[:, None], tracks.motion, usual)


def vanished(markers: MarkerTracker, before: np.ndarray, tracks: Tracks, now: np.ndarray) -> np.ndarray:
    """Which markers (n,) bool of a no-contact image are gone in another one. before, now: `darkness_of` both images."""
    gone = tracks.unlike.copy()  # those that look as they did are there
    there = places_in(tracks, markers)
    for at in np.flatnonzero(gone):
        printed = _darkest(before, markers.points[at], SEEN_WITHIN[0])
        left = _darkest(now, there[at], SEEN_WITHIN[1])
        gone[at] = printed >= PRINTED and 0 <= left < LEFT * printed
    return gone


def usual_darkness(markers: MarkerTracker, before: np.ndarray) -> float:
    """Median of the largest darkness at each marker of a no-contact image. before: its `darkness_of`."""
    return float(np.median([_darkest(before, point, SEEN_WITHIN[0]) for point in markers.points]))


def appeared(
    markers: MarkerTracker, before: np.ndarray, printed: float, tracks: Tracks, now: np.ndarray
) -> np.ndarray:
    """Where another image shows markers at places of the lattice that are empty in the no-contact image, (k, 2) px.

    before, now: `darkness_of` both images. printed: the `usual_darkness` of the no-contact image. Such a marker was hidden or
    worn in the no-contact image.
    """
    places, followed = markers.empty, np.flatnonzero(tracks.found)
    if not len(places) or not len(followed):
        return np.zeros((0, 2))
    shown = []
    for place in places:
        near = followed[np.argsort(np.hypot(*(markers.points[followed] - place).T))[:4]]
        there = place + np.median(tracks.motion[near], axis=0)
        seen = _darkest(now, there, SEEN_WITHIN[1])
        if seen >= max(PRINTED, APPEARED * printed) and _darkest(before, place, SEEN_WITHIN[0]) < LEFT * seen:
            shown.append(there)
    return np.array(shown).reshape(-1, 2)


def _darkest(dark: np.ndarray, point: np.ndarray, reach: int) -> int:
    """Largest darkness around a point (2,) px of the full image; -1 beside the image."""
    u, v = np.rint(point / 2).astype(int).tolist()
    if not (0 <= u < dark.shape[1] and 0 <= v < dark.shape[0]):
        return -1
    return int(dark[max(v - reach, 0) : v + reach + 1, max(u - reach, 0) : u + reach + 1].max())


def painted_over(image: np.ndarray, points: np.ndarray, diameter: float) -> np.ndarray:
    """An image (h, w, 3) uint8 without what is at some points (n, 2) px, filled in from what surrounds them.

    Source: Telea, An image inpainting technique based on the fast marching method, J. Graphics Tools 9 (2004).
    """
    import cv2

    mask = np.zeros(image.shape[:2], np.uint8)
    for u, v in np.rint(points).astype(int).tolist():
        cv2.circle(mask, (u, v), round(WIDER * diameter), 255, -1)
    return cv2.inpaint(image, mask, 3, cv2.INPAINT_TELEA)
