"""Meshes of branch pareto: label regions at every density of the chart, and tight fine ones for the reference."""

import argparse
from pathlib import Path

from gelforge.flow.files import read_json
from gelforge.geometry.gel import load_gel
from gelforge.stages.meshes import publish_mesh
from gelforge.sweeps.references import build_mesh

VERSION = 2


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(prog="gelforge.stages.pareto_meshes", description=__doc__.splitlines()[0])
    parser.add_argument("--name", required=True, help="ccx-REGION-SIZE or fine-REGION-SIZE")
    parser.add_argument("--params", type=Path, required=True, help="slice of [meshes] and [pareto.regions], .json")
    parser.add_argument("--out", type=Path, required=True, help="NAME.npz; NAME.json is written beside it")
    args = parser.parse_args(argv)
    params = read_json(args.params)
    mesh, report = build_mesh(args.name, load_gel(params["meshes"]["gel"]), params)
    publish_mesh(args.name, mesh, report, args.out)
    return 0


if __name__ == "__main__":
    from gelforge.flow.main import exit_with

    exit_with(main)
