"""Pictures of force maps: what a person reads off them."""

import ast
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelforge.reading import faults, frame, untouched, wear
from gelforge.reporting.canvas import canvas, to_png
from gelforge.reporting.forcemaps import FULL_COLOUR_N, MARGIN_PX, PANEL_PX, WARNING_LINES, wrapped, write_maps

WARNING = "the gel is mounted too far from its place in the no-contact image to be sure: (+12.0, -3.0) px aside, 4.1 degrees turned"
GREY = np.full((240, 320, 3), 90, np.uint8)
NOTHING = np.zeros((3, 24, 32), np.float32)


def test_a_warning_is_reported_whole_where_there_is_room_and_else_ends_in_an_ellipsis():
    lines = wrapped(WARNING, 628, WARNING_LINES)
    assert len(lines) > 1 and " ".join(lines) == WARNING
    assert wrapped("", 628, WARNING_LINES) == []
    long = f"{WARNING}; {WARNING}"
    short = wrapped(long, 308, WARNING_LINES)
    assert len(short) == WARNING_LINES and short[-1].endswith(" ...")
    assert long.startswith(" ".join(short).removesuffix(" ..."))


def text_of(node) -> str:
    """The text of a string in the source, with each number of an f-string as 100.0 px."""
    parts = node.values if isinstance(node, ast.JoinedStr) else [node]
    return "".join(str(part.value) if isinstance(part, ast.Constant) else "100.0" for part in parts)


def test_every_reason_for_a_flag_is_written_whole_above_its_picture():
    for module in (faults, frame, untouched, wear):
        tree = ast.parse(Path(module.__file__).read_text(encoding="utf-8"))
        strings = [node for node in ast.walk(tree) if isinstance(node, ast.JoinedStr | ast.Constant)]
        for text in map(text_of, strings):
            if " " in text and "\n" not in text:  # docstrings have several lines
                lines = wrapped(f"press_0001 | FLAGGED: {text}", PANEL_PX - 2 * MARGIN_PX, WARNING_LINES)
                assert not lines[-1].endswith("..."), text


@pytest.mark.filterwarnings("error")
def test_a_name_with_letters_that_the_font_lacks_is_drawn_without_a_warning(tmp_path):
    write_maps(tmp_path / "maps.png", GREY, NOTHING, "press é 漢字")
    figure = canvas(2, 2)
    figure.suptitle("漢字")
    assert to_png(figure) and (tmp_path / "maps.png").stat().st_size


def strong(path) -> int:
    """How many pixels of a picture are of a strong red or blue."""
    picture = cv2.imread(str(path)).astype(int)
    return int((np.ptp(picture, axis=2) > 100).sum())


def test_a_released_gel_is_drawn_pale(tmp_path):
    """What is read in one is noise; scaled to itself it looked like a press."""
    noise = np.where(np.arange(32) % 2, 1.0, -1.0) * np.ones((3, 24, 1)) * np.reshape(FULL_COLOUR_N, (3, 1, 1))
    found = {}
    for name, forces in (("released", 0.1 * noise), ("pressed", noise)):
        write_maps(tmp_path / f"{name}.png", GREY, forces, "")
        found[name] = strong(tmp_path / f"{name}.png")
    assert found["released"] < 0.2 * found["pressed"]  # its colour bars are left
