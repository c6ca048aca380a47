"""Export a dataset of images and labels in a format of other programs.

mcap: ROS 2 messages, which Foxglove and Rerun open. lerobot: LeRobot's layout, version 3. hdf5: one file.
`make feats-export` writes FEATS' layout. `make setup` installs the packages for these formats; without make, run
`pip install '.[exports]'` in this folder.
"""

import importlib
import shutil
from argparse import Namespace
from contextlib import contextmanager
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.cli import command, option
from gelforge.flow.files import bytes_of
from gelforge.flow.layout import EXPORT, Layout
from gelforge.formats.export.samples import Samples

# Module of gelforge.formats.export for each format.
FORMATS = {
    "mcap": "mcap_file",
    "lerobot": "lerobot",
    "hdf5": "hdf5",
}
SUFFIXES = {"mcap": ".mcap", "hdf5": ".h5"}  # of single-file formats

MARK = ".gelforge-export"  # marks folders written by an export, which another export may replace


@contextmanager
def whole_or_absent(path: Path):
    """Yield a temporary path beside `path`; move it to `path` if the block succeeds, else remove it."""
    part = path.with_name(f".{path.name}.part{path.suffix}")
    remove(part)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield part
        remove(path)
        part.rename(path)
    except OSError as error:
        raise BadInput(
            f"{path}: cannot be written ({error.strerror or error}); free space or name another place"
        ) from error
    finally:
        remove(part)


def remove(path: Path) -> None:
    """Remove a file or a folder, if it is there."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def export(samples: Samples, form: str, path: Path) -> None:
    """Write a dataset in one of FORMATS, whole or not at all; BadInput where that is not possible."""
    if form not in FORMATS:
        raise BadInput(f"FORMAT={form}: no such format; choose one of {', '.join(FORMATS)}")
    refuse_foreign(path)
    least = samples.least_bytes()
    refuse_full_disk(path, least + samples.labels.nbytes)
    writer = importlib.import_module(f"gelforge.formats.export.{FORMATS[form]}")
    with whole_or_absent(path) as part:
        writer.write(part, samples)
        if part.is_dir():
            (part / MARK).touch()
        # Some libraries do not report a full disk.
        if bytes_of(part) < least:
            raise BadInput(
                f"{path}: only {bytes_of(part)} of more than {least} bytes were written; free space and export again"
            )


def refuse_foreign(path: Path) -> None:
    """BadInput where the target is a non-empty folder that no export wrote, because it would be deleted."""
    if path.is_dir() and any(path.iterdir()) and not (path / MARK).exists():
        raise BadInput(
            f"{path}: a folder that no export wrote, which would be replaced; name a place that is not there yet"
        )


def refuse_full_disk(path: Path, needed: int) -> None:
    """BadInput where the disk of `path` has less than `needed` bytes free."""
    home = next(parent for parent in path.absolute().parents if parent.exists())
    free = shutil.disk_usage(home).free
    if free < needed:
        raise BadInput(
            f"{path}: needs about {needed / 1e6:.3g} MB, {home} has {free / 1e6:.3g} MB left; free space or name another place"
        )


@command(
    option("--data", type=Path, help="data/DATASET"),
    option("--dataset", type=Path, help="60_dataset/RES"),
    option("--sensors", type=Path, help="sensors.json"),
    option("--format", choices=FORMATS),
    option("--out", type=Path, default=None, help="default: results/DATASET/export/RES/FORMAT/DATASET"),
)
def main(args: Namespace) -> None:
    samples = Samples.open(args.data, args.dataset, args.sensors)
    of, name = Layout(args.dataset.parents[1]), f"{args.data.name}{SUFFIXES.get(args.format, '')}"
    out = args.out or of.folder(EXPORT) / args.dataset.name / args.format / name
    export(samples, args.format, out)
    print(f"{len(samples)} samples in {out}")


if __name__ == "__main__":
    main.exit()
