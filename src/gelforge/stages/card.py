"""Second part of stage 80: the model card of a network."""

from argparse import Namespace
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.cli import option, stage
from gelforge.flow.files import read_json, write_text
from gelforge.flow.layout import Layout
from gelforge.flow.tables import SHIPPED as SHIPS
from gelforge.reporting.modelcard import write_card

VERSION = 5
MEASURED = option(
    "--measured",
    type=Path,
    nargs="*",
    default=[],
    help="JSON files of benchmark figures; figures of other networks are ignored",
)


SHIP = option(
    "--ship", type=Path, default=None, help="write the network there, with the intervals that real sensors showed"
)


@stage(Layout.card, MEASURED, SHIP)
def main(args: Namespace) -> None:
    from gelforge.reading.model import SHIPPED, ForceModel, fingerprint, load_model, save_model

    of = args.of
    network = SHIPPED if args.model == SHIPS else of.network(args.resolution, args.model)
    model = load_model(network)
    metadata = model.metadata
    evaluation = read_json(of.evaluation(args.resolution, args.model))
    if "failed" in evaluation:
        raise BadInput(evaluation["failed"])
    measured = [read_json(path) for path in args.measured]
    own = [found for found in measured if found.get("model") and found["model"] == fingerprint(metadata)]
    for found in own:
        if "real" in found and metadata.get("intervals"):
            metadata = metadata | {"intervals": metadata["intervals"] | {"real": found["real"]}}
    if args.ship:
        save_model(args.ship, ForceModel(metadata, model.graph))
    figures, readings = ([row for found in own for row in found.get(name, [])] for name in ("figures", "readings"))
    write_text(args.out, write_card(metadata, evaluation, figures, readings))


if __name__ == "__main__":
    main.exit()
