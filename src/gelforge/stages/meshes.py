"""Stage 20: a small family of tetrahedral gel meshes, by region and density, each with a quality report."""

import json
import sys
from argparse import Namespace
from pathlib import Path

from gelforge.flow.files import write_json
from gelforge.flow.main import command, option
from gelforge.flow.params.slices import ForMeshes, read_slice
from gelforge.geometry.gel import load_gel
from gelforge.mechanics.family import MeshName, make_mesh
from gelforge.mechanics.mesh import GelMesh

VERSION = 5


def publish_mesh(name: str, mesh: GelMesh, report: dict, out: Path) -> None:
    """Write a mesh to `out`, whatever its suffix, with the report NAME.json beside it, and show the report."""
    write_json(out.with_name(f"{name}.json"), report)
    whole = out.with_name(f".{name}.npz")
    mesh.save(whole)
    whole.replace(out)
    print(json.dumps(report, indent=1), file=sys.stderr)


@command(
    option("--name", help="ccx-REGION-SIZE, such as ccx-centre-0.7"),
    option("--params", type=Path, help="slice of [meshes], .json"),
    option("--out", type=Path, help="20_meshes/NAME.npz; NAME.json is written beside it"),
)
def main(args: Namespace) -> None:
    table = read_slice(args.params, ForMeshes).meshes
    mesh, report = make_mesh(MeshName.parse(args.name), load_gel(table.gel), table)
    publish_mesh(args.name, mesh, report, args.out)


if __name__ == "__main__":
    main.exit()
