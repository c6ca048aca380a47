"""Registration: a picture whose gel was shifted in its holder since the no-contact image, shifted back.

The shift is the median motion of the markers at the picture's rim, where contact does least. It is taken back as far as it
exceeds what contact does there, which grows from nothing without a jump. Turn and zoom are not fitted: contact spreads markers,
which a similarity takes for zoom (on real balls and FEATS' presses it reads forces worse than none does).
"""

import numpy as np

from gelforge.networks.preprocess.markertracks import MarkerTracker, Tracks

OF_CONTACT = 2.5  # px that a contact may move the rim's markers together
LEAST_FOUND = 0.5  # of the rim's markers, that must be found


def rim_shift(markers: MarkerTracker, tracks: Tracks) -> np.ndarray:
    """Shift (2,) px along u and v that is to be taken back; 0 where the rim shows none."""
    found = markers.rim & tracks.found
    if not markers.known or found.sum() < max(1, LEAST_FOUND * markers.rim.sum()):
        return np.zeros(2)
    shift = np.median(tracks.motion[found], axis=0)
    squared = float(shift @ shift)
    return np.asarray(shift * max(0.0, 1.0 - OF_CONTACT**2 / squared) if squared > 0.0 else np.zeros(2))


def shifted_back(image: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """The image (h, w, 3) uint8 as it would be seen without a shift (2,) px."""
    import cv2

    matrix = np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]])
    how = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(image, matrix, image.shape[1::-1], flags=how, borderMode=cv2.BORDER_REPLICATE)
