"""Force maps and totals from images: `gelforge predict IMAGE…`.

Every image gives a picture and a map as .npy, float32 (3, rows, cols) in N per cell; all images share one totals.csv.
After Ctrl-C it has the rows of the images read so far.
Columns fx_n, fy_n, fz_n are the force along gel x (short side), y (long side) and z (pressing is negative).
mx_nm, my_nm, mz_nm are the moment in N m about the gel's apex, the middle of the image.
..._half_width_n, ..._half_width_nm: half of the 90 % prediction interval, for unseen sensors with gels as stiff as in training.
A network that reads pairs needs an image of the sensor while nothing touches it: --nocontact FILE or --profile FILE.
Images are predicted independently, so an image gives the same forces here, in `gelforge live` and in Python. An image is
flagged if the gel moved in its holder since the no-contact image was taken: take a new no-contact image then.
"""

import sys
import tempfile
from argparse import Namespace
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from gelforge.commands.sensoroptions import ENGINE, MODEL, NOCONTACT, PROFILE, SENSOR
from gelforge.errors import BadInput, printable
from gelforge.flow.cli import command, option
from gelforge.flow.files import publish
from gelforge.reading.forcereading import (
    DIGITS,
    TOTAL_COLUMNS,
    ForceReading,
    goes_beyond,
    intervals_text,
    total_columns,
)
from gelforge.reading.model import load_model, require_sensor
from gelforge.reading.profile import files_of
from gelforge.reading.reader import Reader
from gelforge.records.axes import CHANNELS, MOMENTS
from gelforge.records.image import read_image
from gelforge.records.press import N_M
from gelforge.records.regular import FOLDER, file_fault, refuse_to_replace
from gelforge.records.table import GrowingTable

FILMS = (".avi", ".mp4", ".mkv", ".mov", ".webm")  # refused with a hint to `gelforge live`
COLUMNS = [
    "image",
    "map",
    *TOTAL_COLUMNS,
    "vanished_markers",
    "flagged",
    "reason",
]


def totals_row(image: str, name: str, found: ForceReading) -> dict:
    """One row of totals.csv; name: of the map's file, without suffix."""
    return {
        "image": image,
        "map": f"{name}.npy",
        **{
            column: "" if value is None else f"{value:.{DIGITS[column]}f}"
            for column, value in total_columns(found).items()
        },
        "vanished_markers": str(found.vanished),
        "flagged": int(found.flag),
        "reason": found.reason,
    }


def output_names(paths) -> list[str]:
    """Stems for the outputs, made distinct where two images share one."""
    seen: dict[str, int] = {}
    taken: dict[str, None] = {}
    for path in paths:
        name = stem = Path(path).stem
        while name in taken:
            seen[stem] = seen.get(stem, 1) + 1
            name = f"{stem}-{seen[stem]}"
        taken[name] = None
    return list(taken)


def need_folder(out: Path) -> None:
    """Make the folder of the outputs; BadInput where it is not writable."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        raise BadInput(f"--out {out}: cannot be written into ({error.strerror}); name another folder") from error


def predict_files(paths: Sequence[Path], reader: Reader, out: Path, read: Sequence[Path] = ()) -> Iterator[dict]:
    """Predict image files and write their maps below `out`, one after another; yield each one's row of totals.csv.

    All images are checked before anything is written, and read again one by one, because memory may not hold them
    all. totals.csv grows with each image, so an interrupted run keeps its rows. read: other inputs, which no output
    may overwrite. Raises BadInput where one would, or where an image cannot be read.
    """
    from gelforge.reporting.forcemaps import write_maps

    names = output_names(paths)
    written = [out / f"{name}{ending}" for name in names for ending in (".png", ".npy")]
    refuse_to_replace(f"--out {out}", [*written, out / "totals.csv"], [*paths, *read])
    for path in paths:
        read_image(path)
    need_folder(out)
    table = GrowingTable(out / "totals.csv", COLUMNS)  # replaces that of an earlier call, even if this one fails
    try:
        for path, name in zip(paths, names, strict=True):
            image = read_image(path)
            found = reader(image)
            row = totals_row(printable(path), printable(name), found)
            # the maps of an image and its row are written together or, where the disk is full, not at all
            with publish(out / f"{name}.npy") as cells, publish(out / f"{name}.png") as drawn:
                np.save(cells, found.cells)
                flag = f" | FLAGGED: {found.reason}" if found.flag else ""
                title = f"{printable(name)}{flag}"
                write_maps(drawn, found.image, found.cells, title)
                table.add(row)
            yield row
    finally:
        table.close()


def line_of(row: dict) -> str:
    """One row of totals.csv as a line for the terminal."""
    warning = f"  FLAGGED: {row['reason']}" if row["flagged"] else ""
    if row["edge_peak"] and goes_beyond(float(row["edge_peak"])):
        warning += "  CROPPED: the image shows only a part of the contact, so the total is too low"
    forces, halves, moments, halves_of_moments = (
        np.array([float(row[f"{name}_{unit}"] or "nan") for name in names])
        for names, unit in ((CHANNELS, "n"), (CHANNELS, "half_width_n"), (MOMENTS, "nm"), (MOMENTS, "half_width_nm"))
    )
    said = f"{intervals_text(CHANNELS, forces, halves)} N"
    if np.isfinite(moments).all():
        said += f", {intervals_text(MOMENTS, moments / N_M, halves_of_moments / N_M)} N mm"
    return printable(f"{row['image']}: {said}{warning}")


@command(
    option("images", nargs="+", type=Path, metavar="IMAGE"),
    MODEL,
    SENSOR,
    NOCONTACT,
    PROFILE,
    option("--out", type=Path, default=Path("predictions"), help="folder (default: %(default)s)"),
    *ENGINE,
)
def main(args: Namespace) -> None:
    for path in args.images:
        if file_fault(path) == FOLDER:
            raise BadInput(f"{path}: is a folder; name the pictures in it, such as {path}/*.png")
        if path.suffix.lower() in FILMS:
            raise BadInput(f"{path}: is a film; `gelforge live --video {path} --csv readings.csv` reads it")
    picture = read_image(args.nocontact) if args.nocontact else None
    model = load_model(args.model, args.device, args.threads)
    require_sensor(model, args.sensor)
    reader = Reader(picture, args.profile, model)
    if reader.text:
        print(reader.text)
    if reader.doubt:
        print(f"note: {reader.doubt}", file=sys.stderr)
    kept = [*filter(None, [args.nocontact]), *files_of(args.profile)]
    for row in predict_files(args.images, reader, args.out, kept):
        print(line_of(row), flush=True)
    print(f"maps and totals.csv in {args.out}")


if __name__ == "__main__":
    main.exit()
