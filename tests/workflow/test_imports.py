"""What others recorded becomes a dataset: MCAP by topic names, and FEATS' layout with the splits it was published in."""

import json

import cv2
import numpy as np
import pytest

from gelforge.commands.mcap import main as mcap_import
from gelforge.errors import BadInput
from gelforge.flow.files import read_csv, write_csv, write_json, write_text
from gelforge.flow.params import plain
from gelforge.formats.export import ros
from gelforge.formats.feats_folder import import_folder
from gelforge.formats.featsfile import FORCE_FIELDS, POSE_FIELDS, LabelSample, read_sample, write_label
from gelforge.formats.mcap_import import Topics, import_recordings, messages, nearest
from gelforge.labelling.sensor import load_sensors
from gelforge.networks.checkpoint.modelfile import load_model
from gelforge.records.labelfile import read_labels
from gelforge.records.splits import SPLITS
from gelforge.stages.plan import logged_rows, write_shards
from tests.support.parameters import write_stage
from tests.support.synthetic_presses import SETTINGS

TURN = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
TOML = """image = "/gel/image"
wrench = "/ft/wrench"
sign = -1
rotation = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
every = 2
"""


@pytest.fixture
def sensor(root):
    return load_sensors(root / "workflow" / "sensors.toml")["gelsight_mini"]


def pictures(count):
    rng = np.random.default_rng(2)
    return rng.integers(0, 255, (count, 240, 320, 3), np.uint8)


def record(path, images, raw=False, start=10**18):
    """A recording: a picture every 50 ms, a wrench every 10 ms that presses twice, none for the last one taken."""
    from mcap_ros2.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        kind = (
            ("sensor_msgs/msg/Image", ros.schema("sensor_msgs/msg/Image"))
            if raw
            else ("sensor_msgs/msg/CompressedImage", ros.schema("sensor_msgs/msg/CompressedImage"))
        )
        image, wrench = (
            writer.register_msgdef(*kind),
            writer.register_msgdef("geometry_msgs/msg/WrenchStamped", ros.schema("geometry_msgs/msg/WrenchStamped")),
        )
        for k, picture in enumerate(images):
            time = start + k * 50_000_000
            said = {
                "header": ros.header(0, "gel"),
                "format": "png",
                "data": cv2.imencode(".png", picture[..., ::-1])[1].tobytes(),
            }
            if raw:
                said = {"header": ros.header(0, "gel"), "height": 240, "width": 320, "encoding": "bgr8", "is_bigendian": 0,
                        "step": 960, "data": picture[..., ::-1].tobytes()}  # fmt: skip
            writer.write_message("/gel/image", image, said, log_time=time, publish_time=time)
        for k in range(5 * (len(images) - 3)):
            time = start + k * 10_000_000 + 1_000_000
            size = 5.0 if (k // 20) % 2 else 0.0
            force, torque = {"x": 0.1 * size, "y": 0.2 * size, "z": size}, {"x": 0.0, "y": 0.0, "z": 0.01 * size}
            said = {"header": ros.header(0, "ft"), "wrench": {"force": force, "torque": torque}}
            writer.write_message("/ft/wrench", wrench, said, log_time=time, publish_time=time)
        writer.finish()


def topics(folder, text=TOML):
    write_text(folder / "topics.toml", text)
    return Topics.read(folder / "topics.toml")


@pytest.mark.parametrize("raw", [False, True])
def test_a_recording_becomes_pictures_with_total_force(tmp_path, sensor, raw):
    images = pictures(20)
    (tmp_path / "in").mkdir()
    record(tmp_path / "in" / "a.mcap", images, raw)
    found = import_recordings(tmp_path / "in", tmp_path / "lab", topics(tmp_path), sensor)
    assert (found["files"], found["images"], found["without_wrench"]) == (1, 9, 1)
    assert found["largest_gap_s"] == pytest.approx(0.001)
    rows = read_csv(tmp_path / "lab" / "log.csv")
    labels = read_labels(tmp_path / "lab" / "labels" / "1x1.npz")
    for k, row in enumerate(rows):
        kept = cv2.imread(str(tmp_path / "lab" / row["image"]))[..., ::-1]
        assert np.array_equal(kept, images[2 * k])
        # The wrench of that millisecond, turned and with its sign changed.
        size = 5.0 if (10 * k // 20) % 2 else 0.0
        expected = -np.array(TURN) @ [0.1 * size, 0.2 * size, size]
        assert [float(row[f"f{axis}_n"]) for axis in "xyz"] == pytest.approx(expected.tolist(), abs=1e-6)
        assert labels.label[k, :, 0, 0] == pytest.approx(expected[[1, 0, 2]], abs=1e-5)
        assert (
            row["indenter"] == "" and row["dz_mm"] == "" and float(row["mz_nm"] or 0) == pytest.approx(-0.01 * size)
        )
    assert len({row["press_id"] for row in rows}) == 3  # before the first contact, and two contacts


def test_the_dataset_trains_on_totals(tmp_path, sensor, root):
    """From import to network, at one cell; rows that name no sensor are of the dataset's."""
    import subprocess
    import sys

    (tmp_path / "in").mkdir()
    for name in "abcd":
        record(tmp_path / "in" / f"{name}.mcap", pictures(48))
    import_recordings(tmp_path / "in", tmp_path / "lab", topics(tmp_path), sensor)
    log = tmp_path / "lab/log.csv"
    rows = read_csv(log)
    name = rows[0]["sensor_id"]
    write_csv(log, list(rows[0]), [row | {"sensor_id": ""} for row in rows])
    plan = tmp_path / "00_plan"
    write_shards(tmp_path / "lab", logged_rows(log, name), plan, 30)
    out = tmp_path / "60_dataset" / "1x1" / "dataset.json"
    write_json(tmp_path / "indenters.json", {})
    write_stage(tmp_path, "dataset", dataset={"validation": 0.2, "test": 0.2, "force_edges": [1.0, 3.0]})
    import tomllib

    write_json(tmp_path / "sensors.json", tomllib.loads((root / "workflow/sensors.toml").read_text()))
    command = {"data": tmp_path / "lab", "labels": tmp_path / "lab/labels/1x1.npz", "poses": tmp_path, "shards": plan / "shards",
               "catalogue": tmp_path / "indenters.json", "sensors": tmp_path / "sensors.json", "resolution": "1x1",
               "params": tmp_path / "dataset.json", "out": out}  # fmt: skip
    out.parent.mkdir(parents=True)
    words = [word for name, value in command.items() for word in (f"--{name}", str(value))]
    ran = subprocess.run(
        [sys.executable, "-m", "gelforge.stages.dataset", *words], capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    about = json.loads(out.read_text())
    assert about["grid"] == [1, 1] and about["samples"] == 4 * 23 and {"train", "val", "test"} == set(about["splits"])
    write_json(tmp_path / "models.json", {"small": {"kind": "resnet", "blocks": [1, 1], "widths": [8, 16]}})
    write_stage(tmp_path, "train", train={**plain(SETTINGS), "epochs": 1, "shift_cells": 0})
    command = {"dataset": out.parent, "model": "small", "models": tmp_path / "models.json", "params": tmp_path / "train.json",
               "out": tmp_path / "small.onnx.part"}  # fmt: skip
    words = [word for name, value in command.items() for word in (f"--{name}", str(value))]
    ran = subprocess.run(
        [sys.executable, "-m", "gelforge.stages.train", *words], capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    assert load_model(tmp_path / "small.onnx.part").metadata["grid"] == [1, 1]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('image = "/a"', "wrench is missing"),
        (TOML + "colour = 1", "colour is not known"),
        (TOML.replace("[0, 1, 0]", "[0, 2, 0]"), "a rotation"),
        (TOML.replace("[-1, 0, 0]", "[1, 0, 0]"), "no mirror"),
        (TOML + 'touch_n = "0.2 N"', "touch_n"),
        (TOML + "touch_n = [0.2]", "touch_n"),
        (TOML + "touch_n = nan", "touch_n"),
        (TOML + f"touch_n = {10**400}", "touch_n"),
        (TOML + f"latest_s = {10**400}", "latest_s is above 0"),
        (TOML.replace("[0, 1, 0]", f"[0, {10**400}, 0]"), "a rotation"),
        (TOML + 'sensor = ["gelsight_mini"]', "one name"),
        (TOML.replace("every = 2", "every = 0"), "whole number from 1"),
        (TOML.replace("sign = -1", "sign = 3"), "sign is 1 or -1"),
    ],
)
def test_wrong_topics_are_one_sentence(tmp_path, text, said):
    with pytest.raises(BadInput, match=said):
        topics(tmp_path, text)


@pytest.mark.parametrize("harm", ["cut", "text", "a time beyond all clocks", "no such topic", "no such file"])
def test_a_recording_that_cannot_be_used_leaves_nothing(tmp_path, harm, sensor):
    path = tmp_path / "a.mcap"
    record(path, pictures(6), start=2**63 if harm == "a time beyond all clocks" else 10**18)
    names = topics(tmp_path, TOML.replace("/ft/wrench", "/nothing") if harm == "no such topic" else TOML)
    if harm == "cut":
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    elif harm == "text":
        path.write_text("not a recording")
    elif harm == "no such file":
        path = tmp_path / "b.mcap"
    with pytest.raises(BadInput):
        import_recordings(path, tmp_path / "lab", names, sensor)
    assert not [found for found in tmp_path.iterdir() if "lab" in found.name]


@pytest.mark.parametrize("compression", ["NONE", "LZ4", "ZSTD"])
def test_a_corrupt_recording_is_read_or_refused(tmp_path, compression):
    """Its readers raise errors of their own, of struct, of both compressions and of the definitions of ROS 2."""
    from mcap.writer import CompressionType
    from mcap_ros2.writer import Writer

    path, rng = tmp_path / "a.mcap", np.random.default_rng(3)
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=2000, compression=CompressionType[compression])
        wrench = writer.register_msgdef(
            "geometry_msgs/msg/WrenchStamped", ros.schema("geometry_msgs/msg/WrenchStamped")
        )
        zero = dict.fromkeys("xyz", 0.0)
        for time in range(0, 10**9, 10**8):
            said = {"header": ros.header(time, "gel"), "wrench": {"force": zero, "torque": zero}}
            writer.write_message("/ft", wrench, said, log_time=time, publish_time=time)
        writer.finish()
    whole, refused = path.read_bytes(), 0
    assert len(list(messages(path, "/ft"))) == 10
    for _ in range(100):
        harmed = bytearray(whole)
        harmed[rng.integers(len(harmed))] ^= int(rng.integers(1, 256))
        path.write_bytes(harmed)
        try:
            list(messages(path, "/ft"))
        except BadInput as error:
            refused += 1
            # a byte of the encoding's name leaves a whole file of another kind of message
            reported = ("a.mcap: cannot be read as MCAP", "a.mcap: topic /ft holds no ROS 2 messages")
            assert any(each in str(error) for each in reported)
    assert refused > 20


def test_what_is_not_named_is_asked_for(tmp_path):
    with pytest.raises(BadInput, match="FROM="):
        mcap_import(["--from", str(tmp_path / "none"), "--topics", "", "--data", str(tmp_path / "lab")])


def test_the_nearest_wrench_is_taken_within_its_time():
    times = np.array([0, 100, 200])
    assert [nearest(times, time, 40) for time in (-10, 60, 149, 151, 239, 241)] == [0, 1, None, None, 2, None]
    assert nearest(np.array([], np.int64), 5, 10) is None


def publish_feats(folder, outside=False):
    rng = np.random.default_rng(4)
    for k in range(18):
        split = SPLITS[k % 6] if not (outside and k == 17) else "."
        image, label = rng.integers(0, 255, (240, 320, 3), np.uint8), rng.normal(0, 0.1, (3, 4, 5))
        write_label(folder / split / f"p{k}.npy", LabelSample(image, label))


def test_a_published_dataset_keeps_its_six_splits(tmp_path, sensor):
    publish_feats(tmp_path / "feats")
    import_folder(tmp_path / "feats", tmp_path / "lab", sensor)
    splits = {row["sample_id"]: row["split"] for row in read_csv(tmp_path / "lab" / "splits.csv")}
    assert splits == {f"p{k}": SPLITS[k % 6] for k in range(18)}


def test_files_outside_of_the_splits_are_asked_about(tmp_path, sensor):
    publish_feats(tmp_path / "feats", outside=True)
    with pytest.raises(BadInput, match="lies in none of the folders"):
        import_folder(tmp_path / "feats", tmp_path / "lab", sensor)
    assert not (tmp_path / "lab").exists()


def publish_raw(folder, split):
    """Raw samples of the presses that `publish_feats` laid into a folder, without their labels."""
    for path in sorted(folder.rglob("p*.npy")):
        raw = {
            "gs_img": read_sample(path).image,
            "indenter": "sphere_15",
            **dict.fromkeys([*POSE_FIELDS, *FORCE_FIELDS], 0.0),
        }
        (folder / split).mkdir(exist_ok=True)
        np.save(folder / split / f"raw_{path.name}", raw, allow_pickle=True)


def test_raw_samples_beside_the_splits_leave_them_as_published(tmp_path, sensor):
    """They come first, and knew of no split: all presses were then split anew, without a word."""
    publish_feats(tmp_path / "feats")
    publish_raw(tmp_path / "feats", "raw")
    import_folder(tmp_path / "feats", tmp_path / "lab", sensor)
    splits = {row["sample_id"]: row["split"] for row in read_csv(tmp_path / "lab" / "splits.csv")}
    assert splits == {f"raw_p{k}": SPLITS[k % 6] for k in range(18)}


def test_a_press_of_two_splits_is_asked_about(tmp_path, sensor):
    publish_feats(tmp_path / "feats")
    publish_raw(tmp_path / "feats", "train")
    with pytest.raises(BadInput, match="lie in train and"):
        import_folder(tmp_path / "feats", tmp_path / "lab", sensor)
    assert not (tmp_path / "lab").exists()


def test_readings_that_are_no_numbers_are_left_out(tmp_path, sensor):
    """As pictures without a wrench: one of them would spoil the whole dataset's labels."""
    from mcap_ros2.writer import Writer

    with (tmp_path / "holes.mcap").open("wb") as stream:
        writer = Writer(stream)
        image = writer.register_msgdef(
            "sensor_msgs/msg/CompressedImage", ros.schema("sensor_msgs/msg/CompressedImage")
        )
        wrench = writer.register_msgdef(
            "geometry_msgs/msg/WrenchStamped", ros.schema("geometry_msgs/msg/WrenchStamped")
        )
        for k, picture in enumerate(pictures(6)):
            time = 10**18 + k * 50_000_000
            data = cv2.imencode(".png", picture[..., ::-1])[1].tobytes()
            said = {"header": ros.header(time, "gel"), "format": "png", "data": data}
            writer.write_message("/gel/image", image, said, log_time=time, publish_time=time)
            force = {"x": 0.0, "y": float("nan") if k == 2 else 0.0, "z": 1.0}
            said = {
                "header": ros.header(time, "gel"),
                "wrench": {"force": force, "torque": dict.fromkeys("xyz", 0.0)},
            }
            writer.write_message("/ft/wrench", wrench, said, log_time=time, publish_time=time)
        writer.finish()
    (tmp_path / "in").mkdir()
    (tmp_path / "holes.mcap").rename(tmp_path / "in/holes.mcap")
    found = import_recordings(tmp_path / "in", tmp_path / "lab", topics(tmp_path), sensor)
    assert found["images"] == 2 and found["without_wrench"] == 1  # every second one is taken
    assert np.isfinite(read_labels(tmp_path / "lab/labels/1x1.npz").label).all()
