"""Every table that a person gives goes through one reader: what would be read wrong is refused with its line and column."""

from pathlib import Path

import numpy as np
import pytest

from gelforge.commands.projection import read_points
from gelforge.commands.sensor import gain_of
from gelforge.formats.benchfiles import Images, read_gauge, read_path
from gelforge.records import log
from gelforge.records.table import read_table
from tests.support.press_records import log_line
from tests.support.refused import refused

# Reader of each table that a person gives, its header, and a row.
TABLES = {
    "log": (log.read_log, ",".join(log.COLUMNS), log_line()),
    "gauge": (lambda path: read_gauge(path, 1), "time_s,fz_n", "0.0,-1.0"),
    "path": (lambda path: read_path(path, (0, 0, 0)), "time_s,x_mm,y_mm,z_mm", "0.0,1.0,2.0,3.0"),
    "times": (lambda path: Images.of(path.parent), "image,time_s", "a.png,0.0"),
    "readings": (lambda path: gain_of(path, None), "image,force_n", "a.png,1.0"),
    "points": (read_points, "x_mm,y_mm,u_px,v_px", "0,0,1,1"),
    "table": (lambda path: read_table(path, "write it again"), "sample_id,split", "a,train"),
}


@pytest.mark.parametrize("name", TABLES)
def test_no_table_is_read_where_a_column_is_twice_a_cell_too_many_or_a_quotation_mark_swallows_rows(tmp_path, name):
    """The later column won without a word, and so did the rows after the second quotation mark."""
    read, header, row = TABLES[name]
    path = Path(tmp_path / "times.csv")
    for twice in header.split(","):
        path.write_text(f"{header},{twice}\n{row},1\n")
        refused(
            f"times.csv: column {twice} occurs 2 times in the header; keep one of them|2 time columns", read, path
        )
    path.write_text(f'{header},notes\n{row},new\n{row},"\n{row},x\n{row},"\n')
    refused("times.csv: row 3: a quotation mark opens a cell that ends in line 5", read, path)
    path.write_text(f'{header},notes\n{row},x\n{row},"\n')
    refused("times.csv: row 3: ", read, path)
    if name != "log":  # whose rows are rejected one by one
        for wrong in (f"{row},1", row.rpartition(",")[0]):
            path.write_text(f"{header}\n{row}\n{wrong}\n")
            refused("row 3 has another number of cells than the header", read, path)


def test_a_column_that_is_nearly_one_of_a_table_is_refused_so_that_nothing_is_lost(tmp_path):
    """A gauge's sideways forces under a name without unit were dropped, and of two readings of a press one was."""
    for name, more, said in (
        ("gauge", "fx", "column 'fx' is not read; write it as fx_UNIT, with a unit of n, mn"),
        ("gauge", "Fy [N]", r"column 'Fy \[N\]' is not read; write it as fy_UNIT"),
        ("gauge", "fx_g", "column 'fx_g' is not read"),
        ("gauge", "FZ (N)", r"column fz_n occurs 2 times in the header \(fz_n, FZ \(N\)\); keep one of them"),
        ("path", "Z mm", "column z_mm occurs 2 times"),
        ("times", "Time [s]", "column time_s occurs 2 times"),
        ("readings", "Force (N)", "column force_n occurs 2 times"),
        ("points", "U_PX", "column u_px occurs 2 times"),
    ):
        read, header, row = TABLES[name]
        (tmp_path / "times.csv").write_text(f"{header},{more}\n{row},1\n")
        refused(said, read, tmp_path / "times.csv")
    read, header, row = TABLES["gauge"]
    (tmp_path / "times.csv").write_text(f"{header},fz_raw,note,temp_c\n{row},1,dry,21\n0.1,-1,1,,21\n")
    assert read(tmp_path / "times.csv")[1] == ("fz_n",)


@pytest.mark.parametrize(
    "turn, true", [(lambda angle: angle % 360.0, 0.0), (lambda angle: angle % 360.0 - 180.0, 180.0)]
)
def test_a_rotation_between_359_and_1_degrees_is_near_0(tmp_path, turn, true):
    """As a number it was interpolated over the whole turn."""
    times = np.arange(0.0, 10.0, 0.05)
    angles = turn(0.3 * np.sin(3 * times))
    (tmp_path / "path.csv").write_text(
        "time_s,x_mm,y_mm,z_mm,rot_deg\n"
        + "".join(f"{t:.3f},0,0,1,{a:.4f}\n" for t, a in zip(times, angles, strict=True))
    )
    found = read_path(tmp_path / "path.csv", (0, 0, 0)).values[:, 4]
    between = np.interp(np.arange(0.0, 9.9, 0.011), times, found)
    assert np.abs((between - true + 180.0) % 360.0 - 180.0).max() < 0.31


@pytest.mark.parametrize("date", ["2026-06-30T23:59:60.5", "2026-06-30T24:00:00.5", "2026-02-30T10:00:00.5"])
def test_a_date_that_cannot_be_is_refused_with_its_line(tmp_path, date):
    lines = [f"2026-06-30T23:59:{50 + k / 10:06.3f} <Run|WPos:1.000,2.000,0.600|FS:60,0>" for k in range(9)]
    (tmp_path / "path.log").write_text("\n".join([*lines, f"{date} <Run|WPos:1.000,2.000,0.600|FS:60,0>"]))
    refused(f"path.log line 10: '{date}' is not a valid time_utc", read_path, tmp_path / "path.log", (0, 0, 0))
