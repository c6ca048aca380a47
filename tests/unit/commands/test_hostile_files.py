"""Files of others: what cannot be used is refused in a sentence, quickly, and keeps no good sample out."""

import io
import json
import os
import struct
import zipfile
import zlib

import cv2
import numpy as np
import pytest

from gelforge.calibration.readings import read_readings
from gelforge.commands import look, predict, sample
from gelforge.commands.projection import read_picture
from gelforge.errors import BadInput, GelforgeError, printable
from gelforge.formats.mcap_import import messages
from gelforge.formats.numpy_pickle import read_npy
from gelforge.networks.checkpoint.modelfile import load_model, property_of
from gelforge.networks.inference.predictor import load_for_use
from gelforge.networks.uncertainty.ood import LIMITS
from gelforge.records import log
from gelforge.records.film import open_source
from gelforge.records.image import bad_image, read_image
from gelforge.records.labelfile import read_labels
from gelforge.records.press import COLUMNS, RawRow, parse
from gelforge.records.samplefile import read_samples
from gelforge.records.solvetable import read_solves
from gelforge.records.table import numbered_rows
from gelforge.stages.calibrate import load_rejected
from gelforge.stages.plan import write_shards
from tests.support.films import write_film
from tests.support.press_records import log_line, press_record, write_lines

ESCAPES = "a\x1b[2Jb\n\u202ec"


def judged(path):
    """Good ids and (row, reason) of rejections of a log, as stage 10 has them."""
    parsed = [parse(raw, "log.csv") for raw in log.read_log(path)]
    good, doubled = log.without_duplicates([press for press, _ in parsed if press], "log.csv")
    wrong = [r for _, found in parsed for r in found] + doubled
    return [press.sample_id for press in good], sorted((r.row, r.reason) for r in wrong)


def test_every_reader_of_a_log_counts_its_lines(tmp_path):
    """A blank line is a line: stage 10, its shards and calibration name the same row."""
    lines = [log_line(sample_id="s1", fz_n=-1), "", log_line(sample_id="s2", fz_n=-2, dz_mm="deep"),
             log_line(sample_id="s3", fz_n=-3)]  # fmt: skip
    path = write_lines(tmp_path / "log.csv", *lines)
    write_shards(tmp_path, log.read_log(path), tmp_path / "plan", 8)
    rows = log.read_shard(tmp_path / "plan/shards/0000.csv")
    assert [(row.row, row.cells["sample_id"]) for row in rows] == [(2, "s1"), (4, "s2"), (5, "s3")]
    wrong = [r for row in rows for r in parse(row, "log.csv")[1]]
    assert [(r.row, r.sample_id) for r in wrong] == [(4, "s2")]
    log.write_rejections(tmp_path / "0000.rejected.csv", wrong)
    readings = read_readings(path, load_rejected(tmp_path, ["0000"]))
    assert readings.ids.tolist() == ["s1", "s3"] and readings.rows.tolist() == [2, 5]


def test_ids_that_differ_by_blanks_are_one(tmp_path):
    path = write_lines(
        tmp_path / "log.csv", log_line(sample_id="a"), log_line(sample_id="b"), log_line(sample_id="a ")
    )
    assert write_shards(tmp_path, log.read_log(path), tmp_path / "plan", 2) == ["0000"]
    assert judged(path) == (["a", "b"], [(4, "an earlier row has the same sample_id")])


def test_a_column_that_stands_twice_is_refused(tmp_path):
    columns = (*COLUMNS, "x0_mm")
    path = write_lines(tmp_path / "log.csv", log_line(columns), columns=columns)
    with pytest.raises(BadInput, match=r"column x0_mm stands 2 times"):
        log.read_log(path)


def test_columns_of_other_names_are_not_read(tmp_path):
    """One is called as a column of the shards' own files, two have no name at all."""
    columns = ("row", *COLUMNS, "fault", "", "")
    line = ",".join(["seven", log_line(), "none", "", ""])
    path = write_lines(tmp_path / "log.csv", line, columns=columns)
    write_shards(tmp_path, log.read_log(path), tmp_path / "plan", 8)
    row = log.read_shard(tmp_path / "plan/shards/0000.csv")[0]
    assert (row.row, row.fault) == (2, "") and parse(row, "log.csv")[0] is not None


def test_a_log_of_another_separator_says_so(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text((",".join(COLUMNS) + "\n" + log_line()).replace(",", ";"))
    with pytest.raises(BadInput, match="separate cells by commas, not by ';'"):
        log.read_log(path)


def test_a_misspelt_optional_column_is_named(tmp_path):
    columns = (*COLUMNS, "pressid")
    path = write_lines(tmp_path / "log.csv", log_line() + ",p1", columns=columns)
    with pytest.raises(BadInput, match="'pressid' is unknown; write press_id"):
        log.read_log(path)


def test_a_quotation_mark_that_stays_open_keeps_out_its_own_row_alone(tmp_path):
    lines = [log_line(sample_id="a"), log_line(sample_id="b", image='"images/b.png'), log_line(sample_id="c"),
             log_line(sample_id="d", gel_id='"g'), log_line(sample_id="e")]  # fmt: skip
    good, wrong = judged(write_lines(tmp_path / "log.csv", *lines))
    assert good == ["a", "c", "e"] and [row for row, _ in wrong] == [3, 5]


def test_notes_of_several_lines_are_no_fault(tmp_path):
    columns = (*COLUMNS, "notes")
    lines = [log_line(sample_id="a") + ',"two\nlines"', log_line(sample_id="b") + ","]
    path = write_lines(tmp_path / "log.csv", *lines, columns=columns)
    assert judged(path) == (["a", "b"], []) and [row.row for row in log.read_log(path)] == [2, 4]


def test_a_cell_of_a_book_keeps_out_its_own_row_alone(tmp_path):
    lines = [log_line(sample_id="a"), log_line(sample_id="b", gel_id="x" * 200_000), log_line(sample_id="c")]
    path = write_lines(tmp_path / "log.csv", *lines)
    good, wrong = judged(path)
    assert good == ["a", "c"] and [row for row, _ in wrong] == [3] and "131072" in wrong[0][1]
    write_shards(tmp_path, log.read_log(path), tmp_path / "plan", 8)
    assert log.read_shard(tmp_path / "plan/shards/0000.csv")[1].fault == "long_cell"


def test_a_header_of_a_book_is_refused(tmp_path):
    """A file of one long line, as JSON often is, is no log."""
    (tmp_path / "log.csv").write_text("x" * 200_000 + "\n")
    with pytest.raises(BadInput, match="header has a cell of more than 131072"):
        log.read_log(tmp_path / "log.csv")


@pytest.mark.parametrize("read", [read_solves, read_samples, log.rejected_rows])
def test_a_table_that_lost_all_its_bytes_is_not_one_without_rows(tmp_path, read):
    (tmp_path / "0000.csv").write_bytes(b"")
    with pytest.raises(BadInput, match="0000.csv: is empty"):
        read(tmp_path / "0000.csv")


@pytest.mark.parametrize("name", ["..", "../../../x", "a/b", "$(touch f)", "", "-rf", "a" * 101, ESCAPES])
def test_a_sample_id_that_may_name_no_file_never_does(tmp_path, name, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for run in (lambda: sample.main(["--dataset", "demo", f"--id={name}", "--steps", "x"]),
                lambda: look.main(["--data", "data/demo", "--results", "results/demo", f"--id={name}"])):  # fmt: skip
        with pytest.raises(BadInput) as refused:
            run()
        assert str(refused.value).isprintable()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("text", [ESCAPES, "\x00", "\x9b31m", "\udc80", "\u2028", "plain words, ümlaut"])
def test_what_is_shown_obeys_no_text_of_others(text):
    assert printable(text).isprintable()
    assert str(GelforgeError(f"{text}: is wrong")).isprintable()
    rejection = parse(RawRow(2, press_record().cells() | {"sample_id": text, "x0_mm": text}), "log.csv")[1][0]
    assert str(rejection).isprintable() and rejection.sample_id.isprintable() and rejection.value.isprintable()
    assert printable("plain words, ümlaut") == "plain words, ümlaut"


@pytest.fixture
def pipe(tmp_path):
    """A named pipe that nobody writes into: whoever opens it waits until the time limit of tests."""
    os.mkfifo(tmp_path / "pipe.png")
    os.link(tmp_path / "pipe.png", tmp_path / "pipe.npy")
    return tmp_path / "pipe.png"


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


@pytest.mark.parametrize("name", ["a.png", "a.npz", "a.onnx", "log.csv", "a.mp4", "a.mcap"])
def test_a_git_lfs_pointer_is_reported_under_any_name(tmp_path, name):
    """A clone without git-lfs holds these in place of what was pushed."""
    path = tmp_path / name
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n")

    def film(path):
        with open_source(path, None):
            pass

    def recording(path):
        return list(messages(path, "/a"))

    readers = {".png": read_image, ".npz": read_labels, ".onnx": load_model, ".csv": log.read_log, ".mp4": film,
               ".mcap": recording}  # fmt: skip
    with pytest.raises(BadInput, match="git lfs pull"):
        readers[path.suffix](path)


@pytest.mark.parametrize("left", ["no index", "half", "whole"])
def test_a_film_without_its_index_is_reported(tmp_path, left):
    path = write_film(tmp_path / "a.mp4", [np.full((240, 320, 3), 20 * shade, np.uint8) for shade in range(10)])
    data = path.read_bytes()
    cut = {"no index": data.find(b"moov") - 4, "half": len(data) // 4, "whole": len(data)}[left]
    path.write_bytes(data[:cut])
    if left == "whole":
        with open_source(path, None) as (source, _):
            assert source.read()[0]
    else:
        with pytest.raises(BadInput, match="moov, is missing"), open_source(path, None):
            pass


@pytest.mark.parametrize("kind", [".png", ".tiff"])
def test_a_picture_of_sixteen_bits_is_refused(tmp_path, kind):
    """Those of a camera of 12 bits would be read as nearly black."""
    import cv2

    image = np.full((24, 32, 3), 100, np.uint8)
    cv2.imwrite(str(tmp_path / f"a{kind}"), image)
    assert np.array_equal(read_image(tmp_path / f"a{kind}"), image)
    cv2.imwrite(str(tmp_path / f"b{kind}"), image.astype(np.uint16) * 16)
    with pytest.raises(BadInput, match="16 bits a channel"):
        read_image(tmp_path / f"b{kind}")


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


@pytest.mark.parametrize("data", [giant_png(60_000), giant_png(20_000), giant_jpeg()], ids=["png", "smaller", "jpeg"])
def test_a_giant_picture_is_refused_before_it_is_decoded(tmp_path, data):
    (tmp_path / "giant.png").write_bytes(data)
    with pytest.raises(BadInput, match="4096 x 4096"):
        read_image(tmp_path / "giant.png")
    logged = bad_image(press_record(image="giant.png"), "log.csv", tmp_path, (320, 240)).reason
    assert ("has a size of" if data.startswith(b"\x89PNG") else "is not a PNG") in logged


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tiff", ".webp", ".ppm"])
def test_pictures_of_every_kind_are_read_as_before(tmp_path, suffix):
    picture = np.random.default_rng(1).integers(0, 255, (24, 32, 3), np.uint8)
    cv2.imwrite(str(tmp_path / f"p{suffix}"), picture)
    found = read_image(tmp_path / f"p{suffix}")
    assert np.array_equal(found, cv2.imread(str(tmp_path / f"p{suffix}"))[..., ::-1])


@pytest.mark.parametrize("flag", [["--threads", "0"], ["--threads", "-2"], ["--threads", "two"]])
def test_threads_are_counted_from_one(flag, capsys):
    with pytest.raises(SystemExit) as ended:
        predict.main(["a.png", *flag])
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
    "an unknown status": (lambda a: a.update(status=np.array(["OK", "FINE", "OK"])), "sample b: status 'FINE'"),
    "one id eight times": (lambda a: a.update(sample_id=np.array(["a", "a", "c"])), "sample a stands 2 times"),
    "no outside": (lambda a: a.pop("outside"), "array outside is missing"),
    "c10 below zero": (lambda a: a.update(c10=np.float64(-1)), "c10 = -1"),
    "two channels": (lambda a: a.update(label=a["label"][:, :2]), "do not fit each other"),
    "one label less": (lambda a: a.update(label=a["label"][:2]), "do not fit each other"),
    "labels of whole numbers": (lambda a: a.update(label=a["label"].astype(int)), "label is int64"),
    "a flat label": (lambda a: a.update(label=a["label"][0]), "which it cannot be"),
    "ids that are numbers": (lambda a: a.update(sample_id=np.arange(3)), "sample_id is int64"),
    "objects": (lambda a: a.update(status=np.array([{}, [], None], object)), "which it cannot be"),
}


@pytest.mark.parametrize("name", SPOILT)
def test_labels_of_others_are_checked(tmp_path, name):
    arrays = label_arrays()
    spoil, words = SPOILT[name]
    spoil(arrays)
    np.savez(tmp_path / "24x32.npz", **arrays)
    with pytest.raises(BadInput, match=words):
        read_labels(tmp_path / "24x32.npz")


def test_a_good_imported_label_file_is_read(tmp_path):
    np.savez_compressed(tmp_path / "24x32.npz", **label_arrays())
    found = read_labels(tmp_path / "24x32.npz")
    assert found.sample_id.tolist() == ["a", "b", "c"] and found.material == {"c10": 0.0792}


def test_forces_that_a_sensor_read_are_of_no_material(tmp_path):
    """What recordings bring with them says nothing of the gel's stiffness, and nobody reads one from it."""
    arrays = label_arrays()
    del arrays["c10"]
    np.savez(tmp_path / "1x1.npz", **arrays)
    assert read_labels(tmp_path / "1x1.npz").material == {}


def test_an_archive_that_would_fill_the_memory_is_refused(tmp_path):
    path, stream = tmp_path / "24x32.npz", io.BytesIO()
    np.lib.format.write_array_header_1_0(
        stream, {"descr": "<f4", "fortran_order": False, "shape": (3, 3, 10_000, 10_000)}
    )
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("label.npy", stream.getvalue() + bytes(2**20))
        for name, array in label_arrays().items():
            if name != "label":
                body = io.BytesIO()
                np.save(body, array)
                archive.writestr(f"{name}.npy", body.getvalue())
    with pytest.raises(BadInput, match="label claims"):
        read_labels(path)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("label.npy", "w") as member:
        for _ in range(1100):
            member.write(bytes(2**20))
    with pytest.raises(BadInput, match="would unpack to"):
        read_labels(path)


@pytest.mark.parametrize("data", [b"", b"PK\x03\x04", b"not a zip", bytes(range(256))])
def test_what_is_no_archive_is_refused(tmp_path, data):
    (tmp_path / "24x32.npz").write_bytes(data)
    with pytest.raises(BadInput, match="not a label shard"):
        read_labels(tmp_path / "24x32.npz")


@pytest.fixture(scope="module")
def model():
    """The model that ships."""
    return load_for_use(None)


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
    "an input that is a list": about(model__reads=["pair"]),
    "an input that is a table": about(model__reads={"pair": 1}),
    "an input that is a number": about(model__reads=6),
    "another input than its scales'": about(normalisation__reads="difference"),
    "scales of one picture": about(normalisation__reads="image"),
    "no input": without("model", "reads"),
    "an image of a wall": about(image=[10**6, 10**6]),
    "an image of no size": about(image=[0, 320]),
    "an image that is text": about(image="240x320"),
    "a grid that is none": about(grid=[24]),
    "a grid of fractions": about(grid=[24.0, 32.0]),
    "no scales": about(normalisation={}),
    "a scale of zero": about(normalisation__image_std=[0.1, 0.0, 0.1]),
    "scales that are text": about(normalisation__label=["a", "b", "c"]),
    "another input": about(normalisation__reads="sound"),
    "sensors that are numbers": about(known_sensors=[1, 2]),
    "no statistics": about(statistics=None),
    "a crooked matrix": about(statistics__inverse=[[1.0], [1.0, 2.0]]),
    "no means of its pictures": about(statistics__mean=None),
    "a spread of zero": about(statistics__spread=[0.0] * 18),
    "statistics of other pictures": about(
        statistics__mean=[1.0], statistics__spread=[1.0], statistics__inverse=[[1.0]]
    ),
    "no distance to a no-contact image": about(statistics__largest_distance=None),
    "a limit that is null": about(statistics__largest_relief=None),
    "a limit that is text": about(statistics__largest_residual="much"),
    "a limit that is a list": about(statistics__least_share=[0.5]),
    "a limit that is a table": about(statistics__largest_rim_px={}),
    "a limit that is true": about(statistics__largest_rim_lost=True),
    "a limit beyond all numbers": about(statistics__largest_uneven=float("inf")),
    "a limit of four hundred digits": about(statistics__largest_uneven=10**400),
    "intervals that are null": about(intervals=None),
    "distances of markers that are null": about(pitch_px=None),
    "a name that is a list": about(name=["x"]),
    "another format": about(format=99),
}


def rewritten(path, model, change):
    """The model's file with other metadata."""
    changed = dict(model.metadata)
    change(changed)
    path.write_bytes(model.graph + property_of(json.dumps(changed)))
    return path


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_model_is_refused_in_a_sentence(tmp_path, model, name):
    path = rewritten(tmp_path / "m.onnx", model, HOSTILE[name])
    with pytest.raises(BadInput, match=r"m\.onnx: .*(it again|the model again)$"):
        load_model(path)


def test_a_table_of_semicolons_and_decimal_commas_is_reported_what_parts_cells(tmp_path):
    """As spreadsheets write them where a comma is decimal."""
    (tmp_path / "r.csv").write_text("image;force_n\npeak.png;2,5\n")
    with pytest.raises(
        BadInput, match="row 2 has another number of cells.* with commas between the cells; write it anew"
    ):
        numbered_rows(tmp_path / "r.csv", "write it anew")


@pytest.mark.parametrize("name", LIMITS[1:])
def test_a_model_without_a_limit_is_read(tmp_path, model, name):
    """All but the distance, which every network of pairs has."""
    path = rewritten(tmp_path / "m.onnx", model, without("statistics", name))
    assert name not in load_model(path).metadata["statistics"]


@pytest.mark.parametrize("content", ["[1]", "3", "[]", "{" * 5000, "text"])
def test_a_file_whose_metadata_are_no_model_is_refused(tmp_path, model, content):
    (tmp_path / "m.onnx").write_bytes(model.graph + property_of(content))
    with pytest.raises(BadInput, match="not a gelforge model"):
        load_model(tmp_path / "m.onnx")
