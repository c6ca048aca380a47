"""Presses of a ball of known diameter by hand, in the folder layout of gs_sdk's calibration, and the forces that pressed.

    FOLDER/background.png                  the sensor while nothing touches it
    FOLDER/DIAMETERmm/N/gelsight.png       a press
    FOLDER/DIAMETERmm/N/label.npz          center (u, v) and radius in px of the contact's circle, where it was marked

A circle that nobody marked is found (`imprint`). What a reader makes of these presses is the caller's.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.cache import DAMAGED
from gelforge.networks.balls.balltable import THICKNESS_MM, BallCurve, ball_table
from gelforge.networks.balls.imprint import CUT, Circle, contact_place, find_rim
from gelforge.records.image import read_image
from gelforge.records.markers import MARKER_PITCH_MM, markers_in
from gelforge.records.npz import in_short

LAYOUT = "give a folder with background.png and DIAMETERmm/N/gelsight.png, as gs_sdk's calibration has it"
DEPTHS = "which no depth of the table makes, press it 0.3 to 1.7 mm deep"
BACKGROUND = "background.png"
ONE_PLACE = 0.2  # of the picture's width that presses must lie apart
_DIAMETER = re.compile(r"(\d+(?:\.\d+)?)mm")


@dataclass(frozen=True)
class BallPress:
    """A press: its picture (h, w, 3) uint8 RGB, circle of contact in px, normal force in N that made it, and ball's diameter in mm."""

    name: str
    image: np.ndarray
    circle: Circle
    force: float
    diameter: float


@dataclass(frozen=True)
class BallFolder:
    """Presses of one ball that count, and why others do not, by name."""

    presses: list[BallPress]
    left_out: dict[str, str]
    px_per_mm: float


def px_per_mm_of(nocontact: np.ndarray) -> float:
    """Scale of pictures of a sensor, by its markers; BadInput where it has none."""
    pitch = markers_in(nocontact).pitch
    if not pitch:
        raise BadInput(
            "the no-contact image shows no markers, which alone give px per mm: use a gel with markers, and a sharp image"
        )
    return pitch / MARKER_PITCH_MM


def read_presses(
    folder: Path, nocontact: np.ndarray, diameter: float | None = None, thickness: float = THICKNESS_MM,
    px_per_mm: float | None = None, marks: bool = True,
) -> BallFolder:  # fmt: skip
    """The presses of a folder in the order of their numbers.

    nocontact: (h, w, 3) uint8 RGB. diameter: of the ball in mm; as the folder's name states it where None. thickness: of the gel
    at its apex, mm. px_per_mm: by the markers where None. marks: whether marked circles are used. BadInput for a folder
    without presses, sizes beyond the table, presses of which none counts, and presses that all lie in one place.
    """
    scale, counted = px_per_mm or px_per_mm_of(nocontact), []
    left_out: dict[str, str] = {}
    for path, size in _pictures(folder, diameter):
        name = str(path.parent.relative_to(folder))
        image, curve = read_image(path)[..., :3], ball_table().curve(size, thickness)
        try:
            if image.shape != nocontact.shape:
                raise BadInput("it is not of the size of the no-contact image")
            circle = _contact(path.with_name("label.npz") if marks else None, image, nocontact, curve, scale)
            counted.append(BallPress(name, image, circle, _force(circle, curve, scale), size))
        except BadInput as error:
            left_out[name] = str(error)
    if not counted:
        first, why = next(iter(left_out.items()))
        raise BadInput(f"{folder}: none of {len(left_out)} presses counts; {first}: {why}")
    _check_places(folder, counted, nocontact.shape[1])
    return BallFolder(counted, left_out, scale)


def _pictures(folder: Path, diameter: float | None) -> Iterator[tuple[Path, float]]:
    """Pictures of a folder's presses with the diameter of the ball in mm."""
    folders = [path for path in sorted(folder.glob("*mm")) if path.is_dir()]
    sizes = {path: match[1] for path in folders if (match := _DIAMETER.fullmatch(path.name))}
    if diameter is not None and len(sizes) > 1:
        raise BadInput(
            f"{folder}: holds balls of {', '.join(sizes.values())} mm; leave --diameter out, or give one of them alone"
        )
    found = [
        (press / "gelsight.png", float(size) if diameter is None else diameter)
        for path, size in sizes.items()
        for press in sorted(path.iterdir(), key=lambda one: (len(one.name), one.name))
        if (press / "gelsight.png").exists()
    ]
    if not found:
        raise BadInput(f"{folder}: holds no press of a ball; {LAYOUT}")
    yield from found


def _contact(mark: Path | None, image: np.ndarray, nocontact: np.ndarray, curve: BallCurve, scale: float) -> Circle:
    """The circle of contact in px, as marked or else within the rim that is found; BadInput says why a press cannot count."""
    if mark and mark.exists():
        circle = _marked(mark)
        u, v = contact_place(image, nocontact, scale)
        if np.hypot(circle.u - u, circle.v - v) > circle.radius:
            raise BadInput("its mark lies beside its imprint, mark it again or remove label.npz")
    else:
        rim = find_rim(image, nocontact, scale)
        circle = Circle(rim.u, rim.v, curve.radius_at(rim.radius / scale) * scale)
        if np.isnan(circle.radius):
            raise BadInput(f"its rim has a radius of {rim.radius / scale:.2f} mm, {DEPTHS}")
    if not circle.inside(image.shape):
        raise BadInput(CUT)
    return circle


def _force(circle: Circle, curve: BallCurve, scale: float) -> float:
    force = curve.force_at(circle.radius / scale)
    if np.isnan(force):
        raise BadInput(f"its circle has a radius of {circle.radius / scale:.2f} mm, {DEPTHS}")
    return force


def _marked(path: Path) -> Circle:
    """The circle of a label.npz of gs_sdk."""
    try:
        with np.load(path, allow_pickle=False) as label:
            (u, v), radius = label["center"].astype(float), float(label["radius"])
    except DAMAGED as error:
        raise BadInput(f"label.npz cannot be read ({in_short(error)}), remove it and its circle is found") from None
    return Circle(float(u), float(v), radius)


def _check_places(folder: Path, presses: list[BallPress], width: int) -> None:
    """BadInput where all presses lie in one place: light differs over the gel, and one place does not show the others'."""
    centres = [(press.circle.u, press.circle.v) for press in presses]
    apart = max((float(np.hypot(a[0] - b[0], a[1] - b[1])) for a, b in combinations(centres, 2)), default=0.0)
    if apart < ONE_PLACE * width:
        raise BadInput(
            f"{folder}: the ball was pressed in one place only ({len(presses)} presses that count); press it all over the gel"
        )
