"""The raw log: every kind of bad cell, row and file is refused with its place and a hint, and keeps no good row out."""

import io
import re
import zipfile
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image

from gelforge.calibration.readings import read_readings
from gelforge.errors import GelforgeError, printable
from gelforge.flow.files import csv_text
from gelforge.flow.layout import Layout
from gelforge.records import log
from gelforge.records.image import bad_image, read_image
from gelforge.records.press import COLUMNS, FORCES, POSE, RawRow
from gelforge.records.press import parse as parse_row
from gelforge.stages.plan import write_shards
from tests.support.press_records import log_line, write_lines
from tests.support.refused import refused

GOOD = {"sample_id": "a1", "time_utc": "2025-04-08T12:25:19Z", "sensor_id": "gelsight_mini", "gel_id": "g1", "indenter": "sphere_15",
        "x0_mm": "0.5", "y0_mm": "-1", "z0_mm": "0", "dx_mm": "0.2", "dy_mm": "0", "dz_mm": "-1.25", "rot_deg": "30",
        **dict.fromkeys(("fx_n", "fy_n"), ""), "fz_n": "-6.5", **dict.fromkeys(("mx_nm", "my_nm", "mz_nm"), ""), "image": "images/a1.png"}  # fmt: skip
WHOLE = csv_text(list(GOOD), [GOOD])
HEADER = ",".join(COLUMNS)


def parse(row=2, **cells):
    return parse_row(RawRow(row, {**GOOD, **cells}), "data/lab/log.csv")


def line(**cells):
    return ",".join({**GOOD, **cells}[name] for name in COLUMNS)


def read(tmp_path, text):
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    return log.read_log(path)


def renamed(**names):
    """The good row under other names of columns."""
    cells = {names.get(name, name): value for name, value in GOOD.items()}
    return csv_text(list(cells), [cells])


def judged(path):
    """Good ids and (row, reason) of rejections of a log, as stage 10 has them."""
    parsed = [parse_row(raw, "log.csv") for raw in log.read_log(path)]
    good, doubled = log.without_duplicates([press for press, _ in parsed if press], "log.csv")
    wrong = [r for _, found in parsed for r in found] + doubled
    return [press.sample_id for press in good], sorted((r.row, r.reason) for r in wrong)


def test_good_row_is_typed():
    sample, wrong = parse()
    assert not wrong
    assert (sample.row, sample.x0_mm, sample.dz_mm, sample.fz_n, sample.fx_n) == (2, 0.5, -1.25, -6.5, None)
    assert sample.press.dz == -1.25
    assert parse(dz_mm="\u22120.75")[0].dz_mm == -0.75  # the minus sign of print
    assert parse(dz_mm="-0.00107", fz_n="-0.3")[0] is not None


BAD_CELLS = (
    ("x0_mm", "NaN", "not a finite number"),
    ("y0_mm", "inf", "not a finite number"),
    ("dz_mm", "1e999", "not a finite number"),
    ("dx_mm", "0,5", "decimals with a point"),
    ("dy_mm", "two", "not a finite number"),
    ("rot_deg", "1_0", "not a finite number"),
    ("rot_deg", "\u0661", "not a finite number"),
    ("x0_mm", "0x10", "not a finite number"),
    ("z0_mm", "", "is empty"),
    ("fz_n", "nan", "leave the cell empty"),
    ("x0_mm", "1e6", "check the unit"),
    ("fz_n", "-1666", "check the unit"),  # grams of force
    ("mx_nm", "-212.8", "check the unit"),  # newton millimetres
    ("dz_mm", "-0.00107", "check the unit"),  # metres beside newtons
    ("dz_mm", "0", "does not move towards the gel"),
    ("dz_mm", "1.25", "negative"),
    *(("sample_id", name, "file name") for name in ("", "../../etc/passwd", "a/b", ".hidden", "a b", "\u00e4", "a" * 101)),
    ("time_utc", "yesterday", "ISO 8601"),
    ("sensor_id", "", "is empty"),
    ("indenter", "", "is empty"),
)  # fmt: skip


def test_bad_cell_is_rejected_with_its_place_and_a_hint():
    for column, value, said in BAD_CELLS:
        sample, wrong = parse(**{column: value})
        assert sample is None and [r.column for r in wrong] == [column], (column, value)
        assert said in f"{wrong[0].reason}; {wrong[0].hint}", (column, value)
        assert (wrong[0].file, wrong[0].row) == ("data/lab/log.csv", 2) and wrong[0].hint
    _, wrong = parse(x0_mm="x", dz_mm="NaN", indenter="")
    assert sorted(r.column for r in wrong) == ["dz_mm", "indenter", "x0_mm"]  # all at once
    sample, _ = parse(sensor_id="mini_x", indenter="spere_15")
    wrong = log.unknown_names(sample, "log.csv", ["gelsight_mini"], ["sphere_15"])
    assert [(r.column, r.value) for r in wrong] == [("sensor_id", "mini_x"), ("indenter", "spere_15")]
    assert "did you mean sphere_15?" in wrong[1].hint
    for name, near in (("Sphere15", "sphere_15"), ("cuboid", "cuboid_10"), ("spoon", "")):
        (r,) = log.unknown_names(replace(sample, indenter=name), "log.csv", ["mini_x"], ["sphere_15", "cuboid_10"])
        assert (f"did you mean {near}?" in r.hint) if near else ("did you mean" not in r.hint)


def test_what_is_shown_obeys_no_text_of_others():
    for text in ("a\x1b[2Jb\n\u202ec", "\x00", "\x9b31m", "\udc80", "\u2028", "plain words, ümlaut"):
        assert printable(text).isprintable() and str(GelforgeError(f"{text}: is wrong")).isprintable()
        rejection = parse(sample_id=text, x0_mm=text)[1][0]
        assert str(rejection).isprintable() and rejection.sample_id.isprintable() and rejection.value.isprintable()
    assert printable("plain words, ümlaut") == "plain words, ümlaut"


def test_missing_columns_are_named(tmp_path):
    """Those that every press needs once, and not row by row; others before the cells that are too many."""
    for column in COLUMNS:
        sample, wrong = parse_row(RawRow(2, {k: v for k, v in GOOD.items() if k != column}), "log.csv")
        assert sample is None
        assert [(r.column, r.reason) for r in wrong] == [(column, "the column is missing in the header")]
    for column, instead in (("indenter", "indentor"), ("rot_deg", "rotation_deg")):
        said = f"column {column} is missing.*rename '{instead}'"
        refused(said, read, tmp_path, renamed(**{column: instead}))
    for image in ("images/a1.png", ""):
        (row,) = read(tmp_path, HEADER.replace("mx_nm,", "") + "\n" + line(image=image) + "\n")
        (tmp_path / "0000.csv").write_text(log.shard_text([row]))
        for each in (row, *log.read_shard(tmp_path / "0000.csv")):
            sample, wrong = parse_row(each, "log.csv")
            found = [(r.column, r.reason) for r in wrong]
            assert sample is None and found == [("mx_nm", "the column is missing in the header")]


def test_files_that_are_no_log_are_refused(tmp_path):
    path = tmp_path / "log.csv"
    refused("not found", log.read_log, path)
    for text, said in (
        ("", "no presses"),
        (HEADER + "\n", "no presses"),
        (
            (HEADER + "\n" + log_line()).replace(",", ";"),
            "cells are separated by ';'; separate them by commas, and write decimals with a point",
        ),
        ("sep=,\n" + WHOLE, "header is in line 2; remove the lines above it"),
        ("% ATI Nano17\n% N, N m\n\n" + WHOLE, "header is in line 4; remove the lines above it"),
        ("x" * 200_000 + "\n", "row 1: field larger than field limit"),  # one long line, as JSON often is
        (
            WHOLE + log_line(image='"images/b.png') + "\n" + log_line(sample_id="c") + "\n",
            "row 3: unexpected end of data; close each quot",
        ),
        (WHOLE + log_line(image='"images/b".png') + "\n", "row 3: .* expected after"),
        (WHOLE + log_line(gel_id="x" * 200_000) + "\n", "row 3: field larger than field limit"),
        (f"{HEADER},x0_mm\n{log_line()},1\n", "column x0_mm occurs 2 times"),
        (f"{HEADER},pressid\n{log_line()},p1\n", "'pressid' is unknown; write it as press_id"),
        (f"{HEADER},tilt_deg_x\n{log_line()},1\n", "'tilt_deg_x' is unknown; write it as tilt_x_deg"),
        ("depth_mm,fz\n0.3,-0.1\n", "seen: depth_mm, fz; workflow/guide/your-data.md lists the columns"),
        (renamed(image="Image", mz_nm="IMAGE"), "column image occurs 2 times"),
        *(
            (
                f"{HEADER},{twice}\n{log_line()},-9\n",
                rf"occurs 2 times in the header \({of}, {re.escape(twice)}\); keep one of them",
            )
            for twice, of in (("Fz [N]", "fz_n"), ("DZ-mm", "dz_mm"), ("IMAGE", "image"), ("Rot (deg)", "rot_deg"))
        ),
    ):
        refused(said, read, tmp_path, text)
    path.write_bytes(b"sample_id\n\xff\xfe\n")
    refused("UTF-8", log.read_log, path)
    with zipfile.ZipFile(path, "w") as workbook:  # as .xlsx and .ods are
        workbook.writestr("xl/workbook.xml", "<workbook/>")
    for data in (path.read_bytes(), b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(504)):  # and .xls
        path.write_bytes(data)
        refused("is a workbook of Excel or LibreOffice.*save it there as CSV", log.read_log, path)


def test_headers_and_rows_that_are_spelt_otherwise_are_read(tmp_path):
    """Capitals, blanks, dashes; quoted cells behind blanks; byte order marks."""
    quoted = "\n".join(", ".join(f'"{cell}"' for cell in cells) for cells in (GOOD, GOOD.values()))
    texts = [
        *(renamed(sample_id=name) for name in ("Sample_ID", "SAMPLE ID", "sample-id", "sample_Id ")),
        renamed(dz_mm="Dz mm", image="Image"),
        quoted + "\n",
        *("\ufeff" * marks + WHOLE for marks in (1, 2, 3)),
    ]
    for text in texts:
        (row,) = read(tmp_path, text)
        assert {name: row.cells[name] for name in GOOD} == GOOD and row.fault == "", text
        (tmp_path / "0000.csv").write_text(log.shard_text([row]))
        assert log.read_shard(tmp_path / "0000.csv") == [row]


def test_decimal_commas_do_not_shift_cells(tmp_path):
    """Cells behind one lie one too far right; a comma at the end of a row is one too many, too."""
    empty = {"my_nm": "", "mz_nm": "", "image": ""}
    for column, others in (("x0_mm", {}), *((name, empty) for name in ("x0_mm", "dz_mm", "fx_n", "mz_nm"))):
        (row,) = read(tmp_path, HEADER + "\n" + line(**others | {column: "0,5"}) + "\n")
        sample, wrong = parse_row(row, "log.csv")
        assert sample is None and "more" in wrong[0].reason and "decimals with a point" in wrong[0].hint
        (tmp_path / "0000.csv").write_text(log.shard_text([row]))
        assert log.read_shard(tmp_path / "0000.csv") == [row]
    _, wrong = parse_row(read(tmp_path, HEADER + "\n" + line(**empty) + ",\n")[0], "log.csv")
    assert "end rows as the header ends" in wrong[0].hint
    assert read(tmp_path, HEADER + ",\n" + line(**empty) + ",\n")[0].fault == ""


def test_a_row_that_is_wrong_keeps_out_itself_alone(tmp_path):
    rows = {
        "a cell too many": log_line(sample_id="b") + ",1",
        "header again": HEADER.upper(),
        "the same id": log_line(sample_id="a "),
    }
    for name, wrong in rows.items():
        path = write_lines(tmp_path / "log.csv", log_line(sample_id="a"), wrong, log_line(sample_id="c"))
        good, found = judged(path)
        assert good == ["a", "c"] and [row for row, _ in found] == [3], name
        write_shards(Layout(tmp_path / name), log.read_log(path), 8, {})
    assert "an earlier row has the same sample_id" in found[0][1]
    faults = [log.read_shard(Layout(tmp_path / name).shard("0000"))[1].fault for name in [*rows][:2]]
    assert faults == ["more_cells", "second_header"]


def test_every_reader_of_a_log_counts_its_lines(tmp_path):
    """A blank line is a line: stage 10, its shards and calibration name the same row."""
    lines = [log_line(sample_id="s1", fz_n=-1), "", log_line(sample_id="s2", fz_n=-2, dz_mm="deep"),
             log_line(sample_id="s3", fz_n=-3)]  # fmt: skip
    path = write_lines(tmp_path / "log.csv", *lines)
    write_shards(Layout(tmp_path / "plan"), log.read_log(path), 8, {})
    rows = log.read_shard(Layout(tmp_path / "plan").shard("0000"))
    assert [(row.row, row.cells["sample_id"]) for row in rows] == [(2, "s1"), (4, "s2"), (5, "s3")]
    wrong = [r for row in rows for r in parse_row(row, "log.csv")[1]]
    assert [(r.row, r.sample_id) for r in wrong] == [(4, "s2")]
    readings = read_readings(path, {r.row for r in wrong})
    assert readings.ids.tolist() == ["s1", "s3"] and readings.rows.tolist() == [2, 5]


def test_a_name_that_is_nearly_that_of_a_number_is_refused_with_the_right_name(tmp_path):
    """Without its unit, in another unit, in brackets: its values were ignored, or lost where the advice was followed."""
    for name in (*POSE, *FORCES, "tilt_x_deg", "tilt_y_deg"):
        stem, unit = name.rsplit("_", 1)
        for instead in (stem, f"{stem}_g", f"{stem}_inches", f"{stem} [{unit}]", f"{stem}({unit.upper()})"):
            columns = [instead if column == name else column for column in (*COLUMNS, "tilt_x_deg", "tilt_y_deg")]
            path = write_lines(tmp_path / "log.csv", log_line() + ",0,0", columns=columns)
            refused(f"column '{re.escape(instead)}' is unknown; write it as {name}, in ", log.read_log, path)
    beside = write_lines(
        tmp_path / "log.csv", log_line() + ",1,2,3", columns=(*COLUMNS, "fz_g", "fz_raw", "gel_batch")
    )
    assert log.read_log(beside)[0].cells.keys() == set(COLUMNS)


def test_a_quotation_mark_swallows_no_rows(tmp_path):
    """A ditto mark in two rows took all rows between into one cell."""
    rows = [
        log_line(sample_id=name) + f",{note}" for name, note in (("a", "new"), ("b", '"'), ("c", "x"), ("d", '"'))
    ]
    path = write_lines(tmp_path / "log.csv", *rows, columns=(*COLUMNS, "notes"))
    refused("row 3: a quotation mark opens a cell that ends in line 5", log.read_log, path)


def test_a_row_that_was_cut_is_refused_wherever_it_was_cut(tmp_path):
    """Cut to `…,-1` a force of -12.34 N was one of -1 N. A row that ends in an empty cell is whole."""
    whole = log_line(sample_id="b", fz_n=-12.34)
    for at in range(len("b,"), len(whole)):
        path = write_lines(tmp_path / "log.csv", log_line(sample_id="a"), whole[:at])
        good, wrong = judged(path)
        if whole[:at].count(",") == whole.count(","):  # of its last cell alone nothing tells
            continue
        assert good == ["a"] and "fewer cells" in str(wrong), whole[:at]
    assert judged(write_lines(tmp_path / "log.csv", log_line(sample_id="a", image=""))) == (["a"], [])


def test_columns_of_other_names_are_not_read(tmp_path):
    """One is called as a column of the shards' own files, two have no name at all."""
    columns = ("row", *COLUMNS, "fault", "", "")
    path = write_lines(tmp_path / "log.csv", ",".join(["seven", log_line(), "none", "", ""]), columns=columns)
    write_shards(Layout(tmp_path / "plan"), log.read_log(path), 8, {})
    row = log.read_shard(Layout(tmp_path / "plan").shard("0000"))[0]
    assert (row.row, row.fault) == (2, "") and parse_row(row, "log.csv")[0] is not None


def image_bytes(width=320, height=240, channels=3):
    shape = (height, width, channels) if channels > 1 else (height, width)
    return cv2.imencode(".png", np.full(shape, 128, np.uint8))[1].tobytes()


def of_palette(kind):
    stream = io.BytesIO()
    Image.fromarray(np.full((240, 320, 3), 128, np.uint8)).quantize(64).save(stream, kind)
    return stream.getvalue()


def test_a_picture_of_a_palette_is_refused(tmp_path):
    """The network reads a fifth less in one of 64 colours."""
    for kind in ("PNG", "BMP", "TIFF"):
        (tmp_path / "a.png").write_bytes(of_palette(kind))
        refused(
            "a.png: has a palette of at most 256 colours, .*save it in true colour", read_image, tmp_path / "a.png"
        )


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "set" / "images").mkdir(parents=True)
    (tmp_path / "secret.png").write_bytes(image_bytes())
    return tmp_path / "set"


def judge_image(folder, data=None, image="images/a1.png"):
    if data is not None:
        (folder / "images" / "a1.png").write_bytes(data)
    return bad_image(parse(image=image)[0], "log.csv", folder, (320, 240))


def test_bad_image_is_refused(folder):
    assert "cannot be read" in judge_image(folder).reason
    assert "cannot be read" in judge_image(folder, image="images").reason
    good = image_bytes()
    for data, said in (
        (b"", "is empty"),
        (b"GIF89a", "not a PNG"),
        (good[:200], "truncated"),
        (good[:-5], "truncated"),
        (good[:60] + b"\x00\x01\x02" + good[63:], "checksum"),
        (image_bytes(320, 241), "320 x 241"),
        (image_bytes(channels=1), "colour"),
        (of_palette("PNG"), "palette of at most 256 colours"),
    ):
        assert said in judge_image(folder, data).reason
    assert judge_image(folder, good) is None


def test_a_file_of_several_images_is_refused(tmp_path):
    """Of a TIFF of several pages, an animated WebP and an animated PNG the first image was read."""
    pages = [Image.fromarray(np.full((24, 32, 3), 40 * k, np.uint8)) for k in (1, 2)]
    for name in ("a.tiff", "a.webp", "a.png"):
        pages[0].save(tmp_path / name, save_all=True, append_images=pages[1:])
        refused(f"{name}: holds 2 images; save the one that is meant", read_image, tmp_path / name)


def test_image_path_stays_in_the_dataset(folder):
    for path in ("../secret.png", "images/../../secret.png", "/etc/passwd", "images/a\\b.png", ""):
        rejection = judge_image(folder, image=path)
        assert rejection.column == "image" and "cannot be read" not in rejection.reason
    image = folder / "images" / "a1.png"
    image.symlink_to(folder.parent / "secret.png")
    assert "leaves the dataset" in judge_image(folder).reason
    (folder.parent / "disk").mkdir()
    (folder.parent / "disk/a1.png").write_bytes(image_bytes())
    (folder.parent / "disk/b1.png").symlink_to(folder.parent / "secret.png")
    (folder / "linked").symlink_to(
        folder.parent / "disk"
    )  # a folder on another disk is the dataset's, what it links to is not
    assert judge_image(folder, image="linked/a1.png") is None
    assert "leaves the dataset" in judge_image(folder, image="linked/b1.png").reason
    assert "leaves the dataset" in judge_image(folder, image="linked/../../secret.png").reason
    image.unlink()
    (folder / "images" / "real.png").write_bytes(image_bytes())
    image.symlink_to(folder / "images" / "real.png")
    assert judge_image(folder) is None


def test_an_image_that_its_exif_turns_has_the_size_that_is_seen(folder):
    for orientation, size in ((1, ""), (3, ""), (6, "240 x 320"), (8, "240 x 320")):
        exif = Image.Exif()
        exif[0x0112] = orientation
        Image.fromarray(np.full((240, 320, 3), 90, np.uint8)).save(folder / "images" / "a1.png", exif=exif)
        rejection = judge_image(folder)
        assert (rejection is None) if not size else f"is {size} pixels" in rejection.reason
        seen = read_image(folder / "images" / "a1.png").shape[:2]
        assert seen == ((320, 240) if size else (240, 320))
