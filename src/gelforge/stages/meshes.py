"""Stage 20: a small family of tetrahedral gel meshes, by region and density, each with a quality report."""

import argparse
import json
import sys
from pathlib import Path

from gelforge.flow.files import read_json, write_json
from gelforge.geometry.gel import load_gel
from gelforge.mechanics.family import MeshName, make_mesh
from gelforge.mechanics.mesh import GelMesh

VERSION = 2


def publish_mesh(name: str, mesh: GelMesh, report: dict, out: Path) -> None:
    """Write a mesh to `out`, whatever its suffix, with the report NAME.json beside it, and show the report."""
    write_json(out.with_name(f"{name}.json"), report)
    whole = out.with_name(f".{name}.npz")
    mesh.save(whole)
    whole.replace(out)
    print(json.dumps(report, indent=1), file=sys.stderr)


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(prog="gelforge.stages.meshes", description=__doc__.splitlines()[0])
    parser.add_argument("--name", required=True, help="ccx-REGION-SIZE, such as ccx-centre-0.7")
    parser.add_argument("--params", type=Path, required=True, help="slice of [meshes], .json")
    parser.add_argument("--out", type=Path, required=True, help="20_meshes/NAME.npz; NAME.json is written beside it")
    args = parser.parse_args(argv)
    table = read_json(args.params)["meshes"]
    mesh, report = make_mesh(MeshName.parse(args.name), load_gel(table["gel"]), table)
    publish_mesh(args.name, mesh, report, args.out)
    return 0


if __name__ == "__main__":
    from gelforge.flow.main import exit_with

    exit_with(main)
