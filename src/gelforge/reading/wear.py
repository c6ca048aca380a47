"""Worn markers: finds those that vanished, appeared or faded between two images of a gel, and paints markers over.

A network takes a marker that is missing from only one image for a large motion or a bright contact: one of 63 changes
a force by a tenth, eight double it. A marker missing from both changes nothing, so it is painted over in the other
image, too.
"""

import numpy as np

from gelforge.reading.markers import MarkerTracker, Tracks

PRINTED = 15  # levels by which a marker is darker than its surroundings
# Fraction of its darkness below which a marker is gone, or faded. The least of 1638 markers in real presses of a ball
# is 0.65.
LEFT, FADED = 0.35, 0.6
INKED = 0.45  # least fraction of the light that a marker absorbs: on real units 0.54 to 0.76, half worn 0.28 to 0.38
LEAST_DIAMETER = 8.0  # px: smaller markers look paler at half size
APPEARED = 0.6  # of the median darkness of the markers: an empty place that is darker has gained one
SEEN_WITHIN = (2, 4)  # px at half size around a marker's place: in the no-contact image, and where it is tracked to
WIDER = 0.75  # of a marker's diameter: radius of what is painted


def darkness_of(grey: np.ndarray) -> np.ndarray:
    """Levels by which a grey image (h, w) uint8 is darker than a marker's width away, (h / 2, w / 2) uint8.

    Half size shows markers of a dozen pixels as well, in a sixth of the time.
    """
    import cv2

    small = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    side = max(3, round(25 * small.shape[1] / 320) | 1)
    return cv2.morphologyEx(small, cv2.MORPH_BLACKHAT, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)))


def places_in(tracks: Tracks, markers: MarkerTracker) -> np.ndarray:
    """Places (n, 2) px of tracked markers; a lost one is assumed to have moved by the median of the others."""
    usual = np.median(tracks.motion[tracks.found], axis=0) if tracks.found.any() else np.zeros(2)
    return markers.points + np.where(tracks.found[:, None], tracks.motion, usual)


def printed_in(markers: MarkerTracker, before: np.ndarray) -> np.ndarray:
    """Largest darkness at each marker of a no-contact image, (n,) int. before: its `darkness_of`."""
    return _darkest(before, markers.points, SEEN_WITHIN[0])


def vanished(markers: MarkerTracker, printed: np.ndarray, tracks: Tracks, now: np.ndarray) -> np.ndarray:
    """Which markers (n,) bool of a no-contact image are gone in another image.

    printed: `printed_in` of the no-contact image; now: `darkness_of` of the other image.
    """
    left = _darkest(now, places_in(tracks, markers), SEEN_WITHIN[1])
    # markers that look the same are not gone
    return np.asarray(tracks.unlike & (printed >= PRINTED) & (left >= 0) & (left < LEFT * printed))


def faded(markers: MarkerTracker, printed: np.ndarray, tracks: Tracks, now: np.ndarray) -> float:
    """Fraction of the markers of a no-contact image that are fainter in another one; arguments as of `vanished`."""
    if not len(markers.points):
        return 0.0
    left = _darkest(now, places_in(tracks, markers), SEEN_WITHIN[1])
    return float(((left >= 0) & (left < FADED * printed)).mean())


def pale(markers: MarkerTracker) -> float:
    """Fraction of the markers of a no-contact image that absorb less of the light than ink does."""
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
    """Largest darkness around points (n, 2) px of the full image, (n,) int; -1 outside the image."""
    import cv2

    most = cv2.dilate(dark, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
    u, v = np.rint(points / 2).astype(int).T
    inside = (u >= 0) & (u < dark.shape[1]) & (v >= 0) & (v < dark.shape[0])
    found = np.full(len(points), -1)
    found[inside] = most[v[inside], u[inside]]
    return found


def painted_over(image: np.ndarray, points: np.ndarray, diameter: float) -> np.ndarray:
    """An image (h, w, 3) uint8 with the markers at points (n, 2) px filled in from their surroundings.

    Source: Telea, An image inpainting technique based on the fast marching method, J. Graphics Tools 9 (2004).
    """
    import cv2

    mask = np.zeros(image.shape[:2], np.uint8)
    for u, v in np.rint(points).astype(int).tolist():
        cv2.circle(mask, (u, v), round(WIDER * diameter), 255, -1)
    return cv2.inpaint(image, mask, 3, cv2.INPAINT_TELEA)
