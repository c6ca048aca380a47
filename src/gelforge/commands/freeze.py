"""`make freeze`: write the result of a calibration to data/DATASET/calibration.toml."""

from argparse import Namespace

from gelforge.errors import BadInput
from gelforge.flow.cli import RESULTS, command
from gelforge.flow.files import read_json
from gelforge.flow.layout import Layout
from gelforge.flow.params import FROZEN, frozen_of, write_frozen


@command(RESULTS)
def main(args: Namespace) -> None:
    of = Layout(args.results)
    path, out = of.calibration(), of.data / FROZEN
    try:
        summary = read_json(path)
    except (OSError, ValueError) as error:
        raise BadInput(f"{path}: cannot be read ({error}); run {of.command('calibrate')}") from error
    found = frozen_of(of.data.name, summary)
    write_frozen(out, found)
    values = ", ".join(f"{key} = {value}" for table in found.params.values() for key, value in table.items())
    print(f"{out}: {found.name}: {values}")


if __name__ == "__main__":
    main.exit()
