"""What a calibration found: shown, kept in data/DATASET/calibration.toml, or written for the stages that follow it."""

from argparse import Namespace

from gelforge.flow.calibration import FROZEN, CalibratedValues, read_posterior, read_values, write_values
from gelforge.flow.cli import RESULTS, command, group, stage
from gelforge.flow.layout import Layout


def said(found: CalibratedValues) -> str:
    """The values of a calibration in one line."""
    return ", ".join(f"{key} = {value}" for table in found.params.values() for key, value in table.items())


@command(RESULTS)
def show(args: Namespace) -> None:
    """Print what was found."""
    path = Layout(args.results).calibration()
    print(f"{path}: {said(read_posterior(path))}")


@command(RESULTS)
def keep(args: Namespace) -> None:
    """Write what was found to data/DATASET/calibration.toml."""
    of = Layout(args.results)
    path, found = of.data / FROZEN, read_posterior(of.calibration())
    write_values(path, found)
    print(f"{path}: {found.name}: {said(found)}")


@stage(Layout.followed)
def follow(args: Namespace) -> None:
    """Write what labels follow: the kept calibration if there is one, else what was found."""
    frozen = args.of.data / FROZEN
    write_values(args.out, read_values(frozen) if frozen.exists() else read_posterior(args.of.calibration()))


main = group(show=show, keep=keep, follow=follow)

if __name__ == "__main__":
    main.exit()
