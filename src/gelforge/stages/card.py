"""Stage 80, too: the model card of a network."""

from argparse import Namespace
from pathlib import Path

from gelforge.flow.files import read_json, write_text
from gelforge.flow.main import command, option
from gelforge.networks.modelcard import write_card


@command(
    option("--model", type=Path),
    option("--evaluation", type=Path),
    option("--out", type=Path),
)
def main(args: Namespace) -> None:
    from gelforge.networks.modelfile import load_model

    write_text(args.out, write_card(load_model(args.model).about, read_json(args.evaluation)))


if __name__ == "__main__":
    main.exit()
