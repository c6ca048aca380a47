"""Convert a model of an earlier version (.pt) to an ONNX file of this version: `gelforge convert OLD.pt`. Needs gelforge[train]."""

from argparse import Namespace
from pathlib import Path

from gelforge.flow.files import publish
from gelforge.flow.layout import beside
from gelforge.flow.main import command, option
from gelforge.records.regular import refuse_to_replace


@command(
    option("model", type=Path, help="a .pt file of format 4"),
    option(
        "--out",
        type=Path,
        help="the .onnx file (default: beside the model); weights for further training are written beside it",
        default=None,
    ),
)
def main(args: Namespace) -> None:
    from gelforge.networks.checkpoint.convert import read_old
    from gelforge.networks.checkpoint.modelfile import ForceModel, save_model, with_digests
    from gelforge.networks.checkpoint.onnxexport import export
    from gelforge.networks.checkpoint.weights import save_weights

    out = args.out or args.model.with_suffix(".onnx")
    refuse_to_replace(f"--out {out}", [out, beside(out, ".safetensors")], [args.model])
    net, metadata = read_old(args.model)
    stages = export(net, metadata)
    model = ForceModel(with_digests(metadata, stages), stages)
    with publish(beside(out, ".safetensors")) as part:
        save_weights(part, net, model.metadata)
    with publish(out) as part:
        save_model(part, model)
    print(f"{out}: its intervals are not known any more; readers of markers that stood beside it are left out")


if __name__ == "__main__":
    main.exit()
