"""Convert FEATS' files to datasets and back: `make feats-fetch`, `make feats-import`, `make feats-export`."""

from argparse import Namespace
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.cli import command, group, option, stage
from gelforge.flow.layout import Layout
from gelforge.formats.feats_folder import export_dataset, import_folder, refuse_existing
from gelforge.formats.featsfile import write_normalisation
from gelforge.labelling.sensor import find_sensor, load_sensors


@command(
    option("--from", dest="source"),
    option("--data", type=Path, help="data/DATASET, which must not exist"),
    option("--sensor", default="feats_mini", help="name in sensors.toml"),
    option("--sensors", type=Path, default=Path("workflow/sensors.toml")),
)
def bring_in(args: Namespace) -> None:
    """FEATS' .npy files to data/DATASET."""
    if not args.source or not Path(args.source).is_dir():
        raise BadInput(f"FROM={args.source}: not a folder; say make feats-import FROM=folder DATASET=name")
    # a new dataset has no sensors.toml of its own
    sensor = find_sensor(load_sensors(args.sensors), args.sensor, "SENSOR", str(args.sensors))
    found = import_folder(Path(args.source), args.data, sensor)
    print(f"{args.data}: {found['presses']} presses from {found['files']} files; labels: {found['labels'] or 'none'}")


@command(
    option(
        "--from",
        dest="source",
        default="",
        help="folder in the published layout (default: the Hugging Face hub)",
    ),
    option("--split", default="", help="folders to fetch, separated by blanks (default: all)"),
    option("--downloads", type=Path, help="folder for files of the hub"),
    option("--data", type=Path, help="data/DATASET"),
    option("--sensors", type=Path, default=Path("workflow/sensors.toml")),
)
def fetch(args: Namespace) -> None:
    """FEATS' published dataset, from the hub or a copy of it, to data/DATASET."""
    from gelforge.formats.feats_hub import fetch as fetch_from_hub

    refuse_existing(args.data)
    sensors = load_sensors(args.sensors)
    sensor, other = (
        find_sensor(sensors, name, "SENSOR", str(args.sensors)) for name in ("feats_mini", "feats_mini_2")
    )
    splits = args.split.split()
    if args.source and not Path(args.source).is_dir():
        raise BadInput(f"FROM={args.source}: not a folder; give a copy of the dataset's folders, or leave FROM out")
    source = Path(args.source) if args.source else fetch_from_hub(args.downloads, splits)
    found = import_folder(source, args.data, sensor, other, splits)
    print(f"{args.data}: {found['presses']} presses from {found['files']} files; labels: {found['labels'] or 'none'}")


@stage(Layout.feats)
def send_out(args: Namespace) -> None:
    """60_dataset/RES to FEATS' label folders."""
    write_normalisation(args.out, export_dataset(args.of.dataset(args.resolution), args.out.parent))


main = group(**{"import": bring_in, "export": send_out, "fetch": fetch})


if __name__ == "__main__":
    main.exit()
