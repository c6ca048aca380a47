"""Force maps and totals from images: `gelforge predict IMAGE…`.

For every image a picture and the map as .npy, float32 (3, rows, cols) in N per cell, and one totals.csv, which Ctrl-C
leaves with the rows of the images that were read.
Columns grid_x_n, grid_y_n, grid_z_n are FEATS' channels: force along gel y, along gel x, along the normal.
..._half_width_n: nine of ten forces on sensors that training never saw, of gels as stiff as those it saw, were nearer.
unlike_training (in pictures, unlike training): how far an image's colours, sharpness and dots are from those that the
network learnt from; about 1 for an image like them.
A network that reads differences needs a picture of the sensor while nothing touches it: --untouched FILE or --profile
FILE. The network that ships needs one of the two; one that was trained on at most eight sensors holds their pictures
and takes one by --sensor NAME, or the one that the image is nearest to.
All images of one call are taken for one sitting: where their dots tell that the gel moved in its holder since that
picture was taken, or that it is cropped otherwise, they are laid onto it first. Four and more that show dots tell it
together, fewer each by itself.
"""

import tempfile
from argparse import Namespace
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput, printable
from gelforge.flow.files import publish, write_csv
from gelforge.flow.main import command, option, positive
from gelforge.networks.sensorprofile import files_of, untouched_of
from gelforge.networks.sitting import place_sitting
from gelforge.networks.use import GIVEN, Judgement, Untouched, load_for_use, predict_one
from gelforge.records.axes import CHANNELS
from gelforge.records.image import read_image
from gelforge.records.regular import FOLDER, file_fault, refuse_to_replace
from gelforge.records.totals import TOTAL_COLUMNS, total_columns

FILMS = (".avi", ".mp4", ".mkv", ".mov", ".webm")  # names that no picture has
COLUMNS = [
    "image",
    *TOTAL_COLUMNS,
    "untouched",
    "unlike_training",
    "flagged",
    "reason",
    "put_right",
]


def totals_row(name: str, forces: np.ndarray, judged: Judgement) -> dict:
    """One row of totals.csv, of forces (3, rows, cols) N."""
    totals = total_columns(forces, judged.half_width, judged.by_dots, judged.edge_peak)
    return {
        "image": name,
        **{column: "" if value is None else f"{value:.4f}" for column, value in totals.items()},
        "untouched": judged.untouched,
        "unlike_training": f"{judged.score:.2f}",
        "flagged": int(judged.flag),
        "reason": judged.reason,
        "put_right": judged.placed,
    }


def within(half_width: str) -> str:
    """An interval as it stands behind a force."""
    return f" +- {half_width}" if half_width else ""


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
    """Make the folder of the outputs; one that cannot be written into raises BadInput before anything is read."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        raise BadInput(f"--out {out}: cannot be written into ({error.strerror}); name another folder") from error


def predict_files(
    paths: Sequence[Path], untouched: Untouched, out: Path, read: Sequence[Path] = ()
) -> Iterator[dict]:
    """Predict image files and write their maps below `out`, one after another; tell each one's row of totals.csv.

    Every image is read before anything is written, and again when its turn comes: there may be more than memory holds.
    totals.csv is written at the end, which may come early: whoever stops keeps the rows of what was read.
    read: other files that were read, whose place nothing that is written may take.
    """
    from gelforge.reporting.forcemaps import write_maps

    names = output_names(paths)
    written = [out / f"{name}{ending}" for name in names for ending in (".png", ".npy")]
    refuse_to_replace(f"--out {out}", [*written, out / "totals.csv"], [*paths, *read])
    placement = place_sitting(untouched, (read_image(path) for path in paths))
    need_folder(out)
    if placement is not None and placement.correction:
        print(f"the pictures lie otherwise on the untouched one, which is put right: {placement.correction}")
    # no table of an earlier call beside maps of this one, however it ends
    (out / "totals.csv").unlink(missing_ok=True)
    rows = []
    try:
        for path, name in zip(paths, names, strict=True):
            image, forces, judged = predict_one(untouched, read_image(path), placement)
            row = totals_row(printable(path), forces, judged)
            with publish(out / f"{name}.npy") as part:
                np.save(part, forces)
            with publish(out / f"{name}.png") as part:
                flag = f" | FLAGGED: {judged.reason}" if judged.flag else ""
                write_maps(part, image, forces, f"{printable(name)}, unlike training {judged.score:.1f}{flag}")
            rows.append(row)
            yield row
    finally:
        if rows:
            write_csv(out / "totals.csv", COLUMNS, rows)


def line_of(row: dict) -> str:
    """One row of totals.csv as a line for a person."""
    warning = f"  FLAGGED: {row['reason']}" if row["flagged"] else ""
    against = f" against {row['untouched']}" if row["untouched"] not in ("", GIVEN) else ""
    against += f", put right: {row['put_right']}" if row["put_right"] else ""
    forces = ", ".join(
        f"{channel} {row[f'{channel}_n']}{within(row[f'{channel}_half_width_n'])}" for channel in CHANNELS
    )
    return printable(f"{row['image']}: {forces} N{against}{warning}")


@command(
    option("images", nargs="+", type=Path, metavar="IMAGE"),
    option("--model", type=Path, help="model file; the one that came with gelforge if not named", default=None),
    option(
        "--sensor",
        help="the sensor of the images; refused if the model is for others; without --untouched and --profile they are"
        " read against the picture that the model holds of it",
        default=None,
    ),
    option("--untouched", type=Path, metavar="IMAGE", help="the sensor while nothing touches it", default=None),
    option("--profile", type=Path, help="the sensor's profile, of gelforge sensor", default=None),
    option("--out", type=Path, default=Path("predictions"), help="folder (default: %(default)s)"),
    option("--threads", type=positive, default=1),
)
def main(args: Namespace) -> None:
    for path in args.images:
        if file_fault(path) == FOLDER:
            raise BadInput(f"{path}: is a folder; name the pictures in it, such as {path}/*.png")
        if path.suffix.lower() in FILMS:
            raise BadInput(f"{path}: is a film; `gelforge live --video {path} --csv readings.csv` reads it")
    import torch

    torch.set_num_threads(args.threads)
    picture = read_image(args.untouched) if args.untouched else None
    trained = load_for_use(args.model, args.sensor)
    picture, gain = untouched_of(args.profile, picture, trained.about)
    untouched = Untouched(trained, picture, args.sensor, gain)
    kept = [*filter(None, [args.untouched]), *files_of(args.profile)]
    for row in predict_files(args.images, untouched, args.out, kept):
        print(line_of(row), flush=True)
    print(f"maps and totals.csv in {args.out}")


if __name__ == "__main__":
    main.exit()
