"""GetFEM, an independent finite element library, against the references on scenes of the open benchmark.

The scenes include edges and shear; two more have friction, and there `label` and `draft` are compared with GetFEM, whose
law of friction is its own augmented Lagrangian. The program runs in Debian's own Python (python3-getfem, python3-scipy); without
these packages it says so and measures nothing. Every scene is solved once for the same program, scene and gel, so
that an interrupted run resumes.
"""

import hashlib
import json
import subprocess
import sys
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.cli import command, option
from gelforge.flow.params import load_params
from gelforge.flow.tables import IN_PROCESS
from gelforge.mechanics.hexsettings import quality
from gelforge.mechanics.scene import Interface, Scene
from gelforge.mechanics.solvers.hex import HexSolver
from gelforge.stages import challenge
from gelforge.sweeps.challenge import write_scene
from gelforge.sweeps.scenes import parse_scene
from tests.support.debian_python import PROGRAM, PYTHON, has_getfem
from tests.support.figures import Figure, publish_figures

GOALS = ("sphere_1mm", "cuboid_round", "cylinder", "pyramid", "cuboid_shear", "sloping_cuboid", "triple_triangle")
SHARP = ("cuboid_sharp", "punch")  # without a goal: their references are not converged in element size
TOTAL, CELLS = 0.5, 3.0  # largest errors in % of total force: of the total, and summed over blocks of 2 x 2 cells
# Scenes under Coulomb's law, as in workflow/scenes.toml, with their coefficient of friction.
RUBBING = {
    "ball_dragged": ({"indenter": {"kind": "sphere", "diameter": 10, "height": 10}, "depth": 0.6, "dx": 0.5}, 0.4),
    "cuboid_slipping": (
        {"indenter": {"kind": "cuboid", "size": [7, 7], "fillet": 0.5, "height": 10}, "depth": 0.6}, 0.2,
    ),
}  # fmt: skip
RUBBING_TOTAL = 1.5  # %, largest difference of the total force between a method and GetFEM


def submission(folder: Path, scenes: tuple[str, ...], work: Path) -> Path:
    """Folder of GetFEM's forces, named by a digest of all that they depend on. folder: the open benchmark's."""
    digest = hashlib.sha256(PROGRAM.read_bytes())
    for name in ("gel.stl", *(f"scenes/{scene}/scene.json" for scene in (*GOALS, *SHARP, *RUBBING))):
        digest.update((folder / name).read_bytes())
    shape = json.loads((folder / "challenge.json").read_text(encoding="utf-8"))
    digest.update(json.dumps([shape[key] for key in ("c10_mpa", "d1_per_mpa", "gel")]).encode())
    out = work / digest.hexdigest()[:16]
    done = subprocess.run([PYTHON, str(PROGRAM), str(folder), str(out), *scenes], check=False)
    if done.returncode:
        raise BadInput(
            f"{PROGRAM.name} ended with {done.returncode}, see above; scenes that it finished are kept in {out}"
        )
    return out


def rubbing_scenes(folder: Path, nu: float) -> dict[str, Scene]:
    """Write the scenes under Coulomb's law beside the others of the open benchmark's folder, and return them."""
    found = {}
    for name, (table, mu) in RUBBING.items():
        named = parse_scene(name, table, nu)
        found[name] = replace(named.scene, interface=Interface.of_friction(mu))
        write_scene(replace(named, scene=found[name]), folder / "scenes" / name)
    return found


def rubbing_figures(scenes: dict[str, Scene], out: Path) -> list[Figure]:
    """Differences of the total force from GetFEM's. out: the folder of its forces."""
    found = []
    for name, scene in scenes.items():
        rows = np.loadtxt(out / f"{name}.csv", delimiter=",", skiprows=1)
        right = rows[:, 2:].sum(axis=0)
        for method in IN_PROCESS:
            result = HexSolver(quality(method)).solve(scene)
            off = 100 * float(np.linalg.norm(result.total - right) / np.linalg.norm(right))
            note = f"{method} {np.round(result.total, 3).tolist()} N, GetFEM {np.round(right, 3).tolist()} N; "
            note += f"stated {100 * result.error_n / np.linalg.norm(right):.2f} %"
            found.append(Figure(f"{name}, mu {scene.interface.mu:g}, {method}", off, "<=", RUBBING_TOTAL, "%", note))
    return found


def scored(folder: Path, out: Path) -> dict:
    """Scores of a submission by the benchmark's own script."""
    path = out / "score.json"
    subprocess.run([sys.executable, "-I", str(folder / "score.py"), str(out), "--out", str(path)], check=True)
    return json.loads(path.read_text(encoding="utf-8"))


def figures_of(scores: dict) -> list[Figure]:
    """Errors of the scenes that have goals; the scores of the benchmark's script include the sharp ones, too."""
    found = []
    for name, errors in scores["scenes"].items():
        if name in SHARP:
            continue
        own = "unknown" if errors["reference"] is None else f"{100 * errors['reference']:.1f} %"
        seconds = scores["seconds"].get(name)
        note = f"cells {100 * errors['cells']:.1f} %; the reference on doubled elements differs by {own}"
        note += f"; {seconds:.0f} s of processor time" if seconds is not None else ""
        found.append(Figure(f"{name}, total force", 100 * errors["total"], "<=", TOTAL, "%", note))
        found.append(Figure(f"{name}, 2 x 2 cells", 100 * errors["cells_2x2"], "<=", CELLS, "%"))
    return found


@command(
    option("--scenes", nargs="+", choices=[*GOALS, *SHARP, *RUBBING], default=[*GOALS, *SHARP, *RUBBING]),
    option("--work", type=Path, default=Path("results/benchmarks/outside"), help="what is kept"),
    option("--out", type=Path),
)
def main(args: Namespace) -> None:
    if not has_getfem():
        print(f"skipped: {PYTHON} has no GetFEM; sudo apt-get install python3-getfem python3-scipy")
        return
    folder = Path("results/fea_challenge")
    challenge.main(["write", str(folder)])
    rubbing = rubbing_scenes(folder, load_params(Path("workflow")).material.nu)
    out = submission(folder.resolve(), tuple(args.scenes), args.work.resolve())
    figures = rubbing_figures({name: scene for name, scene in rubbing.items() if name in args.scenes}, out)
    scores = scored(folder, out) if set(args.scenes) - set(RUBBING) else {"scenes": {}, "seconds": {}}
    publish_figures(
        args.out, figures_of(scores) + figures, scenes=[{"scene": name} | of for name, of in scores["scenes"].items()]
    )


if __name__ == "__main__":
    main.exit()
