"""Whether the images of a log show what its rows describe, each by itself and all together.

A single image is checked by `reading.faults`. All images of a sensor together are checked by their imprints
(`evidence.imprints`): where they lie, how large they are, and whether they follow the poses of the rows.
"""

import math
import operator
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from gelforge.evidence.imprints import COLS, ROWS, Seen
from gelforge.evidence.placement import BETTER, FEWEST, FITS, OFTEN, gains, moved_map, other_axes, projection
from gelforge.reading.picture import likeness

# Limits of the imprints. The likeness of measured and expected imprints is 0.79 to 0.97 in the rig's presses (median
# 0.91), 0.9 to 0.97 in real presses of a ball. Contacts lie within 0.2 mm of their poses in the median; imprints are
# 1.04 to 1.09 times as large as expected.
#
# Least strength of an imprint (change of colour over expected slope), and its least fraction of the sensor's median.
LEAST_CHANGE, WEAK = 8.0, 0.45
# Rim markers of an image: largest median motion, in pitches, and largest fraction lost or looking different; or twice
# the sensor's 75 % quantile, if larger. Beyond them are none of 48 presses of the rig, and 80 % of other units' images
# whose light fits.
RIM_MOVED, RIM_LOST = 0.2, 0.3
UNLIKE = 0.4  # median likeness up to which the images of a sensor show nothing of their rows
MOVED_MM = 3.0  # distance from its pose beyond which a single imprint is reported
SIZES = np.geomspace(0.7, 1.4, 15)
# Size of measured over expected imprints: usual ratio, and largest deviation for an indenter and for all.
USUAL_SIZE, OTHER_SIZE, OTHER_SCALE = 1.05, 0.1, 0.14
FEWEST_ALIKE = 3  # least number of images of one indenter that show another size or another shape
# Likeness: how far below the median other indenters' shapes are tried; how much such a shape must gain over the own
# shape of any size; and what it must reach.
DOUBTFUL, OTHER_SHAPE, THAT_SHAPE = 0.08, 0.08, 0.8
LOOKED_AT = 12  # images of an indenter whose shape is compared with other indenters'
GHOST = 0.5  # least change common to most images where their poses put nothing, over an image's 99 % quantile

# Possible errors of rot_deg, and the function that corrects each.
TURNS: dict[str, Callable[[float], float]] = {
    "in radians": math.degrees,
    "of the other sign": lambda degrees: -degrees,
    **{
        f"off by {by} degrees": partial(operator.add, by)
        for by in sorted(range(-165, 181, 15), key=lambda by: (abs(by), -by))
        if by
    },
}


@dataclass(frozen=True)
class Finding:
    """A sentence about images, and the rows of the log that it is about: all of a sensor or an indenter, or a single one.

    wrong: whether no label of these rows can be right; else the sentence asks for a check.
    """

    text: str
    rows: tuple[int, ...]
    wrong: bool = False


@dataclass(frozen=True)
class Shapes:
    """The indenters that a log may have used: their names, and the map (30, 40) that a press is expected to give.

    expected: with the named indenter. turned: with the press' own indenter, its rot_deg changed by a function.
    """

    names: Sequence[str]
    expected: Callable[[Seen, str], np.ndarray]
    turned: Callable[[Seen, Callable[[float], float]], np.ndarray]

    def moved(self, moves: np.ndarray) -> "Shapes":
        """The same with all maps moved by `moves`, OpenCV's affine matrix (2, 3)."""
        return Shapes(
            self.names,
            lambda one, name: moved_map(self.expected(one, name), moves),
            lambda one, turn: moved_map(self.turned(one, turn), moves),
        )


def findings(presses: Sequence[Seen], shapes: Shapes | None = None) -> list[Finding]:
    """What is wrong with the images of a log, each kind in one sentence with its number; nothing where they suit their rows.

    presses: in the order of the log, all that have a pose.
    """
    found = []
    for sensor in sorted({one.sensor for one in presses}):
        own = [one for one in presses if one.sensor == sensor]
        said = _fault_of_most(own) or _of_sensor(own, presses, shapes)
        found += [replace(one, text=f"sensor {sensor}: {one.text}") for one in said]
    return found


def _weak(mine: Sequence[Seen]) -> list[Finding]:
    """Images that show no imprint, or a fraction of it, where the depth of their row makes one."""
    made = [one for one in mine if math.isfinite(one.strength)]
    shown = [one.strength for one in made if one.strength >= LEAST_CHANGE]
    least = max(LEAST_CHANGE, WEAK * float(np.median(shown))) if len(shown) >= FEWEST_ALIKE else LEAST_CHANGE
    weak = [one for one in made if one.strength < least]
    if len(weak) >= 2 and len(weak) > len(made) / 2:
        rows = tuple(one.row for one in weak)
        text = (
            f"{len(weak)} of {len(made)} images show no imprint, or hardly any, where the depth of their row makes one (rows {row_list(rows)}):"
            " did the camera run while the indenter pressed, and is `z0_mm` where the tip touches the gel?"
        )
        return [Finding(text, rows, wrong=True)]
    usual = float(np.median(shown)) if shown else LEAST_CHANGE
    return [
        Finding(
            f"row {one.row} ({one.sample_id}): its image shows {one.strength / usual:.0%} of the imprint that its depth makes: is it the"
            " image of another row, or of another moment?",
            (one.row,),
            wrong=True,
        )
        for one in weak
    ]


def _fault_of_most(mine: Sequence[Seen]) -> list[Finding]:
    """A fault that most images of a sensor have: most likely it is the no-contact image, or the column `sensor_id`, that is wrong."""
    counted = Counter(one.fault for one in mine if one.fault)
    fault, count = counted.most_common(1)[0] if counted else ("", 0)
    if len(mine) < FEWEST or count <= len(mine) / 2:
        return []
    text = f"{count} of {len(mine)} images have the same fault, {fault}: check its no-contact image and the column `sensor_id`"
    return [Finding(text, tuple(one.row for one in mine if one.fault == fault), wrong=True)]


def _of_sensor(own: list[Seen], presses: Sequence[Seen], shapes: Shapes | None) -> list[Finding]:
    found = [*_frozen(own), *_other_gel(own)]
    found += _weak([one for one in own if not _about(one, found)])
    mine = [one for one in own if one.telling and not _about(one, found)]
    if len(mine) < FEWEST:
        return found
    said, moves = projection(mine)
    if moves is None:
        return [*found, *_of_shown(mine, presses, shapes)]
    # correct the expected imprints by the common move: the other checks then find only what it leaves unexplained
    moved = {one.row: replace(one, expected=moved_map(one.expected, moves)) for one in own}
    shapes = shapes and shapes.moved(moves)
    presses = [moved.get(one.row, one) for one in presses]
    rest = _of_shown([moved[one.row] for one in mine], presses, shapes)
    return [*found, Finding(said, tuple(one.row for one in mine)), *rest]


def _frozen(mine: Sequence[Seen]) -> list[Finding]:
    """Images that repeat that of the row before, although their poses differ."""
    text = "its image is identical to that of the previous row, although their poses differ: the camera or its recording was frozen"
    return [
        Finding(text, (one.row,), wrong=True)
        for before, one in pairwise(mine)
        if one.telling
        and np.array_equal(before.measured, one.measured)
        and not np.array_equal(before.expected, one.expected)
    ]


def _other_gel(mine: Sequence[Seen]) -> list[Finding]:
    """Single images whose markers at the rim stand or look otherwise than those of the no-contact image."""
    good = [one for one in mine if not one.fault]
    if len(good) < FEWEST:
        return []
    rim = np.array([one.rim for one in good])
    most = np.maximum([RIM_MOVED, RIM_LOST], 2.0 * np.quantile(rim, 0.75, axis=0))
    text = "the markers at the rim of its image are not those of the no-contact image: it is of another unit, or the gel was moved"
    return [
        Finding(text, (one.row,), wrong=True)
        for one, beyond in zip(good, (rim > most).any(axis=1), strict=True)
        if beyond
    ]


def _of_shown(mine: list[Seen], presses: Sequence[Seen], shapes: Shapes | None) -> list[Finding]:
    """What is wrong with images that show imprints."""
    rows = tuple(one.row for one in mine)
    ghost = _ghost(mine)
    if not ghost and (shifted := _other_order(mine, presses)):
        return [shifted]
    wrong = ghost or other_axes(mine)
    turned = None if wrong or not shapes else _other_turn(mine, shapes)
    if turned:
        return [turned]
    wrong = wrong or _unlike(mine)
    if wrong:
        return [Finding(wrong, rows, wrong=True)]
    scale = _all_sizes(mine)
    found = _other_shapes(mine, shapes) if shapes and not scale else []
    found += [] if scale else _sizes([one for one in mine if not _about(one, found)])
    left = [one for one in mine if not _about(one, found)]
    notes = [Finding(one, rows) for one in (scale, projection(left)[0]) if one]
    return [*found, *notes, *_single(left)]


def _about(one: Seen, found: Sequence[Finding]) -> bool:
    return any(one.row in each.rows for each in found)


def _ghost(seen: Sequence[Seen]) -> str:
    """A change that most images show at one place where their poses put nothing: it stems from the no-contact image."""
    shown = np.array([one.measured / np.percentile(one.measured, 99) for one in seen])
    free = np.array([one.expected < 0.02 * one.expected.max() for one in seen])
    enough = free.sum(axis=0) >= max(FEWEST // 2, len(seen) // 3)
    if not enough.any():
        return ""
    common = np.nanquantile(np.where(free, shown, np.nan)[:, enough], 0.3, axis=0)
    if (common > GHOST).sum() < 8:
        return ""
    row, col = np.argwhere(enough)[common > GHOST].mean(axis=0)
    return (
        f"most images share a change around {(col + 0.5) / COLS:.0%} of their width and {(row + 0.5) / ROWS:.0%} of their height, where no"
        " pose puts a contact: something touched the gel in the no-contact image, that image is of another unit, or an indenter has another"
        " shape, for example because its STL file is upside down"
    )


def _other_order(mine: list[Seen], presses: Sequence[Seen]) -> Finding | None:
    """Images that suit the pose of a neighbouring row, from some row on."""
    place = {one.row: at for at, one in enumerate(presses)}
    base = np.array([one.likeness for one in mine])
    for step, what in ((1, "next"), (-1, "previous")):
        beside = np.array([place[one.row] + step for one in mine])
        there = (beside >= 0) & (beside < len(presses))
        other = np.array([
            likeness(one.measured, presses[at].expected) if known else 0.0 for one, at, known in zip(mine, beside, there, strict=True)
        ])  # fmt: skip
        gain = np.where(there, other - base, 0.0)
        those = there & (np.arange(len(mine)) >= gain[::-1].cumsum()[::-1].argmax())
        if those.sum() < FEWEST_ALIKE or not gains(base[those], other[those]):
            continue
        rows = tuple(one.row for one, among in zip(mine, those, strict=True) if among)
        since = "" if len(rows) > OFTEN * len(mine) else f" from row {rows[0]} on"
        text = (
            f"{'the images' + since} suit the pose of the {what} row (likeness {np.median(other[those]):.2f}) better than that of their own"
            f" ({np.median(base[those]):.2f}): the column `image` is shifted by one row{since}"
        )
        return Finding(text, rows, wrong=True)
    return None


def _other_turn(mine: Sequence[Seen], shapes: Shapes) -> Finding | None:
    """Images that show their indenters at another rotation than rot_deg, all by one error."""
    unlike = [one for one in mine if one.likeness < THAT_SHAPE]
    if len(unlike) < FEWEST_ALIKE:
        return None
    chosen = _some(unlike)
    base = np.array([one.likeness for one in chosen])
    found = {
        what: np.array([likeness(one.measured, shapes.turned(one, turn)) for one in chosen])
        for what, turn in TURNS.items()
    }
    what = max(found, key=lambda one: float(np.median(found[one])))
    if not gains(base, found[what]) or np.median(found[what]) < THAT_SHAPE:
        return None
    rows = tuple(one.row for one in unlike)
    text = (
        f"images of {', '.join(sorted({one.indenter for one in unlike}))} show them turned as if rot_deg were {what} (likeness"
        f" {np.median(found[what]):.2f}, as logged {np.median(base):.2f}) in rows {row_list(rows)}: correct the column rot_deg"
    )
    return Finding(text, rows, wrong=True)


def _unlike(mine: list[Seen]) -> str:
    """Images that show nothing of what their rows describe, with the likeness where each is moved to fit best."""
    usual = float(np.median([one.likeness for one in mine]))
    if usual > UNLIKE:
        return ""
    moved = [one.displaced for one in mine]
    fit, away = np.median([fit for fit, _ in moved]), np.median([np.hypot(*move) for _, move in moved]) * mine[0].mm
    return (
        f"the images do not show the contacts that their rows describe (likeness {usual:.2f}, 0.8 to 0.97 are usual; {fit:.2f} where each is moved"
        f" by {away:.0f} mm): check the order of the images, the poses, `projection` in sensors.toml, and the indenters' shapes"
    )


def _best_size(one: Seen) -> tuple[float, float]:
    """Scale about the tip at which the expected imprint is most like the measured one, and that likeness."""
    import cv2

    fits = []
    for size in SIZES:
        about = np.column_stack([np.eye(2) * size, (1.0 - size) * one.centre])
        fits.append(likeness(one.measured, cv2.warpAffine(one.expected, about, (COLS, ROWS))))
    return float(SIZES[int(np.argmax(fits))]), max(fits)


def _size_by_indenter(mine: list[Seen]) -> dict[str, float]:
    names = sorted({one.indenter for one in mine})
    every = {name: [_best_size(one)[0] for one in mine if one.indenter == name] for name in names}
    return {name: float(np.median(sizes)) for name, sizes in every.items() if len(sizes) >= FEWEST_ALIKE}


def _all_sizes(mine: list[Seen]) -> str:
    """The scale of the projection, where all indenters' imprints are larger or smaller alike."""
    sizes = np.array(list(_size_by_indenter(mine).values())) / USUAL_SIZE
    if len(sizes) < 2 or abs(np.median(sizes) - 1.0) < OTHER_SCALE or np.ptp(sizes) > 2.0 * OTHER_SIZE:
        return ""
    return (
        f"the imprints of all indenters are {np.median(sizes):.2f} times as large as expected: check the scale of `projection` in"
        " sensors.toml (make projection)"
    )


def _sizes(mine: list[Seen]) -> list[Finding]:
    """Indenters whose imprints are larger or smaller than their shapes say, beside those of the other indenters."""
    sizes = _size_by_indenter(mine)
    found = []
    for name, own in sizes.items():
        others = [value for other, value in sizes.items() if other != name]
        usual = float(np.median([*others, USUAL_SIZE]))
        limit = OTHER_SIZE if len(others) >= 2 else 2.0 * OTHER_SIZE
        if max(own / usual, usual / own) - 1.0 > limit:
            rows = tuple(one.row for one in mine if one.indenter == name)
            text = (
                f"imprints of {name} are {own / usual:.2f} times as large as its shape says: check its size and unit in the catalogue,"
                " and the column `indenter`"
            )
            found.append(Finding(text, rows))
    return found


def _other_shapes(mine: list[Seen], shapes: Shapes) -> list[Finding]:
    """Images that show the shape of another indenter than the one that their row names."""
    usual = float(np.median([one.likeness for one in mine]))
    better: dict[tuple[str, str], list[tuple[Seen, float]]] = {}
    for name in sorted({one.indenter for one in mine}):
        for one in _some([one for one in mine if one.indenter == name and one.likeness < usual - DOUBTFUL]):
            others = (other for other in shapes.names if other != name)
            fits = {other: likeness(one.measured, shapes.expected(one, other)) for other in others}
            best = max(fits, key=lambda other: fits[other], default="")
            if best and fits[best] > max(THAT_SHAPE, _best_size(one)[1] + OTHER_SHAPE):
                better.setdefault((name, best), []).append((one, fits[best]))
    found = []
    for (name, other), those in better.items():
        if len(those) >= FEWEST_ALIKE:
            rows = tuple(one.row for one, _ in those)
            text = (
                f"images of {name} show the shape of {other} (likeness {np.median([fit for _, fit in those]):.2f}, of {name}"
                f" {np.median([one.likeness for one, _ in those]):.2f}) in rows {row_list(rows)}: check the column `indenter` and the"
                " catalogue"
            )
            found.append(Finding(text, rows))
    return found


def _some(presses: Sequence[Seen]) -> list[Seen]:
    """At most LOOKED_AT presses, evenly spaced."""
    return [
        presses[at] for at in np.unique(np.linspace(0, len(presses) - 1, min(LOOKED_AT, len(presses))).astype(int))
    ]


def row_list(rows: Iterable[int]) -> str:
    """The first five row numbers as text."""
    rows = list(rows)
    return ", ".join(map(str, rows[:5])) + (" …" if len(rows) > 5 else "")


def _single(mine: list[Seen]) -> list[Finding]:
    """Single rows whose contact lies beside its pose or has another shape, while the other rows are right."""
    base = np.array([one.likeness for one in mine])
    usual = float(np.median(base)) if len(mine) >= FEWEST else 0.0
    if usual < FITS:
        return []
    found = []
    for one, own in zip(mine, base, strict=True):
        if own >= FITS:
            continue
        fit, move = one.displaced
        away = float(np.hypot(*move)) * one.mm
        where = f"row {one.row} ({one.sample_id})"
        if fit > max(FITS, own + BETTER) and away > MOVED_MM:
            text = (
                f"{where}: the contact in its image lies {away:.1f} mm from its pose: is it the image of another row?"
            )
            found.append(Finding(text, (one.row,), wrong=True))
        elif own < usual - 2.0 * BETTER:
            text = (
                f"{where}: its image shows no contact of the shape of {one.indenter} at its pose (likeness {own:.2f}, of the others"
                f" {usual:.2f}): is it the image of another row?"
            )
            found.append(Finding(text, (one.row,), wrong=True))
    return found
