"""Markers that wear: which are gone, new or faint in another image of the gel, and images without some of them.

A network takes a marker that is missing in one image alone for a large motion or a bright contact: one of 63 changes a force by a
tenth, eight double it. Missing in both, it changes nothing: so it is painted over in the other.
"""

import numpy as np

from gelforge.reading.markers import MarkerTracker, Tracks

PRINTED = 15  # levels by which a marker is darker than what surrounds it
# Of that darkness: below, the marker is gone, or fainter. Of 1638 markers of real presses of a ball the least has 0.65.
LEFT, FADED = 0.35, 0.6
INKED = 0.45  # of its light that a marker takes at least: on real units 0.54 to 0.76, half worn 0.28 to 0.38
LEAST_DIAMETER = 8.0  # px: smaller markers are paler in an image of half the size
APPEARED = 0.6  # of the darkness of the other markers: a place without a marker that is darker now has got one
SEEN_WITHIN = (2, 4)  # px at half size around a marker's place: in the no-contact image, and where it is followed to
WIDER = 0.75  # of a marker's diameter: radius of what is painted


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


def printed_in(markers: MarkerTracker, before: np.ndarray) -> np.ndarray:
    """Largest darkness at each marker of a no-contact image, (n,) int. before: its `darkness_of`."""
    return _darkest(before, markers.points, SEEN_WITHIN[0])


def vanished(markers: MarkerTracker, printed: np.ndarray, tracks: Tracks, now: np.ndarray) -> np.ndarray:
    """Which markers (n,) bool of a no-contact image are gone in another one. printed: its `printed_in`; now: the other's `darkness_of`."""
    left = _darkest(now, places_in(tracks, markers), SEEN_WITHIN[1])
    # those that look as they did are there
    return np.asarray(tracks.unlike & (printed >= PRINTED) & (left >= 0) & (left < LEFT * printed))


def faded(markers: MarkerTracker, printed: np.ndarray, tracks: Tracks, now: np.ndarray) -> float:
    """Fraction of the markers of a no-contact image that are fainter in another one; arguments as of `vanished`."""
    if not len(markers.points):
        return 0.0
    left = _darkest(now, places_in(tracks, markers), SEEN_WITHIN[1])
    return float(((left >= 0) & (left < FADED * printed)).mean())


def pale(markers: MarkerTracker) -> float:
    """Fraction of the markers of a no-contact image that leave more of the light than ink does."""
    import cv2

    if not len(markers.points) or markers.diameter < LEAST_DIAMETER:
        return 0.0
    dark = darkness_of(markers.grey).astype(float)
    light = dark + cv2.resize(markers.grey, dark.shape[::-1], interpolation=cv2.INTER_AREA) + 1.0
    taken = np.rint(255 * dark / light).astype(np.uint8)
    return float((_darkest(taken, markers.points, SEEN_WITHIN[0]) < 255 * INKED).mean())


def appeared(
    markers: MarkerTracker, before: np.ndarray, printed: np.ndarray, tracks: Tracks, now: np.ndarray
) -> np.ndarray:
    """Where another image shows markers at places of the lattice that are empty in the no-contact image, (k, 2) px.

    before, now: `darkness_of` both images. printed: `printed_in` the no-contact image. Such a marker was hidden or worn in it.
    """
    places, followed = markers.empty, np.flatnonzero(tracks.found)
    if not len(places) or not len(followed):
        return np.zeros((0, 2))
    apart = np.hypot(*(markers.points[followed][None] - places[:, None]).transpose(2, 0, 1))
    near = followed[np.argsort(apart, axis=1)[:, :4]]
    there = places + np.median(tracks.motion[near], axis=1)
    seen = _darkest(now, there, SEEN_WITHIN[1])
    bare = _darkest(before, places, SEEN_WITHIN[0]) < LEFT * seen
    return np.asarray(there[(seen >= max(PRINTED, APPEARED * np.median(printed))) & bare])


def _darkest(dark: np.ndarray, points: np.ndarray, reach: int) -> np.ndarray:
    """Largest darkness around points (n, 2) px of the full image, (n,) int; -1 beside the image."""
    import cv2

    most = cv2.dilate(dark, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
    u, v = np.rint(points / 2).astype(int).T
    inside = (u >= 0) & (u < dark.shape[1]) & (v >= 0) & (v < dark.shape[0])
    found = np.full(len(points), -1)
    found[inside] = most[v[inside], u[inside]]
    return found


def painted_over(image: np.ndarray, points: np.ndarray, diameter: float) -> np.ndarray:
    """An image (h, w, 3) uint8 without what is at some points (n, 2) px, filled in from what surrounds them.

    Source: Telea, An image inpainting technique based on the fast marching method, J. Graphics Tools 9 (2004).
    """
    import cv2

    mask = np.zeros(image.shape[:2], np.uint8)
    for u, v in np.rint(points).astype(int).tolist():
        cv2.circle(mask, (u, v), round(WIDER * diameter), 255, -1)
    return cv2.inpaint(image, mask, 3, cv2.INPAINT_TELEA)
