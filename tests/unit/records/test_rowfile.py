"""Large arrays written row by row."""

import subprocess
import sys

import pytest

from gelforge.records.rowfile import RowFile
from tests.support.memory import PEAK_KIB

WRITE = f"""
import sys
from pathlib import Path
import numpy as np
from gelforge.records.rowfile import write_rows
{PEAK_KIB}
before = peak_kib()
rows = (np.full((240, 320, 3), k % 251, np.uint8) for k in range(1500))
write_rows(Path(sys.argv[1]), np.uint8, (1500, 240, 320, 3), rows)
print(peak_kib() - before)
"""


@pytest.mark.processes
def test_what_was_written_is_no_memory_of_the_process(tmp_path):
    path = tmp_path / "images.npy"
    done = subprocess.run([sys.executable, "-c", WRITE, path], check=True, capture_output=True, text=True)
    assert int(done.stdout) < path.stat().st_size / 1024 / 2  # a third of it, the 512 rows that are kept
    assert [int(RowFile(path)[k].max()) for k in (0, 511, 512, 1499)] == [k % 251 for k in (0, 511, 512, 1499)]
