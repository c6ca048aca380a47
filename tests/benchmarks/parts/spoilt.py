"""What becomes of forces where images of real sensors are spoilt: markers painted over, another fall of light, a gel that moved."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gelforge.reading.forcereading import ForceReading
from gelforge.reading.markers import markers_in
from gelforge.reading.model import ForceModel
from gelforge.reading.reader import Reader
from gelforge.reading.wear import painted_over
from tests.support.figures import Figure
from tests.support.pictures import moved

WORN = {1: 1.03, 2: 1.05, 4: 1.08, 8: 1.15}  # markers painted over: factor on nine of ten forces that is asked for
MOST_RELEASED = 0.15  # N on a gel that nothing touches, beside a no-contact image without some of its markers
RELIT = {
    "corners 30 % darker": lambda s, t: 1.0 - 0.15 * (s * s + t * t),
    "10 % from left to right": lambda s, t: 1.0 + 0.1 * s,
    "20 % from left to right": lambda s, t: 1.0 + 0.2 * s,
}  # s, t: from -1 to 1 across the image
MOST_RELIT = 0.5  # N
MOVES = {
    "a zoom of 0.4 %": (({"zoom": 1.004}, {"zoom": 0.996}), 2.5),
    "a shift of 0.5 px": (({"shift": (0.4, 0.3)},), 1.2),
    "a gel mounted 10 px aside": (({"shift": (8.0, 6.0)},), 3.0),
}  # ways, and per cent of the normal force that is asked for
EACH = 3  # of so many presses one is spoilt


@dataclass(frozen=True)
class Series:
    """Some images (h, w, 3) uint8 of presses into one real sensor, its no-contact image, and what is predicted from them."""

    what: str
    model: ForceModel
    nocontact: np.ndarray
    images: Sequence[np.ndarray]
    read: Sequence[ForceReading]

    @property
    def totals(self) -> np.ndarray:
        """Total forces (n, 3) N of the images as they are."""
        return np.array([one.total for one in self.read])

    @property
    def predictor(self) -> Reader:
        """Of the no-contact image as it is."""
        return Reader(self.nocontact, model=self.model)


def spoilt_figures(series: Series) -> list[Figure]:
    """Figures of every way to spoil the images of a sensor."""
    return [*wear_figures(series), *light_figures(series), *move_figures(series)]


def wear_figures(series: Series) -> list[Figure]:
    """Markers painted over at random, in each image anew: in it, in its no-contact image, or in both."""
    whole, markers, rng = series.predictor, markers_in(series.nocontact), np.random.default_rng(3)
    points, released, figures = markers.points - 0.5, 0.0, []
    for count, goal in WORN.items():
        factors: dict[str, float] = {}
        flagged = []
        for where in ("image", "no-contact image", "both"):
            found = []
            for image, own in zip(series.images, series.totals[:, 2], strict=True):
                lost = points[rng.choice(len(points), count, replace=False)]
                reader = whole
                if where != "image":
                    reader = Reader(painted_over(series.nocontact, lost, markers.diameter), model=series.model)
                    at_rest = reader(series.nocontact)
                    released = max(released, 0.0 if at_rest.flag else float(np.abs(at_rest.total).max()))
                seen = reader(image if where == "no-contact image" else painted_over(image, lost, markers.diameter))
                flagged.append(seen.flag)
                if not seen.flag:
                    found.append(abs(np.log(max(seen.total[2] / own, 0.05))))
            factors[where] = float(np.exp(np.quantile(found, 0.9))) if found else 1.0
        note = ", ".join(f"{where} {factor:.2f}" for where, factor in factors.items())
        note += f"; {len(series.images)} images; flagged {np.mean(flagged):.0%}, these left out"
        what = f"{series.what}: {count} of {len(points)} markers painted over, factor on nine of ten forces"
        figures.append(Figure(what, max(factors.values()), "<=", goal, "", note))
    what = (
        f"{series.what}: the released gel where the no-contact image lacks up to {max(WORN)} markers, largest force"
    )
    return [*figures, Figure(what, released, "<=", MOST_RELEASED, "N")]


def relit(image: np.ndarray, fall: Callable) -> np.ndarray:
    """An image (h, w, 3) uint8 under another fall of light, of RELIT."""
    height, width = image.shape[:2]
    v, u = np.mgrid[:height, :width] + 0.5
    field = fall(2.0 * u / width - 1.0, 2.0 * v / height - 1.0)
    return np.clip(np.rint(image * field[..., None]), 0, 255).astype(np.uint8)


def light_figures(series: Series) -> list[Figure]:
    """A no-contact image that was taken under another fall of light."""
    figures = []
    for what, fall in RELIT.items():
        reader = Reader(relit(series.nocontact, fall), model=series.model)
        seen = [reader(image) for image in series.images]
        change = np.abs(np.array([one.total[2] for one in seen]) - series.totals[:, 2])
        flagged = np.array([one.flag for one in seen])
        note = f"{len(seen)} images; flagged {flagged.mean():.0%}; flagged ones too {change.max():.2f} N, median {np.median(change):.2f} N"
        name = f"{series.what}: no-contact image with {what}, largest unflagged change of force"
        figures.append(Figure(name, float(change[~flagged].max(initial=0.0)), "<=", MOST_RELIT, "N", note))
    return figures


def move_figures(series: Series) -> list[Figure]:
    """Images that are moved against the no-contact image, which nothing in the camera's frame corrects."""
    reader, own, figures = series.predictor, series.totals, []
    for what, (ways, goal) in MOVES.items():
        changes = []
        for way in ways:
            after = np.array([reader(moved(image, **way)).total for image in series.images])
            changes.append(100 * float(np.median(np.abs(after - own).max(axis=1) / np.abs(own[:, 2]))))
        note = f"median of {len(own)} presses" + (
            f"; either way {changes[0]:.1f}, {changes[1]:.1f} %" if len(ways) > 1 else ""
        )
        figures.append(Figure(f"{series.what}: {what} changes force by", max(changes), "<=", goal, "%", note))
    return figures
