"""Fit the background of a no-contact image, and print it as workflow/rig/sensors.toml has it."""

from argparse import Namespace

from gelforge.flow.cli import command, option
from gelforge.records.image import read_image
from gelforge.virtualrig.appearance import COLOURS, fit_background


@command(
    option("image", help="no-contact image, 320 x 240"),
)
def main(args: Namespace) -> None:
    image = read_image(args.image)
    for name, terms in zip(COLOURS, fit_background(image).T, strict=True):
        print(f"{name} = [{', '.join(f'{value:.1f}' for value in terms)}]")


if __name__ == "__main__":
    main.exit()
