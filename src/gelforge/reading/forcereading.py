"""The prediction from one image, the same result from `predict` to the page of `live`, and its columns of a table.

For each channel: CHANNEL_n, the total, and CHANNEL_half_width_n, half of its 90 % prediction interval, empty where it
is not known. edge_peak shows where totals are too low, because the image crops the contact.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from gelforge.records.axes import CHANNELS

KINDS = ("n", "half_width_n")
TOTAL_COLUMNS = (*(f"{channel}_{kind}" for kind in KINDS for channel in CHANNELS), "edge_peak")
LEAST_PRESS = 0.2  # N of normal force below which a map has no shape: predictions on a released gel are smaller
# `edge_peak` from which the image crops the contact. Of 51 real presses, those that end within the image have at most
# 0.1, those that it crops 0.25 and more.
BEYOND = 0.2


@dataclass(frozen=True)
class ForceReading:
    """What was predicted from one image, forces on the gel in N.

    Attributes:
        cells: (3, rows, cols) N along gel x, y and z (pressing is negative). In a
            picture of a GelSight Mini gel y points to the left and gel x upwards.
        total: (3,) N, their sums.
        half_width: (3,) N, half of the 90 % prediction intervals of the totals, for sensors unseen in training with
        gels of
            the stiffness seen there, or with the uncertainty of a profile's factor; None where the model has none.
        reason: what is wrong with the pictures, empty for nothing.
        edge_peak: largest normal force of a cell at the edge of what the picture shows, over the largest of all; above
            0.2 the contact is cropped by the image and the total is too low. NaN where the map has fewer than three rows
            or columns.
        image: (h, w, 3) uint8, the picture below the cells, as the network reads it.
        vanished: number of markers that only one of image and no-contact image shows; both are compared without them.
    """

    cells: np.ndarray
    total: np.ndarray
    half_width: np.ndarray | None
    reason: str
    edge_peak: float
    image: np.ndarray
    vanished: int = 0

    @property
    def flag(self) -> bool:
        """Whether something is wrong with the pictures."""
        return bool(self.reason)

    def __repr__(self) -> str:
        halves = (None, None, None) if self.half_width is None else self.half_width
        totals = (f"{name} {interval_text(*pair)}" for name, *pair in zip(CHANNELS, self.total, halves, strict=True))
        return f"ForceReading({', '.join(totals)} N{', flagged: ' if self.flag else ''}{self.reason})"

    def plot(self) -> Any:
        """Draw the three maps of force.

        Returns:
            A matplotlib Figure: one panel for each component, N per cell; `figure.savefig(path)` writes it.
        """
        from gelforge.reporting.forcemaps import maps_figure

        return maps_figure(self.cells, repr(self))


def interval_digits(half: float) -> int:
    """Number of decimals that show two significant digits of a half width, at most four."""
    return min(max(1 - int(np.floor(np.log10(half))), 0), 4)


def interval_text(value: float, half: float | None = None) -> str:
    """A force and its half width, N, to two significant digits of the half width.

    Without a half width to three decimals, the resolution of FEATS' maps.
    """
    if half is None or not np.isfinite(half) or half <= 0.0:
        return f"{value:+.3f}"
    digits = interval_digits(half)
    return f"{value:+.{digits}f} +- {half:.{digits}f}"


def total_columns(found: ForceReading) -> dict[str, float | None]:
    """Values of TOTAL_COLUMNS, N to four decimals."""
    columns: dict[str, float | None] = {}
    for kind, values in zip(KINDS, (found.total, found.half_width), strict=True):
        for k, channel in enumerate(CHANNELS):
            columns[f"{channel}_{kind}"] = None if values is None else round(float(values[k]), 4)
    return columns | {"edge_peak": None if np.isnan(found.edge_peak) else round(found.edge_peak, 4)}


def edge_peak(forces: np.ndarray, shown: tuple[slice, slice]) -> float:
    """Largest normal force of a cell at the image's edge, over the largest of all; 0 where hardly anything presses.

    forces: (3, rows, cols) N. shown: rows and columns of the cells that the image shows; cells beyond count as its
    edge. NaN where fewer than three rows or columns are shown, because all of these are edge.
    """
    pressed = np.maximum(-forces[2].astype(float), 0.0)
    if min(pressed[shown].shape) < 3:
        return np.nan
    if pressed.sum() < LEAST_PRESS:
        return 0.0
    outer = pressed.copy()
    outer[shown][1:-1, 1:-1] = 0.0
    return float(outer.max() / pressed.max())


def goes_beyond(peak: float) -> bool:
    """Whether an `edge_peak` shows that the image crops the contact, so that the total is too low."""
    return peak >= BEYOND
