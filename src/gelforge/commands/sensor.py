"""A profile of one's own sensor: `gelforge sensor --name MINE --untouched PICTURE --readings readings.csv`.

readings.csv has a row for each press that was weighed: `image`, a picture (its path starts at the table's folder), and
`force_n`, the force that pressed, in newtons (a kitchen scale's grams over 102). Without readings the profile holds the
untouched picture alone. `gelforge predict` and `gelforge live` take the profile with --profile.
"""

from argparse import Namespace
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.main import command, option
from gelforge.networks.sensorprofile import Gain, check_readings, fit_gain, make_profile, write_profile
from gelforge.networks.use import Untouched, load_for_use, predict_one
from gelforge.records.image import read_image
from gelforge.records.markers import pitch_of
from gelforge.records.press import check_id, parse_number
from gelforge.records.table import read_table


def gain_of(readings: Path, untouched: Untouched) -> Gain:
    """The factor that a table of readings tells; BadInput names the row that cannot be used."""
    rows = read_table(readings, "give the columns image and force_n")
    if not rows or {"image", "force_n"} - rows[0].keys():
        raise BadInput(f"{readings}: holds no readings; give the columns image and force_n, a row for each press")
    names = [f"{readings} line {number}: {row['image']}" for number, row in enumerate(rows, 2)]
    measured = np.array([parse_number(row["force_n"]) or np.nan for row in rows])
    images = [read_image(readings.parent / row["image"]) for row in rows]
    read = np.array([-predict_one(untouched, image)[1][2].sum() for image in images], dtype=float)
    check_readings(names, measured, read)
    return fit_gain(measured, read)


@command(
    option("--name", help="of the sensor"),
    option("--untouched", type=Path, metavar="IMAGE", help="the sensor while nothing touches it"),
    option("--readings", type=Path, help="table of pictures and the forces that pressed", default=None),
    option("--model", type=Path, help="model file; the one that came with gelforge if not named", default=None),
    option("--out", type=Path, help="the profile, .toml", default=None),
)
def main(args: Namespace) -> None:
    name, out = check_id(args.name), args.out or Path(f"{args.name}.toml")
    if out.suffix != ".toml":
        raise BadInput(f"--out {out}: give a name that ends in .toml")
    trained, picture = load_for_use(args.model), read_image(args.untouched)
    untouched = Untouched(trained, picture)
    if untouched.fault:
        raise BadInput(f"{args.untouched}: {untouched.fault}; take one while nothing touches the sensor")
    gain = gain_of(args.readings, untouched) if args.readings else Gain()
    profile = make_profile(name, picture, pitch_of(picture), gain, trained.about["name"])
    write_profile(out, profile)
    print(f"{out}: forces times {gain.value:.3f} ({gain.low:.3f} to {gain.high:.3f}), from {gain.readings} readings;"
          f" dots {profile.pitch:.1f} px apart")  # fmt: skip


if __name__ == "__main__":
    main.exit()
