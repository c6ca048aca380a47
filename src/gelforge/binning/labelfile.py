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
from gelforge.files import publish

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


def to_float32(cells: np.ndarray) -> np.ndarray:
    """Round cells (n, 3, rows, cols) to float32 so that every channel's sum stays what it was.

    Rounding each cell alone would lose some 1e-8 of the total. What is lost is put into one small cell,
    whose spacing of float32 values is fine enough to hold it.
    """
    rounded = cells.astype(np.float32)
    lost = (cells - rounded).reshape(*cells.shape[:2], -1).sum(axis=-1)
    flat, size = rounded.reshape(*cells.shape[:2], -1), np.abs(rounded).reshape(*cells.shape[:2], -1)
    fit = size >= 1000.0 * np.abs(lost)[..., None].astype(np.float32)
    fit &= size > 0
    chosen = np.where(fit, size, np.inf).argmin(axis=-1)[..., None]
    usable = fit.any(axis=-1, keepdims=True)
    mended = np.take_along_axis(flat, chosen, -1).astype(float) + np.where(usable, lost[..., None], 0.0)
    np.put_along_axis(flat, chosen, mended.astype(np.float32), -1)
    return flat.reshape(cells.shape)
