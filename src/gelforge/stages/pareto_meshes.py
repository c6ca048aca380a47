"""Meshes of branch pareto: label regions at every density of the chart, and tight fine ones for the reference."""

from argparse import Namespace
from pathlib import Path

from gelforge.flow.files import read_json
from gelforge.flow.main import command, option
from gelforge.geometry.gel import load_gel
from gelforge.stages.meshes import publish_mesh
from gelforge.sweeps.references import build_mesh

VERSION = 2


@command(
    option("--name", help="ccx-REGION-SIZE or fine-REGION-SIZE"),
    option("--params", type=Path, help="slice of [meshes] and [pareto.regions], .json"),
    option("--out", type=Path, help="NAME.npz; NAME.json is written beside it"),
)
def main(args: Namespace) -> None:
    params = read_json(args.params)
    mesh, report = build_mesh(args.name, load_gel(params["meshes"]["gel"]), params)
    publish_mesh(args.name, mesh, report, args.out)


if __name__ == "__main__":
    main.exit()
