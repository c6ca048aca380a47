"""Solve one press, without a log: print its force and moment, write its label as an array and a picture."""

from argparse import ArgumentTypeError, Namespace
from pathlib import Path

import numpy as np

from gelforge.api import label, solve
from gelforge.flow.cli import command, option
from gelforge.flow.files import publish
from gelforge.labelling.grid import Grid


def pair(text: str) -> tuple[float, float]:
    """Two numbers, such as 0.3,-0.1."""
    try:
        x, y = map(float, text.split(","))
    except ValueError:
        raise ArgumentTypeError(f"{text!r}: give two numbers, x and y, such as 0.3,-0.1") from None
    return x, y


@command(
    option("indenter", help="a name of workflow/indenters.toml, such as sphere_10"),
    option("--depth", type=float, help="of the tip below the gel's apex, mm", default=None),
    option("--force", type=float, help="in place of --depth: normal force, N", default=None),
    option("--at", type=pair, metavar="X,Y", help="place of the tip, mm", default=(0.0, 0.0)),
    option("--shear", type=pair, metavar="X,Y", help="sideways motion at depth, mm", default=(0.0, 0.0)),
    option("--tilt", type=pair, metavar="X,Y", help="about gel x and y, degrees", default=(0.0, 0.0)),
    option("--rot", type=float, help="rotation of the indenter about z, degrees", default=0.0),
    option("--method", help="draft, label, fine, ccx or auto", default="draft"),
    option("--resolution", type=Grid.parse, metavar="ROWSxCOLS", default="24x32"),
    option("--out", type=Path, help="write OUT.npy, N per cell, and OUT.png", default=None),
)
def main(args: Namespace) -> None:
    press = solve(
        args.indenter, args.depth, at=args.at, shear=args.shear, rot_deg=args.rot, tilt=args.tilt, method=args.method,
        force=args.force,
    )  # fmt: skip
    print(f"{press}, {press.depth:.3f} mm deep")
    if args.out:
        cells = label(press, args.resolution.shape)
        with publish(args.out.with_suffix(".npy")) as part:
            np.save(part, cells)
        with publish(args.out.with_suffix(".png")) as part:
            press.plot(args.resolution.shape).savefig(part, format="png")
        print(args.out.with_suffix(".npy"), args.out.with_suffix(".png"), sep="\n")


if __name__ == "__main__":
    main.exit()
