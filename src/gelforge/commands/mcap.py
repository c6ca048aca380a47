"""Import recordings (MCAP, bags of ROS) as a dataset: `make mcap-import FROM=recordings TOPICS=topics.toml DATASET=name`."""

from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.evidence.forces import FEWEST, drift, misplaced, off_axes, unit
from gelforge.flow.cli import command, option
from gelforge.formats.mcap_import import Topics, import_recordings
from gelforge.labelling.sensor import find_sensor, load_sensors
from gelforge.reading.frame import colour_fault
from gelforge.reading.reader import Reader
from gelforge.records.image import read_image
from gelforge.records.log import read_log
from gelforge.records.press import PressRecord, parse

ASKED = 24  # strong presses whose images the shipped network reads, and twice as many of all rows
TORN = "the image is torn"  # of reading.faults
ASIDE_N = 0.4  # spread of sideways forces from which on their axes are compared; the network errs by 0.35 N
PRESSED_N = 0.5  # predicted compression above which an image shows a press


@command(
    option("--from", dest="source"),
    option("--topics", help="TOML that names the topics; src/gelforge/formats/mcap_import.py shows one"),
    option("--data", type=Path, help="data/DATASET, which must not exist"),
    option("--sensors", type=Path, default=Path("workflow/sensors.toml")),
)
def main(args: Namespace) -> None:
    for name, value in (("FROM", args.source), ("TOPICS", args.topics)):
        if not value or not Path(value).exists():
            raise BadInput(
                f"{name}={value}: not there; say make mcap-import FROM=recordings TOPICS=topics.toml DATASET=name"
            )
    topics = Topics.read(Path(args.topics))
    sensor = find_sensor(load_sensors(args.sensors), topics.sensor, args.topics, str(args.sensors))
    found = import_recordings(Path(args.source), args.data, topics, sensor)
    print(*found["notes"], sep="\n", end="\n" if found["notes"] else "")
    for doubt in doubts_of_forces(args.data, imported(args.data / "log.csv"), sensor.name):
        print(f"note: {doubt}")
    print(
        f"{args.data}: {found['images']} images with force from {found['files']} recordings, {found['without_wrench']}"
        f" without; an image and its wrench are at most {1e3 * found['largest_gap_s']:.1f} ms apart; make train DATASET={args.data.name} RES=1x1 MODEL=pair_16 learns from them"
    )


def imported(log: Path) -> list[PressRecord]:
    """Rows of a log without poses."""
    return [press for press, _ in (parse(raw, str(log), ("sample_id", "image")) for raw in read_log(log)) if press]


def doubts_of_forces(data: Path, rows: Sequence[PressRecord], sensor: str) -> list[str]:
    """Doubts about unit, axes and drift of recorded forces, from predictions of the shipped network, and about colours.

    The network errs by a factor of two at most, while units differ by four and more. Flagged images are ignored.
    """
    nocontact = data / "nocontact" / f"{sensor}.png"
    known = [row for row in rows if row.fz_n is not None]
    if not nocontact.is_file() or not known:
        return []
    by_force = np.argsort([-float(np.linalg.norm(np.nan_to_num(row.force))) for row in known], kind="stable")
    strong = by_force[np.unique(np.linspace(0, (len(known) - 1) // 2, ASKED).astype(int))]
    through = np.unique(np.linspace(0, len(known) - 1, 2 * ASKED).astype(int))
    rest_image = read_image(nocontact)
    asked, read = np.union1d(strong, through), Reader(nocontact=rest_image)
    force = np.array([known[at].force for at in asked], float)
    seen = [read(read_image(data / known[at].image)) for at in asked]
    normal = np.array([np.nan if one.flag else -one.total[2] for one in seen])
    pressed = np.isin(asked, strong) & (normal > PRESSED_N)
    rest = np.isin(asked, through) & (np.abs(normal) < PRESSED_N)
    torn = [known[at].image for at, one in zip(asked, seen, strict=True) if TORN in one.reason]
    said = [*(f"{nocontact}: {fault}" for fault in colour_fault(rest_image)), drift(force[rest], asked[rest])]
    if torn:
        said.append(
            f"{len(torn)} of {len(asked)} images that were read are torn, such as {torn[0]}: parts of them are of other frames; check the camera's"
            " cable and its rate, and remove such images"
        )
    if pressed.sum() >= FEWEST:
        where = "the recorded force, which was compared with the shipped network's predictions"
        said += [misplaced(force[pressed], normal[pressed]), unit(-force[pressed, 2], normal[pressed], where)]
        aside = np.array([one.total[:2] for one in seen])[pressed] @ [1.0, 1.0j], force[pressed, :2] @ [1.0, 1.0j]
        if min(np.std(each) for each in aside) > ASIDE_N:
            said.append(off_axes(*aside, "what the shipped network reads of them"))
    return [one for one in said if one]


if __name__ == "__main__":
    main.exit()
