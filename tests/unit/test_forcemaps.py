"""Pictures of force maps: what a person reads off them."""

import numpy as np
import pytest

from gelforge.reporting.forcemaps import WARNING_LINES, overlay, wrapped

WARNING = "the gel sits too far from where it sat untouched to be sure: (+12.0, -3.0) px aside, 4.1 degrees turned"
GREY = np.full((240, 320, 3), 90, np.uint8)
NOTHING = np.zeros((3, 24, 32), np.float32)


@pytest.mark.parametrize("zoom", [1, 2])
@pytest.mark.parametrize("warning", [WARNING, f"{WARNING}; {WARNING}; {WARNING}", "a" * 200])
def test_a_warning_stays_within_the_picture_and_leaves_its_size(warning, zoom):
    """All frames of a film have one size, whatever is said of them."""
    plain, warned = (overlay(GREY, NOTHING, ["x", "y"], said, zoom) for said in ("", warning))
    assert plain.shape == warned.shape
    red = (warned != plain).any(axis=(0, 2))
    assert red.any() and (len(warning.split()) == 1 or not red[-3:].any())


def test_a_warning_is_told_whole_where_there_is_room_and_else_ends_in_dots():
    lines = wrapped(WARNING, 628, WARNING_LINES)
    assert len(lines) > 1 and " ".join(lines) == WARNING
    assert wrapped("", 628, WARNING_LINES) == []
    long = f"{WARNING}; {WARNING}"
    short = wrapped(long, 308, WARNING_LINES)
    assert len(short) == WARNING_LINES and short[-1].endswith(" ...")
    assert long.startswith(" ".join(short).removesuffix(" ..."))
