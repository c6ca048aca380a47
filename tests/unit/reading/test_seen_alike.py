"""What a network learns from is what it predicts from, whatever its camera: the same array, to one level."""

import csv
from dataclasses import fields
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import pytest

from gelforge.learning.data import Data
from gelforge.learning.train import frame_of
from gelforge.reading.frame import AS_IT_IS, Learnt, image_frame
from gelforge.reading.pair import NoContact
from gelforge.records.image import read_image
from gelforge.records.press import PressRecord
from gelforge.records.samplefile import TRAINING, DatasetSample
from tests.support.crops import raw, resized
from tests.support.synthetic_presses import with_pictures

LOGGED = dict.fromkeys((field.name for field in fields(PressRecord)), None) | {"image": "x.png", "press_id": ""}


def uncropped(picture):
    """All that the camera sees, its markers 22 px apart."""
    return cv2.resize(raw(picture), (320, 240), interpolation=cv2.INTER_AREA)


def turned(picture):
    return np.ascontiguousarray(picture[::-1, ::-1])


def own_grid(picture):
    """Another print: twice as many markers each way on half the pitch."""
    small = cv2.resize(picture, (160, 120), interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(np.block([[[small], [small[:, ::-1]]], [[small[::-1]], [small[::-1, ::-1]]]]))


CAMERAS = {
    "as the driver": lambda picture: picture,
    "turned by 180 degrees": turned,
    "mirrored": lambda picture: np.ascontiguousarray(picture[:, ::-1]),
    "upright": lambda picture: np.ascontiguousarray(np.rot90(picture)),
    "not cropped": uncropped,
    "640 x 480": lambda picture: resized(picture, 640, 480),
    "an own grid of markers": own_grid,
    "no markers": lambda picture: cv2.medianBlur(picture, 51),
    "turned and not cropped": lambda picture: turned(uncropped(picture)),
}


@pytest.fixture(scope="module")
def logged(root):
    """Images of the demo by unit, and no-contact images."""
    images = {path.stem: [] for path in sorted((root / "data/demo/nocontact").glob("*.png"))[:2]}
    with (root / "data/demo/log.csv").open() as stream:
        for row in csv.DictReader(stream):
            if row["sensor_id"] in images and len(images[row["sensor_id"]]) < 2:
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
            about = {"row": len(table), "sample_id": f"{name}-{len(table)}", "sensor_id": name}
            press = PressRecord(**LOGGED | about)
            table.append(DatasetSample(press, np.zeros(6), np.zeros(6), {}, split=TRAINING))
            images.append(camera(picture))
    labels = np.zeros((len(table), 3, 6, 8), np.float32)
    splits, maps = {TRAINING: np.arange(len(table))}, np.ones(len(table), bool)
    nothing = np.zeros(0)
    data = Data(None, nothing, nothing, nothing, nothing, labels, table, splits, {}, {}, maps)
    with TemporaryDirectory() as folder:
        return with_pictures(data, np.stack(images), nocontact, Path(folder))


def metadata_of(data, before=None):
    return {"image": list(data.image_size), "model": {"kind": "grid"}, "frame": frame_of(data, before).table()}


def reads(metadata, rest):
    """A sensor as prediction sees it."""
    return NoContact(rest, tuple(metadata["image"]), Learnt.of(metadata["frame"]))


def prepared(nocontact, image):
    return nocontact.compare(nocontact.frame(image), image.shape)


def largest_difference(data, metadata):
    """Levels between what training and prediction give the graph, of its worst pixel, and the frames of prediction."""
    learnt = data.seen(np.arange(len(data.table)), True).astype(int)
    worst, frames = 0, []
    for name, rest in data.nocontact.items():
        reader = reads(metadata, rest)
        frames.append(reader.frame)
        for row in np.flatnonzero(data.names("sensor_id") == name):
            seen = prepared(reader, np.ascontiguousarray(data.images[row])).features()
            given = np.concatenate([seen["image"][0], seen["nocontact"][0]], axis=2)
            worst = max(worst, int(np.abs(given - learnt[row]).max()))
    return worst, frames


@pytest.mark.parametrize("camera", [name for name in CAMERAS if name not in ("as the driver", "not cropped")])
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
        turns = reads(metadata, CAMERAS[other](rest))
        assert turns.frame.orientation != AS_IT_IS
        assert np.array_equal(
            prepared(turns, CAMERAS[other](pictures[0])).image.image,
            prepared(reads(metadata, CAMERAS[learnt](rest)), CAMERAS[learnt](pictures[0])).image.image,
        )
    metadata = metadata_of(dataset(logged, [CAMERAS["not cropped"]] * len(logged)))
    frame, markers = image_frame(rest, (240, 320), Learnt.of(metadata["frame"]))
    low, high = metadata["frame"]["pitch_px"]
    assert frame.zoom < 1.0 and 0.97 * low < markers.pitch < 1.03 * high


def test_pictures_of_a_dataset_are_registered_and_without_worn_markers(logged, tmp_path):
    """As prediction prepares them: a shifted gel, and markers that the image lacks."""
    data = dataset(logged, [CAMERAS["as the driver"]] * len(logged))
    images = np.stack(data.images)
    images[0] = np.roll(images[0], 6, axis=1)
    images[2][100:130, 150:190] = images[2][100:130, 150:190].max(axis=(0, 1))
    data = with_pictures(data, images, data.nocontact, tmp_path)
    assert len(data.rests) > len(data.nocontact)
    assert largest_difference(data, metadata_of(data))[0] <= 1
