"""Stage 20: the base mesh of a gel, tetrahedra by pytetwild, which stage 30 bisects for each press.

pytetwild's meshes differ from run to run, and all solves follow the mesh. So a mesh that was made for the same shape is
kept; `make clean-meshes` removes it.
"""

import json
from argparse import Namespace
from contextlib import suppress

from gelforge.errors import BadInput
from gelforge.flow.cli import stage
from gelforge.flow.layout import Layout, beside
from gelforge.geometry.gel import load_gel
from gelforge.mechanics.mesh.basemesh import BaseMesh, build, read

VERSION = 1


def kept(path, gel) -> BaseMesh | None:
    """The mesh that an earlier run made for the same shape; None if there is none that can be used."""
    with suppress(BadInput):
        found = read(path, gel, "")
        return found if found.report.get("version") == VERSION else None
    return None


@stage(Layout.mesh)
def main(args: Namespace) -> None:
    from gelforge.formats.vtu import write_vtu
    from gelforge.mechanics.mesh.tetmesh import jacobians, scaled_jacobians

    gel = load_gel(args.gel)
    made = kept(args.of.mesh(args.gel), gel) or build(gel)
    made.report["version"] = VERSION
    mesh, report = made.bent(gel), made.report
    quality = scaled_jacobians(jacobians(mesh.nodes, mesh.elements))
    write_vtu(beside(args.out, ".vtu"), mesh, cells={"scaled_jacobian": quality})
    made.write(args.out)
    print(
        f"gel {gel.name}: {report['elements']} tetrahedra, scaled Jacobian of the worst {report['min_scaled_jacobian']:.2f}, volume"
        f" {report['volume']:.1f} mm^3 ({report['volume_error']:+.2%}), {report['cpu_seconds']:.1f} s of processor"
    )
    print(json.dumps({"done": 1, "failed": {}, "digest": made.digest, "mesh": report}))


if __name__ == "__main__":
    main.exit()
