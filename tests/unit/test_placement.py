"""A picture laid onto the untouched one: laws on the rig's pictures, with contact and without."""

import csv

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from gelforge.commands.predict import LEAST_SITTING, place_sitting
from gelforge.networks.canonical import match_light
from gelforge.networks.dots import PrintedDots
from gelforge.networks.placement import LEAST_SHIFT, LEAST_TURN, LEAST_ZOOM, common_motion, place, place_alone
from gelforge.networks.use import UNPLACED, Untouched, load_for_use, predict_one
from gelforge.records.image import read_image
from tests.pictures import moved

SENSORS = ("mini_a", "mini_e")
INSIDE = 12.0  # px from the edge, a dot and its neighbourhood, where it can still be followed


@pytest.fixture(scope="module")
def shipped():
    return load_for_use(None)


@pytest.fixture(scope="module")
def presses(root):
    """Untouched pictures by sensor, and (sensor, picture under the light of the untouched one) of every press."""
    folder = root / "data/demo"
    rest = {name: read_image(folder / f"nocontact/{name}.png")[..., :3] for name in SENSORS}
    with (folder / "log.csv").open() as file:
        rows = [(row["sensor_id"], read_image(folder / row["image"])[..., :3]) for row in csv.DictReader(file)]
    return rest, [(name, match_light(image, rest[name]).undo(image)) for name, image in rows]


def put(dots, *images):
    """Placement of pictures of one sitting."""
    return place(dots, [dots.follow(image) for image in images])


def put_alone(dots, image):
    """Placement of a picture by itself."""
    return place_alone(dots, dots.follow(image))


@given(st.sampled_from(SENSORS), st.floats(-10, 10), st.floats(-10, 10), st.floats(-3, 3), st.floats(0.94, 1.06))
@settings(max_examples=30)
def test_what_was_moved_is_found(presses, name, u, v, turn, zoom):
    """On an untouched gel, wherever the dots stay in the picture, each part beyond what contact makes is found."""
    rest = presses[0][name]
    resting, middle = PrintedDots(rest), np.array(rest.shape[1::-1]) / 2
    rotation = np.exp(1j * np.radians(turn)) * zoom
    points = (resting.points[resting.rim] - middle) @ np.array([1.0, 1j]) * rotation + complex(u, v)
    assume((np.abs(np.column_stack([points.real, points.imag])) < middle - INSIDE).all())
    placed = put(resting, moved(rest, (u, v), turn, zoom))
    assert placed.known
    if np.hypot(u, v) > 1.2 * LEAST_SHIFT:
        assert np.hypot(*(placed.shift - (u, v))) < 0.2
    if abs(turn) > 1.2 * LEAST_TURN:
        assert placed.turn == pytest.approx(turn, abs=0.05)
    if abs(zoom - 1) > 1.2 * LEAST_ZOOM:
        assert placed.zoom == pytest.approx(zoom, abs=0.002)


def test_contact_alone_moves_no_picture(presses):
    """No press of a gel that sat still is taken for a gel that moved, so its forces stay what they were."""
    rest, pictures = presses
    dots = {name: PrintedDots(picture) for name, picture in rest.items()}
    for name, picture in pictures:
        assert put(dots[name], picture).undo(picture) is picture


def test_a_single_picture_is_moved_where_it_is_beyond_doubt(presses):
    """Of presses shifted by 5 px some are found by themselves, and those are found well; none that sat still is moved."""
    rest, pictures = presses
    dots = {name: PrintedDots(picture) for name, picture in rest.items()}
    found = [put_alone(dots[name], moved(picture, (4.0, -3.0))) for name, picture in pictures]
    told = [placed for placed in found if placed.told]
    assert 0.3 * len(found) < len(told)
    assert max(np.hypot(*(placed.shift - (4.0, -3.0))) for placed in told) < 0.25 * np.hypot(4.0, 3.0)
    assert not any(put_alone(dots[name], picture).told for name, picture in pictures)


def test_a_shift_is_found_beside_contact(presses):
    """Where the rim tells it, as for most presses, a shift is found as well as contact at the rim lets it."""
    rest, pictures = presses
    dots = {name: PrintedDots(picture) for name, picture in rest.items()}
    found = [put(dots[name], moved(picture, (4.0, -3.0))) for name, picture in pictures]
    told = [placed for placed in found if placed.known]
    assert len(told) > 0.7 * len(found)
    left = [np.hypot(*(placed.shift - (4.0, -3.0))) for placed in told]
    assert max(left) < 0.25 * np.hypot(4.0, 3.0) and np.median(left) < 0.3 * LEAST_SHIFT


def test_another_gels_print_is_laid_over_it(presses):
    """Dots that stand beside those of the untouched picture by a pixel each, and all of them 8 px aside, still tell it."""
    rest, _ = presses
    dots, rng = PrintedDots(rest["mini_a"]), np.random.default_rng(6)
    rim = dots.rim
    end = dots.points[rim] + [7.0, -4.0] + rng.uniform(-1.2, 1.2, (int(rim.sum()), 2))
    placed = common_motion(dots.points[rim], end, np.ones(len(end), bool), dots.sides[rim], np.array([160.0, 120.0]))
    assert placed.known and np.hypot(*(placed.shift - (7.0, -4.0))) < 0.5
    small = end - [6.0, -3.5]  # as far as contact may drag them: then so uneven a motion is none
    assert not common_motion(
        dots.points[rim], small, np.ones(len(end), bool), dots.sides[rim], np.array([160.0, 120.0])
    ).told


def test_a_sitting_tells_more_than_a_press(presses):
    """Over all presses of a sensor the shift is found to half of what the worst single one tells."""
    rest, pictures = presses
    for name, untouched in rest.items():
        dots = PrintedDots(untouched)
        seen = [moved(picture, (4.0, -3.0)) for sensor, picture in pictures if sensor == name]
        together = put(dots, *seen)
        alone = [np.hypot(*(one.shift - (4.0, -3.0))) for one in (put(dots, image) for image in seen) if one.known]
        assert together.known
        assert np.hypot(*(together.shift - (4.0, -3.0))) < 0.5 * max(alone)


MOVES = {
    "two px aside": {"shift": (2.0, 0.0)},
    "three percent nearer": {"zoom": 1.03},
    "a degree turned": {"turn": 1.0},
    "all of it": {"shift": (5.0, -4.0), "turn": -1.0, "zoom": 0.97},
}


@pytest.mark.parametrize("move", MOVES)
def test_a_gel_that_sits_otherwise_is_no_force(shipped, presses, move):
    """Below 0.3 N where the bare difference reads 8 to 35 N, whether its sitting is known or not."""
    for picture in presses[0].values():
        untouched, seen = Untouched(shipped, picture), moved(picture, **MOVES[move])
        for placement in (place_sitting(untouched, [seen] * LEAST_SITTING), None):
            _, forces, verdict = predict_one(untouched, seen, placement)
            assert np.abs(forces.sum((1, 2))).max() < 0.3
        assert "told by" in verdict["placed"]


@pytest.mark.parametrize(
    ("move", "most", "share"),
    # contact spreads the rim's dots, too: what it does to a zoom stays
    [("two px aside", 0.3, 0.7), ("three percent nearer", np.inf, 0.3), ("a degree turned", 0.3, 0.7)],
)
def test_presses_of_a_gel_that_sits_otherwise_read_nearer_to_what_they_are(shipped, presses, move, most, share):
    """In the median of presses placed one by one, what the move adds is below `most` N, and below this share of it bare."""
    rest, pictures = presses
    left, bare = [], []
    for name, picture in pictures[::4]:
        untouched, seen = Untouched(shipped, rest[name]), moved(picture, **MOVES[move])
        own = predict_one(untouched, picture)[1].sum((1, 2))
        left.append(
            np.abs(
                predict_one(untouched, seen, place_sitting(untouched, [seen] * LEAST_SITTING))[1].sum((1, 2)) - own
            ).max()
        )
        bare.append(np.abs(predict_one(untouched, seen, UNPLACED)[1].sum((1, 2)) - own).max())
    print(f"{move}: {np.median(left):.2f} N left of {np.median(bare):.2f} N")
    assert np.median(left) < most and np.median(left) < share * np.median(bare)


def test_dots_that_disagree_tell_nothing():
    rng = np.random.default_rng(4)
    start = rng.uniform(0, 300, (28, 2))
    sides = np.tile(np.eye(4, dtype=bool), (7, 1))
    end = start + rng.uniform(-15, 15, start.shape)
    assert not common_motion(start, end, np.ones(28, bool), sides, np.array([160.0, 120.0])).known


def test_one_side_that_moved_otherwise_tells_nothing():
    start = np.stack(np.meshgrid(np.linspace(20, 300, 7), np.linspace(20, 220, 4)), axis=-1).reshape(-1, 2)
    sides = np.column_stack([start == start.min(axis=0), start == start.max(axis=0)])
    end = start + [3.0, 0.0] + 4.0 * sides[:, [1]] * [0.0, 1.0]
    middle, all_seen = np.array([160.0, 120.0]), np.ones(28, bool)
    assert not common_motion(start, end, all_seen, sides, middle).known
    assert common_motion(start, start + [3.0, 0.0], all_seen, sides, middle).known


@pytest.mark.parametrize("few", [0, 1, 3])
def test_a_picture_with_too_few_dots_is_left_as_it_is(few):
    picture = np.full((240, 320, 3), 120, np.uint8)
    for k in range(few):
        cv2.circle(picture, (60 + 80 * k, 120), 5, (30, 30, 30), -1)
    placed = put(PrintedDots(picture), picture)
    assert not placed.known and placed.undo(picture) is picture


def narrow(picture):
    """What a camera sees that shows five sevenths of both sides, at the picture's own size."""
    height, width = picture.shape[:2]
    top, left = height // 7, width // 7
    return cv2.resize(
        picture[top : height - top, left : width - left], (width, height), interpolation=cv2.INTER_CUBIC
    )


def test_a_view_without_the_rim_is_not_laid_onto_it(shipped, presses):
    """The outermost dots that it shows are dragged with the gel: what moved them all alike is sideways force."""
    rest = narrow(presses[0]["mini_a"])
    untouched = Untouched(shipped, rest)
    assert untouched.view.zoom < 0.9
    dragged = moved(rest, (4.0, 0.0))
    assert place_sitting(untouched, [dragged] * LEAST_SITTING) is None


@pytest.mark.parametrize("count", [0, 1, LEAST_SITTING - 1])
def test_fewer_pictures_are_no_sitting(shipped, presses, count):
    rest = presses[0]["mini_a"]
    assert place_sitting(Untouched(shipped, rest), [moved(rest, (4.0, 0.0))] * count) is None
