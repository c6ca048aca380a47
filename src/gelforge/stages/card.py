"""Stage 80, too: the model card of a network."""

from argparse import Namespace
from pathlib import Path

from gelforge.flow.files import read_json, write_text
from gelforge.flow.main import command, option
from gelforge.networks.modelcard import write_card

VERSION = 3


@command(
    option("--model", type=Path),
    option("--evaluation", type=Path),
    option(
        "--measured",
        type=Path,
        nargs="*",
        default=[],
        help="figures of benchmarks; those of other networks are left out",
    ),
    option("--out", type=Path),
)
def main(args: Namespace) -> None:
    from gelforge.networks.modelfile import load_model
    from gelforge.networks.sensorprofile import fingerprint

    about = load_model(args.model).about
    measured = [read_json(path) for path in args.measured]
    own = [found for found in measured if found.get("model") and found["model"] == fingerprint(about)]
    figures, readings = ([row for found in own for row in found.get(name, [])] for name in ("figures", "readings"))
    write_text(args.out, write_card(about, read_json(args.evaluation), figures, readings))


if __name__ == "__main__":
    main.exit()
