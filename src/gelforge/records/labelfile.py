"""The artifact of stage 50: labels of one shard of samples at one resolution.

An uncompressed .npz. `n` samples:

| array | shape, type | meaning |
| --- | --- | --- |
| sample_id, status | (n,) str | as in the forces; a sample without a valid state has labels of NaN |
| label | (n, 3, rows, cols) float32 | N per cell; channels force along gel y, along gel x, along z (FEATS) |
| outside | (n, 3) float64 | N that fell outside the image, same channels |
| c10 | () float64 | MPa, the material that the forces belong to |
| c10_interval68, c10_interval95 | (2,) float64 | MPa, where the material was calibrated; labels scale with c10 |
"""

import zipfile
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import publish

CHANNELS = (1, 0, 2)  # gel axis of each channel: grid_x is the force along gel y (FEATS, label_generation.py)


def write_labels(path, blocks, shape, arrays: dict) -> None:
    """Write a shard whose label array of `shape` comes in consecutive `blocks` (b, 3, rows, cols) float32.

    Labels are streamed, because a large shard at a fine resolution does not fit in memory. `arrays` is a
    function called after the last block, or a dict, of the other arrays. Whole or not at all.
    """
    with publish(path) as part, zipfile.ZipFile(part, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
        with archive.open(zipfile.ZipInfo("label.npy"), "w", force_zip64=True) as member:
            header = {"descr": "<f4", "fortran_order": False, "shape": tuple(int(n) for n in shape)}
            np.lib.format.write_array_header_1_0(member, header)
            for block in blocks:
                member.write(np.ascontiguousarray(block, "<f4").data)
        for name, array in (arrays() if callable(arrays) else arrays).items():
            with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w") as member:
                np.lib.format.write_array(member, np.asanyarray(array), allow_pickle=False)


def read_labels(path, names=None) -> dict:
    """Arrays of a label shard by name, all or those asked for; an unreadable file raises BadInput."""
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in names or file.files}
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise BadInput(f"{Path(path)}: not a label shard ({error}); delete it and run make labels again") from error


def to_float32(values: np.ndarray, group: np.ndarray, groups: int) -> np.ndarray:
    """Round values (k,) to float32 (k,) so that the sum of each group stays what it was.

    group (k,) numbers the values' groups from 0 to groups - 1. Rounding each value alone would lose some
    1e-8 of a sum. What is lost is put into one small value, whose spacing of float32 numbers is fine
    enough to hold it, and which is a thousand times what it takes in.
    """
    rounded = values.astype(np.float32)
    lost = np.bincount(group, values - rounded, groups)
    size = np.abs(rounded).astype(float)
    score = np.where((size > 0) & (size >= 1000.0 * np.abs(lost)[group]), size, np.inf)
    smallest = np.full(groups, np.inf)
    np.minimum.at(smallest, group, score)
    match = np.flatnonzero(np.isfinite(score) & (score == smallest[group]))
    chosen = match[np.unique(group[match], return_index=True)[1]]
    rounded[chosen] = (rounded[chosen] + lost[group[chosen]]).astype(np.float32)
    return rounded
