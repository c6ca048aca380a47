"""The network that comes with gelforge: it reads pictures as soon as the set-up is done."""

import csv
from itertools import islice
from pathlib import Path

import numpy as np

from gelforge.commands import predict
from gelforge.flow.tables import SHIPPED_IMAGE
from gelforge.reading.frame import as_shipped
from gelforge.reading.model import SHIPPED, load_model, require_sensor
from gelforge.reading.reader import Reader
from gelforge.records.film import frames, open_source
from gelforge.records.nocontactimage import nocontact_of
from tests.support.refused import refused

LARGEST = 3 * 2**20  # bytes


def test_it_is_small_and_its_card_says_where_it_learnt():
    assert SHIPPED.stat().st_size <= LARGEST
    card = SHIPPED.with_suffix(".md").read_text(encoding="utf-8")
    assert "learnt from the virtual rig" in card
    assert f"# Model card: {load_model(SHIPPED).metadata['name']}" in card


def test_the_plan_knows_the_size_of_pictures_that_it_reads():
    assert SHIPPED_IMAGE[::-1] == tuple(load_model(SHIPPED).metadata["image"])


def test_it_reads_presses_it_never_saw(root, tmp_path):
    """The demo's presses of a known unit, a plan of its own: far better than the best constant, and none is flagged."""
    log = [row for row in csv.DictReader((root / "data/demo/log.csv").open()) if row["sensor_id"] == "mini_a"]
    truth = {row["sample_id"]: row for row in csv.DictReader((root / "data/demo/truth/presses.csv").open())}
    images = [str(root / "data/demo" / row["image"]) for row in log]
    rest = str(root / "data/demo/nocontact/mini_a.png")
    assert predict.main([*images, "--nocontact", rest, "--out", str(tmp_path)]) == 0
    rows = list(csv.DictReader((tmp_path / "totals.csv").open()))
    assert not any(int(row["flagged"]) for row in rows)
    read = np.array([float(row["fz_n"]) for row in rows])
    real = np.array([float(truth[row["sample_id"]]["fz_n"]) for row in log])
    assert 3 * np.abs(read - real).mean() < np.abs(np.median(real) - real).mean()
    assert np.load(tmp_path / f"{log[0]['sample_id']}.npy").shape == (3, 24, 32)


def test_it_is_for_any_sensor_that_brings_its_no_contact_image(root):
    """It learnt from too many units to be one of theirs: the demo's report reads units of other names with it."""
    model = load_model(SHIPPED)
    assert model.needs_nocontact and len(model.metadata["sensors"]) > 8
    require_sensor(model, "any name")
    refused("give it with --nocontact NOCONTACT or --profile", Reader, model=model)


def some_frames(film: Path) -> list[np.ndarray]:
    """Every twentieth frame (h, w, 3) uint8 RGB of a film, from the first on that a camera does not set its exposure in."""
    with open_source(film, None) as (source, announced):
        return [
            np.ascontiguousarray(frame[:, :, ::-1])
            for frame in islice(frames(source, announced, "", None), 10, None, 20)
        ]


def test_the_other_finger_of_a_gripper_is_flagged_and_ones_own_is_not(reference, shipped):
    """Both look alike and show no rim; a released gel reads up to 40 N against the other's no-contact image."""
    for grasp in ("glass_box_1", "wooden_statue_5"):
        films = [reference / f"gripper_videos/{grasp}_camera_{finger}.avi" for finger in (0, 2)]
        fingers = [Reader(nocontact_of(film, None), model=shipped) for film in films]
        flagged = {True: [], False: []}
        for one, predictor in enumerate(fingers):
            for other, film in enumerate(films):
                flagged[one == other] += [predictor(image).flag for image in some_frames(film)]
        assert np.mean(flagged[False]) >= 0.9 and np.mean(flagged[True]) <= 0.25, grasp


def test_images_of_a_log_are_judged_in_exactly_its_view(shipped):
    """A zoom that differs by a ten-thousandth changed levels, and a torn frame was flagged by a reader alone."""
    assert as_shipped(shipped.size).table() == shipped.metadata["frame"]
