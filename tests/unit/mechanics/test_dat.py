"""The reader of CalculiX' .dat: what is whole is read, what is not is refused by name."""

import numpy as np
import pytest

from gelforge.mechanics.ccx.dat import DatError, Unfinished, last_table, read_dat

HEAD = "\n displacements (vx,vy,vz) for set NTOP and time  0.{time}000000E+01\n\n"
ROWS = "         1  1.000000E-01 -2.000000E-01  3.000000E-01\n         7  4.000000E-01  5.000000E-01 -6.000000E-01\n"
FORCES = "\n forces (fx,fy,fz) for set NBASE and time  0.1000000E+01\n\n"
FORCES += "         3 -1.000000E+00  0.000000E+00  2.500000E-101\n"
NODES = np.array([1, 7])


def whole(time="1"):
    return HEAD.format(time=time) + ROWS


def read(text, nodes=NODES):
    return last_table(read_dat(text), "displacements", "NTOP", nodes)


def test_values_come_in_the_order_asked_for():
    assert read(whole() + FORCES, np.array([1, 7]))[1].tolist() == [0.4, 0.5, -0.6]


def test_exponents_of_three_digits_lose_their_letter():
    text = whole() + FORCES.replace("E-101", "-101")
    assert last_table(read_dat(text), "forces", "NBASE", np.array([3]))[0, 2] == 2.5e-101


def test_last_of_several_steps_counts():
    early = HEAD.format(time="5") + ROWS.replace("1.000000E-01", "9.000000E-01")
    assert read(early + whole())[0, 0] == 0.1


def test_what_is_not_whole_is_refused_by_name():
    for text, reason in (
        ("", "printed nothing"),
        (whole(time="5"), "stopped early"),
        (whole()[:-20], "truncated"),
        *((whole()[:-cut], "truncated") for cut in range(1, 9)),
        (HEAD.format(time="1") + ROWS.splitlines()[0] + "\n", "truncated"),
        (whole().replace("5.000000E-01", "         NaN"), "not finite at node 7"),
        (whole().replace("5.000000E-01", "*************"), "not a number"),
        (whole().replace("         7", "         8"), "another mesh"),
        (whole().replace("1.000000E-01 -2", "1.000000E-001-2"), "no space between two columns"),
        (
            whole().replace("1.000000E-01 -2.000000E-01  3", "1.000000E-001-2.000000E-0013"),
            "no space between two columns",
        ),
        (whole().replace("1.000000E-01", "1,000000E-01"), "not a number"),
        (whole().replace("1.000000E-01", "NAN(IND)"), "not a number"),
    ):
        with pytest.raises(DatError, match=reason):
            read(text)


def test_a_job_that_did_not_finish_is_distinguished_from_a_file_that_cannot_be_read():
    nodes = np.array([1, 2])
    with pytest.raises(Unfinished):
        last_table(read_dat(""), "displacements", "NTOP", nodes)
    with pytest.raises(Unfinished):
        last_table(read_dat(whole(time="5")), "displacements", "NTOP", nodes)
    with pytest.raises(DatError) as corrupt:
        last_table(read_dat(whole()), "displacements", "NTOP", np.array([1, 2, 7]))
    assert not isinstance(corrupt.value, Unfinished)
