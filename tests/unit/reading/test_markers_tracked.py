"""Markers of a gel, where optical flow finds them; totals and their columns; a network that is fine-tuned from another."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelforge.flow.files import read_csv
from gelforge.learning.data import open_data
from gelforge.learning.export import load_weights
from gelforge.learning.start import Start, require_scale, scales_before
from gelforge.reading.forcereading import TOTAL_COLUMNS, ForceReading, edge_peak, goes_beyond, total_columns
from gelforge.reading.frame import ImageFrame
from gelforge.reading.light import match_light
from gelforge.reading.markers import MarkerTracker, markers_in
from gelforge.reading.model import SHIPPED
from gelforge.reading.reader import Reader
from gelforge.records.axes import CHANNELS
from gelforge.records.image import read_image
from gelforge.stages.train import train
from tests.support.parameters import with_values
from tests.support.pictures import moved
from tests.support.refused import refused
from tests.support.synthetic_presses import SETTINGS, with_pictures, write_dataset


@pytest.fixture(scope="module")
def rest(demo_nocontact):
    return demo_nocontact["mini_a"]


@pytest.fixture(scope="module")
def presses(root, rest):
    """Pictures of mini_a in its no-contact image's light."""
    rows = [row for row in read_csv(root / "data/demo/log.csv") if row["sensor_id"] == "mini_a"][::4]
    pictures = [read_image(root / "data/demo" / row["image"])[..., :3] for row in rows]
    return [match_light(picture, rest).undo(picture) for picture in pictures]


def tracker(picture):
    return MarkerTracker(picture, markers_in(picture))


def motion_of(markers, image):
    return markers.on_lattice(markers.track(image))


def test_markers_at_rest_have_not_moved(rest):
    markers = tracker(rest)
    motion = motion_of(markers, rest)
    assert markers.known and motion[2].sum() == (markers.at[:, 0] >= 0).sum() >= 60
    assert np.abs(motion[:2]).max() < 1e-3


@given(u=st.floats(-6, 6), v=st.floats(-6, 6))
@settings(max_examples=20)
def test_all_markers_of_a_moved_picture_have_moved_as_it_did(rest, u, v):
    motion = motion_of(tracker(rest), moved(rest, (u, v)))
    seen = motion[2] > 0
    assert seen.sum() >= 45  # a picture that moved does not show them all
    assert np.median(np.hypot(motion[0][seen] - u, motion[1][seen] - v)) < 0.2


def test_a_covered_dot_is_not_seen_and_the_others_stay(rest):
    markers = tracker(rest)
    covered, (u, v) = rest.copy(), markers.points[len(markers.points) // 2].astype(int)
    covered[v - 14 : v + 14, u - 14 : u + 14] = np.random.default_rng(0).integers(0, 255, (28, 28, 3))
    motion = motion_of(markers, covered)
    row, col = markers.at[len(markers.points) // 2]
    assert motion[2, row, col] == 0
    assert (motion[2] > 0).sum() >= len(markers.points) - 3


def test_light_moves_no_dot(rest, presses):
    """A picture at eight tenths of its light, brought back to that of the no-contact image, shows the same motion."""
    markers = tracker(rest)
    for picture in presses:
        dark = np.rint(picture * 0.8).astype(np.uint8)
        motion, again = motion_of(markers, picture), motion_of(markers, match_light(dark, rest).undo(dark))
        both = (motion[2] > 0) & (again[2] > 0)
        assert both.sum() > 0.9 * motion[2].sum()
        assert np.abs(motion[:2] - again[:2])[:, both].mean() < 0.05


def test_a_gel_without_print_has_no_markers():
    for shade in (0, 130):
        picture = np.full((240, 320, 3), shade, np.uint8)
        markers = tracker(picture)
        assert not markers.known and not motion_of(markers, picture).any()


def reading(forces, half_width=None, edge=0.0):
    """A reading of forces (3, rows, cols) N."""
    return ForceReading(forces, forces.sum((1, 2)), half_width, "", edge, 1.0)


def test_totals_are_written_with_what_is_known_of_them():
    forces = np.zeros((3, 24, 32))
    forces[:, 3, 4] = 0.5, -0.25, -7.0
    row = total_columns(reading(forces, np.array([0.1, 0.2, 0.3])))
    assert tuple(row) == TOTAL_COLUMNS
    assert [row[f"{name}_n"] for name in CHANNELS] == [0.5, -0.25, -7.0]
    assert row["fz_half_width_n"] == 0.3
    assert row["edge_peak"] == 0.0
    total = total_columns(reading(forces.sum((1, 2), keepdims=True), edge=np.nan))
    assert total["fz_n"] == -7.0 and total["edge_peak"] is None  # one cell is no edge


def test_a_map_that_is_all_edge_says_nothing_of_what_touches_beyond_it():
    for rows, cols in ((1, 1), (2, 2), (2, 32), (24, 1)):
        forces = np.full((3, rows, cols), -1.0)
        assert np.isnan(edge_peak(forces, (slice(rows), slice(cols)))) and not goes_beyond(np.nan)


def test_the_edge_is_that_of_what_a_camera_shows():
    """A contact at the border of a narrow view is cropped by it, although the map has room there."""
    grid = 24, 32
    for zoom in (0.55, 0.71, 1.0, 1.4):
        rows, cols = ImageFrame((240, 320), (240, 320), zoom=zoom).cells_shown(grid)
        assert rows.start == 24 - rows.stop and cols.start == 32 - cols.stop
        assert (rows.stop - rows.start) / 24 == pytest.approx(min(zoom, 1.0), abs=1 / 24)
        forces = np.zeros((3, *grid))
        forces[2, rows.start, 15] = -3.0
        assert edge_peak(forces, (rows, cols)) == 1.0
        forces[2, 12, 15] = -4.0
        assert edge_peak(forces, (rows, cols)) == 0.75


def test_a_contact_that_the_picture_cuts_goes_on_beyond_it():
    """However much force lies inside; one that ends a cell before the edge does not."""
    for zoom in (0.55, 0.71, 1.0):
        for side in ("top", "bottom", "left", "right"):
            shown = ImageFrame((240, 320), (240, 320), zoom=zoom).cells_shown((24, 32))
            cut = block_at(side, 0, shown)
            assert goes_beyond(edge_peak(cut, shown))
            # a whole view has nothing beyond it
            assert zoom == 1.0 or goes_beyond(edge_peak(block_at(side, -1, shown), shown))
            assert not goes_beyond(edge_peak(block_at(side, 1, shown), shown))
            assert not goes_beyond(edge_peak(-cut, shown))  # what pulls is no press
            assert not goes_beyond(edge_peak(1e-4 * cut, shown))  # what a released gel may read


def block_at(side: str, gap: int, shown) -> np.ndarray:
    """A block (3, 24, 32) that begins `gap` cells within the picture's edge on that side, and ends in the map's middle."""
    forces = np.zeros((3, 24, 32))
    rows, cols = (gap, 4) if side in ("top", "bottom") else (4, gap)
    forces[2, shown[0].start + rows : 16, shown[1].start + cols : 20] = -1.0
    return forces if side in ("top", "left") else forces[:, ::-1, ::-1]


@pytest.fixture(scope="module")
def seen(rest, presses, tmp_path_factory):
    """A few pictures that have markers, all of one sensor."""
    data = open_data(write_dataset(tmp_path_factory.mktemp("dataset") / "24x32", 40, rest.shape[:2], (24, 32)))
    pictures = np.stack([presses[k % len(presses)] for k in range(len(data.images))])
    return with_pictures(data, pictures, dict.fromkeys(data.nocontact, rest), tmp_path_factory.mktemp("pictures"))


STILL = with_values(SETTINGS, epochs=1, learning_rate=1e-12, frozen_share=1.0)


def test_a_fine_tuned_network_holds_the_range_of_all_that_it_learnt_from(seen, shipped):
    about = shipped.metadata
    before = np.array(about["normalisation"]["range"])
    new = before * [0.5, 1.5, 2.0]
    found = scales_before(about, about["model"], seen, {"range": new.tolist()})["range"]
    np.testing.assert_array_equal(found, np.maximum(before, new))


def test_a_network_goes_on_to_scales_a_little_beyond_those_it_knows_and_to_no_other(seen):
    """Units drawn from the same ranges as those that it learnt from stand a little beyond them."""
    pitches = [markers_in(picture).pitch for picture in seen.nocontact.values()]
    require_scale({"name": "other", "frame": {"pitch_px": [1.03 * max(pitches), 1.1 * max(pitches)]}}, seen)
    refused(
        "px apart",
        require_scale,
        {"name": "other", "frame": {"pitch_px": [1.1 * max(pitches), 1.2 * max(pitches)]}},
        seen,
    )
    shipped = Start(*load_weights(SHIPPED.with_suffix(".safetensors")))
    nearer = {name: cv2.resize(picture[24:-24, 32:-32], (320, 240)) for name, picture in seen.nocontact.items()}
    other = replace(seen, nocontact=nearer)
    refused("px apart", train, other, "tuned", shipped.metadata["model"], STILL, start=shipped)


def test_a_network_that_hardly_learnt_predicts_as_the_one_that_ships(seen, rest, presses, shipped):
    """Its intervals are not those of the other."""
    start = Start(*load_weights(SHIPPED.with_suffix(".safetensors")))
    found = train(seen, "tuned", start.metadata["model"], STILL, start=start)
    assert found.metadata["tta"]
    predictors = [Reader(rest, model=model) for model in (found.model, shipped)]
    for picture in presses[:3]:
        one, other = (predictor(picture).total for predictor in predictors)
        assert one == pytest.approx(other, abs=1e-3)
