"""FEATS' files: samples and labels in, labels and normalisation out, and what is refused."""

import os
import shutil
import subprocess
import sys

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gelforge.commands import feats
from gelforge.flow.files import read_csv, write_csv
from gelforge.formats.feats_folder import export_dataset, import_folder
from gelforge.formats.featsfile import (
    FORCE_FIELDS,
    POSE_FIELDS,
    LabelSample,
    RawSample,
    read_normalisation,
    read_sample,
    write_label,
    write_normalisation,
)
from gelforge.labelling.sensor import load_sensors
from gelforge.learning.data import open_data
from gelforge.records.labelfile import read_labels
from gelforge.records.samplefile import SPLITS, read_samples
from tests.support.pressed_dataset import collect, label, write_pressed
from tests.support.refused import refused

IMAGE = np.random.default_rng(0).integers(0, 255, (240, 320, 3), np.uint8)
RAW = {
    "gs_img": IMAGE,
    "indenter": "sphere_15",
    "x_0": 1.0,
    "y_0": -2.0,
    "z_0": 0.0,
    "d_x": 0.1,
    "d_y": 0.0,
    "d_z": -1.5,
    "deg": 30.0,
    "f_x": np.float64(0.2),
    "f_y": 0.1,
    "f_z": -7.5,
    "m_x": 0.01,
    "m_y": 0.0,
    "m_z": 0.0,
}
GRID = np.random.default_rng(1).normal(0, 0.1, (24, 32))
GRIDS = {"x": GRID, "y": 2 * GRID, "z": -np.abs(GRID)}
LABEL = {"gs_img": IMAGE}
LABEL |= {f"grid_{axis}": grid for axis, grid in GRIDS.items()} | {
    f"f_{axis}": grid.sum() for axis, grid in GRIDS.items()
}


def save(path, value):
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, value, allow_pickle=True)
    return path


@pytest.fixture
def sensor(root, monkeypatch):
    monkeypatch.chdir(root)
    return load_sensors("workflow/sensors.toml")["feats_mini"]


def test_the_reference_label_file(reference):
    sample = read_sample(reference / "feats/images/nocontact_train_sensor.npy")
    assert isinstance(sample, LabelSample) and sample.label.shape == (3, 24, 32) and not sample.label.any()


def test_the_reference_normalisation(reference):
    ranges = read_normalisation(reference / "feats/images/normalization_08042025_122519.npy")
    assert set(ranges) == {"gs_img", "grid_x", "grid_y", "grid_z", "f_x", "f_y", "f_z"}
    assert ranges["f_z"] == {"min": pytest.approx(-73.294363), "max": 0.0}


def test_raw_samples_come_under_our_columns(tmp_path):
    sample = read_sample(save(tmp_path / "a.npy", RAW))
    assert isinstance(sample, RawSample) and np.array_equal(sample.image, IMAGE)
    assert sample.values["dz_mm"] == -1.5 and sample.values["fz_n"] == -7.5 and sample.values["rot_deg"] == 30.0


BAD_FIELDS = (
    (RAW, {"d_z": None}, "d_z.*finite number"),
    (RAW, {"d_z": float("nan")}, "d_z.*nan"),
    (RAW, {"x_0": 10**400}, "x_0.*finite number"),
    (RAW, {"f_x": "strong"}, "f_x.*strong"),
    (RAW, {"indenter": 3}, "indenter"),
    (RAW, {"deg": True}, "deg"),
    (RAW, {"gs_img": IMAGE.astype(float)}, "gs_img.*float64"),
    (RAW, {"gs_img": IMAGE[..., 0]}, "gs_img"),
    (LABEL, {"grid_x": GRID[:5]}, "grid_y.*must agree"),
    (LABEL, {"grid_z": GRID * np.nan}, "grid_z.*NaN"),
    (LABEL, {"f_z": 3.0}, "f_z.*sum"),
    (LABEL, {"grid_y": "x"}, "grid_y"),
)


def test_bad_fields_are_named(tmp_path):
    for base, change, said in BAD_FIELDS:
        refused(f"bad.npy.*{said}", read_sample, save(tmp_path / "bad.npy", {**base, **change}))


def test_cells_of_half_precision_are_summed_exactly(tmp_path):
    grid = (1e5 * np.abs(GRID)).astype(np.float16)
    grids, total = dict.fromkeys(("grid_x", "grid_y", "grid_z"), grid), grid.sum(dtype=float)
    held = {"gs_img": IMAGE, **grids, **dict.fromkeys(("f_x", "f_y", "f_z"), total)}
    assert read_sample(save(tmp_path / "half.npy", held)).label.sum() == pytest.approx(3 * total)
    refused("its cells sum to", read_sample, save(tmp_path / "half.npy", held | {"f_z": 1.01 * total}))


def test_missing_fields_are_named(tmp_path):
    path = save(tmp_path / "bad.npy", {name: value for name, value in RAW.items() if name != "x_0"})
    refused("bad.npy: field x_0 is missing", read_sample, path)
    refused("hold a dict of named fields", read_sample, save(tmp_path / "list.npy", np.zeros(3)))


@settings(max_examples=30)
@given(arrays(np.float32, (3, 4, 5), elements=st.floats(-100, 100, width=32)), arrays(np.uint8, (6, 7, 3)))
def test_labels_survive_the_round_trip(tmp_path_factory, grid, image):
    path = tmp_path_factory.mktemp("trip") / "a.npy"
    write_label(path, LabelSample(image, grid))
    back = read_sample(path)
    assert np.array_equal(back.label.astype(np.float32), grid) and np.array_equal(back.image, image)
    theirs = np.load(path, allow_pickle=True).item()  # our own file, written two lines above
    assert list(theirs) == ["gs_img", "grid_x", "grid_y", "grid_z", "f_x", "f_y", "f_z"]
    assert theirs["f_y"] == pytest.approx(grid[0].sum(dtype=float), abs=1e-9)


def test_normalisation_survives_the_round_trip(tmp_path):
    ranges = {"gs_img": {"min": 3.0, "max": 255.0}, "f_z": {"min": -73.25, "max": 0.5}}
    write_normalisation(tmp_path / "n.npy", ranges)
    assert read_normalisation(tmp_path / "n.npy") == ranges
    for other in ({"f_z": 3}, {3: ranges["f_z"]}, {b"f_z": ranges["f_z"]}):
        refused("not a normalisation file", read_normalisation, save(tmp_path / "m.npy", other))


def test_a_folder_becomes_a_dataset(tmp_path, sensor):
    source = tmp_path / "feats"
    save(source / "raw/20250408-122519.npy", RAW)
    save(source / "raw/20250408-122530.npy", {**RAW, "gs_img": IMAGE[::-1], "f_z": -3.0})
    save(source / "labels/train/press 1.npy", LABEL)
    save(source / "labels/normalization_08042025_122519.npy", {"f_z": {"min": -1.0, "max": 0.0}})
    found = import_folder(source, tmp_path / "data", sensor)
    assert found == {"presses": 2, "labels": {"24x32": 1}, "files": 4}
    rows = read_csv(tmp_path / "data/log.csv")
    joined = next(row for row in rows if row["fz_n"] == "-7.5")
    assert joined["sample_id"] == "press_1" and joined["time_utc"] == "2025-04-08T12:25:19Z"
    assert joined["sensor_id"] == "feats_mini" and float(joined["dz_mm"]) == -1.5
    image = cv2.imread(str(tmp_path / "data" / joined["image"]))
    assert np.array_equal(image[..., ::-1], IMAGE)
    labels = read_labels(tmp_path / "data/labels/24x32.npz")
    assert labels.sample_id.tolist() == ["press_1"]
    assert np.array_equal(labels.label[0], np.stack([2 * GRID, GRID, -np.abs(GRID)]).astype(np.float32))
    said = (tmp_path / "data/dataset.toml").read_text()
    assert 'sensor = "feats_mini"' in said and 'gel = "gelsight_mini"' in said


BAD_FOLDERS = (
    ({"a.npy": {**RAW, "gs_img": IMAGE[:100]}}, "a.npy.*gs_img.*320 x 100.*320 x 240"),
    ({"a.npy": LABEL, "b.npy": LABEL}, "b.npy.*same image.*a.npy|a.npy.*same image.*b.npy"),
    ({"a.npy": RAW, "b.npy": RAW}, "b.npy.*same image.*a.npy|a.npy.*same image.*b.npy"),
    ({"x/a.npy": RAW, "y/a.npy": {**RAW, "gs_img": IMAGE[::-1]}}, "a.npy.*(same|differ|name)"),
    ({}, "no .npy files"),
    ({"normalization_1.npy": {"f": {"min": 0, "max": 1}}}, "normalisation files only"),
    ({"a.npy": RAW, "b.npy": {**RAW, "d_z": "deep"}}, "b.npy.*d_z"),
)


def test_a_bad_folder_leaves_nothing_behind(tmp_path, sensor):
    for k, (files, said) in enumerate(BAD_FOLDERS):
        source, out = tmp_path / f"feats{k}", tmp_path / f"out{k}"
        source.mkdir()
        for name, value in files.items():
            save(source / name, value)
        refused(said, import_folder, source, out / "data", sensor)
        assert not out.exists() or not list(out.iterdir())


def test_a_hostile_file_stops_the_import(tmp_path, sensor):
    class Trap:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "ran"),)

    save(tmp_path / "feats/a.npy", RAW)
    save(tmp_path / "feats/evil.npy", np.array({"gs_img": Trap()}, dtype=object))
    refused("evil.npy: refused, it holds the name", import_folder, tmp_path / "feats", tmp_path / "data", sensor)
    assert not (tmp_path / "ran").exists() and not (tmp_path / "data").exists()


def test_an_existing_dataset_is_not_overwritten(tmp_path, sensor):
    (tmp_path / "data").mkdir()
    save(tmp_path / "feats/a.npy", RAW)
    refused("exists already", import_folder, tmp_path / "feats", tmp_path / "data", sensor)


def test_our_labels_go_out_and_come_back(tmp_path, sensor):
    made = write_pressed(tmp_path, count=12)
    label(made, "6x8")
    dataset = collect(made, "6x8")
    ranges = export_dataset(dataset, tmp_path / "feats/labels")
    write_normalisation(tmp_path / "feats/labels/normalization_ours.npy", ranges)
    data = open_data(dataset)
    for at, row in enumerate(s.cells() for s in data.table):
        back = read_sample(tmp_path / "feats/labels" / row["split"] / f"{row['sample_id']}.npy")
        assert np.array_equal(back.label.astype(np.float32), data.labels[at]) and np.array_equal(
            back.image, data.images[at]
        )
    import_folder(tmp_path / "feats", tmp_path / "again/data/back", sensor)
    again = read_labels(tmp_path / "again/data/back/labels/6x8.npz")
    order = [s.press.sample_id for s in data.table]
    assert sorted(order) == again.sample_id.tolist()
    assert np.array_equal(again.label, data.labels[np.argsort(order)])
    # Imported labels feed stage 60 without any stage before it.
    results = shutil.copytree(made["results"], tmp_path / "again/results/back")
    trained = open_data(collect({"results": results}, "6x8"))
    assert len(trained.table) == 12 and trained.info["c10"] == pytest.approx(0.0792)


def test_a_second_export_leaves_no_sample_of_the_first_in_another_split(tmp_path, sensor):
    made = write_pressed(tmp_path, count=12)
    label(made, "6x8")
    dataset, out = collect(made, "6x8"), tmp_path / "feats"
    export_dataset(dataset, out)
    (out / "mine").mkdir()
    (out / "mine" / "notes.npy").write_bytes(b"not ours")
    table = dataset / "samples.csv"
    rows = read_csv(table)
    # a split of one's own, as an imported dataset may have, is gone again at the last export
    for swapped in ({"train": "test", "test": "train"}, {"test": "field"}, {}):
        write_csv(table, list(rows[0]), [row | {"split": swapped.get(row["split"], row["split"])} for row in rows])
        export_dataset(dataset, out)
    there = {(path.parent.name, path.stem) for path in out.glob("*/*.npy")}
    assert there == {(s.split, s.press.sample_id) for s in read_samples(table)} | {("mine", "notes")}


def test_a_sensor_that_is_none_is_to_be_added_where_an_import_reads_it(tmp_path):
    """Not to a dataset's own file: before the import there may be no such folder."""
    asked = ["--from", str(tmp_path), "--data", str(tmp_path / "data"), "--sensor", "lab_a"]
    said = refused(r"'lab_a' is not in workflow/sensors.toml, which has .*add it there", feats.bring_in, asked)
    assert "own sensors.toml" not in said


@pytest.mark.processes
def test_the_command_names_what_is_missing(root):
    done = subprocess.run(
        [sys.executable, "-m", "gelforge.commands.feats", "import", "--from", "", "--data", "data/x"],
        cwd=root,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2 and "FROM=folder" in done.stderr and "Traceback" not in done.stderr
    assert not (root / "data/x").exists()


def publish_feats(folder, outside=False):
    rng = np.random.default_rng(4)
    for k in range(18):
        split = SPLITS[k % 6] if not (outside and k == 17) else "."
        image, label = rng.integers(0, 255, (240, 320, 3), np.uint8), -rng.uniform(0, 0.1, (3, 4, 5))
        write_label(folder / split / f"p{k}.npy", LabelSample(image, label))


def test_a_published_dataset_keeps_its_six_splits(tmp_path, sensor):
    publish_feats(tmp_path / "feats")
    import_folder(tmp_path / "feats", tmp_path / "lab", sensor)
    splits = {row["sample_id"]: row["split"] for row in read_csv(tmp_path / "lab" / "splits.csv")}
    assert splits == {f"p{k}": SPLITS[k % 6] for k in range(18)}


def test_files_outside_of_the_splits_are_asked_about(tmp_path, sensor):
    publish_feats(tmp_path / "feats", outside=True)
    refused("is in none of the folders", import_folder, tmp_path / "feats", tmp_path / "lab", sensor)
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
    refused("lie in train and", import_folder, tmp_path / "feats", tmp_path / "lab", sensor)
    assert not (tmp_path / "lab").exists()


def test_numbers_beyond_the_limits_of_a_log_are_named(tmp_path, sensor):
    pulls, large = 3 * np.abs(GRID), -99 * np.abs(GRID)
    for base, change, said in (
        (RAW, {"f_z": -684.0}, "field f_z is -684, larger than 500; check the unit"),
        (RAW, {"d_x": 2000.0}, "field d_x is 2000, larger than 1000"),
        (LABEL, {"grid_z": pulls, "f_z": pulls.sum()}, "field f_z is .*pulls"),
        (LABEL, {"grid_z": large, "f_z": large.sum()}, "field f_z is .*larger than 500"),
    ):
        save(tmp_path / "feats/a.npy", base | change)
        refused(f"a.npy: {said}", import_folder, tmp_path / "feats", tmp_path / "data", sensor)
        assert not (tmp_path / "data").exists()
