"""Films of real sensors: what is read of a released gel, of two fingers that hold one object, and of a gel that is dragged."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from gelforge.reading.forcereading import BEYOND
from gelforge.reading.markers import markers_in
from gelforge.reading.model import ForceModel
from gelforge.reading.reader import Reader
from gelforge.records.film import numbered
from gelforge.records.nocontactimage import SETTLING, find_nocontact
from tests.support.figures import Figure
from tests.support.films import frames_of

EVERY = 3  # every so manyth frame of a film is read
RELEASED_PX = 0.6  # nine of ten markers nearer than this to where they are at rest: nothing touches
HELD_PX = 1.0  # and farther than this: something does
MOST_AT_EDGE = 0.7  # edge_peak up to which most of a contact is taken to be seen
TRACKED = {"winSize": (21, 21), "maxLevel": 2}


@dataclass(frozen=True)
class Read:
    """A film as read: totals (n, 3) N in the labels' channels, and the markers' motion (n, d, 2) px.

    flagged: (n,) bool, pictures that `predict` flags. peak: (n,) largest force at the picture's edge (records.forcereading).
    """

    total: np.ndarray
    motion: np.ndarray
    flagged: np.ndarray
    peak: np.ndarray

    @property
    def moved(self) -> np.ndarray:
        """How far nine of ten markers have moved, (n,) px."""
        return np.nanpercentile(np.hypot(self.motion[..., 0], self.motion[..., 1]), 90, axis=1)


def motion_of(markers: np.ndarray, rest: np.ndarray, image: np.ndarray) -> np.ndarray:
    """How far markers (d, 2) of the picture at rest have moved in another picture, (d, 2) px; NaN where one is lost.

    A marker is lost that, followed back, does not come home.
    """
    grey = [cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) for picture in (rest, image)]
    start = (markers - 0.5).astype(np.float32).reshape(-1, 1, 2)
    found, seen, _ = cv2.calcOpticalFlowPyrLK(*grey, start, None, **TRACKED)
    home, _, _ = cv2.calcOpticalFlowPyrLK(*grey[::-1], found, None, **TRACKED)
    kept = (seen.ravel() > 0) & (np.hypot(*(home - start).reshape(-1, 2).T) < 1.0)
    return np.where(kept[:, None], (found - start).reshape(-1, 2), np.nan)


def read_film(path: Path, model: ForceModel) -> Read:
    """Read every third frame of a film, and follow its markers."""
    images = frames_of(path)
    rest, _ = find_nocontact(numbered(images), str(path))
    markers, predictor = markers_in(rest).points, Reader(rest, model=model)
    chosen = images[SETTLING::EVERY]  # while a camera sets its exposure nothing is known
    found = [predictor(image) for image in chosen]
    return Read(
        total=np.array([one.total for one in found]),
        motion=np.array([motion_of(markers, rest, image) for image in chosen]),
        flagged=np.array([one.flag for one in found]),
        peak=np.array([one.edge_peak for one in found]),
    )


def released_figures(films: dict[str, Read]) -> list[Figure]:
    """What is read of a gel that nothing touches."""
    worst = {}
    for name, film in films.items():
        free = film.moved < RELEASED_PX
        if free.sum() >= 3:
            worst[name] = float(np.percentile(np.abs(film.total[free]).max(axis=1), 90))
    name = max(worst, key=worst.get)
    note = f"{name}; {len(worst)} films, median {np.median(list(worst.values())):.2f}"
    return [Figure("released gels, nine of ten frames of the worst film", worst[name], "<=", 0.1, "N", note)]


def every_frame(one: Read, two: Read, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Of the first `count` frames of two fingers those in which both are touched, and those that their likeness is measured on."""
    return (one.moved[:count] > HELD_PX) & (two.moved[:count] > HELD_PX), np.ones(count, bool)


def mostly_seen(one: Read, two: Read, count: int) -> tuple[np.ndarray, np.ndarray]:
    """As `every_frame`, without frames that are flagged, and those in which a contact presses hardest about a picture's edge.

    Of frames in which just one is touched nothing is known.
    """
    both, _ = every_frame(one, two, count)
    good = ~(one.flagged[:count] | two.flagged[:count])
    neither = (one.moved[:count] < RELEASED_PX) & (two.moved[:count] < RELEASED_PX)
    both = both & good & (one.peak[:count] < MOST_AT_EDGE) & (two.peak[:count] < MOST_AT_EDGE)
    return both, both | (neither & good)


def seen_whole(one: Read, two: Read, count: int) -> tuple[np.ndarray, np.ndarray]:
    """As `mostly_seen`, without frames whose image crops a contact: only what both see whole is equal."""
    both, compared = mostly_seen(one, two, count)
    whole = (one.peak[:count] < BEYOND) & (two.peak[:count] < BEYOND)
    return both & whole, compared & whole


def grasps_of(films: dict[str, Read], choose: Callable) -> np.ndarray:
    """Median normal force in N of either finger while both are touched, and their correlation over time, (grasps, 3).

    choose: `every_frame`, `mostly_seen` or `seen_whole`.
    """
    found = []
    for name, one in films.items():
        two = films.get(name.removesuffix("camera_0") + "camera_2")
        if not name.endswith("camera_0") or two is None:
            continue
        count = min(len(one.moved), len(two.moved))
        both, compared = choose(one, two, count)
        left, right = (-film.total[:count, 2] for film in (one, two))
        if both.sum() >= 5 and min(np.median(left[both]), np.median(right[both])) > 0.0:
            likeness = float(np.corrcoef(left[compared], right[compared])[0, 1])
            found.append((float(np.median(left[both])), float(np.median(right[both])), likeness))
    return np.array(found).reshape(-1, 3)


def factor_between(one: np.ndarray, other: np.ndarray) -> float:
    """Factor by which forces (n,) N differ, median."""
    return float(np.exp(np.median(np.abs(np.log(one / other)))))


def finger_figures(films: dict[str, Read]) -> list[Figure]:
    """Normal forces of two fingers that hold one object, over all frames in which both see most of what touches them."""
    most, every, whole = (grasps_of(films, choose) for choose in (mostly_seen, every_frame, seen_whole))
    usual, of_all = (factor_between(*grasps[:, :2].T) for grasps in (most, every))
    # what both cameras see of one object differs too much for a goal
    return [
        Figure("two fingers on one object, factor between them, median", usual, "", usual, "",
               f"{len(most)} grasps; both see all of the contact in {len(whole)}; {of_all:.2f} over all"
               f" frames of {len(every)}; correlation over time {np.median(most[:, 2]):.2f}"),
    ]  # fmt: skip


def sideways_figures(films: dict[str, Read]) -> list[Figure]:
    """Sideways force against the mean motion of the markers: likeness over all films, angle film by film."""
    moved, pulled, angles = [], [], []
    for film in films.values():
        motion = np.nanmean(film.motion, axis=1)
        # image columns run against gel y, rows against gel x
        force = -film.total[:, [1, 0]]
        held = np.hypot(*motion.T) > HELD_PX
        if held.sum() < 10:
            continue
        moved.append(motion[held])
        pulled.append(force[held])
        cross = motion[held, 0] * force[held, 1] - motion[held, 1] * force[held, 0]
        angles.append(np.median(np.degrees(np.abs(np.arctan2(cross, (motion[held] * force[held]).sum(axis=1))))))
    motion, force = np.concatenate(moved), np.concatenate(pulled)
    likeness = float(min(np.corrcoef(motion[:, k], force[:, k])[0, 1] for k in (0, 1)))
    note = f"{len(angles)} films"
    return [
        Figure("sideways force against markers, correlation, lesser of two axes", likeness, ">=", 0.98, "", note),
        Figure("sideways force against markers, angle, median", float(np.median(angles)), "<=", 5.0, "degrees"),
    ]
