"""Combine gauge log, path log and images of a bench, each with its own clock, into a dataset."""

import argparse
import sys
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gelforge.commands.mcap import doubts_of_forces
from gelforge.errors import BadInput
from gelforge.flow import schema
from gelforge.flow.cli import command, option, positive
from gelforge.flow.files import read_toml
from gelforge.flow.tables import PosesTable
from gelforge.formats.benchfiles import Images, read_gauge, read_path
from gelforge.formats.benchlog import Aligned, Setup, align, nocontact_of, write_dataset
from gelforge.formats.feats_folder import refuse_existing
from gelforge.geometry.gel import load_gel
from gelforge.geometry.indenters import load_catalogue
from gelforge.geometry.touch import first_touch
from gelforge.labelling.sensor import Sensor, find_sensor, load_sensors
from gelforge.reading.frame import image_frame, same_shape
from gelforge.records.frames import check_frames
from gelforge.records.press import Press, RawRow, Rejection, parse
from gelforge.stages.poses import geometric_faults

START_MM = 3.0  # above the apex, where no body touches yet


def place(text: str) -> tuple[float, float, float]:
    """Three numbers X,Y,Z, as the `type` of an option."""
    try:
        x, y, z = map(float, text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a position X,Y,Z in mm") from None
    return x, y, z


def newtons(text: str) -> float:
    """A force above 0 N, as the `type` of an option."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < np.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not a force above 0 N")
    return value


@command(
    option("--gauge", type=Path, required=True, help="CSV of a time and fz_UNIT, perhaps fx_UNIT and fy_UNIT"),
    option(
        "--path",
        type=Path,
        required=True,
        help="CSV of a time and x_UNIT, y_UNIT, z_UNIT, or GRBL's reports, each after its time in s",
    ),
    option("--images", type=Path, required=True, help="a film, or a folder of images with times.csv (image, time_s)"),
    option("--data", type=Path, required=True, help="the dataset's folder, data/NAME, which must not exist"),
    option("--sensor", required=True, help="of workflow/sensors.toml"),
    option("--indenter", required=True, help="of workflow/indenters.toml"),
    option("--gel-id", default="gel", help="your name of the piece of gel"),
    option("--origin", type=place, default=(0.0, 0.0, 0.0), metavar="X,Y,Z", help="the gel's apex on the path, mm"),
    option("--sign", type=int, choices=(1, -1), default=1, help="-1: the gauge counts pressing as positive"),
    option("--touch", type=newtons, default=0.1, help="least force that counts as contact, N"),
    option("--every", type=positive, default=1, help="take every n-th state of a press"),
    option("--sensors", type=Path, default=Path("workflow/sensors.toml")),
    option("--indenters", type=Path, default=Path("workflow/indenters.toml")),
    option("--params", type=Path, default=Path("workflow/params.toml")),
)
def main(args: Namespace) -> None:
    refuse_existing(args.data)
    sensor = find_sensor(load_sensors(args.sensors), args.sensor, "--sensor", str(args.sensors))
    body = load_catalogue(args.indenters, [args.indenter])[args.indenter]
    (gauge, measured), path = read_gauge(args.gauge, args.sign), read_path(args.path, args.origin)
    gel = load_gel(sensor.gel)
    bench, images = Setup(sensor, args.indenter, args.gel_id, touch_height(gel, body)), Images.of(args.images)
    found = align(gauge, measured, path, images, bench, args.touch, args.every)
    print(*found.notes, sep="\n")
    limits = schema.parse(
        PosesTable, read_toml(args.params).get("poses", {}), schema.Place(str(args.params), ("poses",))
    )
    for line in leave_out(found, body, gel, limits):
        print(line, file=sys.stderr)
    nocontact = nocontact_of(found, images)
    write_dataset(found, images, nocontact, framing(sensor, nocontact, f"{args.images}: images"), bench, args.data)
    draw(found, args.data / "aligned.png")
    for doubt in doubts_of_forces(args.data, list(found.rows.values()), sensor.name):
        print(f"note: {doubt}")
    presses = len({row.press_id for row in found.rows.values()})
    print(
        f"{args.data}: {len(found.rows)} rows of {presses} presses; look at aligned.png there, then make DATASET={args.data.name} labels"
    )


def touch_height(gel, body) -> Callable[[float, float, float], float]:
    """A function that returns the height of a body's tip, mm, at which it meets the gel at x, y mm, turned in degrees."""

    def height(x: float, y: float, turn: float) -> float:
        press = Press(x, y, START_MM, 0.0, 0.0, -2.0 * START_MM, turn)
        met = first_touch(gel, body, press)
        return START_MM * (1.0 - 2.0 * met) if met is not None else float("nan")

    return height


def framing(sensor: Sensor, nocontact: np.ndarray, where: str) -> Callable[[np.ndarray], np.ndarray]:
    """A function that brings images to the sensor's size.

    Images of another aspect ratio are framed by the markers of the no-contact image, as in `predict`.
    """
    width, height = sensor.image
    if not same_shape(nocontact.shape, (height, width)):
        frame, _ = image_frame(nocontact, (height, width))
        if not frame.as_logged:
            print(frame.text)
            return frame
    return lambda image: sensor.sized(image, where)


def leave_out(found: Aligned, body, gel, params) -> list[str]:
    """Remove rows that stage 10 would reject; return a sentence for each reason. BadInput where none is left."""
    lines = {row.sample_id: at for at, row in found.rows.items()}
    good, wrong = [], []
    for number, row in enumerate(found.rows.values(), 2):
        record, faults = parse(RawRow(number, row.cells()), "log.csv")
        if record is not None:
            faults = geometric_faults(record, "log.csv", body, gel, params)
            good += [] if faults else [record]
        wrong += faults[:1]
    wrong += check_frames(good, "log.csv")
    by_reason: dict[str, list[Rejection]] = {}
    for each in wrong:
        by_reason.setdefault(f"{each.column}: {each.reason}", []).append(each)
        found.rows.pop(lines[each.sample_id], None)
    said = [
        f"{len(of)} images left out, {reason} (the first is {of[0].sample_id}: {of[0].hint})"
        for reason, of in by_reason.items()
    ]
    too_large = [each for each in wrong if each.column == "fz_n"]
    if 2 * len(too_large) > len(found.rows):
        raise BadInput(f"{found.gauge.name}: in {len(too_large)} images {too_large[0].reason}: {too_large[0].hint}")
    if not found.rows:
        raise BadInput(f"{found.path.name}: no image is left: " + "; ".join(said))
    return said


def draw(found: Aligned, path: Path) -> None:
    """Plot force, depth, image change and the log's rows over time, and the residuals of the presses' offsets."""
    from gelforge.reporting.canvas import canvas_with_axes, save_png

    figure, ((top,), (below,)) = canvas_with_axes(2, 1, 11.0, 6.4)
    start, depth, change = found.gauge.times[0], found.path, found.change
    at = found.clocks["images"].to_gauge(change.times)
    curves = (
        ("force", found.gauge.times, found.gauge.values[:, 0]),
        ("depth", found.clocks["path"].to_gauge(depth.times), np.maximum(depth.values[:, 0], 0.0)),
        ("change of the images", at, change.values[:, 0]),
    )
    for name, times, values in curves:
        top.plot(times - start, values / (np.nanmax(values) or 1.0), linewidth=0.8, label=name)
    rows = at[list(found.rows)] - start
    forces = found.gauge.values[:, 0]
    top.plot(
        rows,
        np.interp(rows, found.gauge.times - start, forces) / forces.max(),
        "k.",
        markersize=4,
        label="rows of the log",
    )
    top.set(title="The three recordings on the gauge's clock: they rise and fall together in each press")
    top.set(ylabel="fraction of its maximum")
    limits, furthest = [], 0.0
    for (name, clock), mark in zip(found.clocks.items(), ("o", "x"), strict=True):
        times, offsets = clock.presses.T
        line = clock.offset_s + clock.drift / (1.0 + clock.drift) * (times - clock.middle_s - clock.offset_s)
        off = 1e3 * (offsets - line)
        limit = 1e3 * clock.limit_s
        limits.append(f"{name} {limit:.1f} ms")
        furthest = max(furthest, np.abs(off).max(), limit)
        (marks,) = below.plot(times - start, off, mark, label=f"{name}, drift {clock.drift * 1e6:+.0f} ppm")
        for height in (-limit, limit):
            below.axhline(height, color=marks.get_color(), linewidth=0.8, linestyle="--")
    below.axhline(0.0, color="0.7", linewidth=0.8)
    below.set(
        title=f"Deviation of each press from its clock's line; dashed: largest scatter that is accepted ({', '.join(limits)})"
    )
    below.set(
        xlabel="time on the gauge's clock, s",
        ylabel="ms",
        xlim=top.get_xlim(),
        ylim=(-1.4 * furthest, 1.4 * furthest),
    )
    for axis in (top, below):
        axis.legend(loc="upper right", fontsize=8)
    save_png(path, figure)


if __name__ == "__main__":
    main.exit()
