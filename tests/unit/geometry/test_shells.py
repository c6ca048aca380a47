"""Bodies of several shells: the surface that is seen from outside decides, or a sentence names the shell."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from gelforge.errors import BadInput
from gelforge.geometry.sampled import Sampled, check_body
from gelforge.geometry.shells import outer_surface
from gelforge.geometry.triangles import Mesh, cleaned, is_watertight, joined, volume
from tests.support.blocks import FACES, box


def outer(*shells: Mesh) -> Mesh:
    """What is left of shells that one file holds."""
    return outer_surface(*cleaned(*joined(list(shells))), "body.stl")


BODY = box([0, 0, 0], 4.0)
BESIDE = {
    "inside": ([1, 1, 1], 2.0, 64.0),
    "apart": ([6, 0, 0], 2.0, 72.0),
    "at a whole face": ([4, 0, 0], 4.0, 128.0),
    "at a part of a face": ([4, 1, 1], 2.0, 72.0),
    "at an edge": ([4, 4, 0], 4.0, 128.0),
    "at a part of an edge": ([4, 4, 1], 2.0, 72.0),
    "at a corner": ([4, 4, 4], 4.0, 128.0),
    "at a face from inside": ([2, 1, 1], 2.0, 64.0),
    "at a corner from inside": ([0, 0, 0], 2.0, 64.0),
    "overlapping": ([2, 2, 2], 4.0, 120.0),
    "the same again": ([0, 0, 0], 4.0, 64.0),
}


def test_a_second_shell_of_any_sense_leaves_the_outer_surface():
    for (where, (low, size, expected)), inverted, diagonals in product(BESIDE.items(), (False, True), (False, True)):
        surface = outer(BODY, box(low, size, inverted, diagonals))
        assert is_watertight(surface[1]) and volume(*surface) == pytest.approx(expected, abs=1e-9), where
        if where == "inside":
            np.testing.assert_array_equal(surface[0], cleaned(*BODY)[0])


corner, side = st.tuples(*[st.integers(0, 5)] * 3), st.tuples(*[st.integers(1, 4)] * 3)


@settings(max_examples=25)
@given(
    st.lists(st.tuples(corner, side, st.booleans(), st.booleans()), min_size=1, max_size=5), st.integers(0, 2**32 - 1)
)
def test_random_shells_inside_outside_inverted_and_touching(cells, seed):
    """On whole millimetres shells touch, overlap and lie in each other all the time; what is solid can be counted."""
    vertices, faces = cleaned(*joined([box(*cell) for cell in cells]))
    turned = np.random.default_rng(seed).random(len(faces)) < 0.5
    try:
        surface = outer_surface(vertices, np.where(turned[:, None], faces[:, ::-1], faces), "body.stl")
    except BadInput as error:
        assert str(error).startswith("body.stl")
        return
    solid = np.zeros((11, 11, 11), bool)
    for low, size, _, _ in cells:
        solid[tuple(slice(a + 1, a + 1 + b) for a, b in zip(low, size, strict=True))] = True
    air, _ = ndimage.label(~solid)
    filled = np.count_nonzero(air != air[0, 0, 0])
    assert is_watertight(surface[1]) and volume(*surface) == pytest.approx(filled, abs=1e-6)


def test_a_cavity_between_parts_that_overlap_is_filled():
    plates = [
        box([-0.1, -0.1, 0.0], [4.2, 4.2, 0.5]), box([-0.1, -0.1, 3.5], [4.2, 4.2, 0.5]),
        box([0.0, 0.0, 0.2], [0.5, 4.0, 3.6]), box([3.5, 0.0, 0.2], [0.5, 4.0, 3.6]),
        box([0.1, 0.0, 0.2], [3.8, 0.5, 3.6]), box([0.1, 3.5, 0.2], [3.8, 0.5, 3.6]),
    ]  # fmt: skip
    assert volume(*outer(*plates)) == pytest.approx(4.2 * 4.2 + 4.0 * 4.0 * 3.0)


def test_a_body_that_is_written_several_times_counts_once():
    assert volume(*outer(BODY, BODY, box([0, 0, 0], 4.0, inverted=True))) == pytest.approx(64.0)
    assert volume(*outer(BODY, BODY, box([4, 0, 0], 4.0))) == pytest.approx(128.0)


SHEET = np.array([[0, 1, 2], [0, 2, 1]])
MOEBIUS = np.array([[i, (i + 1) % 5, (i + 2) % 5] for i in range(5)])


def test_a_shell_that_bounds_nothing_is_named():
    pulled = box([6, 0, 0], 2.0)
    pulled[0][0] += [3.0, 1.0, 1.0]
    for shell, says in (
        ((box([6, 0, 0], 2.0)[0], FACES[:-1]), r"\(11 triangles, x 6 to 8, .*not closed: 3 edges"),
        ((np.array([[6, 0, 0], [7, 0, 0], [6, 1, 0.0]]), SHEET), r"\(2 triangles.*it is a sheet"),
        ((np.array([[4, 0, 0], [4, 0, 4], [9, 0, 0.0]]), SHEET), r"\(2 triangles.*it is a sheet"),
        ((np.random.default_rng(1).normal(9.0, 1.0, (5, 3)), MOEBIUS), "not closed"),
        (pulled, "triangles cut through each other"),
    ):
        with pytest.raises(BadInput, match=rf"body.stl: shell 2 of 2 .*{says}"):
            outer(BODY, shell)
    inside = np.array([[1, 1, 1], [2, 1, 1], [1, 2, 1.0]]), SHEET
    assert volume(*outer(BODY, inside)) == pytest.approx(64.0)


def test_the_distance_to_a_hollow_body_is_that_to_a_full_one():
    """Deep inside, too, where solvers look for the way out."""
    shells = [box([-2, -2, 0], 4.0), box([-1.5, -1.5, 0.3], 3.0, inverted=True), box([-1, -1, 1], 1.0)]
    full, hollow = (Sampled("b", *check_body(*cleaned(*joined(s)), "b")) for s in (shells[:1], shells))
    points = np.random.default_rng(0).uniform(-3, 3, (2000, 3))
    for mine, other in zip(hollow.distance(points), full.distance(points), strict=True):
        np.testing.assert_array_equal(mine, other)


def flat_on(corner: int, other: int) -> Mesh:
    """A triangle of no area along an edge of the body, its third corner in the middle of that edge."""
    ends = BODY[0][[corner, other]]
    return np.vstack([ends[0], ends.mean(axis=0), ends[1]]), np.array([[0, 1, 2]])


def test_triangles_that_a_file_holds_twice_or_that_have_no_area_change_nothing():
    for twice in ([0], [0, 1], [0, 6], [3], [2, 3, 4, 5]):
        for again in (BODY[1][twice], BODY[1][twice][:, ::-1]):
            assert volume(*outer(BODY, (BODY[0], again))) == pytest.approx(64.0)
            assert volume(*outer(BODY, (BODY[0], again), flat_on(0, 1))) == pytest.approx(64.0)
    vertices, faces = outer(BODY, flat_on(0, 1), flat_on(5, 7))
    assert volume(vertices, faces) == pytest.approx(64.0) and is_watertight(faces)


def test_what_is_twice_hides_no_hole():
    """Nor are triangles taken away where others leave edges open, too: the message is about the file as it is."""
    for gone in ([0], [0, 1], [11]):
        with pytest.raises(BadInput, match="not closed"):
            outer((BODY[0], np.delete(BODY[1], gone, axis=0)), (BODY[0], BODY[1][5:6]))
