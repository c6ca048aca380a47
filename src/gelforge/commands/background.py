"""The background of a picture without contact, as it stands in workflow/rig/sensors.toml."""

from argparse import Namespace

import cv2

from gelforge.errors import BadInput
from gelforge.flow.main import command, option
from gelforge.virtualrig.background import fit_background
from gelforge.virtualrig.looks import COLOURS


@command(
    option("image", help="a picture without contact, 320 x 240"),
)
def main(args: Namespace) -> None:
    image = cv2.imread(args.image)
    if image is None:
        raise BadInput(f"{args.image}: no readable image; give a PNG of the gel without contact")
    for name, terms in zip(COLOURS, fit_background(image[..., ::-1]).T, strict=True):
        print(f"{name} = [{', '.join(f'{value:.1f}' for value in terms)}]")


if __name__ == "__main__":
    main.exit()
