"""A picture laid onto the untouched one: laws on the rig's pictures, with contact and without."""

import csv
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from gelforge.networks.canonical import match_light
from gelforge.networks.dotaugment import mirrored
from gelforge.networks.dots import COLS, ROWS, PrintedDots
from gelforge.networks.lattice import PITCH, lattice_points, moved_alike, straightened, without_still
from gelforge.networks.placement import LEAST_MOVE, UNPLACED, about_middle, as_they_lie, believed, place
from gelforge.networks.placereader import PlaceReader, Places, train_place_reader
from gelforge.networks.sitting import LEAST_SITTING, LOOKED_AT, MOST_KEPT, Stream, Thinned, place_sitting
from gelforge.networks.use import GIVEN, Untouched, load_for_use, predict_one
from gelforge.records.image import read_image
from tests.pictures import distance_of, moved

SENSORS = ("mini_a", "mini_e")
INSIDE = 12.0  # px from the edge, a dot and its neighbourhood, where it can still be followed


@pytest.fixture(scope="module")
def shipped():
    return load_for_use(None)


@pytest.fixture(scope="module")
def reader(shipped):
    """The reader of places that ships; it saw no press, unit or untouched picture of these tests."""
    return shipped.places


@pytest.fixture(scope="module")
def presses(root):
    """Untouched pictures by sensor, and (sensor, picture under the light of the untouched one) of every press."""
    folder = root / "data/demo"
    rest = {name: read_image(folder / f"nocontact/{name}.png")[..., :3] for name in SENSORS}
    with (folder / "log.csv").open() as file:
        rows = [(row["sensor_id"], read_image(folder / row["image"])[..., :3]) for row in csv.DictReader(file)]
    return rest, [(name, match_light(image, rest[name]).undo(image)) for name, image in rows]


@pytest.fixture(scope="module")
def dots_of_a(presses):
    return PrintedDots(presses[0]["mini_a"])


def put(reader, dots, *images):
    """Placement of pictures of one sitting."""
    return place(reader, dots, [dots.follow(image) for image in images])


def motion_of(presses):
    """Motion of the dots (n, 3, ROWS, COLS) in every press."""
    rest, pictures = presses
    dots = {name: PrintedDots(picture) for name, picture in rest.items()}
    return np.stack([dots[name].on_lattice(dots[name].follow(picture)) for name, picture in pictures])


def off(placed, dots, **way):
    """How far the dots are from where a move of `tests.pictures.moved` takes them, px."""
    return distance_of(placed, dots.points, **way)


@given(st.sampled_from(SENSORS), st.floats(-10, 10), st.floats(-10, 10), st.floats(-3, 3), st.floats(0.94, 1.06))
@settings(max_examples=30, deadline=None)
def test_what_was_moved_is_found(reader, presses, name, u, v, turn, zoom):
    """On an untouched gel, wherever the dots stay in the picture."""
    rest = presses[0][name]
    resting, middle = PrintedDots(rest), np.array(rest.shape[1::-1]) / 2
    rotation = np.exp(1j * np.radians(turn)) * zoom
    points = (resting.points[resting.rim] - middle) @ np.array([1.0, 1j]) * rotation + complex(u, v)
    assume((np.abs(np.column_stack([points.real, points.imag])) < middle - INSIDE).all())
    assert (
        off(put(reader, resting, moved(rest, (u, v), turn, zoom)), resting, shift=(u, v), turn=turn, zoom=zoom)
        < LEAST_MOVE
    )


def test_contact_alone_moves_no_picture(reader, presses):
    """No press of a gel that sat still is taken for a gel that moved, so its forces stay what they were."""
    rest, pictures = presses
    dots = {name: PrintedDots(picture) for name, picture in rest.items()}
    for name, picture in pictures:
        assert put(reader, dots[name], picture).undo(picture) is picture


WAYS = {
    "five px aside": {"shift": (4.0, -3.0)},
    "three percent nearer": {"zoom": 1.03},
    "two degrees turned": {"turn": 2.0},
    "all of it": {"shift": (5.0, -4.0), "turn": -1.0, "zoom": 0.97},
}


@pytest.mark.parametrize("way", WAYS)
def test_how_a_gel_sits_is_found_beside_contact(reader, presses, way):
    """By a single picture to a fraction of a pixel, of all presses of a sensor together to half of what most tell."""
    rest, pictures = presses
    for name, untouched in rest.items():
        dots = PrintedDots(untouched)
        seen = [moved(picture, **WAYS[way]) for sensor, picture in pictures if sensor == name]
        alone = [off(put(reader, dots, image), dots, **WAYS[way]) for image in seen]
        together = off(put(reader, dots, *seen), dots, **WAYS[way])
        print(f"{way}, {name}: {np.median(alone):.2f}, {np.percentile(alone, 90):.2f}, together {together:.2f} px")
        assert np.median(alone) < 0.25 and np.percentile(alone, 90) < 0.5
        assert together < 0.25


@pytest.mark.parametrize("way", WAYS)
def test_a_sitting_is_found_nearer_once_its_pictures_lie_about_so(shipped, presses, way):
    """Dots are followed where their contrast is, which in a picture that was zoomed is not where they stand."""
    rest, pictures = presses
    for name, untouched in rest.items():
        reader = Untouched(shipped, untouched)
        seen = [moved(picture, **WAYS[way]) for sensor, picture in pictures if sensor == name]
        assert off(place_sitting(reader, seen), reader.dots(GIVEN), **WAYS[way]) < 0.05


@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(-0.1, 0.1), st.floats(0.9, 1.1))
def test_what_a_picture_tells_that_was_laid_is_told_of_it_as_it_lay(dots_of_a, right, down, turn, zoom):
    """A dot is where the placement takes the place to which the laid picture's move takes it."""
    standing = dots_of_a.standing
    points = standing.points
    laid = about_middle(dots_of_a, zoom * np.exp(1j * turn), complex(right, down))
    left = Places(np.array([1.002 + 0.01j]), np.array([0.1 - 0.2j]), np.array([2.0]))
    told = as_they_lie(laid, left)
    rest, middle = left.a[0] * points + left.b[0], complex(*standing.middle)
    there = np.column_stack([(rest + middle).real, (rest + middle).imag]) @ laid.matrix[:, :2].T + laid.matrix[:, 2]
    np.testing.assert_allclose(told.a[0] * points + told.b[0] + middle, there @ [1.0, 1j], atol=1e-9)
    assert told.contact == left.contact


@pytest.mark.parametrize("count", [0, 1, MOST_KEPT, MOST_KEPT + 1, 1000])
def test_of_many_pictures_a_few_are_kept_that_are_spread_over_all(count):
    thinned = Thinned()
    for number in range(count):
        thinned.add(np.array(number))
    kept = np.array(thinned.kept)
    assert min(count, MOST_KEPT // 2) <= len(kept) <= MOST_KEPT
    if count:
        apart = np.diff([*kept, count])
        assert kept[0] == 0 and (apart <= apart[0]).all() and (apart[:-1] == apart[0]).all()


def test_a_picture_in_which_the_gel_sits_otherwise_does_not_move_a_sitting(reader, presses):
    """As the first one, taken before the gel was pushed home; a mean would go three pixels towards it."""
    rest, pictures = presses
    name = pictures[0][0]
    dots, seen = (
        PrintedDots(rest[name]),
        [moved(picture, (4.0, -3.0)) for sensor, picture in pictures if sensor == name],
    )
    stray = moved(rest[name], (-8.0, 8.0))
    assert off(put(reader, dots, stray, *seen[:4]), dots, shift=(4.0, -3.0)) < 0.5


def test_of_a_gel_that_is_pressed_hard_a_small_move_is_not_believed(reader, presses):
    """The reader's errors grow with what contact does to all dots alike; of a gel at rest the same move is put right."""
    rest, pictures = presses
    name, hardest = pictures[int(reader.places(motion_of(presses)).contact.argmax())]
    dots = PrintedDots(rest[name])
    assert put(reader, dots, moved(rest[name], (0.8, 0.0))).moves
    assert put(reader, dots, moved(hardest, (0.8, 0.0))) is UNPLACED


def test_lost_dots_hardly_matter(reader, presses):
    """A fifth of the dots gone: places are still found to a fraction of a pixel."""
    rest, pictures = presses
    rng, left = np.random.default_rng(3), []
    for name, picture in pictures[::3]:
        dots = PrintedDots(rest[name])
        followed = dots.follow(moved(picture, (4.0, -3.0)))
        motion = followed.motion.copy()
        motion[rng.random(len(motion)) < 0.2] = np.nan
        left.append(off(place(reader, dots, [replace(followed, motion=motion)]), dots, shift=(4.0, -3.0)))
    assert np.median(left) < 0.4


def test_dots_that_stand_still_under_writing_hardly_matter(reader, presses):
    """A name over the corner of a film covers two dots: what is found there does not move with the gel."""
    rest, pictures = presses
    left = []
    for name, picture in pictures[::3]:
        dots = PrintedDots(rest[name])
        followed = dots.follow(moved(picture, (-2.0, 1.0)))
        corner = np.hypot(*(dots.points - dots.points.min(axis=0)).T).argsort()[:2]
        motion = followed.motion.copy()
        motion[corner] = 0.0
        left.append(off(place(reader, dots, [replace(followed, motion=motion)]), dots, shift=(-2.0, 1.0)))
    assert np.median(left) < 0.4


def test_dots_of_a_gel_are_kept_however_it_sits(presses):
    motion = motion_of(presses)
    np.testing.assert_array_equal(without_still(motion), motion)
    sat = moved_alike(*(torch.full((len(motion),), value) for value in (3.0, -2.0, 0.02, 0.03))).numpy()
    otherwise = np.concatenate([motion[:, :2] + sat * motion[:, 2:], motion[:, 2:]], axis=1).astype(np.float32)
    np.testing.assert_array_equal(without_still(otherwise), otherwise)
    covered = otherwise.copy()
    covered[:, :2, 3, 4] = 0.0
    kept = without_still(covered)
    moves = np.hypot(otherwise[:, 0, 3, 4], otherwise[:, 1, 3, 4]) > 3.0
    assert (kept[:, 2, 3, 4] == 0)[moves].mean() > 0.9
    kept[:, :, 3, 4] = covered[:, :, 3, 4]
    np.testing.assert_array_equal(kept, covered)


def test_a_dot_without_neighbours_is_not_judged():
    motion = np.zeros((1, 3, ROWS, COLS), np.float32)
    motion[0, 2, ::4, ::4] = 1.0
    motion[0, 0, ::4, ::4] = 3.0
    motion[0, 0, 4, 4] = 0.0
    np.testing.assert_array_equal(without_still(motion), motion)


@pytest.mark.parametrize("print_turn", [-8.0, 0.0, 8.0])
@pytest.mark.parametrize("print_zoom", [0.95, 1.05])
def test_a_print_of_any_pitch_and_turn_is_laid_as_well(reader, presses, print_turn, print_zoom):
    untouched = moved(presses[0]["mini_a"], turn=print_turn, zoom=print_zoom)
    dots = PrintedDots(untouched)
    for way in ({"zoom": 1.04}, {"turn": 2.5}, {"shift": (5.0, -4.0)}):
        assert off(put(reader, dots, moved(untouched, **way)), dots, **way) < 0.5


def test_pictures_that_show_too_few_dots_have_no_say(shipped, reader, presses):
    """Black frames in a sitting change nothing, and a picture of which most dots are lost is left as it is."""
    rest = presses[0]["mini_a"]
    dots, seen, black = PrintedDots(rest), moved(rest, (5.0, -4.0)), np.zeros_like(rest)
    wanted = put(reader, dots, *[seen] * 4)
    assert np.array_equal(put(reader, dots, *[seen] * 4, *[black] * 9).matrix, wanted.matrix)
    assert put(reader, dots, black) is UNPLACED
    assert place_sitting(Untouched(shipped, rest), [seen] * (LEAST_SITTING - 1) + [black] * 9) is None
    followed = dots.follow(seen)
    few = followed.motion.copy()
    few[np.random.default_rng(0).random(len(few)) < 0.7] = np.nan
    assert place(reader, dots, [replace(followed, motion=few)]) is UNPLACED


@pytest.mark.parametrize("way", [{"shift": (14.0, 0.0)}, {"turn": -5.0}, {"zoom": 1.1}, {"zoom": 0.9}])
def test_a_gel_that_sits_too_far_away_is_told(shipped, presses, way):
    rest = presses[0]["mini_a"]
    assert "the gel sits too far" in predict_one(Untouched(shipped, rest), moved(rest, **way))[2].reason


def test_a_move_of_the_lattice_is_a_similarity():
    parts = torch.tensor([[1.5, -2.0, 0.02, -0.03]])
    v, u = np.meshgrid(*(PITCH * (np.arange(n) - n // 2) for n in (ROWS, COLS)), indexing="ij")
    z = u + 1j * v
    wanted = (1 - 0.03 + 0.02j) * z + (1.5 - 2.0j) - z
    np.testing.assert_allclose(moved_alike(*parts.T)[0], np.stack([wanted.real, wanted.imag]), atol=1e-5)


@given(st.integers(0, 2**32 - 1), st.floats(-30, 30), st.floats(-30, 30), st.floats(-0.3, 0.3), st.floats(-0.2, 0.2))
@settings(max_examples=30, deadline=None)
def test_what_the_reader_tells_moves_as_the_gel_does(seed, right, down, turn, zoom):
    """Whatever its weights, and whichever dots are lost."""
    draw = torch.Generator().manual_seed(seed)
    motion = torch.randn(4, 3, ROWS, COLS, generator=draw)
    motion[:, 2] = (torch.rand(4, ROWS, COLS, generator=draw) < 0.7).float()
    motion[:, :2] *= motion[:, 2:]
    z, spun = torch.complex(*lattice_points()), complex(1 + zoom, turn)
    there = spun * (z + torch.complex(motion[:, 0], motion[:, 1])) + complex(right, down) - z
    aside = torch.stack([there.real * motion[:, 2], there.imag * motion[:, 2], motion[:, 2]], dim=1)
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        reader = PlaceReader().eval()
    told, after = reader.places(motion.numpy()), reader.places(aside.numpy())
    np.testing.assert_allclose(after.a, spun * told.a, atol=1e-5)
    np.testing.assert_allclose(after.b, spun * told.b + complex(right, down), atol=1e-3)
    np.testing.assert_allclose(after.contact, told.contact, atol=1e-3)


def test_dots_that_all_move_alike_leave_nothing_behind():
    parts = torch.tensor([[1.5, -2.0, 0.02, -0.03], [0.0, 0.0, 0.0, 0.0]])
    found = torch.ones(2, 1, ROWS, COLS)
    found[0, 0, :3] = 0  # worn dots move nothing
    left, a, b = straightened(torch.cat([moved_alike(*parts.T) * found, found], dim=1).numpy())
    np.testing.assert_allclose(left[:, :2], 0, atol=1e-4)
    np.testing.assert_allclose(a, [0.97 + 0.02j, 1], atol=1e-6)
    np.testing.assert_allclose(b, [1.5 - 2.0j, 0], atol=1e-4)
    lost, a, b = straightened(np.zeros((1, 3, ROWS, COLS), np.float32))  # no dot tells anything
    assert not lost.any() and a == 1 and b == 0


def test_a_mirrored_motion_is_mirrored_back_by_its_signs():
    motion = torch.randn(200, 3, ROWS, COLS, generator=torch.Generator().manual_seed(0))
    seen, signs = mirrored(motion, torch.Generator().manual_seed(1))
    assert {tuple(sign) for sign in signs.tolist()} == {(a, b) for a in (-1.0, 1.0) for b in (-1.0, 1.0)}
    for before, after, (right, down) in zip(motion, seen, signs.tolist(), strict=True):
        back = after.flip(2) if right < 0 else after
        back = back.flip(1) if down < 0 else back
        torch.testing.assert_close(back * torch.tensor([right, down, 1.0]).view(3, 1, 1), before)


def test_a_reader_of_places_learns_what_contact_does(presses):
    """From two of three presses: on the others it leaves less than a third of a move of 5 px, from whatever weights."""
    motion = motion_of(presses)
    known = np.arange(len(motion)) % 3 != 0
    reader = train_place_reader(np.tile(motion[known], (16, 1, 1, 1)), 24, seed=5)
    aside = motion[~known] + motion[~known, 2:] * np.array([4.0, -3.0, 0.0], np.float32).reshape(3, 1, 1)
    told = reader.places(aside)
    assert np.median(np.abs(told.b - (4 - 3j))) < 5.0 / 3 and np.median(np.abs(told.a - 1)) < 0.02


def test_the_same_seed_gives_the_same_reader_of_places(presses):
    motion = motion_of(presses)
    one, same, other = (train_place_reader(motion, 2, seed).outer.weight for seed in (5, 5, 6))
    assert torch.equal(one, same) and not torch.equal(one, other)


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
            _, forces, judged = predict_one(untouched, seen, placement)
            assert np.abs(forces.sum((1, 2))).max() < 0.3
        assert "as its dots tell" in judged.placed


def test_the_picture_that_is_shown_lies_below_its_forces(shipped, presses):
    """Forces lie as the untouched picture does; so does what is drawn below them."""
    rest, pictures = presses
    name, picture = pictures[0]
    shown, _, judged = predict_one(Untouched(shipped, rest[name]), moved(picture, shift=(7.0, 4.0)))
    inner = np.s_[15:-15, 15:-15]
    apart = [
        np.abs(one[inner].astype(float) - picture[inner]).mean() for one in (shown, moved(picture, shift=(7.0, 4.0)))
    ]
    assert judged.placed and apart[0] < 0.3 * apart[1]


@pytest.mark.parametrize("move", MOVES)
def test_presses_of_a_gel_that_sits_otherwise_read_nearer_to_what_they_are(shipped, presses, move):
    """What a move adds to a press falls to a third of it and less in the median, in a sitting and one by one."""
    rest, pictures = presses
    left, alone, bare = [], [], []
    for name, picture in pictures[::4]:
        untouched, seen = Untouched(shipped, rest[name]), moved(picture, **MOVES[move])
        own = predict_one(untouched, picture)[1].sum((1, 2))

        def added(placement, untouched=untouched, seen=seen, own=own):
            return np.abs(predict_one(untouched, seen, placement)[1].sum((1, 2)) - own).max()

        left.append(added(place_sitting(untouched, [seen] * LEAST_SITTING)))
        alone.append(added(None))
        bare.append(added(UNPLACED))
    told = [np.median(values) for values in (left, alone, bare)]
    print(f"{move}: {told[0]:.2f} N left in a sitting, {told[1]:.2f} N alone, of {told[2]:.2f} N")
    assert told[0] < 0.33 * told[2] and told[1] < 0.33 * told[2]


def test_a_stream_knows_how_a_gel_sits_when_a_press_begins(shipped, presses):
    """By itself a picture in which contact does much more than a small move does not tell it, nor does it undo what is known."""
    rest, pictures = presses
    left, alone = [], []
    for name, picture in pictures[::6]:
        untouched, way = Untouched(shipped, rest[name]), {"shift": (0.9, -0.6)}
        own = predict_one(untouched, picture)[1].sum((1, 2))
        stream, seen = Stream(untouched), moved(picture, **way)
        for _ in range(LEAST_SITTING):
            stream.read(moved(rest[name], **way))
        for _ in range(2 * LOOKED_AT):
            told = stream.read(seen)
        for found, one in ((left, told), (alone, predict_one(untouched, seen))):
            found.append(np.abs(one[1].sum((1, 2)) - own).max())
    print(f"{np.median(left):.2f} N left in a stream, {np.median(alone):.2f} N alone")
    assert np.median(left) < 0.5 * np.median(alone)


def test_the_first_picture_of_a_stream_is_laid_as_it_is_by_itself(shipped, presses):
    rest, pictures = presses
    for name, picture in pictures[:3]:
        untouched, seen = Untouched(shipped, rest[name]), moved(picture, zoom=1.03)
        np.testing.assert_allclose(
            Stream(untouched).read(seen)[1].sum((1, 2)), predict_one(untouched, seen)[1].sum((1, 2)), atol=0.01
        )


def test_a_stream_of_a_gel_that_sat_still_is_read_as_its_pictures_are(shipped, presses):
    rest, pictures = presses
    untouched = Untouched(shipped, rest["mini_a"])
    stream, own = Stream(untouched), [picture for name, picture in pictures if name == "mini_a"]
    for picture in own:
        np.testing.assert_array_equal(stream.read(picture)[1], predict_one(untouched, picture)[1])


def test_a_stream_that_cannot_tell_how_the_gel_sits_is_read_as_its_pictures_are(shipped, presses):
    """In a view without the rim, and of a gel without dots."""
    rest, plain = presses[0]["mini_a"], np.full((240, 320, 3), 120, np.uint8)
    for untouched, seen in ((narrow(rest), narrow(moved(rest, (4.0, 0.0)))), (plain, plain)):
        one = Untouched(shipped, untouched)
        stream = Stream(one)
        for _ in range(2):
            np.testing.assert_array_equal(stream.read(seen)[1], predict_one(one, seen)[1])


def test_dark_frames_at_the_beginning_of_a_stream_tell_nothing(shipped, presses):
    rest = presses[0]["mini_a"]
    stream, seen = Stream(Untouched(shipped, rest)), moved(rest, (3.0, -2.0))
    for _ in range(LEAST_SITTING):
        stream.read(np.zeros_like(rest))
    told = [np.abs(stream.read(seen)[1].sum((1, 2))).max() for _ in range(LOOKED_AT)]
    assert told[-1] < 0.3


def test_what_a_long_press_may_hide_is_still_believed(dots_of_a):
    """Where it tells as well that nothing moved as what was known before; and no longer where nothing touches, and tells so."""

    def told(shift, contact):
        return Places(np.array([1.0 + 0j]), np.array([shift]), np.array([contact]))

    known = believed(dots_of_a, told(0.9 - 0.6j, 0.0), 1, UNPLACED)
    assert known.moves and np.allclose(known.shift, (0.9, -0.6))
    assert believed(dots_of_a, told(0.8 - 0.5j, 8.0), 1, known) is known
    assert believed(dots_of_a, told(0.8 - 0.5j, 8.0), 1, UNPLACED) is UNPLACED
    assert believed(dots_of_a, told(0.1 + 0.0j, 0.0), 1, known) is UNPLACED
    assert np.allclose(believed(dots_of_a, told(5.0 + 0.0j, 8.0), 1, known).shift, (5.0, 0.0))


def test_a_gel_that_is_pushed_while_it_is_filmed_is_followed_at_once(shipped, presses):
    """However long it sat as before, and although something presses on it."""
    rest, pictures = presses
    name, picture = max(pictures, key=lambda press: np.abs(press[1].astype(int) - rest[press[0]]).mean())
    untouched, way = Untouched(shipped, rest[name]), {"shift": (3.0, -2.0), "zoom": 1.02}
    stream, own = Stream(untouched), predict_one(untouched, picture)[1].sum((1, 2))
    for _ in range(LOOKED_AT * 2 * LEAST_SITTING):
        assert not stream.read(rest[name])[2].placed
    told = [stream.read(moved(picture, **way))[1].sum((1, 2)) for _ in range(LOOKED_AT + LEAST_SITTING)]
    first, last, alone = (
        np.abs(one - own).max()
        for one in (told[0], told[-1], predict_one(untouched, moved(picture, **way))[1].sum((1, 2)))
    )
    print(f"pushed while pressed: {first:.2f} N added, {last:.2f} N at last, {alone:.2f} N by itself")
    assert last < 0.2 * first and last < alone + 0.1


@pytest.mark.parametrize("contact", [0.0, 5.0, 8.0, 12.0])
@pytest.mark.parametrize("count", [4, 16])
def test_a_picture_that_nothing_touched_does_not_outweigh_many_presses(dots_of_a, contact, count):
    """One of a gel that was not pushed home yet, beside presses that tell all the same."""
    places = Places(
        np.ones(count + 1, complex),
        np.array([*[4.0 - 3.0j] * count, -8.0 + 8.0j]),
        np.array([*[contact] * count, 0.0]),
    )
    assert np.abs(believed(dots_of_a, places, count + 1, UNPLACED).shift - (4.0, -3.0)).max() < 0.5


def test_another_gels_picture_is_told_although_it_is_laid_onto_the_untouched_one(shipped, presses):
    rest, pictures = presses
    other = {"mini_a": "mini_e", "mini_e": "mini_a"}
    flagged = [predict_one(Untouched(shipped, rest[other[name]]), picture)[2].flag for name, picture in pictures]
    own = [predict_one(Untouched(shipped, rest[name]), picture)[2].flag for name, picture in pictures]
    assert np.mean(flagged) >= 0.9 and not any(own)


def test_without_a_reader_or_a_print_a_picture_is_left_as_it_is(reader, presses):
    rest = presses[0]["mini_a"]
    dots, plain = PrintedDots(rest), np.full((240, 320, 3), 120, np.uint8)
    assert place(None, dots, [dots.follow(moved(rest, (4.0, 0.0)))]) is UNPLACED
    assert place(reader, dots, []) is UNPLACED
    for few in (0, 1, 3):
        picture = plain.copy()
        for k in range(few):
            cv2.circle(picture, (60 + 80 * k, 120), 5, (30, 30, 30), -1)
        placed = put(reader, PrintedDots(picture), picture)
        assert placed is UNPLACED and placed.undo(picture) is picture


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
