"""Stage 80, too: the model card of a network."""

from argparse import Namespace
from pathlib import Path

from gelforge.flow.files import read_json, write_text
from gelforge.flow.main import command, option
from gelforge.reporting.modelcard import write_card

VERSION = 5


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
    from gelforge.networks.checkpoint.modelfile import fingerprint, load_model

    metadata = load_model(args.model).metadata
    measured = [read_json(path) for path in args.measured]
    own = [found for found in measured if found.get("model") and found["model"] == fingerprint(metadata)]
    figures, readings = ([row for found in own for row in found.get(name, [])] for name in ("figures", "readings"))
    write_text(args.out, write_card(metadata, read_json(args.evaluation), figures, readings))


if __name__ == "__main__":
    main.exit()
