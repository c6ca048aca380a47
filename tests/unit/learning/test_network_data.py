"""Datasets that training must refuse, and what it says."""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from gelforge.errors import BadInput
from gelforge.flow.files import read_csv, read_json, write_csv, write_json
from gelforge.learning.data import FILES, LEAST_TOTAL, data_version, open_data, require_splits, scales
from gelforge.learning.train import loss_of
from gelforge.records.rowfile import RowFile, array_on_disk
from tests.support.memory import PEAK_KIB
from tests.support.parameters import with_values
from tests.support.refused import refused
from tests.support.synthetic_presses import SETTINGS, write_dataset


@pytest.fixture
def folder(tmp_path):
    return write_dataset(tmp_path / "6x8", 16, (48, 64), (6, 8))


def test_what_is_no_dataset_to_learn_from_is_refused(folder, tmp_path):
    def spoilt(file: str, array=None, read=open_data):
        """A call that reads a copy of the dataset in which one file is gone, or is another array."""
        copy = Path(shutil.copytree(folder, tmp_path / "copy", dirs_exist_ok=True))
        (copy / file).unlink()
        if array is not None:
            np.save(copy / file, array)
        return lambda: read(copy)

    images, labels = np.load(folder / "images.npy"), np.load(folder / "labels.npy")
    infinite, none = labels.copy(), labels.copy()
    infinite[5, 1, 2, 3] = np.nan
    none[:, 0] = 0
    for name in FILES:
        refused(name, spoilt(name))
    for file, array, said in (
        ("labels.npy", infinite, "p0005"),
        ("images.npy", images.astype(np.float32), "uint8"),
        ("images.npy", images[:-1], "15 images"),
        ("images.npy", images[..., 0], "uint8"),
    ):
        refused(said, spoilt(file, array))
    refused("zero in every", spoilt("labels.npy", none, lambda copy: scales(open_data(copy))))
    (folder / "images.npy").write_bytes(b"corrupt")
    refused("not a readable", open_data, folder)
    np.save(folder / "images.npy", images)
    rows = read_csv(folder / "samples.csv")
    for keep, said in ((("test", "val"), "'train' holds 0"), (("train",), "'val' holds 0")):
        changed = [row | {"split": row["split"] if row["split"] in keep else "test"} for row in rows]
        write_csv(folder / "samples.csv", list(rows[0]), changed)
        refused(said, require_splits, open_data(folder))
    write_json(folder / "dataset.json", read_json(folder / "dataset.json") | {"grid": [24, 32]})
    refused("24", open_data, folder)


def test_an_array_on_disk_has_its_room_at_once(tmp_path):
    """Where a full disk would not be seen before a page is written to, it stops the whole process."""
    array = array_on_disk(tmp_path / "a.npy", np.float32, (300, 1000))
    state = (tmp_path / "a.npy").stat()
    assert 512 * state.st_blocks >= state.st_size > array.nbytes
    array[:] = 3.0
    array.flush()
    assert np.load(tmp_path / "a.npy").shape == (300, 1000)


@given(st.one_of(st.integers(-7, 6), st.slices(7), st.lists(st.integers(-7, 6), max_size=9)))
def test_rows_of_a_file_are_those_of_its_array(rows):
    array = np.random.default_rng(1).integers(0, 255, (7, 2, 3)).astype(np.uint16)
    with tempfile.TemporaryDirectory() as folder:
        np.save(Path(folder, "a.npy"), array)
        found = RowFile(Path(folder, "a.npy"))
        assert (found.shape, found.dtype, len(found)) == (array.shape, array.dtype, 7)
        expected = array[np.array(rows, int) if isinstance(rows, list) else rows]
        assert found[rows].dtype == expected.dtype and np.array_equal(found[rows], expected)


def test_a_file_of_rows_that_is_cut_short_or_lies_otherwise_is_named(tmp_path):
    path = tmp_path / "a.npy"
    np.save(path, np.zeros((4, 100), np.uint8))
    found = RowFile(path)
    with pytest.raises(IndexError):
        found[4]
    os.truncate(path, path.stat().st_size - 50)
    assert not found[2].any()
    with pytest.raises(BadInput, match="ends before its row 3"):
        found[2:]
    np.save(path, np.asfortranarray(np.ones((4, 3))))
    with pytest.raises(BadInput, match="one after another"):
        RowFile(path)


@pytest.mark.processes
def test_reading_rows_takes_no_memory_for_the_file(tmp_path):
    """Its pages are the system's, not the process's, which a mapped file of this size would fill."""
    np.lib.format.open_memmap(tmp_path / "a.npy", "w+", np.uint8, (300, 1_000_000))  # takes no room on the disk
    program = (
        f"import sys\nfrom pathlib import Path\nfrom gelforge.records.rowfile import RowFile\n{PEAK_KIB}"
        "rows = RowFile(Path(sys.argv[1]))\nbefore = peak_kib()\n"
        "assert not any(rows[k].any() for k in range(len(rows)))\n"
        "print(peak_kib() - before)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, tmp_path / "a.npy"], check=True, capture_output=True, text=True
    )
    assert int(done.stdout) < 50_000  # KiB, of 300 000


def test_a_bad_label_is_named_whatever_block_it_is_in(folder, block):
    labels = np.load(folder / "labels.npy")
    for row in (1, 7, 15):
        spoilt = labels.copy()
        spoilt[row, 2, 0, 0] = np.inf
        np.save(folder / "labels.npy", spoilt)
        refused(rf"the label of sample p{row:04d} \(row {row}\) is not finite", open_data, folder)


def test_a_version_changes_with_every_part_of_a_dataset(folder, block):
    """Also with what lies beyond one block of rows."""
    before, others = data_version(open_data(folder)), set()
    for name, changed in (
        ("labels.npy", lambda array: array[15].__imul__(1.001)), ("nocontact.npy", lambda array: array[0].__ixor__(1)),
        ("images.npy", lambda array: array[0].__ixor__(1)),
    ):  # fmt: skip
        whole = (folder / name).read_bytes()
        array = np.load(folder / name)
        changed(array)
        np.save(folder / name, array)
        others.add(data_version(open_data(folder)))
        (folder / name).write_bytes(whole)
    rows = read_csv(folder / "samples.csv")
    write_csv(folder / "samples.csv", list(rows[0]), [rows[0] | {"split": "test"}, *rows[1:]])
    others.add(data_version(open_data(folder)))
    write_csv(folder / "samples.csv", list(rows[0]), rows)
    assert len(others) == 4 and before not in others
    assert data_version(open_data(folder)) == before


def test_scales_are_those_of_the_training_split(folder, block):
    data = open_data(folder)
    rows = data.splits["train"]
    found = scales(data)
    pixels = data.images[rows] / 255
    np.testing.assert_allclose(found["image_mean"], pixels.mean((0, 1, 2)), rtol=1e-9)  # same sums, other order
    np.testing.assert_allclose(found["image_std"], pixels.std((0, 1, 2)), rtol=1e-6)
    np.testing.assert_allclose(found["label"], np.sqrt((data.labels[rows] ** 2.0).mean((0, 2, 3))), rtol=1e-6)


def test_a_component_whose_totals_cancel_has_a_scale(folder):
    """As in centred presses without shear: what rounding leaves of their sideways totals is no scale to divide by."""
    labels = np.load(folder / "labels.npy")
    settings = with_values(SETTINGS, total_weight=1.0)
    for rest in (0.0, 1e-6):
        labels[:, 0] = 0.0
        labels[:, 0, 0, :2] = [1.0 + rest, -1.0]
        np.save(folder / "labels.npy", labels)
        found = scales(open_data(folder))
        assert found["total"][0] == pytest.approx(LEAST_TOTAL * max(found["total"])) and found["label"][0] > 0
        one = torch.zeros(1, 3, 2, 2)
        off = one.clone()
        off[0, 0, 0, 0] = 1e-3 / found["label"][0]  # a thousandth of a newton
        scale, total = (torch.tensor(found[key]) for key in ("label", "total"))
        assert loss_of(off, one, torch.ones(1, dtype=torch.bool), scale, total, settings) < 0.1
