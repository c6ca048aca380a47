"""Markers that only the image or only the no-contact image shows hardly change a force, and are counted."""

import cv2
import numpy as np
import pytest

from gelforge.flow.files import read_csv
from gelforge.reading.model import load_model
from gelforge.reading.reader import Reader
from gelforge.reading.wear import painted_over
from gelforge.records.image import read_image

ENOUGH = 5.0  # N from which a change is a fraction of the force, below it is an absolute one
MOST_VANISHED = 8  # markers that only one image may show
LIGHT = 0.6  # N by which lighter presses change


@pytest.fixture(scope="module")
def sensor(root):
    """A predictor of mini_a, every second image of it in the demo, which are seventeen, and what is read of each."""
    demo = root / "tests/data/presses"
    rows = [row for row in read_csv(demo / "log.csv") if row["sensor_id"] == "mini_a"]
    predictor = Reader(read_image(demo / "nocontact/mini_a.png"), model=load_model(None))
    images = [read_image(demo / row["image"]) for row in rows[::2]]
    return predictor, images, [predictor(image).total[2] for image in images]


def nine_of_ten(pairs) -> tuple[float, float]:
    """Change of nine of ten forces of (whole, changed) normal forces, N: of ENOUGH and more as fractions; of others in N."""
    whole, changed = np.abs(np.array(pairs, float)).T
    heavy, change = whole >= ENOUGH, np.abs(changed - whole)
    return np.quantile(change[heavy] / whole[heavy], 0.9), np.quantile(change[~heavy], 0.9)


def without(predictor, image, count: int, seed: int, strength=1.0):
    """An image that lost some markers of its gel, partly for a strength below 1."""
    seen = predictor.compare(image)
    markers = seen.nocontact.markers
    lost = np.random.default_rng(seed).choice(np.flatnonzero(seen.tracks.found), count, replace=False)
    there = markers.points[lost] + seen.tracks.motion[lost]
    gone = painted_over(image, there, markers.diameter)
    return np.rint(strength * gone + (1 - strength) * image.astype(float)).astype(np.uint8)


def test_vanished_markers_hardly_change_a_force(sensor):
    """Nine of ten by less than the first limit, and each of ENOUGH and more by less than the second."""
    predictor, images, read = sensor
    for count, most, each in ((1, 0.05, 0.1), (8, 0.15, 0.25)):
        forces = []
        for seed, (image, whole) in enumerate(zip(images, read, strict=True)):
            worn = predictor(without(predictor, image, count, seed))
            assert worn.vanished == count
            forces.append((whole, worn.total[2]))
            assert whole > -ENOUGH or worn.total[2] / whole == pytest.approx(1.0, abs=each)
        heavy, light = nine_of_ten(forces)
        assert heavy < most and light < LIGHT


@pytest.mark.slow
def test_markers_that_only_the_no_contact_image_lacks_hardly_change_nine_of_ten_forces(sensor, root):
    predictor, images, read = sensor
    rest, markers = read_image(root / "data/demo/nocontact/mini_a.png"), predictor.nocontact.markers
    for count, most in ((1, 0.05), (8, 0.15)):
        forces = []
        for seed in range(2):
            lost = np.random.default_rng(seed).choice(len(markers.points), count, replace=False)
            worn = Reader(painted_over(rest, markers.points[lost], markers.diameter), model=predictor.model)
            assert worn(rest).total == pytest.approx(0.0, abs=0.15)  # N
            for image, whole in zip(images, read, strict=True):
                seen = worn(image)
                # a marker in an outermost column that lost all its neighbours is on no lattice
                assert count - 1 <= seen.vanished <= count
                forces.append((whole, seen.total[2]))
        heavy, light = nine_of_ten(forces)
        assert heavy < most and light < LIGHT


def half_worn(image, points, diameter):
    """An image on whose gel some markers (n, 2) px have half of their ink left."""
    gone = painted_over(image, points, diameter)
    return ((gone.astype(int) + image) // 2).astype(np.uint8)


@pytest.mark.slow
def test_half_worn_markers_change_a_force_by_a_tenth_or_are_flagged(sensor, root):
    """Markers worn in the image alone, and in the no-contact image as well."""
    predictor, images, read = sensor
    rest, markers = read_image(root / "data/demo/nocontact/mini_a.png"), predictor.nocontact.markers
    for seed in range(0, len(images), 2):
        image, whole = images[seed], read[seed]
        motion = np.nan_to_num(predictor.compare(image).tracks.motion)
        for count in (8, 24, 63):
            which = np.random.default_rng(seed).permutation(len(markers.points))[:count]
            worn = half_worn(image, (markers.points + motion)[which], markers.diameter)
            also = half_worn(rest, markers.points[which], markers.diameter)
            for reader in (predictor, Reader(also, model=predictor.model)):
                seen = reader(worn)
                assert seen.flag or seen.total[2] / whole == pytest.approx(1.0, abs=0.1), count
                assert seen.flag == (count > 8), count


def test_dust_changes_nine_of_ten_forces_by_a_tenth_or_is_flagged(sensor):
    """Grains are as large in the image whatever the press, so they change a light press by a force and no fraction of it."""
    predictor, images, read = sensor
    forces = []
    for seed in range(2):
        rng, dust = np.random.default_rng(seed), np.ones(images[0].shape[:2], np.float32)
        for u, v in rng.uniform((10, 10), (310, 230), (20, 2)).astype(int).tolist():
            cv2.circle(dust, (u, v), int(rng.integers(1, 6)), float(rng.uniform(0.5, 1.2)), -1, cv2.LINE_AA)
        for image, whole in zip(images, read, strict=True):
            seen = predictor(np.clip(image * dust[..., None], 0, 255).astype(np.uint8))
            if not seen.flag:
                forces.append((whole, seen.total[2]))
    heavy, light = nine_of_ten(forces)
    assert heavy < 0.1 and light < LIGHT


def test_a_released_gel_without_markers_bears_nothing(sensor, root):
    predictor, *_ = sensor
    rest = read_image(root / "data/demo/nocontact/mini_a.png")
    for count in (1, 4, 8):
        found = predictor(without(predictor, rest, count, count))
        assert found.vanished == count
        assert np.abs(found.total).max() < 0.15  # N


def test_many_vanished_markers_are_flagged_where_they_change_a_force(sensor):
    """By more than its interval, as the network reads the pair in which they are not painted over."""
    predictor, images, read = sensor
    flagged = []
    for seed, (image, whole) in enumerate(zip(images[::3], read[::3], strict=True)):
        for count in (MOST_VANISHED + 4, 3 * MOST_VANISHED):
            found = predictor(without(predictor, image, count, seed))
            flagged.append(f"{found.vanished} markers are visible only in" in found.reason)
            assert found.flag or abs(found.total[2] - whole) < found.half_width[2], (seed, count)
    assert any(flagged) and not all(flagged)


def test_the_order_of_images_does_not_matter(sensor):
    predictor, images, _ = sensor
    worn = without(predictor, images[0], MOST_VANISHED + 4, 1)
    first = predictor(worn)
    for image in images[::4]:
        predictor(without(predictor, image, 3, 7))
        seen = predictor.compare(image)  # a gel that keeps its markers is read as it is
        assert seen.vanished == 0 and seen.nocontact is predictor.nocontact
    again = predictor(worn)
    np.testing.assert_array_equal(first.cells, again.cells)
