"""Stage 20: the base mesh of a gel, tetrahedra by pytetwild, which stage 30 bisects for each press.

pytetwild's meshes differ from run to run, and the keys of solves hold the mesh. So a mesh is made once for a shape and
kept beside the solves: datasets that share solves share the mesh, and a removed dataset gets it again.
"""

import json
import shutil
from argparse import Namespace
from contextlib import suppress
from pathlib import Path

from gelforge.errors import BadInput
from gelforge.flow.cli import stage
from gelforge.flow.files import digest_of_value, kept
from gelforge.flow.layout import Layout, beside
from gelforge.geometry.gel import Gel, load_gel
from gelforge.mechanics.mesh.basemesh import SUFFIX, BaseMesh, build, read, shape_text

VERSION = 1


def shared_mesh(gel: Gel, solves: Path, own: Path) -> Path:
    """The file of a gel's mesh beside the solves: there already, or the mesh in `own`, this dataset's file, or a new one.

    Of two datasets at once the first makes it, and the other one waits.
    """

    def usable(path: Path) -> BaseMesh:
        try:
            return read(path, gel, "")
        except BadInput as error:
            raise ValueError(str(error)) from error

    def make() -> BaseMesh:
        with suppress(ValueError):
            return usable(own)
        return build(gel)

    path = solves / f"mesh-{digest_of_value([shape_text(gel), VERSION])[:16]}{SUFFIX}"
    kept(path, usable, make, lambda part, mesh: mesh.write(part))
    return path


@stage(Layout.mesh)
def main(args: Namespace) -> None:
    from gelforge.formats.vtu import write_vtu
    from gelforge.mechanics.mesh.tetmesh import jacobians, scaled_jacobians

    gel = load_gel(args.gel)
    path = shared_mesh(gel, args.of.solves, args.of.mesh(args.gel))
    made = read(path, gel, "remove it, and it is made again")
    mesh, report = made.bent(gel), made.report
    quality = scaled_jacobians(jacobians(mesh.nodes, mesh.elements))
    write_vtu(beside(args.out, ".vtu"), mesh, cells={"scaled_jacobian": quality})
    shutil.copyfile(path, args.out)  # to the byte, so that what follows is not made again
    print(
        f"gel {gel.name}: {report['elements']} tetrahedra, scaled Jacobian of the worst {report['min_scaled_jacobian']:.2f}, volume"
        f" {report['volume']:.1f} mm^3 ({report['volume_error']:+.2%}), {report['cpu_seconds']:.1f} s of processor"
    )
    print(json.dumps({"done": 1, "failed": {}, "digest": made.digest, "mesh": report}))


if __name__ == "__main__":
    main.exit()
