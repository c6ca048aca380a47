"""What is predicted from one picture: the one result from `predict` to the page of `live`."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ForceReading:
    """What was predicted from one image, forces on the gel in N.

    cells: (3, rows, cols) along gel y, gel x and the gel's normal (FEATS' channels; pressing is negative). In a picture
    of a GelSight Mini gel y points to the left and gel x upwards. total: (3,), their sums. half_width: (3,) N, half of the
    90 % prediction intervals of the totals, on sensors that training never saw and of gels as stiff as those it saw, or as
    uncertain as the factor of a profile is; None where the model knows none. reason: what is wrong with the pictures,
    empty for nothing. edge_peak: largest normal force of a cell at the edge of what the picture shows, over the largest of
    all; above 0.2 the contact is cropped by the image and the total is too low. NaN where the map has fewer than three rows or
    columns. ood_score: how unlike the training images it is, about 1 for one like them. image: (h, w, 3) uint8 RGB below the
    cells.
    """

    cells: np.ndarray
    total: np.ndarray
    half_width: np.ndarray | None
    reason: str
    edge_peak: float
    ood_score: float
    image: np.ndarray

    @property
    def flag(self) -> bool:
        """Whether something is wrong with the pictures."""
        return bool(self.reason)
