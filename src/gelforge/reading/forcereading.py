"""The prediction from one image, the same result from `predict` to the page of `live`, and its columns of a table.

For each channel: CHANNEL_n, the total, and CHANNEL_half_width_n, half of its 90 % prediction interval, empty where it
is not known; likewise mx_nm, mx_half_width_nm and so on, the moment about the gel's apex in N m. edge_peak shows where totals are too low, because the image crops the contact.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gelforge.records.axes import CHANNELS, MOMENTS
from gelforge.records.press import N_M

# Columns and their decimal places: tenths of a millinewton, and micronewton metres.
DIGITS = {
    **{f"{channel}_{kind}": 4 for kind in ("n", "half_width_n") for channel in CHANNELS},
    **{f"{moment}_{kind}": 6 for kind in ("nm", "half_width_nm") for moment in MOMENTS},
    "edge_peak": 4,
}
TOTAL_COLUMNS = tuple(DIGITS)
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
            gels of the stiffness seen there, or with the uncertainty of a profile's factor; None where the model has
            none.
        reason: what is wrong with the pictures, empty for nothing.
        edge_peak: largest normal force of a cell at the edge of what the picture shows, over the largest of all; above
            0.2 the contact is cropped by the image and the total is too low. NaN where the map has fewer than three rows
            or columns.
        image: (h, w, 3) uint8, the picture below the cells, as the network reads it.
        moment: (3,) N mm, of the forces about gel x, y and z through the apex, the middle of the gel's undeformed
            surface, taken to be in the middle of the image; NaN where the map has fewer than three rows or columns.
        moment_half_width: (3,) N mm, as half_width; it includes an error of place of the forces.
        vanished: number of markers that only one of image and no-contact image shows; both are compared without them.
    """

    cells: np.ndarray
    total: np.ndarray
    half_width: np.ndarray | None
    reason: str
    edge_peak: float
    image: np.ndarray
    vanished: int = 0
    moment: np.ndarray = field(default_factory=lambda: np.full(3, np.nan))
    moment_half_width: np.ndarray | None = None

    @property
    def wrench(self) -> np.ndarray:
        """Force and moment, (6,) N and N m."""
        return np.concatenate([self.total, N_M * self.moment])

    @property
    def flag(self) -> bool:
        """Whether something is wrong with the pictures."""
        return bool(self.reason)

    def __repr__(self) -> str:
        forces = intervals_text(CHANNELS, self.total, self.half_width)
        moments = intervals_text(MOMENTS, self.moment, self.moment_half_width)
        return f"ForceReading({forces} N, {moments} N mm{', flagged: ' if self.flag else ''}{self.reason})"

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


def intervals_text(names: Sequence[str], values: np.ndarray, halves: np.ndarray | None) -> str:
    """Values (3,) by name with their half widths (3,), as `interval_text`."""
    pairs = zip(names, values, (None, None, None) if halves is None else halves, strict=True)
    return ", ".join(f"{name} {interval_text(*pair)}" for name, *pair in pairs)


def total_columns(found: ForceReading) -> dict[str, float | None]:
    """Values of TOTAL_COLUMNS, N and N m, to their DIGITS; None where unknown."""
    unknown = np.full(3, np.nan)
    halves = [unknown if half is None else half for half in (found.half_width, found.moment_half_width)]
    values = [*found.total, *halves[0], *(N_M * found.moment), *(N_M * halves[1]), found.edge_peak]
    return {
        name: None if np.isnan(value) else round(float(value), digits)
        for (name, digits), value in zip(DIGITS.items(), values, strict=True)
    }


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
