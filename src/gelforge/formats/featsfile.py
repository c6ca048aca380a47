"""FEATS' files: a pickled dict in one .npy per press, and the normalisation file.

Raw samples hold gs_img, indenter, x_0 … d_z, deg, f_x … m_z; label files hold gs_img, grid_x, grid_y,
grid_z, f_x, f_y, f_z (feats-ai/feats, cnc_data_aquisition.py, label_generation.py, normalize.py).
"""

import math
import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import publish
from gelforge.records.arrays import in_short
from gelforge.records.regular import file_fault

POSE_FIELDS = {
    "x_0": "x0_mm",
    "y_0": "y0_mm",
    "z_0": "z0_mm",
    "d_x": "dx_mm",
    "d_y": "dy_mm",
    "d_z": "dz_mm",
    "deg": "rot_deg",
}
FORCE_FIELDS = {"f_x": "fx_n", "f_y": "fy_n", "f_z": "fz_n", "m_x": "mx_nm", "m_y": "my_nm", "m_z": "mz_nm"}
GRIDS = ("grid_x", "grid_y", "grid_z")
TOTALS = ("f_x", "f_y", "f_z")
LARGEST_FILE = 2**30
CONSTRUCTORS = {"_reconstruct", "scalar", "ndarray", "dtype"}  # names of numpy that the pickles of numpy.save use
SUM_TOLERANCE = 1e-5  # relative to the sum of the cells' absolute forces; FEATS' totals are float64 sums of its cells


@dataclass(frozen=True)
class RawSample:
    """A press as recorded: image (h, w, 3) uint8 RGB, and values by the column names of gelforge's log."""

    image: np.ndarray
    values: dict


@dataclass(frozen=True)
class LabelSample:
    """A labelled image: image (h, w, 3) uint8 RGB, label (3, rows, cols) N per cell, along gel x, y, z."""

    image: np.ndarray
    label: np.ndarray


class Unpickler(pickle.Unpickler):
    """An unpickler that knows only numpy's constructors, so that a file cannot call anything else."""

    def find_class(self, module: str, name: str) -> Any:
        """One of numpy's constructors; UnpicklingError for any other name."""
        if module not in ("numpy", "numpy.core.multiarray", "numpy._core.multiarray") or name not in CONSTRUCTORS:
            raise pickle.UnpicklingError(f"the name {module[:80]}.{name[:80]}")
        return super().find_class(module.replace("numpy.core", "numpy._core"), name)


def read_npy(path: str | Path) -> Any:
    """Read a .npy file, pickled or not; no code of the file runs.

    A 0-d object array gives the object in it, as numpy's .item() would. BadInput for a file that is corrupt, too
    large, or holds anything but arrays, scalars and plain containers.
    """
    path = Path(path)
    fault = file_fault(path) or (f"more than {LARGEST_FILE >> 20} MiB" if path.stat().st_size > LARGEST_FILE else "")
    if fault:
        raise BadInput(f"{path}: cannot be read ({fault}); give a .npy file")
    try:
        with path.open("rb") as stream:
            old = np.lib.format.read_magic(stream) == (1, 0)
            read_header = np.lib.format.read_array_header_1_0 if old else np.lib.format.read_array_header_2_0
            shape, _, kind = read_header(stream)
            if not kind.hasobject:
                return np.load(path, allow_pickle=False)
            found = Unpickler(stream).load()
        if type(found) is not np.ndarray or found.dtype != object or found.shape != shape:
            raise pickle.UnpicklingError("a pickle that is not the object array its header promises")
        return found[()]
    except pickle.UnpicklingError as error:
        raise BadInput(
            f"{path}: refused, it holds {in_short(error)}; only numpy arrays, scalars and plain containers are read; save the sample"
            " again with numpy.save"
        ) from error
    except Exception as error:  # corrupt bytes make the unpickler and numpy raise many kinds of errors
        raise BadInput(f"{path}: truncated or not a .npy file ({in_short(error)}); copy it again") from error


def exchanged(forces: np.ndarray) -> np.ndarray:
    """Swap forces (3, ...) between gel x, y, z and FEATS' order: grid_x acts along gel y, grid_y along gel x.

    FEATS names the image's axes, and the image's columns run along gel y (feats-ai/feats, label_generation.py).
    """
    return forces[[1, 0, 2]]


def feats_fields(sample: LabelSample) -> dict:
    """Force fields of a label file: grids (rows, cols) float64 N per cell, and their sums."""
    label = exchanged(np.asarray(sample.label, np.float64))
    totals = [np.float64(grid.sum()) for grid in label]
    return dict(zip(GRIDS, label, strict=True)) | dict(zip(TOTALS, totals, strict=True))


def read_sample(path) -> RawSample | LabelSample:
    """Read one press, raw or labelled; BadInput for fields that are missing, of a wrong type or not finite."""
    found = read_npy(path)
    if not isinstance(found, dict) or not all(isinstance(name, str) for name in found):
        raise BadInput(
            f"{path}: holds {type(found).__name__}, FEATS' files hold a dict of named fields; is it from another program?"
        )
    image = _image(path, found)
    if all(name in found for name in GRIDS):
        return LabelSample(image, _label(path, found))
    missing = [name for name in ("indenter", *POSE_FIELDS, *FORCE_FIELDS) if name not in found]
    if missing:
        raise BadInput(
            f"{path}: field {missing[0]} is missing (it has {', '.join(found)[:120]});"
            " a raw sample needs all of FEATS' fields, a label file grid_x, grid_y and grid_z"
        )
    names = {**POSE_FIELDS, **FORCE_FIELDS}
    values = {column: _number(path, name, found[name]) for name, column in names.items()}
    return RawSample(image, {"indenter": _text(path, "indenter", found["indenter"]), **values})


def _image(path, found) -> np.ndarray:
    image = found.get("gs_img")
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        seen = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
        raise BadInput(f"{path}: field gs_img is {seen}; it must be a uint8 image (height, width, 3)")
    return image


def _label(path, found) -> np.ndarray:
    grids = [found[name] for name in GRIDS]
    for name, grid in zip(GRIDS, grids, strict=True):
        if not isinstance(grid, np.ndarray) or grid.ndim != 2 or grid.dtype.kind not in "fiu" or not grid.size:
            raise BadInput(f"{path}: field {name} is not a two-dimensional array of numbers; label the press again")
        if grid.shape != grids[0].shape:
            raise BadInput(
                f"{path}: field {name} has {grid.shape} cells, grid_x has {grids[0].shape}; they must agree"
            )
        if not np.isfinite(grid).all():
            raise BadInput(f"{path}: field {name} holds NaN or infinity; label the press again")
    # sums in half precision have relative errors of thousandths and overflow at 65504
    label = np.stack(grids).astype(np.float64)
    for name, grid in zip(TOTALS, label, strict=True):
        total = _number(path, name, found.get(name))
        if abs(total - grid.sum()) > SUM_TOLERANCE * np.abs(grid).sum() + 1e-9:
            raise BadInput(f"{path}: field {name} is {total:g} N, its cells sum to {grid.sum():g} N; label it again")
    return exchanged(label)


def _number(path, name, value) -> float:
    number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    if isinstance(value, np.ndarray) and value.shape == () and value.dtype.kind in "fiu":
        number = True
    if not number or not _finite(value):
        seen = repr(value)[:40] if isinstance(value, (str, float, np.floating)) else type(value).__name__
        raise BadInput(f"{path}: field {name} is {seen}; it must be a finite number")
    return float(value)


def _finite(value) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer in a file may exceed the range of floats
        return False


def _text(path, name, value) -> str:
    if not isinstance(value, str) or not value.strip() or len(value) > 100 or not value.isprintable():
        raise BadInput(f"{path}: field {name} must be a short name; correct it in the sample")
    return value.strip()


def write_label(path, sample: LabelSample) -> None:
    """Write a label file in FEATS' layout, whole or not at all."""
    _save(path, {"gs_img": np.asarray(sample.image, np.uint8), **feats_fields(sample)})


def read_normalisation(path) -> dict:
    """Read a normalisation file: {field: {"min": value, "max": value}} for every field of the labels."""
    found = read_npy(path)
    good = isinstance(found, dict) and all(
        isinstance(name, str) and isinstance(ends, dict) and {"min", "max"} <= set(ends)
        for name, ends in found.items()
    )
    if not good or not found:
        raise BadInput(
            f"{path}: not a normalisation file, which holds min and max of every field; run normalize again"
        )
    return {
        name: {key: _number(path, f"{name}.{key}", ends[key]) for key in ("min", "max")}
        for name, ends in found.items()
    }


def write_normalisation(path, ranges: dict) -> None:
    """Write `ranges` ({field: {"min", "max"}}) as FEATS' normalisation file, whole or not at all."""
    kind = {"gs_img": np.uint8}
    _save(
        path,
        {
            name: {key: kind.get(name, np.float64)(ends[key]) for key in ("min", "max")}
            for name, ends in ranges.items()
        },
    )


def is_normalisation(path) -> bool:
    """Whether a file's name is that of a normalisation file."""
    return Path(path).name.startswith("normalization")


def _save(path, value: dict) -> None:
    with publish(path) as part, part.open("wb") as stream:
        np.save(stream, np.array(value, object), allow_pickle=True)


class Ranges:
    """Smallest and largest value of every field over the labels seen so far, as FEATS' normalize.py finds them."""

    def __init__(self):
        self.found = {}

    def add(self, sample: LabelSample) -> None:
        for name, value in {"gs_img": sample.image, **feats_fields(sample)}.items():
            low, high = float(np.min(value)), float(np.max(value))
            ends = self.found.setdefault(name, {"min": low, "max": high})
            ends["min"], ends["max"] = min(ends["min"], low), max(ends["max"], high)
