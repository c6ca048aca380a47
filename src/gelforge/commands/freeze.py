"""`make freeze`: write the result of a calibration to data/DATASET/calibration.toml."""

from argparse import Namespace

from gelforge.flow.calibration import FROZEN, read_posterior, write_frozen
from gelforge.flow.cli import RESULTS, command, option
from gelforge.flow.layout import Layout


@command(RESULTS, option("--show", action="store_true", default=False, help="print what was found, write nothing"))
def main(args: Namespace) -> None:
    of = Layout(args.results)
    found = read_posterior(of.calibration())
    values = ", ".join(f"{key} = {value}" for table in found.params.values() for key, value in table.items())
    if args.show:
        print(f"{of.calibration()}: {values}")
        return
    path = of.data / FROZEN
    write_frozen(path, found)
    print(f"{path}: {found.name}: {values}")


if __name__ == "__main__":
    main.exit()
