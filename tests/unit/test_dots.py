"""The reader of dots: what it is given, what it makes of it, and how its totals meet those of the pictures' network."""

import csv
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from parameters import with_values
from synthetic_presses import SETTINGS, write_dataset

from gelforge.errors import BadInput
from gelforge.networks.agreement import blend, dots_fault, fit_blend
from gelforge.networks.canonical import View, match_light
from gelforge.networks.data import open_data
from gelforge.networks.dotreader import KEPT, VIEWS, DotPresses, DotReader, DotsOneByOne, train_dot_reader
from gelforge.networks.dots import COLS, FAR, HOME, ROWS, PrintedDots
from gelforge.networks.fitting import ENOUGH_PAIRS, meet, readers_of_dots, usual_rows
from gelforge.networks.goingon import require_scale, scales_before
from gelforge.networks.halves import rounded
from gelforge.networks.lattice import IMAGES, mirror_images
from gelforge.networks.modelcard import dot_lines, interval_lines, place_lines
from gelforge.networks.modelfile import Trained, load_model, save_model
from gelforge.networks.placereader import PlaceReader, PlacesOneByOne
from gelforge.networks.sensorprofile import Gain, fingerprint
from gelforge.networks.use import Predicted, Untouched, load_for_use, predict_one
from gelforge.records.axes import CHANNELS
from gelforge.records.image import read_image
from gelforge.records.markers import pitch_of
from gelforge.records.totals import TOTAL_COLUMNS, edge_peak, goes_beyond, total_columns
from gelforge.stages.train import train
from tests.pictures import moved


@pytest.fixture(scope="module")
def rest(root):
    return read_image(root / "data/demo/nocontact/mini_a.png")[..., :3]


@pytest.fixture(scope="module")
def presses(root, rest):
    """Pictures of mini_a in its untouched picture's light, and their forces (3,) N along the gel."""
    with (root / "data/demo/log.csv").open() as stream:
        rows = [row for row in csv.DictReader(stream) if row["sensor_id"] == "mini_a"][::4]
    pictures = [read_image(root / "data/demo" / row["image"])[..., :3] for row in rows]
    return [match_light(picture, rest).undo(picture) for picture in pictures]


def motion_of(dots, image):
    return dots.on_lattice(dots.follow(image))


def test_dots_at_rest_have_not_moved(rest):
    dots = PrintedDots(rest)
    motion = motion_of(dots, rest)
    assert dots.known and motion[2].sum() == (dots.at[:, 0] >= 0).sum() >= 60
    assert np.abs(motion[:2]).max() < 1e-3


@given(u=st.floats(-6, 6), v=st.floats(-6, 6))
@settings(max_examples=20)
def test_all_dots_of_a_moved_picture_have_moved_as_it_did(rest, u, v):
    motion = motion_of(PrintedDots(rest), moved(rest, (u, v)))
    seen = motion[2] > 0
    assert seen.sum() >= 45  # a picture that moved does not show them all
    assert np.median(np.hypot(motion[0][seen] - u, motion[1][seen] - v)) < 0.2


def test_a_covered_dot_is_not_seen_and_the_others_stay(rest):
    dots = PrintedDots(rest)
    covered, (u, v) = rest.copy(), dots.points[len(dots.points) // 2].astype(int)
    covered[v - 14 : v + 14, u - 14 : u + 14] = np.random.default_rng(0).integers(0, 255, (28, 28, 3))
    motion = motion_of(dots, covered)
    row, col = dots.at[len(dots.points) // 2]
    assert motion[2, row, col] == 0
    assert (motion[2] > 0).sum() >= len(dots.points) - 3


def test_light_moves_no_dot(rest, presses):
    """A picture at eight tenths of its light, brought back to that of the untouched one, shows the same motion."""
    dots = PrintedDots(rest)
    for picture in presses:
        dark = np.rint(picture * 0.8).astype(np.uint8)
        motion, again = motion_of(dots, picture), motion_of(dots, match_light(dark, rest).undo(dark))
        both = (motion[2] > 0) & (again[2] > 0)
        assert both.sum() > 0.9 * motion[2].sum()
        assert np.abs(motion[:2] - again[:2])[:, both].mean() < 0.05


@pytest.mark.parametrize("picture", [np.zeros((240, 320, 3), np.uint8), np.full((240, 320, 3), 130, np.uint8)])
def test_a_gel_without_print_has_no_dots(picture):
    dots = PrintedDots(picture)
    assert not dots.known and not motion_of(dots, picture).any()


AUGMENT = with_values(SETTINGS.augment, misplaced_share=0.0)


def law(motion: np.ndarray) -> np.ndarray:
    """Totals that dots tell: sideways by their mean motion, along the normal by how far they spread from the middle."""
    col, row = np.meshgrid(np.arange(COLS) - COLS // 2, np.arange(ROWS) - ROWS // 2)
    spread = (motion[:, 0] * col + motion[:, 1] * row).mean(axis=(1, 2))
    return np.column_stack([motion[:, 0].mean((1, 2)), motion[:, 1].mean((1, 2)), -5.0 * spread])


@pytest.fixture(scope="module")
def lawful():
    rng = np.random.default_rng(3)
    col, row = np.meshgrid(np.arange(COLS) - COLS // 2, np.arange(ROWS) - ROWS // 2)
    drag, spread = rng.normal(0, 1, (400, 2, 1, 1)), rng.uniform(0, 0.5, (400, 1, 1))
    motion = np.stack([drag[:, 0] + spread * col, drag[:, 1] + spread * row, np.ones((400, ROWS, COLS))], axis=1)
    motion = motion.astype(np.float32)
    totals = np.repeat(law(motion)[:, None], len(VIEWS), axis=1)
    return DotPresses(motion, np.ones((400, len(VIEWS), ROWS, COLS), bool), totals)


def test_a_reader_learns_what_dots_tell(lawful):
    reader = train_dot_reader(lawful, 25, 0, AUGMENT)
    off = np.abs(reader.totals(lawful.motion) - lawful.totals[:, 0]).mean(axis=0)
    assert (off < 0.15 * np.abs(lawful.totals[:, 0]).mean(axis=0)).all()


def pressed_by_balls(rng, count):
    """Motion of dots that spread around a ball and are dragged with it, none of them at the rim; and totals."""
    col, row = np.meshgrid(np.arange(COLS) - COLS // 2, np.arange(ROWS) - ROWS // 2)
    x, y = rng.uniform(-1.5, 1.5, (2, count, 1, 1))
    depth, right, down = rng.uniform(0.2, 3, (count, 1, 1)), *rng.normal(0, 2, (2, count, 1, 1))
    near = np.exp(-((col - x) ** 2 + (row - y) ** 2) / 3.0)
    motion = np.stack(
        [near * (right + depth * (col - x)), near * (down + depth * (row - y)), np.ones_like(near)], axis=1
    )
    return motion.astype(np.float32), np.column_stack([right.ravel(), down.ravel(), -5.0 * depth.ravel()])


def test_what_the_rim_does_is_no_force_to_a_reader_that_saw_gels_sit_otherwise():
    """A shift of the whole gel looks like drag: sideways force is what it would be read as."""
    motion, totals = pressed_by_balls(np.random.default_rng(11), 600)
    presses = DotPresses(
        motion, np.ones((600, len(VIEWS), ROWS, COLS), bool), np.repeat(totals[:, None], len(VIEWS), 1)
    )
    shifted = motion[:200] + np.array([1.2, -1.6, 0.0], np.float32)[:, None, None]
    sits = with_values(AUGMENT, misplaced_share=0.5, misplaced_px=2.5, misplaced_zoom=0.03)
    changed = []
    for how in (AUGMENT, sits):
        reader = train_dot_reader(presses, 8, 0, how)
        changed.append(np.abs(reader.totals(shifted) - reader.totals(motion[:200])).mean(axis=0)[:2])
    assert (changed[1] < 0.25 * changed[0]).all(), changed


def test_dots_that_are_found_close_at_home_are_found_in_the_pyramid(rest, presses):
    """On presses: what is looked for near where it should be is what the whole way back finds."""
    dots = PrintedDots(rest)
    start = dots.points.astype(np.float32)[:, None]
    for image in [rest, *presses, moved(rest, (4.0, -3.0))]:
        before, after = dots.grey, cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        there, seen, _ = cv2.calcOpticalFlowPyrLK(before, after, start, None, **FAR)
        back, _, _ = cv2.calcOpticalFlowPyrLK(after, before, there, None, **FAR)
        wanted = (seen[:, 0] > 0) & (np.hypot(*(back - start)[:, 0].T) < HOME)
        followed = dots.follow(image)
        np.testing.assert_array_equal(followed.found, wanted)
        np.testing.assert_array_equal(followed.motion[wanted], (there - start)[wanted, 0])


def test_the_same_seed_trains_the_same_reader(lawful):
    one, two, other = (train_dot_reader(lawful, 1, seed, AUGMENT) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.totals(lawful.motion), two.totals(lawful.motion))
    assert np.abs(one.totals(lawful.motion) - other.totals(lawful.motion)).max() > 1e-3


def test_dots_that_did_not_move_tell_no_force():
    """Whatever its weights, and whichever dots are found."""
    motion = np.zeros((20, 3, ROWS, COLS), np.float32)
    motion[:, 2] = np.random.default_rng(0).random((20, ROWS, COLS)) < 0.6
    torch.manual_seed(5)
    assert not DotReader().totals(motion).any()
    one_by_one = DotsOneByOne(DotReader())
    assert not any(one_by_one.total(motion[k]).any() for k in (*range(20), *range(20)))


def motions_of_prints(count: int, prints: int) -> np.ndarray:
    """Random motions (n, 3, ROWS, COLS) px of dots of which one of so many patterns was found."""
    rng = np.random.default_rng(count)
    found = (rng.random((prints, ROWS, COLS)) < 0.7)[rng.integers(prints, size=count)].astype(np.float32)
    aside = rng.normal(0, 4.0, (count, 2, ROWS, COLS)).astype(np.float32)
    return np.concatenate([aside * found[:, None], found[:, None]], axis=1)


@pytest.mark.parametrize("prints", [1, 3, KEPT + 20])
def test_pictures_read_one_by_one_tell_what_they_tell_together(prints):
    """Whatever the weights, and however many patterns of found dots come in turns: of each is kept what is its own."""
    torch.manual_seed(prints)
    reader, places = DotReader().eval(), PlaceReader().eval()
    reader.scale = torch.tensor([3.0, 2.0, 9.0])
    motion = motions_of_prints(2 * KEPT + 60, prints)
    one_by_one = DotsOneByOne(reader)
    np.testing.assert_allclose([one_by_one.total(one) for one in motion], reader.totals(motion), atol=1e-4)
    told = [PlacesOneByOne(places).places(motion[k : k + 1]) for k in range(20)]
    assert reader.totals(motion[:0]).shape == (0, 3)
    for none in (places.places(motion[:0]), PlacesOneByOne(places).places(motion[:0])):
        assert none.a.shape == none.b.shape == none.contact.shape == (0,)
    together = places.places(motion[:20])
    for name in ("a", "b", "contact"):
        np.testing.assert_allclose(
            np.concatenate([getattr(one, name) for one in told]), getattr(together, name), atol=1e-4
        )


def test_a_press_that_is_turned_by_half_tells_the_force_that_is_turned():
    """Whatever the weights."""
    torch.manual_seed(3)
    reader, motion = DotReader().eval(), motions_of_prints(12, 4)
    turned = mirror_images(motion)[3]
    np.testing.assert_array_equal(turned[:, 2], motion[:, 2, ::-1, ::-1])
    reversed_force = reader.totals(motion) * [-1.0, -1.0, 1.0]
    np.testing.assert_allclose(reader.totals(turned), reversed_force, atol=1e-5)
    one_by_one = DotsOneByOne(reader)
    np.testing.assert_allclose([one_by_one.total(one) for one in turned], reversed_force, atol=1e-4)


@pytest.mark.parametrize("image", range(len(IMAGES)))
def test_a_gel_that_is_seen_in_a_mirror_sits_as_that_shows_it(image):
    """Whatever the weights."""
    torch.manual_seed(4)
    places, motion = PlaceReader().eval(), motions_of_prints(12, 4)
    (u, v), told = IMAGES[image], places.places(motion)
    seen = places.places(mirror_images(motion)[image])
    np.testing.assert_allclose(seen.b, u * told.b.real + 1j * v * told.b.imag, atol=1e-4)
    np.testing.assert_allclose(seen.a, told.a.real + 1j * u * v * told.a.imag, atol=1e-6)
    np.testing.assert_allclose(seen.contact, told.contact, atol=1e-4)
    np.testing.assert_array_equal(mirror_images(mirror_images(motion)[image])[image], motion)


def test_a_reader_of_pictures_one_by_one_stays_what_it_was():
    """Also where the network that it was made of learns on."""
    torch.manual_seed(1)
    reader, motion = DotReader().eval(), motions_of_prints(4, 2)
    one_by_one = DotsOneByOne(reader)
    before = [one_by_one.total(one) for one in motion]
    with torch.no_grad():
        for value in reader.parameters():
            value.mul_(1.5)
    np.testing.assert_array_equal([one_by_one.total(one) for one in motion], before)


# -- both readers


@given(seed=st.integers(0, 2**31), weight=st.lists(st.floats(0, 1), min_size=3, max_size=3))
@settings(max_examples=50)
def test_totals_meet_at_their_weighted_mean(seed, weight):
    rng = np.random.default_rng(seed)
    forces = rng.normal(0, 0.01, (3, 24, 32)).astype(np.float32)
    forces[2, 6:18, 8:24] -= 0.1
    total = forces.sum((1, 2), dtype=float)
    by_dots = total * rng.uniform(0.7, 1.4, 3)
    settled = blend(forces, by_dots, weight)
    np.testing.assert_allclose(
        settled.sum((1, 2), dtype=float), total + weight * (by_dots - total), rtol=1e-4, atol=1e-4
    )
    assert np.corrcoef(settled[2].ravel(), forces[2].ravel())[0, 1] > 0.9999  # the normal map keeps its shape
    free = forces[2] >= 0
    assert np.array_equal(settled[:2, free], forces[:2, free])  # nothing rubs where nothing presses


@pytest.mark.parametrize("by_dots", [7.0, -0.1, -400.0])
def test_dots_that_tell_nonsense_at_most_halve_or_double_a_press(by_dots):
    forces = np.full((3, 24, 32), -0.01, np.float32)
    settled = blend(forces, np.array([0.0, 0.0, by_dots]), [0.0, 0.0, 1.0])
    assert 0.5 <= settled[2].sum() / forces[2].sum() <= 2.0


def test_without_a_press_a_map_stays_what_it_is():
    forces = np.full((3, 24, 32), 1e-5, np.float32)
    assert blend(forces, np.array([1.0, 1.0, -5.0]), [0.5, 0.5, 0.5]) is forces


def test_each_part_of_a_dataset_has_as_much_say_in_how_readers_meet():
    rng = np.random.default_rng(4)

    def part(count, by_picture, by_dots, times=1):
        """A part on which the readers are off by so much (N), and the same with each picture several times."""
        labels = rng.uniform(-1, 1, (count, 3, 2, 2))
        true = labels.sum((2, 3))
        forces = labels + rng.normal(0, by_picture, true.shape)[:, :, None, None] / 4
        dots = true + rng.normal(0, by_dots, true.shape)
        told = [(np.repeat(forces, n, 0), np.repeat(dots, n, 0), np.repeat(labels, n, 0)) for n in (1, times)]
        return [(Predicted(forces, None, dots, True), labels) for forces, dots, labels in told]

    (many, _), (few, often) = part(300, 0.5, 0.1), part(20, 0.1, 0.9, times=9)
    one, other, both = (np.array(meet(parts)["weight"]) for parts in ([many], [few], [many, few]))
    assert (one > 0.8).all() and (other < 0.2).all() and (both < one).all()
    assert np.array_equal(both, meet([many, often])["weight"])


def test_the_better_reader_has_more_say_and_a_contradiction_is_told():
    rng = np.random.default_rng(2)
    true = rng.uniform(-1, 1, (400, 3)) * [2, 2, 30]
    good, poor = true + rng.normal(0, 0.1, true.shape), true + rng.normal(0, 0.5, true.shape)
    told = fit_blend(poor, good, true)
    assert min(told["weight"]) > 0.8 > 0.2 > max(fit_blend(good, poor, true)["weight"])
    assert set(told["apart"]) == set(CHANNELS)
    usual = [dots_fault(told["apart"], a, b) for a, b in zip(poor, good, strict=True)]
    assert np.mean([bool(fault) for fault in usual]) < 0.01
    fault = dots_fault(told["apart"], np.array([0.0, 0.0, -20.0]), np.array([0.0, 0.0, -5.0]))
    assert fault == "its dots tell force along gel z of -5.0 N, its brightness of -20.0 N"


def test_a_contradiction_names_the_axis_that_the_force_is_along():
    """x and y in the lines around it are the gel's; the channel grid_x holds the force along y."""
    apart = {name: [0.1, 0.0, 0.0] for name in CHANNELS}
    for channel, axis in enumerate("yxz"):
        fault = dots_fault(apart, np.zeros(3), 2.0 * np.eye(3)[channel])
        assert f"gel {axis} of 2.0 N" in fault and "grid_" not in fault


def test_a_contradiction_is_told_in_the_newtons_that_are_read(rest, presses):
    shipped = load_for_use(None)
    apart = {"grid_x": [np.inf, 0.0, 0.0], "grid_y": [np.inf, 0.0, 0.0], "grid_z": [0.0, 0.0, 0.0]}
    suspicious = replace(shipped, about=shipped.about | {"dots": shipped.about["dots"] | {"apart": apart}})
    plain, told = Untouched(suspicious, rest), []
    contradicted = next(image for image in presses if "along gel z" in predict_one(plain, image)[2].reason)
    for gain in (1.0, 3.0):
        _, _, judged = predict_one(Untouched(suspicious, rest, gain=Gain(gain, gain, gain, 9)), contradicted)
        told.append(np.array(re.search("gel z of (.+) N, its brightness of (.+) N", judged.reason).groups(), float))
        assert told[-1][0] == pytest.approx(judged.by_dots[2], abs=0.051)
    assert told[1] == pytest.approx(3.0 * told[0], abs=0.21)  # both are told to a tenth


@pytest.fixture(scope="module")
def with_dots():
    shipped = load_for_use(None)
    torch.manual_seed(0)
    about = shipped.about | {"dots": {"weight": [0.5] * 3, "apart": {name: [0.1, 0.1, 0.0] for name in CHANNELS}}}
    about |= {"places": {"data": "somewhere", "pictures": 1234}, "stacking": None}
    by_dots, places = rounded(DotReader()).eval(), rounded(PlaceReader()).eval()
    return Trained(shipped.net, about, shipped.untouched, by_dots, places)


def test_a_model_file_keeps_its_readers_of_dots(with_dots, lawful, tmp_path):
    save_model(tmp_path / "m.pt", with_dots)
    again = load_model(tmp_path / "m.pt")
    np.testing.assert_array_equal(again.dots.totals(lawful.motion), with_dots.dots.totals(lawful.motion))
    assert again.about["dots"]["weight"] == [0.5] * 3
    found, saved = (vars(one.places.places(lawful.motion)) for one in (again, with_dots))
    for name in saved:
        np.testing.assert_array_equal(found[name], saved[name])
    save_model(tmp_path / "none.pt", replace(with_dots, places=None, about=with_dots.about | {"places": None}))
    assert load_model(tmp_path / "none.pt").places is None


def test_a_file_of_readers_in_single_precision_is_read_too(with_dots, lawful, tmp_path, monkeypatch):
    monkeypatch.setattr("gelforge.networks.modelfile.halved", lambda tensors: tensors)
    save_model(tmp_path / "m.pt", with_dots)
    again = load_model(tmp_path / "m.pt")
    np.testing.assert_array_equal(again.dots.totals(lawful.motion), with_dots.dots.totals(lawful.motion))


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda reader: reader.pop("outer.bias"), "the tensors do not fit"),
        (lambda reader: reader["outer.bias"].fill_(2.0), "not those that were trained"),
        (lambda reader: reader["outer.bias"].fill_(float("nan")), "holds NaN or infinity"),
        (lambda reader: reader["inner.weight"].fill_(float("inf")), "holds NaN or infinity"),
        (lambda reader: reader.clear(), "the tensors do not fit"),
    ],
)
@pytest.mark.parametrize("which", ["dots", "places"])
def test_a_damaged_reader_of_dots_is_refused(with_dots, tmp_path, which, spoil, told):
    path = tmp_path / "m.pt"
    save_model(path, with_dots)
    parts = torch.load(path, weights_only=True)
    spoil(parts[which])
    torch.save(parts, path)
    with pytest.raises(BadInput, match=f"{which}: .*{told}"):
        load_model(path)


def test_the_card_says_how_much_dots_have_to_say():
    assert "50 % / 25 % / 100 % (grid_x / grid_y / grid_z)" in dot_lines({"dots": {"weight": [0.5, 0.25, 1.0]}})[0]
    assert dot_lines({}) == []


def test_the_card_of_the_network_that_ships_tells_its_intervals():
    about = load_for_use(None).about
    (told,) = interval_lines(about)
    assert all(f"{name} " in told for name in CHANNELS) and "% of the whole force" in told
    assert interval_lines(about | {"intervals": {}}) == []


def test_the_card_says_what_the_reader_of_places_learnt_from(with_dots):
    assert "1234 pictures (somewhere)" in place_lines(with_dots.about)[0]
    assert place_lines({}) == place_lines({"places": None}) == []


def test_totals_are_written_with_what_is_known_of_them():
    forces = np.zeros((3, 24, 32))
    forces[:, 3, 4] = 0.5, -0.25, -7.0
    row = total_columns(forces, np.array([0.1, 0.2, 0.3]), None, 0.0)
    assert tuple(row) == TOTAL_COLUMNS
    assert [row[f"{name}_n"] for name in CHANNELS] == [0.5, -0.25, -7.0]
    assert row["grid_z_half_width_n"] == 0.3 and row["grid_z_by_dots_n"] is None
    assert row["edge_peak"] == 0.0
    total = total_columns(forces.sum((1, 2), keepdims=True), None, None, np.nan)
    assert total["grid_z_n"] == -7.0 and total["edge_peak"] is None  # one cell is no edge


@pytest.mark.parametrize("grid", [(12, 16), (24, 32), (48, 64), (3, 3)])
def test_what_touches_beyond_the_picture_shows_at_its_edge(grid):
    rows, cols = grid
    forces, whole = np.zeros((3, *grid)), (slice(rows), slice(cols))
    forces[2, 0, cols // 2] = -0.1  # what a released gel may read
    assert edge_peak(forces, whole) == 0.0
    forces[2, 0, cols // 2] = -1.0
    assert edge_peak(forces, whole) == 1.0
    forces[2, :, 0] = 5.0  # what pulls is no press
    assert edge_peak(forces, whole) == 1.0
    forces[2, rows // 2, cols // 2] -= 3.0
    assert edge_peak(forces, whole) == pytest.approx(1 / 3)


@pytest.mark.parametrize("grid", [(1, 1), (2, 2), (2, 32), (24, 1)])
def test_a_map_that_is_all_edge_tells_nothing_of_it(grid):
    forces = np.full((3, *grid), -1.0)
    whole = slice(grid[0]), slice(grid[1])
    assert np.isnan(edge_peak(forces, whole)) and total_columns(forces, None, None, np.nan)["edge_peak"] is None
    assert not goes_beyond(np.nan)


@pytest.mark.parametrize("zoom", [0.55, 0.71, 1.0, 1.4])
def test_the_edge_is_that_of_what_a_camera_shows(zoom):
    """A contact at the border of a narrow view goes on beyond it, although the map has room there."""
    view, grid = View(zoom, (0.0, 0.0, 0.0)), (24, 32)
    rows, cols = view.cells_shown(grid)
    assert rows.start == 24 - rows.stop and cols.start == 32 - cols.stop
    assert (rows.stop - rows.start) / 24 == pytest.approx(min(zoom, 1.0), abs=1 / 24)
    forces = np.zeros((3, *grid))
    forces[2, rows.start, 15] = -3.0
    assert edge_peak(forces, (rows, cols)) == 1.0
    forces[2, 12, 15] = -4.0
    assert edge_peak(forces, (rows, cols)) == 0.75


@pytest.mark.parametrize("zoom", [0.55, 0.71, 1.0])
@pytest.mark.parametrize("side", ["top", "bottom", "left", "right"])
def test_a_contact_that_the_picture_cuts_goes_on_beyond_it(zoom, side):
    """However much force lies inside; one that ends a cell before the edge does not."""
    grid = 24, 32
    shown = View(zoom, (0.0, 0.0, 0.0)).cells_shown(grid)

    def contact(gap: int) -> np.ndarray:
        """A block that begins `gap` cells within the picture's edge on that side, and ends in the map's middle."""
        forces = np.zeros((3, *grid))
        rows, cols = (gap, 4) if side in ("top", "bottom") else (4, gap)
        forces[2, shown[0].start + rows : 16, shown[1].start + cols : 20] = -1.0
        return forces if side in ("top", "left") else forces[:, ::-1, ::-1]

    cut = contact(0)
    assert goes_beyond(edge_peak(cut, shown))
    assert zoom == 1.0 or goes_beyond(edge_peak(contact(-1), shown))  # a whole view has nothing beyond it
    assert not goes_beyond(edge_peak(contact(1), shown))
    assert not goes_beyond(edge_peak(-cut, shown))  # what pulls is no press
    assert not goes_beyond(edge_peak(1e-4 * cut, shown))  # what a released gel may read


@pytest.fixture(scope="module")
def seen(rest, presses, tmp_path_factory):
    """A few pictures that have dots, all of one sensor."""
    data = open_data(write_dataset(tmp_path_factory.mktemp("dataset") / "24x32", 40, rest.shape[:2], (24, 32)))
    pictures = np.stack([presses[k % len(presses)] for k in range(len(data.images))])
    return replace(data, images=pictures, nocontact=dict.fromkeys(data.nocontact, rest))


@pytest.fixture(scope="module")
def trained(seen):
    """A network of pairs and its readers of dots, after hardly any training."""
    settings_ = with_values(SETTINGS, epochs=1, dot_epochs=2, place_epochs=2)
    return train(seen, "pair", {"kind": "grid", "width": 8, "blocks": 1, "reads": "pair"}, settings_)


STILL = with_values(SETTINGS, epochs=1, learning_rate=1e-12, least_rate=0.0, frozen_share=1.0)


def test_few_pictures_leave_the_readers_what_they_know_of_each_other(seen, rest, presses):
    shipped = load_for_use(None)
    found = train(seen, "tuned", shipped.about["model"], STILL, start=shipped)
    assert found.about["dots"]["weight"] == shipped.about["dots"]["weight"]
    assert found.about["intervals"] == shipped.about["intervals"]
    assert found.about["places"] == shipped.about["places"]
    kept = zip(found.places.parameters(), shipped.places.parameters(), strict=True)
    assert all(torch.equal(a, b) for a, b in kept)
    limits, before = found.about["statistics"], shipped.about["statistics"]
    assert limits["mean"] == before["mean"] and limits["threshold"] >= before["threshold"]
    assert limits["least_share"] <= before["least_share"] and limits["largest_rim_px"] >= before["largest_rim_px"]
    began_as = replace(shipped, stacking=found.stacking)  # which stays where it serves these pictures
    for picture in presses[:3]:
        told = [predict_one(Untouched(one, rest), picture)[1].sum((1, 2)) for one in (found, began_as)]
        assert told[0] == pytest.approx(told[1], abs=1e-3)


def test_a_network_that_goes_on_tells_the_range_of_all_that_it_learnt_from(seen):
    about = load_for_use(None).about
    before = np.array(about["normalisation"]["range"])
    new = before * [0.5, 1.5, 2.0]
    found = scales_before(about, about["model"], seen, {"range": new.tolist()})["range"]
    np.testing.assert_array_equal(found, np.maximum(before, new))


def test_a_network_does_not_go_on_from_another_scale(seen):
    shipped = load_for_use(None)
    nearer = {name: cv2.resize(picture[24:-24, 32:-32], (320, 240)) for name, picture in seen.nocontact.items()}
    with pytest.raises(BadInput, match="px apart"):
        train(replace(seen, nocontact=nearer), "tuned", shipped.about["model"], STILL, start=shipped)


def test_a_network_goes_on_to_scales_a_little_beyond_those_it_knows(seen):
    """Units drawn from the same ranges as those that it learnt from stand a little beyond them."""
    pitches = [pitch_of(picture) for picture in seen.nocontact.values()]
    require_scale({"name": "other", "pitch_px": [1.03 * max(pitches), 1.1 * max(pitches)]}, seen)
    with pytest.raises(BadInput, match="px apart"):
        require_scale({"name": "other", "pitch_px": [1.1 * max(pitches), 1.2 * max(pitches)]}, seen)


def test_training_leaves_a_reader_of_dots_beside_the_network(trained, rest, presses):
    assert trained.dots is not None and trained.places is not None
    weight = np.array(trained.about["dots"]["weight"])
    for picture in presses[:3]:
        untouched = Untouched(trained, rest)
        _, forces, judged = predict_one(untouched, picture)
        alone = Untouched(replace(trained, dots=None), rest)
        _, bare, _ = predict_one(alone, picture)
        wanted = blend(bare, judged.by_dots, weight.tolist())
        np.testing.assert_allclose(forces, wanted, rtol=1e-5, atol=1e-7)


def test_what_was_trained_reads_back_from_its_file(trained, rest, presses, tmp_path):
    save_model(tmp_path / "m.pt", trained)
    again = load_model(tmp_path / "m.pt")
    for name in ("dots", "places"):
        for kept, was in zip(getattr(again, name).parameters(), getattr(trained, name).parameters(), strict=True):
            assert torch.equal(kept, was)
    assert fingerprint(again.about).count("-") == 2
    others = again.about | {"places": again.about["places"] | {"sha256": "0" * 64}}
    assert fingerprint(others) != fingerprint(again.about)


def test_places_are_learnt_where_a_grid_cannot_be_cut_into_views(rest, presses, tmp_path):
    """As of recordings whose labels are totals, RES=1x1: how a gel sits is no matter of the grid."""
    data = open_data(write_dataset(tmp_path / "1x1", 24, rest.shape[:2], (1, 1)))
    pictures = np.stack([presses[k % len(presses)] for k in range(len(data.images))])
    data = replace(data, images=pictures, nocontact=dict.fromkeys(data.nocontact, rest))
    by_dots, places = readers_of_dots(data, with_values(SETTINGS, place_epochs=1))
    assert by_dots is None and places is not None


@pytest.mark.parametrize(("val", "train"), [(1, 30), (3, 500), (ENOUGH_PAIRS, 500), (2 * ENOUGH_PAIRS, 30)])
def test_a_picture_that_trained_tells_what_good_pairs_are_like_where_few_validate(seen, val, train):
    """Limits of one validation picture flagged pictures that the network had learnt from."""
    data = replace(seen, splits={"val": np.arange(val), "train": 1000 + np.arange(train)})
    rows = usual_rows(data)
    assert len(set(rows.tolist())) == len(rows) == max(val, min(ENOUGH_PAIRS, val + train))
    assert set(range(val)) <= set(rows.tolist())


def test_no_reader_of_dots_is_trained_where_there_are_none(tmp_path):
    data = open_data(write_dataset(tmp_path / "6x8", 24, (48, 64), (6, 8)))
    data = replace(data, nocontact=dict.fromkeys(data.nocontact, np.full((48, 64, 3), 120, np.uint8)))
    model = {"kind": "grid", "width": 8, "blocks": 1, "reads": "pair"}
    found = train(data, "pair", model, with_values(SETTINGS, epochs=1, dot_epochs=2, place_epochs=2))
    assert found.dots is None and found.places is None
