"""A profile of your own sensor, with a kitchen scale: `gelforge sensor --name MINE --camera 0 --weigh`.

--weigh takes the no-contact image, then a live page shows the force: hold a press still, type the scale's grams and
Enter, five times or more. It writes images and forces to the folder MINE-readings, then the profile. With --video,
the film stops at each held press.
To use existing images: `gelforge sensor --name MINE --nocontact IMAGE --readings readings.csv`. readings.csv has one
row per weighed press: `image`, the path of its image relative to the table's folder, and `force_n`, the pressing
force in newtons (a kitchen scale's grams divided by 102). Without readings the profile holds only the no-contact
image. In place of --nocontact, --camera NUMBER or --video FILE give the no-contact image: the mean of the first
frames at rest, as in `gelforge live`. `gelforge predict` and `gelforge live` take the profile with --profile. An
image that shows only a part of the contact is not used, because only a part of the force is predicted from it.
"""

import hashlib
import sys
from argparse import Namespace
from itertools import compress
from pathlib import Path

import numpy as np

from gelforge.commands.camera import camera_number
from gelforge.commands.sensoroptions import MODE, MODEL, NOCONTACT
from gelforge.errors import BadInput
from gelforge.evidence.forces import of_readings
from gelforge.flow.cli import command, option
from gelforge.reading.forcereading import goes_beyond, interval_digits
from gelforge.reading.frame import reduced
from gelforge.reading.markers import markers_in
from gelforge.reading.model import ForceModel, load_model
from gelforge.reading.profile import (
    Gain,
    check_readings,
    fit_gain,
    gain_there,
    make_profile,
    odd_readings,
    write_profile,
)
from gelforge.reading.reader import Reader
from gelforge.records.film import Film, open_source, source_name
from gelforge.records.image import read_image
from gelforge.records.nocontactimage import find_nocontact, nocontact_of
from gelforge.records.press import check_id
from gelforge.records.regular import real_place, refuse_to_replace
from gelforge.records.table import TableRows

ASKED = "give the columns image and force_n, a row for each press"


def gain_of(readings: Path, reader: Reader) -> Gain:
    """Fit the force factor to a table of readings; BadInput names the row that cannot be used."""
    table = TableRows.read(readings, ASKED, ("image", "force_n"), "readings")
    pictures, measured = _pictures(table), np.array(table.numbers("force_n"))
    read, whole = _normals(reader, pictures)
    if not whole.any():
        raise BadInput(
            f"{readings}: none of {len(whole)} images shows the whole contact; press a smaller body, or nearer to the middle"
        )
    names, measured, read = list(compress(pictures, whole)), measured[whole], read[whole]
    check_readings(names, measured, read)
    for name, fault in odd_readings(names, measured, read).items():
        print(f"{name}: {fault}; the reading is used, remove it if it is wrong", file=sys.stderr)
    for line in of_readings(measured, read):
        print(f"{readings}: {line}", file=sys.stderr)
    return fit_gain(measured, read)


def _pictures(table: TableRows) -> dict[str, np.ndarray]:
    """Images (h, w, 3) uint8 of a table, by how messages name their row; BadInput names one that cannot be used."""
    lines: dict[bytes, int] = {}  # line by hash of the image: a frozen camera writes one image under several names
    found = {}
    for number, row in table:
        name, where = row["image"], f"{table.path} line {number}"
        try:
            image = read_image(Path(table.path).parent / name)
        except BadInput as error:
            raise BadInput(f"{where}: {error}") from None
        first = lines.setdefault(hashlib.blake2b(image.tobytes()).digest(), number)
        if first != number:
            raise BadInput(
                f"{where}: {name} shows the image of line {first} again; an image counts once, give one of each press"
            )
        found[f"{where}: {name}"] = image
    return found


def nocontact_picture(
    image: Path | None, video: Path | None, camera: int | None, mode: tuple[int, int] | None = None
) -> tuple[np.ndarray, str]:
    """The no-contact image (h, w, 3) uint8 RGB of the sensor, and its source; BadInput unless just one is given."""
    if sum(source is not None for source in (image, video, camera)) != 1:
        raise BadInput(
            "give one of --nocontact IMAGE, --video FILE and --camera NUMBER: the sensor while nothing touches it"
        )
    if image is not None:
        return read_image(image), str(image)
    return nocontact_of(video, camera, mode), source_name(video, camera)


def _normals(reader: Reader, pictures: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Predict compression (n,) in N from images by name, and decide which of them (n,) bool show the whole contact.

    The others are named on the terminal. So are images that `predict` would flag; they still count, because some
    flags are wrong.
    """
    read, whole = [], []
    for name, picture in pictures.items():
        found = reader(picture)
        read.append(-float(found.total[2]))
        whole.append(not goes_beyond(found.edge_peak))
        if found.flag:
            print(f"{name}: FLAGGED: {found.reason}; remove the image if that is true", file=sys.stderr)
        if not whole[-1]:
            print(f"{name}: is not used, because it does not show the whole contact", file=sys.stderr)
    return np.array(read), np.array(whole)


def check_options(args: Namespace, out: Path) -> None:
    """BadInput for options that exclude each other, and for an existing image that the profile's would overwrite."""
    if out.suffix != ".toml":
        raise BadInput(f"--out {out}: give a name that ends in .toml")
    beside = out.with_suffix(".png")
    refuse_to_replace(f"--out {out}", [out, beside], [args.video, args.readings, args.model])
    if (
        beside.exists()
        and not out.exists()
        and (args.nocontact is None or real_place(beside) != real_place(args.nocontact))
    ):
        raise BadInput(
            f"{beside} exists already and would be replaced by the profile's picture; give another --name or --out"
        )


def factor_replaced(out: Path, measures: bool) -> Gain:
    """The factor of the profile that a new one replaces; an unmeasured factor where there is none.

    measures: whether the new one has readings. Raises BadInput for a file that is no profile, and where a measured
    factor would be replaced by none, because nothing else holds it.
    """
    kept = gain_there(out)
    if kept is None:
        raise BadInput(f"{out} exists already and is not a sensor's profile; give another --name or --out")
    if kept.readings and not measures:
        raise BadInput(
            f"{out}: is a profile whose factor, {kept.value:.2f}, comes from {kept.readings} readings and would be replaced"
            f" by one without any; give --readings again, another --name or --out, or remove {out}"
        )
    return kept


def weigh(args: Namespace, out: Path) -> tuple[np.ndarray, Gain, dict]:
    """Weigh presses by camera or film; return the no-contact image (h, w, 3), the factor and the model's metadata."""
    import cv2

    from gelforge.live.webpage import PageServer
    from gelforge.live.weigh import HELP, Weighing, weigh_camera, weigh_film

    if (args.video is None) == (args.camera is None) or args.readings:
        raise BadInput("--weigh: give either --camera NUMBER or --video FILE, and no --readings")
    folder = out.with_name(f"{out.stem}-readings")
    if folder.exists():
        raise BadInput(
            f"{folder} exists already, from an earlier weighing; remove it, or give another --name or --out"
        )
    model, name = load_model(args.model), source_name(args.video, args.camera)
    with open_source(args.video, args.camera, args.mode) as (capture, announced):
        frames = iter(Film(capture, announced, name, None, args.camera is not None, args.video))
        if args.nocontact:
            picture = read_image(args.nocontact)
        else:
            found, frames = find_nocontact(frames, name)
            picture = cv2.cvtColor(found, cv2.COLOR_BGR2RGB)
        reader = reader_beside(model, picture, name)
        folder.mkdir(parents=True)
        weighing, page = Weighing(folder, reader), PageServer("127.0.0.1", 0)
        print(f"{page.url} shows {name}; {HELP}", flush=True)
        try:
            (weigh_film if args.camera is None else weigh_camera)(weighing, frames, page.send)
        finally:
            page.stop()
    if not weighing.names:
        folder.rmdir()
        raise BadInput(f"{name}: no press was weighed, so nothing is written; {HELP}")
    return reduced(picture), gain_of(folder / "readings.csv", reader), model.metadata


def reader_beside(model: ForceModel, picture: np.ndarray, source: str) -> Reader:
    """A reader with a no-contact image (h, w, 3); BadInput where the image is unusable."""
    reader = Reader(reduced(picture), model=model)
    if reader.text:
        print(f"{source}: {reader.text}", file=sys.stderr)
    if fault := reader.fault or reader.doubt:
        raise BadInput(f"{source}: {fault}; take a sharp one while nothing touches the sensor")
    return reader


@command(
    option("--name", help="name of the sensor"),
    NOCONTACT,
    option("--video", type=Path, help="video that begins while nothing touches the sensor", default=None),
    option(
        "--camera", type=camera_number, help="number of the camera; nothing may touch the sensor now", default=None
    ),
    MODE,
    option("--weigh", action="store_true", help="weigh presses now: hold one still, type the scale's grams, Enter"),
    option("--readings", type=Path, help="table of images and force readings", default=None),
    MODEL,
    option("--out", type=Path, help="file of the profile, .toml", default=None),
)
def main(args: Namespace) -> None:
    name, out = check_id(args.name, "--name"), args.out or Path(f"{args.name}.toml")
    check_options(args, out)
    before = factor_replaced(out, args.weigh or args.readings is not None)
    if args.weigh:
        picture, gain, metadata = weigh(args, out)
    else:
        picture, source = nocontact_picture(args.nocontact, args.video, args.camera, args.mode)
        model = load_model(args.model)
        picture, metadata = reduced(picture), model.metadata
        reader = reader_beside(model, picture, source)
        gain = gain_of(args.readings, reader) if args.readings else Gain()
    profile = make_profile(name, picture, markers_in(picture).pitch, gain, metadata)
    write_profile(out, profile)
    what = "reading" if gain.readings == 1 else "readings"
    instead = f", in place of {before.value:.2f} from {before.readings}" if before.readings else ""
    digits = interval_digits((gain.high - gain.low) / 2)
    factor, low, high = (f"{value:.{digits}f}" for value in (gain.value, gain.low, gain.high))
    print(f"{out}: force factor {factor} ({low} to {high}), from {gain.readings} {what}{instead};"
          f" markers {profile.pitch:.1f} px apart")  # fmt: skip


if __name__ == "__main__":
    main.exit()
