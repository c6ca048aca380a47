"""The gel's height from its slopes."""

import numpy as np


def height_of(slopes: np.ndarray, mm_per_px: float) -> np.ndarray:
    """Height (h, w) mm of the surface above the unloaded one, negative where it is pressed in.

    slopes: (2, h, w) along u and v, h and w even, mm per mm. mm_per_px: size of one of their pixels. The surface whose slopes
    are nearest to these in the mean square, by cosine transforms (Frankot and Chellappa 1988, IEEE PAMI 10; Simchony,
    Chellappa and Shao 1990, IEEE PAMI 12, for free edges). Slopes leave its level open: the median of the outermost pixels is 0.
    """
    import cv2

    along, across = (np.asarray(one, np.float32) for one in slopes)
    rows, cols = along.shape
    # differences between neighbours, of which each is the mean of both slopes; none over the edge
    right, down = (along[:, 1:] + along[:, :-1]) / 2, (across[1:] + across[:-1]) / 2
    bend = np.diff(np.pad(right, ((0, 0), (1, 1))), axis=1) + np.diff(np.pad(down, ((1, 1), (0, 0))), axis=0)
    of_rows, of_cols = (2 * np.cos(np.pi * np.arange(side) / side) - 2 for side in (rows, cols))
    stiffness = of_rows[:, None] + of_cols[None, :]
    stiffness[0, 0] = 1.0  # the mean, which is left open
    height = cv2.idct((cv2.dct(bend) / stiffness).astype(np.float32)) * mm_per_px
    edge = np.concatenate([height[0], height[-1], height[:, 0], height[:, -1]])
    return height - np.median(edge)
