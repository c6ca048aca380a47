"""The independent streams of random numbers of a plan, in one table.

A stream is a press of the plan and a purpose, a number from here, for `rigplan.generator`. The numbers follow no
scheme, but every dataset was drawn with them, and a plan that is repeated must give the same presses and images. A
number must therefore keep its meaning, and new purposes need unused numbers.
"""

MOST_FRAMES = 99  # frames of one press that a plan may ask for

ORDER = 0  # what is pressed, where and how deep
BENCH = 1  # axis errors, touch height, and the load cell's noise at a press's end
WHO_SEES = 20_000  # which sensors see a press
MOUNTING = 30_000  # tilt, height of touch and seating of a mounting, whose number stands for a press's

# Camera noise: 2 + unit + 1000 * frame for the first FEW_FRAMES frames of FEW_UNITS units, which stays below the load
# cell's numbers. Later frames, which would collide with these, and further units have numbers from _CAMERAS on.
_CAMERA, _FRAME, FEW_UNITS, FEW_FRAMES = 2, 1000, 998, 10
_CAMERAS = 1_000_000
_LOAD_CELL = 10_000  # first number; one for each frame before a press's end

# A press number that no plan has, for draws that all presses share: the drift of the load cell. (A unit's values and
# its no-contact image have streams [seed, number]; numpy treats them as [seed, number, 0], the ORDER of the press of
# that number. The same draws may thus occur in both, which is harmless: they are used for different quantities.)
EVERY_PRESS = 999_999_999


def camera(unit: int, frame: int) -> int:
    """Purpose of the noise in the image of a press's sensor `unit` at a frame, both from 0 on; else ValueError."""
    _check_frame(frame)
    if unit < 0:
        raise ValueError(f"unit = {unit}: sensors of a press are counted from 0 on")
    if unit < FEW_UNITS and frame < FEW_FRAMES:
        return _CAMERA + unit + _FRAME * frame
    return _CAMERAS + MOST_FRAMES * unit + frame


def load_cell(frame: int) -> int:
    """Purpose of the load cell's noise at a frame before a press's end; at the end it is part of BENCH."""
    _check_frame(frame)
    return _LOAD_CELL + frame


def _check_frame(frame: int) -> None:
    if not 0 <= frame < MOST_FRAMES:
        raise ValueError(f"frame = {frame}: a press has at most {MOST_FRAMES} frames, counted from 0 on")
