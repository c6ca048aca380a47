"""What a network learns from is what it predicts from, whatever its camera: the same array, to one level."""

import csv
from dataclasses import fields, replace

import cv2
import numpy as np
import pytest

from gelforge.learning.data import Data
from gelforge.learning.fitting import frame_of
from gelforge.reading.frame import AS_IT_IS, Learnt, image_frame
from gelforge.reading.pair import Preprocessor
from gelforge.records.image import read_image
from gelforge.records.press import PressRecord
from gelforge.records.samplefile import TRAINING, DatasetSample
from tests.support.crops import raw, resized

LOGGED = dict.fromkeys((field.name for field in fields(PressRecord)), None) | {"image": "x.png", "press_id": ""}


def uncropped(picture):
    """All that the camera sees, its markers 22 px apart."""
    return cv2.resize(raw(picture), (320, 240), interpolation=cv2.INTER_AREA)


def turned(picture):
    return np.ascontiguousarray(picture[::-1, ::-1])


def upright(picture):
    return np.ascontiguousarray(np.rot90(picture))


def own_grid(picture):
    """Another print: twice as many markers each way on half the pitch."""
    small = cv2.resize(picture, (160, 120), interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(np.block([[[small], [small[:, ::-1]]], [[small[::-1]], [small[::-1, ::-1]]]]))


def without_markers(picture):
    return cv2.medianBlur(picture, 51)


CAMERAS = {
    "as the driver": lambda picture: picture,
    "turned by 180 degrees": turned,
    "mirrored": lambda picture: np.ascontiguousarray(picture[:, ::-1]),
    "upright": upright,
    "not cropped": uncropped,
    "640 x 480": lambda picture: resized(picture, 640, 480),
    "an own grid of markers": own_grid,
    "no markers": without_markers,
    "turned and not cropped": lambda picture: turned(uncropped(picture)),
}


@pytest.fixture(scope="module")
def logged(root):
    """Images of the demo by unit, and no-contact images."""
    images = {path.stem: [] for path in sorted((root / "data/demo/nocontact").glob("*.png"))[:2]}
    with (root / "data/demo/log.csv").open() as stream:
        for row in csv.DictReader(stream):
            if row["sensor_id"] in images and len(images[row["sensor_id"]]) < 3:
                images[row["sensor_id"]].append(read_image(root / "data/demo" / row["image"]))
    return {
        name: (read_image(root / f"data/demo/nocontact/{name}.png"), seen) for name, seen in images.items() if seen
    }


def dataset(logged, cameras):
    """A dataset of units whose cameras see as they do, all to train on."""
    table, images, nocontact = [], [], {}
    for (name, (rest, pictures)), camera in zip(logged.items(), cameras, strict=False):
        nocontact[name] = camera(rest)
        for picture in pictures:
            press = PressRecord(
                **LOGGED | {"row": len(table), "sample_id": f"{name}-{len(table)}", "sensor_id": name}
            )
            table.append(DatasetSample(press, np.zeros(3), np.zeros(3), {}, split=TRAINING))
            images.append(camera(picture))
    labels = np.zeros((len(table), 3, 6, 8), np.float32)
    return Data(
        None,
        np.stack(images),
        labels,
        table,
        {TRAINING: np.arange(len(table))},
        {},
        nocontact,
        np.ones(len(table), bool),
    )


def metadata_of(data, before=None):
    return {
        "image": list(data.image_size),
        "model": {"kind": "grid"},
        "frame": frame_of(data, before).table(),
    }


def largest_difference(data, metadata):
    """Levels between what training and prediction give the graph, of its worst pixel, and the frames of prediction."""
    learnt = data.seen(np.arange(len(data.table)), True).astype(int)
    worst, frames = 0, []
    for name, rest in data.nocontact.items():
        prepare = Preprocessor(metadata, rest)
        frames.append(prepare.frame)
        for row in np.flatnonzero(data.names("sensor_id") == name):
            seen = prepare(np.ascontiguousarray(data.images[row]))
            given = np.concatenate([seen.feature("image")[0], seen.feature("nocontact")[0]], axis=2)
            worst = max(worst, int(np.abs(given - learnt[row]).max()))
    return worst, frames


@pytest.mark.parametrize("camera", CAMERAS)
def test_training_and_prediction_give_the_graph_the_same_array(logged, camera):
    data = dataset(logged, [CAMERAS[camera]] * len(logged))
    worst, frames = largest_difference(data, metadata_of(data))
    assert worst <= 1
    assert all(frame.as_logged for frame in frames)


def test_sensors_whose_cameras_lie_otherwise_each_stay_as_they_were_learnt(logged):
    """Also of a network that goes on from one that knew another view."""
    data = dataset(logged, [CAMERAS["as the driver"], CAMERAS["turned by 180 degrees"]])
    usual = metadata_of(dataset(logged, [CAMERAS["as the driver"]] * 2))
    for metadata in (metadata_of(data), metadata_of(data, usual)):
        assert largest_difference(data, metadata)[0] <= 1


def test_any_other_camera_is_brought_to_the_view_that_was_learnt(logged):
    """A network that learnt from turned images turns those of a camera that lies as usual, and the other way round."""
    (rest, pictures), *_ = logged.values()
    for learnt, other in (("turned by 180 degrees", "as the driver"), ("as the driver", "mirrored")):
        metadata = metadata_of(dataset(logged, [CAMERAS[learnt]] * len(logged)))
        prepare = Preprocessor(metadata, CAMERAS[other](rest))
        assert prepare.frame.orientation != AS_IT_IS
        assert np.array_equal(
            prepare(CAMERAS[other](pictures[0])).image,
            Preprocessor(metadata, CAMERAS[learnt](rest))(CAMERAS[learnt](pictures[0])).image,
        )
    metadata = metadata_of(dataset(logged, [CAMERAS["not cropped"]] * len(logged)))
    frame, markers = image_frame(rest, (240, 320), Learnt.of(metadata["frame"]))
    low, high = metadata["frame"]["pitch_px"]
    assert frame.zoom < 1.0 and 0.97 * low < markers.pitch < 1.03 * high


def test_what_is_taken_back_of_a_row_is_kept(logged):
    """Later epochs see what the first one saw: a shifted gel, and markers that the image lacks."""
    data = dataset(logged, [CAMERAS["as the driver"]] * len(logged))
    images = np.stack(data.images)
    images[0] = np.roll(images[0], 6, axis=1)
    images[1][100:130, 150:190] = images[1][100:130, 150:190].max(axis=(0, 1))
    data = replace(data, images=images)
    first = data.seen(np.arange(len(images)), True)
    assert np.array_equal(first, data.seen(np.arange(len(images)), True))
    assert largest_difference(data, metadata_of(data))[0] <= 1
