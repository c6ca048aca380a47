"""The streams of random numbers of a plan, in one table: what is drawn for one thing does not depend on another.

A stream is a press of the plan and a purpose, a number from here, for `rigplan.generator`. The numbers follow no scheme
that one would choose today. data/demo and every dataset since were drawn with them, and a plan that is carried out again
must give the same presses and pictures, so a number that was ever used keeps its meaning; new ones go where none is.
"""

MOST_FRAMES = 99  # frames of one press that a plan may ask for

ORDER = 0  # what is pressed, where and how deep
BENCH = 1  # play of the axes, the touch, and the load cell's noise at a press's end
WHO_SEES = 20_000  # which sensors see a press

# Noise of the cameras: 2 + unit + 1000 * frame while that stays below the load cell's numbers, which holds for
# FEW_FRAMES frames of FEW_UNITS units. A later frame (whose number once was the load cell's of an earlier one) or a
# further unit has its number past CAMERAS, where nothing else is.
_CAMERA, _FRAME, FEW_UNITS, FEW_FRAMES = 2, 1000, 998, 10
_CAMERAS = 1_000_000
_LOAD_CELL = 10_000  # and on, one for each frame before a press's end

# A press that no plan has, for what is drawn once for all presses: the waves in which the load cell drifts. (A unit's
# ranges and its no-contact image have streams of two numbers, the seed and one of their own, which numpy takes for the
# ORDER of a press of that number. A number of a unit may thus be one of a press; neither shows in what the other makes.)
EVERY_PRESS = 999_999_999


def camera(unit: int, frame: int) -> int:
    """Purpose of the noise in the picture that the `unit`th sensor of a press takes at a frame, both from 0 on."""
    _check_frame(frame)
    if unit < 0:
        raise ValueError(f"unit = {unit}: sensors of a press are counted from 0 on")
    if unit < FEW_UNITS and frame < FEW_FRAMES:
        return _CAMERA + unit + _FRAME * frame
    return _CAMERAS + MOST_FRAMES * unit + frame


def load_cell(frame: int) -> int:
    """Purpose of what the load cell adds at a frame before a press's end; at the end it is a part of BENCH."""
    _check_frame(frame)
    return _LOAD_CELL + frame


def _check_frame(frame: int) -> None:
    if not 0 <= frame < MOST_FRAMES:
        raise ValueError(f"frame = {frame}: a press has at most {MOST_FRAMES} frames, counted from 0 on")
