"""The raw log: every kind of bad cell is refused with its place and a hint."""

import cv2
import numpy as np
import pytest
from PIL import Image

from gelforge.errors import BadInput
from gelforge.records import log
from gelforge.records.image import bad_image, read_image
from gelforge.records.press import COLUMNS, RawRow
from gelforge.records.press import parse as parse_row

GOOD = {
    "sample_id": "a1",
    "time_utc": "2025-04-08T12:25:19Z",
    "sensor_id": "gelsight_mini",
    "gel_id": "g1",
    "indenter": "sphere_15",
    "x0_mm": "0.5",
    "y0_mm": "-1",
    "z0_mm": "0",
    "dx_mm": "0.2",
    "dy_mm": "0",
    "dz_mm": "-1.25",
    "rot_deg": "30",
    "fx_n": "",
    "fy_n": "",
    "fz_n": "-6.5",
    "mx_nm": "",
    "my_nm": "",
    "mz_nm": "",
    "image": "images/a1.png",
}


def parse(row=2, **cells):
    return parse_row(RawRow(row, {**GOOD, **cells}), "data/lab/log.csv")


def image_bytes(width=320, height=240, channels=3):
    shape = (height, width, channels) if channels > 1 else (height, width)
    return cv2.imencode(".png", np.full(shape, 128, np.uint8))[1].tobytes()


def test_good_row_is_typed():
    sample, wrong = parse()
    assert not wrong
    assert (sample.row, sample.x0_mm, sample.dz_mm, sample.fz_n, sample.fx_n) == (2, 0.5, -1.25, -6.5, None)
    assert sample.press.dz == -1.25


@pytest.mark.parametrize(
    ("column", "value", "says"),
    [
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
        ("fz_n", "1e9", "check the unit"),
        ("x0_mm", "1e6", "check the unit"),
        ("dz_mm", "0", "does not move towards the gel"),
        ("dz_mm", "1.25", "negative"),
        ("sample_id", "", "file name"),
        ("sample_id", "../../etc/passwd", "file name"),
        ("sample_id", "a/b", "file name"),
        ("sample_id", ".hidden", "file name"),
        ("sample_id", "a b", "file name"),
        ("sample_id", "\u00e4", "file name"),
        ("sample_id", "a" * 101, "file name"),
        ("time_utc", "yesterday", "ISO 8601"),
        ("sensor_id", "", "is empty"),
        ("indenter", "", "is empty"),
    ],
)
def test_bad_cell_is_rejected_with_its_place(column, value, says):
    sample, wrong = parse(**{column: value})
    assert sample is None
    assert [r.column for r in wrong] == [column]
    assert says in f"{wrong[0].reason}; {wrong[0].hint}"
    assert (wrong[0].file, wrong[0].row) == ("data/lab/log.csv", 2)
    assert wrong[0].hint


@pytest.mark.parametrize("column", COLUMNS)
def test_missing_column_is_named(column):
    row = {k: v for k, v in GOOD.items() if k != column}
    sample, wrong = parse_row(RawRow(2, row), "log.csv")
    assert sample is None
    assert [(r.column, r.reason) for r in wrong] == [(column, "the column is missing in the header")]


@pytest.mark.parametrize("image", ["images/a1.png", ""])
def test_a_name_that_the_header_lost_is_reported_before_the_cells_that_are_too_many(tmp_path, image):
    header = [name for name in COLUMNS if name != "mx_nm"]
    cells = [{**GOOD, "image": image}[name] for name in COLUMNS]
    (tmp_path / "log.csv").write_text(",".join(header) + "\n" + ",".join(cells) + "\n")
    (row,) = log.read_log(tmp_path / "log.csv")
    (tmp_path / "0000.csv").write_text(log.shard_text([row]))
    for read in (row, *log.read_shard(tmp_path / "0000.csv")):
        sample, wrong = parse_row(read, "log.csv")
        assert sample is None and [(r.column, r.reason) for r in wrong] == [
            ("mx_nm", "the column is missing in the header")
        ]


@pytest.mark.parametrize(
    ("column", "instead"), [("dz_mm", "dz"), ("indenter", "indentor"), ("rot_deg", "rotation_deg")]
)
def test_a_column_that_every_press_needs_under_another_name_is_refused_once(tmp_path, column, instead):
    """And not row by row, shard by shard."""
    row = {instead if name == column else name: value for name, value in GOOD.items()}
    path = tmp_path / "log.csv"
    path.write_text(log.csv_text(list(row), [row]))
    with pytest.raises(BadInput, match=f"column {column} is missing.*rename '{instead}'"):
        log.read_log(path)


@pytest.mark.parametrize(
    ("values", "column"),
    [
        ({"dz_mm": "-0.00107", "fz_n": "-16.3"}, "dz_mm"),
        ({"fz_n": "-1666"}, "fz_n"),
        ({"mx_nm": "-212.8"}, "mx_nm"),
    ],
)
def test_other_units_are_reported_where_no_gel_can_be_so(values, column):
    """Metres beside newtons, grams of force, newton millimetres."""
    press, wrong = parse(**values)
    assert press is None and [one.column for one in wrong] == [column] and "check the unit" in wrong[0].hint
    assert parse(dz_mm="-0.00107", fz_n="-0.3")[0] is not None


def test_all_faults_of_a_row_are_reported_at_once():
    _, wrong = parse(x0_mm="x", dz_mm="NaN", indenter="")
    assert sorted(r.column for r in wrong) == ["dz_mm", "indenter", "x0_mm"]


def test_decimal_commas_do_not_shift_cells(tmp_path):
    path = tmp_path / "log.csv"
    cells = [GOOD[name] for name in COLUMNS]
    cells[5] = "0,5"
    path.write_text(",".join(COLUMNS) + "\n" + ",".join(cells) + "\n")
    sample, wrong = parse_row(log.read_log(path)[0], "log.csv")
    assert sample is None
    assert "more cells" in wrong[0].reason
    shard = tmp_path / "0000.csv"
    shard.write_text(log.shard_text(log.read_log(path)))
    assert log.read_shard(shard) == log.read_log(path)


def test_later_duplicates_are_rejected():
    rows = [parse(row=n, sample_id=name)[0] for n, name in ((2, "a"), (3, "b"), (4, "a"))]
    good, wrong = log.without_duplicates(rows, "log.csv")
    assert [s.row for s in good] == [2, 3]
    assert [(r.row, r.column) for r in wrong] == [(4, "sample_id")]
    assert "row 2" in wrong[0].hint


def test_unknown_sensor_and_indenter():
    sample, _ = parse(sensor_id="mini_x", indenter="spere_15")
    wrong = log.unknown_names(sample, "log.csv", ["gelsight_mini"], ["sphere_15"])
    assert [(r.column, r.value) for r in wrong] == [("sensor_id", "mini_x"), ("indenter", "spere_15")]


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "set" / "images").mkdir(parents=True)
    (tmp_path / "secret.png").write_bytes(image_bytes())
    return tmp_path / "set"


def judge_image(folder, data=None, image="images/a1.png"):
    if data is not None:
        (folder / "images" / "a1.png").write_bytes(data)
    return bad_image(parse(image=image)[0], "log.csv", folder, (320, 240))


def test_good_image_is_taken(folder):
    assert judge_image(folder, image_bytes()) is None


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (None, "cannot be read"),
        (b"", "not a PNG"),
        (b"GIF89a", "not a PNG"),
        (image_bytes()[:200], "truncated"),
        (image_bytes()[:-1], "truncated"),
        (image_bytes()[:60] + b"\x00\x01\x02" + image_bytes()[63:], "checksum"),
        (image_bytes(320, 241), "320 x 241"),
        (image_bytes(channels=1), "colour"),
    ],
)
def test_bad_image_is_refused(folder, data, says):
    assert says in judge_image(folder, data).reason


@pytest.mark.parametrize("path", ["../secret.png", "images/../../secret.png", "/etc/passwd", "images/a\\b.png", ""])
def test_image_path_stays_in_the_dataset(folder, path):
    rejection = judge_image(folder, image=path)
    assert rejection.column == "image"
    assert "cannot be read" not in rejection.reason


def test_link_out_of_the_dataset_is_refused(folder):
    (folder / "images" / "a1.png").symlink_to(folder.parent / "secret.png")
    assert "leaves the dataset" in judge_image(folder).reason
    (folder / "linked").symlink_to(folder.parent)
    assert "leaves the dataset" in judge_image(folder, image="linked/secret.png").reason


def test_link_within_the_dataset_is_taken(folder):
    (folder / "images" / "real.png").write_bytes(image_bytes())
    (folder / "images" / "a1.png").symlink_to(folder / "images" / "real.png")
    assert judge_image(folder) is None


@pytest.mark.parametrize("there", ["a1.PNG", "A1.png", "A1.Png"])
def test_an_image_under_a_name_in_other_letters_is_named(folder, there):
    (folder / "images" / there).write_bytes(image_bytes())
    assert judge_image(folder).hint == f"write its name as it is there: {there}"


@pytest.mark.parametrize(("orientation", "size"), [(1, ""), (3, ""), (6, "240 x 320"), (8, "240 x 320")])
def test_an_image_that_its_exif_turns_has_the_size_that_is_seen(folder, orientation, size):
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(np.full((240, 320, 3), 90, np.uint8)).save(folder / "images" / "a1.png", exif=exif)
    rejection = judge_image(folder)
    assert (rejection is None) if not size else f"is {size} pixels" in rejection.reason
    seen = read_image(folder / "images" / "a1.png").shape[:2]
    assert seen == ((320, 240) if size else (240, 320))


def test_folder_as_image_is_refused(folder):
    assert "cannot be read" in judge_image(folder, image="images").reason


def test_empty_and_absent_logs_are_errors(tmp_path):
    path = tmp_path / "log.csv"
    with pytest.raises(BadInput, match="not found"):
        log.read_log(path)
    path.write_text("")
    with pytest.raises(BadInput, match="no presses"):
        log.read_log(path)
    path.write_text(",".join(COLUMNS) + "\n")
    with pytest.raises(BadInput, match="no presses"):
        log.read_log(path)
    path.write_bytes(b"sample_id\n\xff\xfe\n")
    with pytest.raises(BadInput, match="UTF-8"):
        log.read_log(path)


def test_rows_are_numbered_as_an_editor_shows_them(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(log.csv_text(list(GOOD), [GOOD, GOOD]))
    assert [row.row for row in log.read_log(path)] == [2, 3]


@pytest.mark.parametrize(
    "name", ["Sample_ID", "SAMPLE ID", "sample-id", "sample_Id "], ids=["capitals", "blank", "dash", "blank behind"]
)
def test_a_header_that_is_spelt_otherwise_is_read(tmp_path, name):
    path = tmp_path / "log.csv"
    renamed = {name if key == "sample_id" else key: cell for key, cell in GOOD.items()}
    path.write_text(log.csv_text(list(renamed), [renamed]))
    assert log.read_log(path)[0].cells == GOOD
    renamed = {"Dz mm" if key == "dz_mm" else "Image" if key == "image" else key: cell for key, cell in GOOD.items()}
    path.write_text(log.csv_text(list(renamed), [renamed]))
    assert log.read_log(path)[0].cells == GOOD


def test_quoted_cells_behind_blanks_are_read(tmp_path):
    path = tmp_path / "log.csv"
    quoted = [", ".join(f'"{cell}"' for cell in cells) for cells in (GOOD, GOOD.values())]
    path.write_text("\n".join([*quoted, ""]))
    assert log.read_log(path)[0].cells == GOOD


def test_a_first_line_for_excel_alone_is_named(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("sep=,\n" + log.csv_text(list(GOOD), [GOOD]))
    with pytest.raises(BadInput, match="seen: sep=, ; remove this line"):
        log.read_log(path)


def test_a_column_spelt_in_two_ways_is_refused_but_not_beside_its_own_name(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(log.csv_text([*GOOD, "Image"], [{**GOOD, "Image": "other.png"}]))
    assert log.read_log(path)[0].cells["image"] == GOOD["image"]
    others = {key: cell for key, cell in GOOD.items() if key != "image"} | {"Image": "a", "IMAGE": "b"}
    path.write_text(log.csv_text(list(others), [others]))
    with pytest.raises(BadInput, match="column image stands 2 times"):
        log.read_log(path)


@pytest.mark.parametrize("marks", [1, 2, 3])
def test_byte_order_marks_are_no_part_of_the_header(tmp_path, marks):
    path = tmp_path / "log.csv"
    path.write_text("\ufeff" * marks + log.csv_text(list(GOOD), [GOOD]), encoding="utf-8")
    assert log.read_log(path)[0].cells == GOOD


@pytest.mark.parametrize("commas", [",", ",,", ", ,"])
def test_commas_at_the_end_of_rows_are_no_cells(tmp_path, commas):
    path = tmp_path / "log.csv"
    lines = log.csv_text(list(GOOD), [{**GOOD, "image": "images/a.png"}]).splitlines()
    path.write_text("\n".join([lines[0], lines[1] + commas]))
    row = log.read_log(path)[0]
    assert (row.cells["image"], row.fault) == ("images/a.png", "") and parse_row(row, "log.csv")[0]
    shard = tmp_path / "0000.csv"
    shard.write_text(log.shard_text([row]))
    assert log.read_shard(shard) == [row]


@pytest.mark.parametrize("column", ["x0_mm", "dz_mm", "fx_n", "mz_nm"])
def test_a_decimal_comma_before_empty_cells_is_no_comma_at_the_end(tmp_path, column):
    """Cells behind it lie one too far right, and the last one is empty: taken for a comma at the end, forces would be wrong."""
    cells = {**GOOD, "my_nm": "", "mz_nm": "", "image": ""}
    line = ",".join("0,5" if name == column else cells[name] for name in COLUMNS)
    path = tmp_path / "log.csv"
    path.write_text(",".join(COLUMNS) + "\n" + line + "\n")
    sample, wrong = parse_row(log.read_log(path)[0], "log.csv")
    assert sample is None and "decimals with a point" in wrong[0].hint and "more" in wrong[0].reason
    path.write_text(",".join(COLUMNS) + "\n" + ",".join(cells[name] for name in COLUMNS) + ",\n")
    _, wrong = parse_row(log.read_log(path)[0], "log.csv")
    assert "remove the comma at the end of each row, or end the header with one" in wrong[0].hint
    path.write_text(",".join(COLUMNS) + ",\n" + ",".join(cells[name] for name in COLUMNS) + ",\n")
    assert log.read_log(path)[0].fault == ""


def test_a_header_in_the_middle_is_reported_once_and_the_rest_is_read(tmp_path):
    path = tmp_path / "log.csv"
    whole = log.csv_text(list(GOOD), [GOOD])
    path.write_text(whole + whole.upper().splitlines()[0] + "\n" + whole.splitlines()[1] + "\n")
    rows = log.read_log(path)
    sample, wrong = parse_row(rows[1], "log.csv")
    assert sample is None and [r.reason for r in wrong] == ["the row is a header again"]
    assert [row.fault for row in rows] == ["", "second_header", ""]


def test_the_minus_sign_of_print_is_a_minus_sign():
    sample, _ = parse_row(RawRow(2, {**GOOD, "dz_mm": "\u22120.75"}), "log.csv")
    assert sample.dz_mm == -0.75
