"""Virtual benches that lean and touch too high or too low: how well 12 presses of each show it, and what labels gain.

Each bench is a mounting of one rig plan. The rig's presses, the solves and each bench's results are kept below the
folder of the figures, so that a stopped run resumes. `straight` benches lean by less than 0.3 degrees: images must not
say otherwise.
"""

import hashlib
from argparse import Namespace
from pathlib import Path

import numpy as np

from gelforge.calibration.readings import choose_presses, readings_of
from gelforge.calibration.tilts import tilted_mountings
from gelforge.errors import BadInput
from gelforge.evidence.logimages import LogImages
from gelforge.flow.calibration import found_in
from gelforge.flow.cli import command, option
from gelforge.flow.files import read_json, write_json, write_text
from gelforge.flow.params import altered, load_params
from gelforge.geometry.gel import load_gel
from gelforge.geometry.indenters import load_catalogue
from gelforge.geometry.solids import feels_tilt
from gelforge.labelling.sensor import load_sensors
from gelforge.mechanics.hexsettings import quality
from gelforge.mechanics.material import REFERENCE_C10, Material
from gelforge.mechanics.scene import Interface, Scene
from gelforge.mechanics.solvers.hex import HexSolver
from gelforge.records.log import read_log, read_presses
from gelforge.records.press import LoggedPress
from gelforge.records.table import read_table
from gelforge.stages import calibrate, fea, images, poses, rig
from tests.benchmarks.parts.leant import wide_tilts
from tests.support.figures import PUBLISHED_DATA, Figure, publish_figures

PRESSES = 12
HEAD = """dataset = "{name}"
seed = {seed}
presses = {presses}
gel = "gelsight_mini"
catalogue = "indenters.toml"
start_utc = "2026-01-12T09:00:00Z"
seconds_per_press = 38.5
held_out_sensors = []

[truth]
c10_mpa = 0.0853
nu = 0.475
friction = 0.7
compliance_mm_per_n = 0.006
shear_compliance_mm_per_n = 0.004
touch_offset_mm = 0.0
touch_scatter_mm = 0.002
force_noise_n = 0.03
force_bias_n = [0.02, -0.015, 0.03]
drift_n = 0.02
moment_noise_nm = 0.0005
cnc_um = 0.25

[mountings]
presses = {each}
tilt_deg = {tilt}
touch_offset_mm = [-0.15, 0.15]
seating = 0.1
"""
KIND = """
[[kind]]
weight = 1
indenters = ["{indenter}"]
sensors = ["{sensor}"]
x_mm = [{x}, {x}]
y_mm = [{y}, {y}]
depth_mm = [{depth}, {depth}]
shear = [{shear}, {shear}]
rot_deg = [{turn}, {turn}]
max_force_n = 40
"""
# Indenter, x, y, depth, turn, sideways path over depth: what the guide asks a new bench for first, and some more.
SESSION = (
    ("cuboid_10", 0.0, 0.0, 0.6, 0, 0.0),
    ("sphere_15", 0.0, 0.0, 0.6, 0, 0.0),
    ("cylinder_8", 1.5, 2.0, 0.7, 0, 0.0),
    ("cuboid_15", 0.0, 0.0, 0.45, 45, 0.0),
    ("sphere_10", -1.5, 2.0, 1.1, 0, 0.0),
    ("cuboid_10", -1.0, -2.0, 0.5, 30, 0.0),
    ("sphere_15", 1.0, -1.0, 1.4, 0, 0.0),
    ("cylinder_8", -1.5, -3.0, 0.5, 0, 0.0),
    ("bar_5", 0.0, 2.0, 0.6, 20, 0.0),
    ("sphere_10", 1.0, 3.0, 0.7, 0, 0.0),
    ("sphere_15", -1.0, 1.0, 0.5, 0, 4.0),
    ("cuboid_10", 1.0, 1.5, 0.7, 70, 0.0),
)
LAW = "coulomb"
# Name, seed, tilts in degrees and sensor of the benches.
ASKEW, STRAIGHT = ("askew", 7, [1.0, 3.0], "mini_b"), ("straight", 8, [0.0, 0.3], "mini_a")
NINETY = 1.645  # standard deviations of a 90 % interval


def pressed(folder: Path, count: int, name: str, seed: int, tilt: list[float], sensor: str, jobs: int) -> Path:
    """The dataset of `count` benches."""
    text = HEAD.format(name=name, seed=seed, presses=PRESSES * count, each=PRESSES, tilt=tilt)
    for indenter, x, y, depth, turn, shear in SESSION:
        text += KIND.format(indenter=indenter, sensor=sensor, x=x, y=y, depth=depth, turn=turn, shear=shear)
    plan = folder / f"{name}.toml"
    write_text(plan, text)
    return rig.run(plan, folder / "data", "workflow", jobs)


def by_forces(data: Path, mounting: str, folder: Path, jobs: int) -> dict:
    """Summary of a calibration of one bench."""
    params = load_params(Path("workflow"))
    rows = [row for row in read_log(data / "log.csv") if row.cells["mounting"] == mounting]
    logged = readings_of(rows, str(data / "log.csv"))
    catalogue = load_catalogue("workflow/indenters.toml", sorted(set(logged.indenters.tolist())))
    readings = logged.take(choose_presses(logged, params.calibrate.max_presses, LAW, catalogue))
    tilted, _ = tilted_mountings(readings, catalogue)
    readings, emulator, _ = calibrate.emulate(
        readings, catalogue, params.calibrate, LAW, float(params.material.nu), folder / "solves", jobs, tilted
    )
    done, seen = calibrate.calibrate(readings, emulator, params.calibrate, LAW, logged, REFERENCE_C10, tilted)
    found = calibrate.summarise(done, params.calibrate, seen)
    found["bench"]["stated_tilt_deg"] = {}
    return found


def normal_force(press: LoggedPress, body, c10: float, mu: float) -> float:
    """Normal force, N, of a label of a press."""
    nu = float(load_params(Path("workflow")).material.nu)
    scene = Scene(load_gel("gelsight_mini"), Material(nu), body, press.press, Interface.of_friction(mu))
    return float(HexSolver(quality("draft")).solve(scene).total[2]) * c10 / REFERENCE_C10


def label_errors(data: Path, mounting: str, summary: dict, true: dict) -> dict[str, list[float]]:
    """Relative errors of the normal force of labels of flat presses: `before` by the poses as logged, on a gel and a frame of
    known stiffness, `after` by all that the calibration found."""
    log = [press for press in read_presses(data / "log.csv") if press.mounting == mounting]
    force = {row["sample_id"]: float(row["fz_n"]) for row in read_table(data / "truth/presses.csv", "")}
    bodies = load_catalogue("workflow/indenters.toml", sorted({press.indenter for press in log}))
    found, usual = found_in(mounting, summary).params, load_params(Path("workflow")).poses
    known = {"compliance_mm_per_n": true["compliance_mm_per_n"]}
    cases = {
        "before": (altered(usual, **known), true["c10_mpa"], true["friction"]),
        "after": (altered(usual, **found["poses"]), found["material"]["c10"], found["interface"]["mu"]),
    }
    errors: dict[str, list[float]] = {}
    for press in log:
        if feels_tilt(bodies[press.indenter]):
            for case, (table, c10, mu) in cases.items():
                path, _ = poses.yielded(press, "log.csv", table)
                label = normal_force(path, bodies[press.indenter], c10, mu)
                errors.setdefault(case, []).append(abs(label / force[press.sample_id] - 1.0))
    return errors


def by_images(data: Path, mounting: str) -> dict:
    """What images say of a bench, as in images.json."""
    log = [press for press in read_presses(data / "log.csv") if press.mounting == mounting]
    bodies = load_catalogue("workflow/indenters.toml", sorted({press.indenter for press in log}))
    shown = LogImages(data, load_sensors("workflow/sensors.toml"))
    (found,) = images.tilts(log, shown, bodies)
    return found


def kept(path: Path, plan: Path, make) -> dict:
    """What was stored in `path` for the same plan, of any length, and versions, or is made now."""
    of = [line for line in plan.read_text(encoding="utf-8").splitlines() if not line.startswith("presses")]
    versions = f"{calibrate.VERSION} {images.VERSION} {fea.VERSION}"
    key = hashlib.sha256(f"{of} {versions}".encode()).hexdigest()[:16]
    found = read_json(path) if path.exists() else {}
    if found.get("key") != key:
        found = {"key": key, **make()}
        write_json(path, found)
    return found


def askew_bench(data: Path, mounting: str, folder: Path, jobs: int) -> dict:
    """What is found of one bench, and the truth: tilts with standard errors, degrees, touch, mm, errors of labels."""
    true, summary, seen = truth_of(data, mounting), by_forces(data, mounting, folder, jobs), by_images(data, mounting)
    rows = [summary["parameters"][name] for name in ("tilt_x", "tilt_y")]
    return {
        "truth": true,
        "forces": {"tilt": [row["median"] for row in rows],
                   "error": [(row["interval68"][1] - row["interval68"][0]) / 2 for row in rows]},
        "images": {"tilt": seen["tilt_deg"], "error": seen["error_deg"]},
        "offset": summary["bench"]["offset"],
        "labels": label_errors(data, mounting, summary, true),
    }  # fmt: skip


def truth_of(data: Path, mounting: str) -> dict:
    return read_json(data / "truth/truth.json")["mountings"][mounting]


def joined(one: dict) -> dict:
    """Tilt by forces and images together, each with its weight."""
    parts = [
        (np.array(one[source]["tilt"]), np.array(one[source]["error"]) ** -2.0) for source in ("forces", "images")
    ]
    weight = parts[0][1] + parts[1][1]
    return {"tilt": sum(tilt * w for tilt, w in parts) / weight, "error": weight**-0.5}


def tilt_figures(found: list[dict]) -> list[Figure]:
    """Errors of tilt, and how many of its intervals hold the truth, by source."""
    figures = []
    true = np.array([one["truth"]["tilt_deg"] for one in found])
    sources = {"moments": [one["forces"] for one in found], "images": [one["images"] for one in found],
               "both": [joined(one) for one in found]}  # fmt: skip
    for (name, of), goal in zip(sources.items(), (0.6, 0.8, 0.3), strict=True):
        off, error = np.array([one["tilt"] for one in of]) - true, np.array([one["error"] for one in of])
        far, held = np.hypot(*off.T), float((np.abs(off) <= NINETY * error).mean())
        figures += [
            Figure(f"tilt by {name}, largest error", far.max(), "<=", goal, "degrees",
                   f"{len(of)} benches; median {np.median(far):.2f}"),
            Figure(f"tilt by {name}: 90 % intervals hold the truth", 100 * held, ">=", 90, "%"),
        ]  # fmt: skip
    return figures


def bench_figures(found: list[dict]) -> list[Figure]:
    """Errors of touch and of labels."""
    # positive in [poses]: deeper; in the rig: the tip above the logged touch
    off = np.array([one["offset"] + one["truth"]["touch_offset_mm"] for one in found])
    before, after = ([max(one["labels"][case]) for one in found] for case in ("before", "after"))
    return [
        Figure("zero of a mounting, largest error", np.abs(off).max(), "<=", 0.03, "mm", f"mean {off.mean():+.3f}"),
        Figure("labels of flat presses as logged, worst", 100 * max(before), "", 0, "%", f"median of benches {100 * np.median(before):.0f}"),
        Figure("labels of flat presses as calibrated, worst", 100 * max(after), "<=", 3, "%", f"median of benches {100 * np.median(after):.1f}"),
    ]  # fmt: skip


def feats_figures() -> list[Figure]:
    """FEATS' wide presses: one bench, whose tilt about x by hand is 2 to 3 degrees in each."""
    tilts = np.array(list(wide_tilts(PUBLISHED_DATA).values()))[:, 0]
    common = np.sign(np.median(tilts))
    alike, sized = (np.sign(tilts) == common).mean(), ((np.abs(tilts) >= 1.5) & (np.abs(tilts) <= 3.5)).mean()
    note = f"{len(tilts)} presses; median {np.median(tilts):.1f} degrees"
    return [
        Figure("FEATS' wide presses, tilt of one sign by images", 100 * alike, ">=", 100, "%", note),
        Figure("FEATS' wide presses, tilt of 1.5 to 3.5 degrees by images", 100 * sized, ">=", 80, "%"),
    ]


@command(
    option("--out", type=Path),
    option("--jobs", type=int, default=1),
    option("--count", type=int, default=10, help="benches of each kind"),
)
def main(args: Namespace) -> None:
    if args.count < 1:
        raise BadInput(f"--count {args.count}: give 1 or more")
    folder = args.out.parent / "benches"
    folder.mkdir(parents=True, exist_ok=True)
    found: list[dict] = []
    said: list[dict] = []
    for kind, results in ((ASKEW, found), (STRAIGHT, said)):
        data = pressed(folder, args.count, *kind, args.jobs)
        for k in range(args.count):
            mounting = f"mounting_{k + 1:02d}"

            def make(data=data, mounting=mounting, kind=kind) -> dict:
                return (
                    by_images(data, mounting) if kind is STRAIGHT else askew_bench(data, mounting, folder, args.jobs)
                )

            results.append(kept(folder / f"{kind[0]}_{k + 1:02d}.json", folder / f"{kind[0]}.toml", make))
    accused = sum(bool(one["note"]) for one in said)
    figures = [*tilt_figures(found), *bench_figures(found)]
    figures.append(
        Figure(
            "straight benches that images accuse",
            100 * accused / len(said),
            "<=",
            2,
            "%",
            f"{accused} of {len(said)}",
        )
    )
    if PUBLISHED_DATA.exists():
        figures += feats_figures()
    publish_figures(args.out, figures)


if __name__ == "__main__":
    main.exit()
