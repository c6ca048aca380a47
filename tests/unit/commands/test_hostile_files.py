"""Files of others: what cannot be used is refused in a sentence, quickly, and keeps no good sample out."""

import json
import os
import struct
import zlib

import cv2
import numpy as np
import pytest

from gelforge.commands import look, predict, sample
from gelforge.commands.projection import read_picture
from gelforge.errors import BadInput
from gelforge.flow.files import write_csv
from gelforge.flow.layout import Layout
from gelforge.formats.featsfile import read_npy
from gelforge.formats.mcap_messages import messages
from gelforge.reading.model import load_model, property_of
from gelforge.records import log
from gelforge.records.film import open_source
from gelforge.records.image import bad_image, read_image
from gelforge.records.labelfile import read_labels
from gelforge.records.samplefile import read_samples
from gelforge.records.solvetable import read_solves
from gelforge.records.table import read_table
from tests.support.parameters import write_stage
from tests.support.press_records import press_record
from tests.support.refused import refused

ESCAPES = "a\x1b[2Jb\n\u202ec"


def test_a_table_that_lost_all_its_bytes_is_not_one_without_rows(tmp_path):
    (tmp_path / "0000.csv").write_bytes(b"")
    for read in (read_solves, read_samples):
        refused("0000.csv: is empty", read, tmp_path / "0000.csv")


def test_a_sample_id_that_may_name_no_file_never_does(tmp_path, monkeypatch):
    """Of a log that has a row of that name, which stage 10 rejects."""
    monkeypatch.chdir(tmp_path)
    of = Layout(tmp_path / "results/demo")
    for stage in ("poses", "forces"):
        write_stage(of.params, stage)
    names = ("..", "../../../x", "a/b", "$(touch f)", "", "-rf", "a" * 101, "a\x1b[2Jb\n\u202ec")
    for path in (of.shard_table, of.shard("0000")):
        write_csv(path, ["sample_id", "shard", "row"], [{"sample_id": name, "shard": 0, "row": 2} for name in names])
    there = sorted(tmp_path.rglob("*"))
    for name in names:
        said = "is not usable as a file name" if name else "no sample named"
        refused(said, sample.main, ["results/demo", f"--id={name}"])
        refused(said, look.main, ["--data", "data/demo", "--results", "results/demo", f"--id={name}"])
    assert sorted(tmp_path.rglob("*")) == there


@pytest.fixture
def pipe(tmp_path):
    """A named pipe that nobody writes into: whoever opens it waits until the time limit of tests."""
    os.mkfifo(tmp_path / "pipe.png")
    os.link(tmp_path / "pipe.png", tmp_path / "pipe.npy")
    return tmp_path / "pipe.png"


def test_a_device_is_no_picture(tmp_path):
    (tmp_path / "zero.png").symlink_to("/dev/zero")
    refused("zero.png", read_image, tmp_path / "zero.png")


def test_a_pipe_is_no_file(pipe, tmp_path):
    assert "a named pipe" in bad_image(press_record(image="pipe.png"), "log.csv", tmp_path, (320, 240)).reason
    readers = (read_image, read_labels, load_model, log.read_log, lambda p: read_npy(p.with_suffix(".npy")),
               lambda p: read_picture(p, (320, 240)), lambda p: read_picture(p.with_suffix(".npy"), (320, 240)))  # fmt: skip
    for read in readers:
        with pytest.raises(BadInput, match="named pipe"):
            read(pipe)


def test_a_link_that_leads_to_itself_is_rejected(tmp_path):
    (tmp_path / "loop.png").symlink_to(tmp_path / "loop.png")
    rejection = bad_image(press_record(image="loop.png"), "log.csv", tmp_path, (320, 240))
    assert rejection.column == "image" and "leads to itself" in rejection.reason
    with pytest.raises(BadInput, match=r"loop\.png"):
        read_image(tmp_path / "loop.png")


def test_a_git_lfs_pointer_is_reported_under_any_name(tmp_path):
    """A clone without git-lfs holds these in place of what was pushed."""

    def film(path):
        with open_source(path, None):
            pass

    def recording(path):
        return list(messages(path, ["/a"]))

    for name, read in (("a.png", read_image), ("a.npz", read_labels), ("a.onnx", load_model), ("log.csv", log.read_log),
                       ("a.mp4", film), ("a.mcap", recording)):  # fmt: skip
        (tmp_path / name).write_text("version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n")
        refused("git lfs pull", read, tmp_path / name)


def test_pictures_of_every_kind_are_read_and_those_of_sixteen_bits_refused(tmp_path):
    """Those of a camera of 12 bits would be read as nearly black."""
    picture = np.random.default_rng(1).integers(0, 255, (24, 32, 3), np.uint8)
    for kind in (".png", ".jpg", ".bmp", ".tiff", ".webp", ".ppm"):
        path = tmp_path / f"p{kind}"
        cv2.imwrite(str(path), picture)
        assert np.array_equal(read_image(path), cv2.imread(str(path))[..., ::-1]), kind
    for kind in (".png", ".tiff"):
        cv2.imwrite(str(tmp_path / f"t{kind}"), np.dstack([picture, np.full(picture.shape[:2], 9, np.uint8)]))
        assert np.array_equal(read_image(tmp_path / f"t{kind}")[..., ::-1], picture), kind  # transparency is left out
        cv2.imwrite(str(tmp_path / f"b{kind}"), picture.astype(np.uint16) * 16)
        refused("16 bits a channel", read_image, tmp_path / f"b{kind}")


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def giant_png(side: int) -> bytes:
    """A PNG of a few bytes that says it is `side` pixels wide and high."""
    header = struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(b"\0" * 999))
        + chunk(b"IEND", b"")
    )


def giant_jpeg() -> bytes:
    data = bytearray(cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes())
    at = data.index(b"\xff\xc0")
    data[at + 5 : at + 9] = struct.pack(">HH", 65000, 65000)
    return bytes(data)


def test_a_giant_picture_is_refused_before_it_is_decoded(tmp_path):
    for data, reason in (
        (giant_png(60_000), "4096 x 4096"),
        (giant_png(20_000), "4096 x 4096"),
        (giant_jpeg(), "is not a PNG"),
    ):
        (tmp_path / "giant.png").write_bytes(data)
        refused("4096 x 4096", read_image, tmp_path / "giant.png")
        assert reason in bad_image(press_record(image="giant.png"), "log.csv", tmp_path, (320, 240)).reason


def test_threads_are_counted_from_one(capsys):
    for count in ("0", "-2", "two"):
        with pytest.raises(SystemExit) as ended:
            predict.main(["a.png", "--threads", count])
        assert ended.value.code == 2 and "whole number above 0" in capsys.readouterr().err


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("in the way")
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((240, 320, 3), np.uint8))
    with pytest.raises(BadInput, match=r"--out .*file/out: cannot be written into"):
        image = str(tmp_path / "a.png")
        predict.main([image, "--nocontact", image, "--out", str(tmp_path / "file/out")])


N = 3


def label_arrays() -> dict:
    return {
        "sample_id": np.array(["a", "b", "c"]),
        "status": np.array(["OK", "OK", "DIVERGED"]),
        "label": np.zeros((N, 3, 4, 5), np.float32),
        "outside": np.full((N, 3), np.nan),
        "c10": np.float64(0.0792),
    }


def nan_in(arrays):
    arrays["label"][1, 2, 3, 4] = np.nan


SPOILT = {
    "a label that is not finite": (nan_in, "sample b has a label that is not finite"),
    "an unknown status": (
        lambda a: a.update(status=np.array(["OK", "FINE", "OK"])),
        "sample b: unknown status 'FINE'",
    ),
    "one id eight times": (lambda a: a.update(sample_id=np.array(["a", "a", "c"])), "sample a occurs 2 times"),
    "no outside": (lambda a: a.pop("outside"), "array outside is missing"),
    "c10 below zero": (lambda a: a.update(c10=np.float64(-1)), "c10 = -1"),
    "two channels": (lambda a: a.update(label=a["label"][:, :2]), "do not fit each other"),
    "one label less": (lambda a: a.update(label=a["label"][:2]), "do not fit each other"),
    "labels of whole numbers": (lambda a: a.update(label=a["label"].astype(int)), "label is int64"),
    "a flat label": (lambda a: a.update(label=a["label"][0]), "label is float32 .*expected 4-dimensional floats"),
    "ids that are numbers": (lambda a: a.update(sample_id=np.arange(3)), "sample_id is int64"),
    "objects": (lambda a: a.update(status=np.array([{}, [], None], object)), "array status: Object arrays"),
}


def test_labels_of_others_are_checked(tmp_path):
    path = tmp_path / "24x32.npz"
    for spoil, words in SPOILT.values():
        arrays = label_arrays()
        spoil(arrays)
        np.savez(path, **arrays)
        refused(words, read_labels, path)
    for data in (b"", b"PK\x03\x04", b"not a zip", bytes(range(256))):
        path.write_bytes(data)
        refused("not a label shard", read_labels, path)


def test_a_changed_bit_of_a_label_file_is_noticed(tmp_path):
    path, arrays = tmp_path / "24x32.npz", label_arrays()
    arrays["label"] = np.random.default_rng(5).normal(size=arrays["label"].shape).astype(np.float32)
    np.savez(path, **arrays)
    data = path.read_bytes()
    for at in range(0, len(data), 101):
        path.write_bytes(data[:at] + bytes([data[at] ^ 16]) + data[at + 1 :])
        try:
            assert np.array_equal(read_labels(path).label[...], arrays["label"]), at  # a byte that nothing reads
        except BadInput:
            pass


def test_good_imported_labels_are_read(tmp_path):
    """Forces that a sensor read say nothing of the gel's stiffness."""
    np.savez_compressed(tmp_path / "24x32.npz", **label_arrays())
    found = read_labels(tmp_path / "24x32.npz")
    assert found.sample_id.tolist() == ["a", "b", "c"] and found.material == {"c10": 0.0792}
    np.savez(tmp_path / "1x1.npz", **{name: array for name, array in label_arrays().items() if name != "c10"})
    assert read_labels(tmp_path / "1x1.npz").material == {}


@pytest.fixture(scope="module")
def model():
    """The model that ships."""
    return load_model(None)


def about(**changes):
    def change(model):
        for name, value in changes.items():
            table, _, key = name.partition("__")
            model[table] = {**model[table], key: value} if key else value

    return change


def without(table, key):
    def change(model):
        model[table] = {name: value for name, value in model[table].items() if name != key}

    return change


HOSTILE = {
    "another digest": about(sha256=64 * "0"),
    "a digest that is a table": about(sha256={}),
    "another kind": about(model__kind="transformer"),
    "a kind that is a list": about(model__kind=["grid"]),
    "a kind that is a number": about(model__kind=3),
    "no kind": without("model", "kind"),
    "an image of a wall": about(image=[10**6, 10**6]),
    "an image of no size": about(image=[0, 320]),
    "an image that is text": about(image="240x320"),
    "a grid that is none": about(grid=[24]),
    "a grid of fractions": about(grid=[24.0, 32.0]),
    "no scales": about(normalisation={}),
    "a scale of zero": about(normalisation__image_std=[0.1, 0.0, 0.1]),
    "scales that are text": about(normalisation__label=["a", "b", "c"]),
    "sensors that are numbers": about(known_sensors=[1, 2]),
    "no answer": about(answer=[]),
    "an answer beyond all numbers": about(answer=[float("inf")]),
    "an answer of four hundred digits": about(answer=[10**400]),
    "an answer that is text": about(answer="1.0"),
    "intervals that are null": about(intervals=None),
    "no view of cameras": about(frame=None),
    "distances of markers that are null": about(
        frame={"usual_px": 31.2, "pitch_px": None, "grid": [7, 9], "views": []}
    ),
    "moments of no camera": about(frame={"usual_px": 31.2, "pitch_px": [], "grid": [7, 9], "views": [[1, 2]]}),
    "a name that is a list": about(name=["x"]),
    "another format": about(format=99),
}


def rewritten(path, model, change):
    """The model's file with other metadata."""
    changed = dict(model.metadata)
    change(changed)
    path.write_bytes(model.graph.content + property_of(json.dumps(changed)))
    return path


def test_a_hostile_model_is_refused_in_a_sentence(tmp_path, model):
    for change in HOSTILE.values():
        path = rewritten(tmp_path / "m.onnx", model, change)
        refused(r"m\.onnx: .*(it again|the model again)$", load_model, path)
    for content in ("[1]", "3", "[]", "{" * 5000, "text"):
        path.write_bytes(model.graph.content + property_of(content))
        refused("not a gelforge model", load_model, path)


def test_a_table_of_semicolons_and_decimal_commas_is_reported_what_parts_cells(tmp_path):
    """As spreadsheets write them where a comma is decimal."""
    for mark in ";\t":
        (tmp_path / "r.csv").write_text(f"image{mark}force_n\na.png{mark}3,5\n")
        refused(
            "separate them by commas, and write decimals with a point; write it anew",
            read_table,
            tmp_path / "r.csv",
            "write it anew",
        )
