"""Stage 70, too: a trained network as ONNX, published only if it agrees with torch."""

from argparse import Namespace
from pathlib import Path

from gelforge.errors import GelforgeError
from gelforge.flow.main import command, option
from gelforge.networks.onnxgraph import TOLERANCE, export, largest_difference, sample_images

VERSION = 1


@command(
    option("--model", type=Path),
    option("--out", type=Path),
)
def main(args: Namespace) -> None:
    from gelforge.networks.modelfile import load_model

    trained = load_model(args.model)
    export(trained, args.out)
    found = largest_difference(trained, args.out, sample_images(trained.about["image"]))
    print(", ".join(f"{engine}: {value:.1e} of the range" for engine, value in found.items()))
    if not all(value <= TOLERANCE for value in found.values()):  # NaN is no agreement
        args.out.unlink()
        raise GelforgeError(
            f"{args.model}: its ONNX form differs from torch by {max(found.values()):.1e} of the range, "
            f"allowed is {TOLERANCE}; report the versions of torch and the engine"
        )


if __name__ == "__main__":
    main.exit()
