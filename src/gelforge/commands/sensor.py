"""A profile of your own sensor: `gelforge sensor --name MINE --nocontact PICTURE --readings readings.csv`.

readings.csv has one row per weighed press: `image`, the path of its image relative to the table's folder, and `force_n`, the
pressing force in newtons (a kitchen scale's grams over 102). Without readings the profile holds the no-contact image alone.
In place of --nocontact, --camera NUMBER or --video FILE give the no-contact image: the mean of the first frames at rest, as
in `gelforge live`. `gelforge predict` and `gelforge live` take the profile with --profile.

--balls FOLDER needs no scale. Press a ball of known diameter by hand; the images are FOLDER/background.png and
FOLDER/5.000mm/1/gelsight.png, 2/gelsight.png and so on. The profile then also holds the sensor's table of slopes.

Two sensors of a gripper need no scale to agree, since two fingers that hold one object press equally. --opposite LEFT.toml
--grasps grasps.csv matches this sensor to the profile of the other one, by images of both at the same moments (columns
`image` and `opposite`). Only readings show which of the two is right in newtons. An image that shows only a part of the
contact is not used in either table, because only a part of the force is predicted from it.
"""

import hashlib
import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from itertools import compress
from pathlib import Path

import numpy as np

from gelforge.commands.camera import camera_number
from gelforge.commands.sensoroptions import MODE, MODEL, NOCONTACT
from gelforge.errors import BadInput
from gelforge.evidence.forces import of_readings
from gelforge.flow.main import command, option
from gelforge.networks.balls.ballpresses import BACKGROUND, LAYOUT, BallFolder, BallPress, read_presses
from gelforge.networks.balls.balltable import C10_MPA, THICKNESS_MM
from gelforge.networks.balls.slopefit import fit_slope_table
from gelforge.networks.inference.predictor import Predictor, load_for_use
from gelforge.networks.inference.sensorprofile import (
    AS_READ,
    LEAST_N,
    Gain,
    check_readings,
    check_same_network,
    felt_by_both,
    files_of,
    fit_gain,
    fit_opposite,
    gain_there,
    make_profile,
    odd_readings,
    of_balls,
    read_profile,
    write_profile,
)
from gelforge.networks.preprocess.imageframe import reduced
from gelforge.networks.preprocess.slopetable import SlopeTable
from gelforge.records.film import source_name
from gelforge.records.forcereading import goes_beyond
from gelforge.records.image import read_image
from gelforge.records.markers import markers_in
from gelforge.records.nocontactimage import nocontact_of
from gelforge.records.press import check_id, parse_number
from gelforge.records.regular import real_place, refuse_to_replace
from gelforge.records.table import filled_rows

ASKED = "give the columns {}, a row for each {}"


def gain_of(readings: Path, predictor: Predictor, before: Gain = AS_READ) -> Gain:
    """The factor that a table of readings gives, and `before` without them; BadInput names the row that cannot be used."""
    rows = filled_rows(readings, ("image", "force_n"), "readings", ASKED.format("image and force_n", "press"))
    pictures = _pictures(readings, rows, "image")
    measured = np.array([_force(name, row["force_n"]) for name, (_, row) in zip(pictures, rows, strict=True)])
    read, whole = _normals(predictor, pictures)
    if not whole.any():
        raise BadInput(
            f"{readings}: in none of {len(whole)} pictures is all of the contact seen; press a smaller body, or nearer to the middle"
        )
    names, measured, read = list(compress(pictures, whole)), measured[whole], read[whole]
    check_readings(names, measured, read)
    for name, fault in odd_readings(names, measured, read).items():
        print(f"{name}: {fault}; it counts, leave it out if it is wrong", file=sys.stderr)
    for line in of_readings(measured, read):
        print(f"{readings}: {line}", file=sys.stderr)
    return fit_gain(measured, read, before)


def nocontact_for_slopes(predictor: Predictor) -> np.ndarray:
    """The no-contact image that a table of slopes is learnt beside; BadInput where images are scaled, turned or cropped."""
    nocontact = predictor.prepare.nocontact
    if nocontact is None or not nocontact.frame.shows_rim or predictor.text:
        raise BadInput("images are not of the network's own size and scale, so no table of slopes is learnt")
    return nocontact.picture


def learnt_from_balls(balls: BallFolder, predictor: Predictor) -> tuple[Gain, SlopeTable | None]:
    """Factor on forces and table of slopes by presses of a ball; those that do not count are named on the terminal."""
    for name, why in balls.left_out.items():
        print(f"{name}: does not count, {why}", file=sys.stderr)
    table = None
    try:
        nocontact = nocontact_for_slopes(predictor)
        learnt = [replace(press, image=predictor.prepare(press.image).lit) for press in balls.presses]
        table = fit_slope_table(learnt, nocontact, balls.px_per_mm)
    except BadInput as error:
        print(f"no table of slopes: {error}", file=sys.stderr)
    read, counts = _normals(predictor, {press.name: press.image for press in balls.presses})
    return _gain_of_balls(balls.presses, read, counts), table


def _gain_of_balls(presses: Sequence[BallPress], read: np.ndarray, counts: np.ndarray) -> Gain:
    """The factor that presses tell by what is read in them, (n,) N, where they count, (n,) bool."""
    for press, seen in zip(presses, read, strict=True):
        if seen < LEAST_N:
            print(f"{press.name}: does not count, the network reads {seen:.1f} N in it", file=sys.stderr)
    counts = counts & (read >= LEAST_N)
    if not counts.any():
        raise BadInput(
            f"in none of {len(read)} presses of the ball does the network read {LEAST_N:g} N; press firmer"
        )
    force = np.array([press.force for press in presses])
    return of_balls(fit_gain(force[counts], read[counts]))


def _pictures(table: Path, rows: list[tuple[int, dict[str, str]]], column: str) -> dict[str, np.ndarray]:
    """The pictures that a column names, (h, w, 3) uint8, by what a row is called; BadInput names one that cannot be used."""
    lines: dict[bytes, int] = {}  # by what a picture shows: a camera that froze writes it under several names
    found = {}
    for number, row in rows:
        name, where = row[column], f"{table} line {number}"
        try:
            image = read_image(table.parent / name)
        except BadInput as error:
            raise BadInput(f"{where}: {error}") from None
        first = lines.setdefault(hashlib.blake2b(image.tobytes()).digest(), number)
        if first != number:
            raise BadInput(
                f"{where}: {name} shows the picture of line {first} again; a picture counts once, give one of each press"
            )
        found[f"{where}: {name}"] = image
    return found


def _force(name: str, text: str) -> float:
    """A measured force in N; BadInput for what is no number."""
    value = parse_number(text)
    if value is None:
        raise BadInput(
            f"{name}: force_n = {text[:100]!r} is no number; write newtons with a decimal point, such as 3.5"
        )
    return value


def gain_beside(grasps: Path, predictor: Predictor, opposite: Path) -> Gain:
    """The factor by which grasps bring this sensor to the profile of the finger opposite."""
    rows = filled_rows(grasps, ("image", "opposite"), "grasps", ASKED.format("image and opposite", "moment"))
    other = read_profile(opposite)
    check_same_network(other, predictor.metadata)
    facing = Predictor(predictor.model, other.nocontact, other.gain, table=other.table)
    pictures = _pictures(grasps, rows, "image")
    read, here = _normals(predictor, pictures)
    felt, there = _normals(facing, _pictures(grasps, rows, "opposite"))
    whole = here & there
    if not whole.any():
        raise BadInput(
            f"{grasps}: in none of {len(whole)} grasps do both pictures show all of the contact, so their forces need not be"
            " alike; hold a smaller body, or nearer to the middle of both"
        )
    names, felt, read = compress(pictures, whole), felt[whole], read[whole]
    for name, one, another, counts in zip(names, read, felt, felt_by_both(felt, read), strict=True):
        if not counts:
            print(f"{name}: does not count, {one:.1f} and {another:.1f} N are read; press firmer", file=sys.stderr)
    return fit_opposite(felt, read, other.gain)


def nocontact_picture(
    image: Path | None, video: Path | None, camera: int | None, mode: tuple[int, int] | None = None
) -> tuple[np.ndarray, str]:
    """The no-contact image (h, w, 3) uint8 RGB of the sensor, and where it is from; exactly one source may be given."""
    if sum(source is not None for source in (image, video, camera)) != 1:
        raise BadInput(
            "give one of --nocontact IMAGE, --video FILE and --camera NUMBER: the sensor while nothing touches it"
        )
    if image is not None:
        return read_image(image), str(image)
    return nocontact_of(video, camera, mode), source_name(video, camera)


def _normals(predictor: Predictor, pictures: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Normal forces (n,) in N that are predicted from pictures by name, above 0 where something presses.

    And which pictures (n,) bool show all of the contact. The others are named on the terminal, and so are those that
    `predict` would flag, which count, as some flags are wrong.
    """
    read, whole = [], []
    for name, picture in pictures.items():
        found = predictor.predict(picture)
        read.append(-float(found.total[2]))
        whole.append(not goes_beyond(found.edge_peak))
        if found.flag:
            print(f"{name}: FLAGGED: {found.reason}; leave it out if that is so", file=sys.stderr)
        if not whole[-1]:
            print(f"{name}: does not count, the contact is cropped by the image", file=sys.stderr)
    return np.array(read), np.array(whole)


def check_options(args: Namespace, out: Path) -> None:
    """BadInput for options that do not go together, and for a picture that the profile's own would replace."""
    if out.suffix != ".toml":
        raise BadInput(f"--out {out}: give a name that ends in .toml")
    if (args.opposite is None) != (args.grasps is None):
        raise BadInput("--opposite and --grasps go together: a profile of the other finger, and pictures of both")
    if args.balls is None and (args.diameter is not None or args.thickness is not None):
        raise BadInput("--diameter and --thickness say what --balls FOLDER shows: give it, too")
    if args.balls and args.grasps:
        raise BadInput("give either --balls or --grasps: a ball gives more than the readings of another finger")
    if args.readings and args.grasps:
        raise BadInput(
            "give either --readings or --grasps: what was weighed says more than what another finger reads"
        )
    beside = out.with_suffix(".png")
    read = [
        args.video,
        args.readings,
        args.grasps,
        args.balls and args.balls / BACKGROUND,
        args.model,
        *files_of(args.opposite),
    ]
    refuse_to_replace(f"--out {out}", [out, beside], read)
    if (
        beside.exists()
        and not out.exists()
        and (args.nocontact is None or real_place(beside) != real_place(args.nocontact))
    ):
        raise BadInput(
            f"{beside} is there already and would be replaced by the profile's picture; give another --name or --out"
        )


def factor_replaced(out: Path, measures: bool) -> Gain:
    """The factor of the profile that a new one takes the place of; as read where there is none.

    measures: whether the new one has readings, balls or grasps. Raises BadInput for a file that is no profile, and for a profile
    whose factor was measured where the new one's is not: that was work, and nothing else holds it.
    """
    kept = gain_there(out)
    if kept is None:
        raise BadInput(f"{out} is there already and is no sensor's profile; give another --name or --out")
    if kept.readings and not measures:
        raise BadInput(
            f"{out}: is a profile whose factor, {kept.value:.3f}, comes from {kept.readings} readings or grasps and would be replaced"
            f" by one without any; give --readings, --balls or --grasps again, another --name or --out, or remove {out}"
        )
    return kept


@command(
    option("--name", help="name of the sensor"),
    NOCONTACT,
    option("--video", type=Path, help="video that begins while nothing touches the sensor", default=None),
    option(
        "--camera", type=camera_number, help="number of the camera; nothing may touch the sensor now", default=None
    ),
    MODE,
    option("--readings", type=Path, help="table of images and force readings", default=None),
    option(
        "--balls",
        type=Path,
        metavar="FOLDER",
        help="folder of ball presses: background.png and DIAMETERmm/N/gelsight.png, as gs_sdk writes them",
        default=None,
    ),
    option(
        "--diameter", type=float, help="diameter of the ball, mm (default: from the name of its folder)", default=None
    ),
    option(
        "--thickness",
        type=float,
        help=f"thickness of the gel where the ball pressed, mm (default: {THICKNESS_MM:g})",
        default=None,
    ),
    option("--opposite", type=Path, help="profile of the sensor on the opposite finger", default=None),
    option("--grasps", type=Path, help="table of images of both fingers while they hold one object", default=None),
    MODEL,
    option("--out", type=Path, help="file of the profile, .toml", default=None),
)
def main(args: Namespace) -> None:
    name, out = check_id(args.name, "--name"), args.out or Path(f"{args.name}.toml")
    check_options(args, out)
    before = factor_replaced(out, bool(args.readings or args.grasps or args.balls))
    if args.balls and args.nocontact is args.video is args.camera is None:
        if not (args.balls / BACKGROUND).exists():
            raise BadInput(f"{args.balls}: holds no {BACKGROUND}; {LAYOUT}, or the no-contact image by --nocontact")
        args.nocontact = args.balls / BACKGROUND
    picture, source = nocontact_picture(args.nocontact, args.video, args.camera, args.mode)
    thickness = THICKNESS_MM if args.thickness is None else args.thickness
    balls = read_presses(args.balls, picture, args.diameter, thickness) if args.balls else None
    model = load_for_use(args.model)
    picture = reduced(picture)
    predictor = Predictor(model, picture)
    if predictor.text:
        print(f"{source}: {predictor.text}", file=sys.stderr)
    if predictor.fault:
        raise BadInput(f"{source}: {predictor.fault}; take a sharp one while nothing touches the sensor")
    gain, table, note = Gain(), None, ""
    if balls:
        gain, table = learnt_from_balls(balls, predictor)
        note = f"; {balls.px_per_mm:.2f} px per mm; gel of C10 {C10_MPA:g} MPa assumed, which balls cannot measure"
    if args.readings:
        gain = gain_of(args.readings, predictor, gain)
    elif args.grasps:
        gain = gain_beside(args.grasps, predictor, args.opposite)
    profile = make_profile(name, picture, markers_in(picture).pitch, gain, model.metadata, table)
    write_profile(out, profile)
    what = "grasp" if args.grasps else "press" if args.balls else "reading"
    what += "" if gain.readings == 1 else "es" if args.balls else "s"
    instead = f", in place of {before.value:.3f} from {before.readings}" if before.readings else ""
    print(f"{out}: forces times {gain.value:.3f} ({gain.low:.3f} to {gain.high:.3f}), from {gain.readings} {what}{instead};"
          f" markers {profile.pitch:.1f} px apart{note}")  # fmt: skip


if __name__ == "__main__":
    main.exit()
