"""Import MCAP recordings as a dataset: `make mcap-import FROM=recordings TOPICS=topics.toml DATASET=name`."""

from argparse import Namespace
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.main import command, option
from gelforge.formats.mcap_import import Topics, import_recordings
from gelforge.labelling.sensor import find_sensor, load_sensors


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
    print(
        f"{args.data}: {found['images']} images with force from {found['files']} recordings, {found['without_wrench']}"
        f" without; an image and its wrench are at most {1e3 * found['largest_gap_s']:.1f} ms apart; make train DATASET={args.data.name} RES=1x1 MODEL=pair_16 learns from them"
    )


if __name__ == "__main__":
    main.exit()
