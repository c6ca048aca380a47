"""Names of earlier versions: what users have in files and scripts still works under them."""

import pytest

from gelforge.flow.files import read_csv, write_csv


@pytest.mark.parametrize("name", ["hint", "remedy"])
def test_a_table_of_rejected_rows_is_read_by_both_names_of_its_column(tmp_path, name):
    write_csv(tmp_path / "0000.rejected.csv", ["row", name], [{"row": 2, name: "write a number"}])
    assert read_csv(tmp_path / "0000.rejected.csv") == [{"row": "2", "hint": "write a number"}]
