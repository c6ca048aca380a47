"""`make freeze`: write the result of a calibration to data/DATASET/calibration.toml."""

from argparse import Namespace
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.files import read_json
from gelforge.flow.main import command, option
from gelforge.flow.params.frozen import frozen_of, write_frozen


@command(
    option("--summary", type=Path, help="results/DATASET/calibrate/summary.json"),
    option("--out", type=Path, help="data/DATASET/calibration.toml"),
)
def main(args: Namespace) -> None:
    try:
        summary = read_json(args.summary)
    except (OSError, ValueError) as error:
        raise BadInput(f"{args.summary}: cannot be read ({error}); run make calibrate") from error
    found = frozen_of(args.out.parent.name, summary)
    write_frozen(args.out, found)
    values = ", ".join(f"{key} = {value}" for table in found.params.values() for key, value in table.items())
    print(f"{args.out}: {found.name}: {values}")


if __name__ == "__main__":
    main.exit()
