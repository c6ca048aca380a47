"""The virtual rig: speed, similarity to real images, agreement with mechanics."""

import time
from argparse import Namespace
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from tqdm import tqdm

from gelforge.commands.projection import read_points
from gelforge.errors import BadInput
from gelforge.flow.cli import command, option
from gelforge.formats.featsfile import read_sample
from gelforge.geometry.gel import Gel
from gelforge.geometry.indenters import load_catalogue
from gelforge.reading.markers import markers_in
from gelforge.stages.rig import units_of
from gelforge.virtualrig import streams
from gelforge.virtualrig.bench import Bench, Pressing
from gelforge.virtualrig.fields import field_of, surface_of
from gelforge.virtualrig.render import Pressed, Renderer
from gelforge.virtualrig.rigplan import Order, Plan, generator, orders, read_plan
from tests.support import likeness as measure
from tests.support.figures import PUBLISHED_DATA, Figure, publish_figures

REFERENCE_UNIT = "mini_a"
# Of the real cuboid's press only the depth is published; the sideways path comes from its markers (3 px in u).
CUBOID = Order(0, "cuboid", "", REFERENCE_UNIT, "cuboid_10", 0.0, 0.0, 2.284, (0.0, -0.25), 0.0, 1e9)
PARTS = ("presses", "likeness", "cuboid")
MOVED_PX = 2.0  # a marker farther from the grid than this has moved; printing errors of real markers are 1 px


@dataclass
class Rig:
    """One bench with its cameras, and the press of the real cuboid image."""

    plan: Plan
    bench: Bench
    units: tuple[dict, dict]  # appearances and sensors by name
    cameras: dict[str, Renderer] = field(default_factory=dict)  # made so far

    @classmethod
    def of(cls, plan_path, workflow: Path) -> "Rig":
        plan = read_plan(plan_path)
        bench = Bench(plan, load_catalogue(workflow / plan.catalogue), Gel())
        return cls(plan, bench, units_of(plan, workflow))

    def camera(self, name: str) -> Renderer:
        """The camera of a unit, made at its first use."""
        if name not in self.cameras:
            appearances, sensors = self.units
            self.cameras[name] = Renderer(appearances[name], sensors[name].projection, self.bench.gel)
        return self.cameras[name]

    @cached_property
    def cuboid(self) -> Pressing:
        """The press of the real cuboid image."""
        return self.bench.press(CUBOID)[-1]

    def view(self, pressing: Pressing):
        """Displacement field and body of a press, as cameras take them."""
        result = pressing.result
        surface = surface_of(result.mesh, result.displacement, pressing.real)
        return field_of(self.bench.gel, surface), Pressed(self.bench.body(pressing.order.indenter), pressing.real)

    def picture(self, pressing: Pressing, purpose: int = streams.camera(0, 0)) -> np.ndarray:
        """Image of a press by its sensor."""
        noise = generator(self.plan, pressing.order.index, purpose)
        return self.camera(pressing.order.sensor).image(*self.view(pressing), noise)


def pressed(rig: Rig, count: int = 24) -> tuple[list[Pressing], list[float]]:
    """Presses spread over the whole plan, and the processor seconds that each took to simulate and render."""
    some = [order for order in orders(rig.plan) if order.unit == 0][7 :: max(1, rig.plan.presses // count)][:count]
    rig.picture(rig.bench.press(some[0])[-1])  # compiles what numba compiles
    pressings, seconds = [], []
    for name in tqdm(dict.fromkeys(order.indenter for order in some[1:]), "indenters"):
        rig.bench.body(name)
    for order in tqdm(some, "presses"):
        start = time.process_time()
        pressings.append(rig.bench.press(order)[-1])
        rig.picture(pressings[-1])
        seconds.append(time.process_time() - start)
    return pressings, seconds


def speed(rig: Rig, pressings: list[Pressing], seconds: list[float]) -> list[Figure]:
    """Time of a press, and images per second."""
    worst = pressings[int(np.argmax(seconds))]
    note = f"processor time on one core, {len(seconds)} presses of {rig.plan.dataset}.toml, "
    slowest = f"{worst.order.indenter}, {-worst.real.dz:.2f} mm, {-worst.force[2]:.0f} N"
    camera, view = rig.camera(pressings[0].order.sensor), rig.view(pressings[0])
    start, rounds = time.process_time(), 60
    for k in range(rounds):
        camera.image(*view, np.random.default_rng(k))
    rate = rounds / (time.process_time() - start)
    return [
        Figure("one press simulated and rendered, mean", float(np.mean(seconds)), "<=", 3.0, "s",
               note + f"median {np.median(seconds):.2f} s"),
        Figure("one press simulated and rendered, slowest", max(seconds), "<=", 3.0, "s", note + slowest),
        Figure("rendering alone", rate, ">=", 50.0, "images/s", "displacement field to 8-bit image"),
    ]  # fmt: skip


def likeness(rig: Rig, reference: Path) -> list[Figure]:
    """No-contact image of the reference unit against the real one."""
    real, ours = (measure.no_contact(image, 7, 9) for image in no_contact_pair(rig, reference))
    note = "no contact, reference unit against the real image"
    pitch, diameter = np.abs(ours.grid.pitch - real.grid.pitch), abs(ours.grid.diameter - real.grid.diameter)
    noise = ours.noise / real.noise
    return [
        Figure("markers found", ours.grid.count, "==", 63, "", f"{note}: {real.grid.count} in the real one"),
        Figure("marker pitch, difference", pitch.max(), "<=", 0.5, "px", note),
        Figure("marker diameter, difference", diameter, "<=", 1.0, "px", f"{note}: {real.grid.diameter:.2f} px"),
        Figure(
            "mean colour, largest difference", np.abs(ours.colour - real.colour).max(), "<=", 8.0, "grey levels", note
        ),
        Figure(
            "smoothed background, least correlation",
            measure.background_correlation(ours, real).min(),
            ">=",
            0.9,
            "",
            note,
        ),
        Figure("noise level, largest factor", np.maximum(noise, 1 / noise).max(), "<=", 1.5, "", note),
    ]


def no_contact_pair(rig: Rig, reference: Path) -> tuple[np.ndarray, np.ndarray]:
    """The real no-contact image and the rig's, RGB."""
    real = read_sample(reference / "feats" / "images" / "nocontact_train_sensor.npy").image
    return real, rig.camera(REFERENCE_UNIT).image(rng=np.random.default_rng(rig.plan.seed))


def real_cuboid(reference: Path) -> np.ndarray:
    """The real image of the pressed cuboid, RGB."""
    return cv2.imread(str(reference / "feats" / "images" / "cuboid_10-2-284.png"))[..., ::-1]


def cuboid(rig: Rig, reference: Path) -> list[Figure]:
    """The pressed cuboid against the real image of one."""
    pressing = rig.cuboid
    camera = rig.camera(REFERENCE_UNIT)
    # FEATS marked these corners at 14 px/mm; in gel mm they are those of the cuboid. This camera shows them
    # elsewhere, and larger, because the middle of a flank is nearer to it.
    marked, _ = read_points(reference / "feats" / "point_correspondences.csv")
    corners = camera.seen(marked, np.array([[0.0, 0.0, pressing.real.dz / 2]]))
    expected = np.array([corners[:, 0].min(), corners[:, 0].max(), corners[:, 1].min(), corners[:, 1].max()])
    middle = camera.seen(
        np.array([[pressing.real.x0, pressing.real.y0]]), np.array([[pressing.real.dx, pressing.real.dy, 0.0]])
    )[0]
    sides = measure.steepest(camera.height(*rig.view(pressing)), middle)
    shift = middle - [np.mean(expected[:2]), np.mean(expected[2:])]
    off = np.abs(sides - expected - np.repeat(shift, 2))
    pictures = (*no_contact_pair(rig, reference), real_cuboid(reference), rig.picture(pressing))
    motion, ours = dot_motions(*pictures)
    moved = np.linalg.norm(motion, axis=1) > MOVED_PX
    cosine, uneven = cosines(motion, ours), cosines(without_even_part(motion), without_even_part(ours))
    there = f"of {moved.sum()} markers that moved over {MOVED_PX:g} px in the real picture; "
    deep = f"{-pressing.log.dz:.2f} mm by the log, {-pressing.real.dz:.2f} mm into the gel"
    return [
        Figure("cuboid outline, largest distance of a side", off.max(), "<=", 3.0, "px",
               f"steepest line of each flank against the corners at this unit's scale, less the sideways path; {deep}"),
        Figure("cuboid markers displaced in the same direction", (cosine[moved] > 0.5).mean(), ">=", 0.9, "fraction",
               f"within 60 degrees, {there}mean cosine {cosine[moved].mean():.2f}, correlation "
               f"{np.corrcoef(motion.ravel(), ours.ravel())[0, 1]:.2f}; less the even stretch, which the print of "
               f"that unit may share: {(uneven > 0.5).mean():.2f}"),
    ]  # fmt: skip


def dot_motions(real_before, before, real_after, after) -> tuple[np.ndarray, np.ndarray]:
    """Motion (63, 2) px of each marker in the real image and in ours, minus the mean motion of all.

    The real cuboid's sensor has no no-contact image, so that of another sensor with the same marker grid replaces it.
    The mean removes the offset between both gels in their holders, a few px; a slightly larger grid would look like
    motion.
    """
    start, end, our_start, our_end = (_all_markers(image) for image in (real_before, real_after, before, after))
    return tuple(motion - motion.mean(axis=0) for motion in (end - start, our_end - our_start))


def without_even_part(motion: np.ndarray) -> np.ndarray:
    """Motion (63, 2) of the markers minus its best affine fit over the grid."""
    row, col = np.divmod(np.arange(len(motion)), 9)
    design = np.column_stack([np.ones(len(motion)), col, row])
    return motion - design @ np.linalg.lstsq(design, motion, rcond=None)[0]


def cosines(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cosine (n,) of the angle between vectors (n, 2)."""
    return (a * b).sum(axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)


def _all_markers(image: np.ndarray) -> np.ndarray:
    """Position (63, 2) px of every marker, row by row."""
    grid = markers_in(image).grid(7, 9)
    if grid.count != 63:
        raise BadInput(f"{grid.count} of 63 markers found in a picture of the pressed cuboid; look at make rig-check")
    return grid.points


def tracking(rig: Rig, pressings: list[Pressing]) -> list[Figure]:
    """Markers tracked from a no-contact to a pressed image, against nodal displacements.

    Here the illumination does not depend on slopes, because a slope across a marker shifts its darkness-weighted
    centre.
    """
    lights = {name: rig.camera(name) for name in {pressing.order.sensor for pressing in pressings}}
    plain = {
        name: Renderer(replace(camera.appearance, slope_gain=np.zeros(3)), camera.projection, camera.gel)
        for name, camera in lights.items()
    }
    error, moved = tracking_errors(rig, plain, pressings)
    lit, _ = tracking_errors(rig, lights, pressings)
    note = f"{len(error)} markers in {len(pressings)} pairs that moved up to {moved:.1f} px, illuminated without slopes; "
    note += f"median {np.median(error):.3f}, 95 % below {np.quantile(error, 0.95):.3f}, largest {error.max():.2f}; "
    note += f"in full light, where flanks mislead the tracker, {np.sqrt((lit**2).mean()):.2f}"
    rms = float(np.sqrt((error**2).mean()))
    return [Figure("markers tracked against finite elements, root mean square", rms, "<=", 0.15, "px", note)]


def tracking_errors(rig: Rig, cameras: dict[str, Renderer], pressings: list[Pressing]) -> tuple[np.ndarray, float]:
    """Distance (n,) px of tracked markers from their positions by nodal displacements, and the largest motion."""
    errors, moved = [], 0.0
    for pressing in pressings:
        camera, index = cameras[pressing.order.sensor], pressing.order.index
        start, expected = camera.appearance.markers, measure.markers_by_mechanics(camera, pressing.result)
        before = camera.image(rng=generator(rig.plan, index, streams.camera(1, 0)))
        after = camera.image(*rig.view(pressing), generator(rig.plan, index, streams.camera(0, 0)))
        motion, followed = measure.tracked_markers(before, after, expected, start)
        whole = camera.appearance.diameter
        followed &= measure.inside_image(start, whole) & measure.inside_image(expected, whole)
        errors.append(np.linalg.norm(motion - (expected - start), axis=1)[followed])
        moved = max(moved, float(np.linalg.norm(expected - start, axis=1).max()))
    return np.concatenate(errors), moved


@command(
    option("--out", type=Path, default=Path("results/benchmarks/rig.json")),
    option("--page", type=Path, help="HTML page to write, with the rig's pictures beside real ones", default=None),
    option("--plan", type=Path, default=Path("workflow/rig/train.toml")),
    option("--parts", nargs="+", choices=PARTS, default=PARTS, help="fewer only to try it out; a page needs all"),
    option("--workflow", type=Path, default=Path("workflow")),
    option("--reference", type=Path, default=PUBLISHED_DATA),
)
def main(given: Namespace) -> None:
    """Measure the parts and write the figures and, if asked, the page that shows rendered images beside real ones."""
    if not given.reference.is_dir():
        raise BadInput(f"{given.reference}: no reference data there; set GELFORGE_REFERENCE to it")
    cv2.setNumThreads(1)
    rig = Rig.of(given.plan, given.workflow)
    pressings, figures = [], []
    if "presses" in given.parts:
        pressings, seconds = pressed(rig)
        figures += speed(rig, pressings, seconds) + tracking(rig, pressings)
    if "likeness" in given.parts:
        figures += likeness(rig, given.reference)
    if "cuboid" in given.parts:
        figures += cuboid(rig, given.reference)
    publish_figures(given.out, figures)
    if given.page and len(given.parts) == len(PARTS):
        from tests.benchmarks.parts.rig_page import write_page

        write_page(given.page, rig, given.reference, pressings, figures)
        print(given.page)


if __name__ == "__main__":
    main.exit()
