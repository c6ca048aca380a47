"""Gauge log, path log and images of a bench, each with its own clock, as a dataset with a log."""

from argparse import Namespace
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.main import command, option, positive
from gelforge.formats.benchfiles import Images, Setup, align, read_gauge, read_path
from gelforge.labelling.sensor import find_sensor, load_sensors


def place(text: str) -> tuple[float, float, float]:
    """Three numbers with commas between them."""
    x, y, z = map(float, text.split(","))
    return x, y, z


@command(
    option("--gauge", type=Path, required=True, help="CSV of a time and fz_UNIT, perhaps fx_UNIT and fy_UNIT"),
    option(
        "--path",
        type=Path,
        required=True,
        help="CSV of a time and x_UNIT, y_UNIT, z_UNIT, or lines of time and G-code",
    ),
    option("--images", type=Path, required=True, help="a film, or a folder of images with times.csv (image, time_s)"),
    option("--data", type=Path, required=True, help="the dataset's folder, data/NAME, which must not exist"),
    option("--sensor", required=True, help="of workflow/sensors.toml"),
    option("--indenter", required=True, help="of workflow/indenters.toml"),
    option("--gel-id", default="gel", help="your name of the piece of gel"),
    option("--origin", type=place, default=(0.0, 0.0, 0.0), metavar="X,Y,Z", help="the gel's apex on the path, mm"),
    option("--sign", type=int, choices=(1, -1), default=1, help="-1: the gauge counts pressing as positive"),
    option("--touch", type=positive, default=0.1, help="N from which on the gel is pressed"),
    option("--every", type=int, default=1, help="of so many images of a press one is taken"),
    option("--sensors", type=Path, default=Path("workflow/sensors.toml")),
)
def main(args: Namespace) -> None:
    if args.every < 1:
        raise BadInput(f"--every {args.every}: give a whole number from 1")
    sensor = find_sensor(load_sensors(args.sensors), args.sensor, "--sensor", str(args.sensors))
    gauge, path = read_gauge(args.gauge, args.sign), read_path(args.path, args.origin)
    bench = Setup(sensor, args.indenter, args.gel_id)
    print(*align(gauge, path, Images.of(args.images), bench, args.data, args.touch, args.every), sep="\n")
    print(f"next: make DATASET={args.data.name} labels")


if __name__ == "__main__":
    main.exit()
