"""One page with the rig's pictures beside real ones, and the figures that compare them."""

from pathlib import Path

import cv2
import numpy as np

from gelforge.flow.files import write_text
from gelforge.reporting.page import Section, render
from gelforge.virtualrig.bench import Pressing
from gelforge.virtualrig.rigplan import Order
from tests.benchmarks.rig import REFERENCE_UNIT, Rig, no_contact_pair, real_cuboid
from tests.support.figures import Figure
from tests.support.films import frames_of

ENLARGED = 2
SHOWN = 15  # presses of the plan
# What each real video shows, and the press of a virtual unit that stands beside it: sensor, indenter, depth, path.
VIDEOS = {
    "plier_camera_2": ("mini_d", "cylinder_10_7", 0.9, (0.2, 0.1)),
    "glass_box_camera_2": ("mini_d", "pyramid_10", 1.2, (0.0, 0.2)),
    "plier_camera_0": ("mini_e", "sphere_15", 0.8, (0.0, 0.1)),
    "cheese_tube_camera_0": ("mini_e", "bar_5", 0.8, (0.0, -0.2)),
}

DIFFERENCES = (
    "Light: real pictures darken and turn redder as a whole while a hand or an object shades the gel; the rig's do "
    "not.",
    "Outline of a flat punch: real ones show thin bright and dark lines within a band 25 px wide; the rig's flanks "
    "are smooth bands of the same strength, 10 px wider, because a hexahedron of its mesh is 10 px.",
    "Print lines: real ones break, merge and carry wrinkles between them, and blue and red part more; the rig's are "
    "even, half as strong on the reference unit.",
    "Markers: real ones differ more in shape from one to the next and some are half worn; markers at a flank are narrowed "
    "in both.",
    "Gel: real ones carry scratches, hairs and specks beside the markers; the rig's are clean.",
    "Far from the punch the rig's markers move outwards by up to 8 px; how much of the real markers' motion is that, and "
    "how much a print a few percent larger, is unknown without a picture of that unit before contact.",
)


def png(*images: np.ndarray) -> bytes:
    """RGB images side by side, enlarged, as PNG."""
    gap = np.full((images[0].shape[0], 4, 3), 255, np.uint8)
    row = np.hstack([part for image in images for part in (image, gap)][:-1])
    large = cv2.resize(row, None, fx=ENLARGED, fy=ENLARGED, interpolation=cv2.INTER_CUBIC)
    return cv2.imencode(".png", large[..., ::-1])[1].tobytes()


def most_changed(images: list[np.ndarray]) -> np.ndarray:
    """The frame that is least like the last one, in which nothing touches the gel any more."""
    last = images[-1].astype(np.float32)
    return max(images, key=lambda image: float(np.abs(image - last).mean()))


def beside_real(rig: Rig, reference: Path) -> list[Section]:
    """No-contact image, cuboid and videos, real on the left."""
    real, ours = no_contact_pair(rig, reference)
    pressing = rig.cuboid
    still = Section("Without contact").picture(
        png(real, ours), "Left: real GelSight Mini. Right: the rig's reference unit."
    )
    pressed = Section("10 mm cuboid, 2.284 mm deep").picture(
        png(real_cuboid(reference), rig.picture(pressing)),
        f"Left: real (another unit). Right: the rig, {-pressing.real.dz:.2f} mm of {-pressing.log.dz:.2f} mm left "
        f"after the frame gave way, {-pressing.force[2]:.0f} N.",
    )
    videos = Section("Two other real sensors").text(
        "Objects in the videos are not the rig's indenters; light, markers and the appearance of edges and texture compare."
    )
    for number, (name, (sensor, indenter, depth, path)) in enumerate(VIDEOS.items()):
        seen = frames_of(reference / "slip_videos" / f"{name}.avi")
        order = Order(10_000 + number, name, "", sensor, indenter, -0.5, 1.0, depth, path, 20.0, 60.0)
        images = most_changed(seen), seen[-1], rig.picture(rig.bench.press(order)[-1])
        caption = f"{name}: touched, after release; right: the rig's {sensor} with {indenter}, {depth} mm."
        videos.picture(png(*images), caption)
    return [still, pressed, videos]


def gallery(rig: Rig, presses: list[Pressing]) -> Section:
    """Pictures of presses of the plan, three in a row."""
    section = Section("Presses of the plan")
    for k in range(0, len(presses) - 2, 3):
        row = presses[k : k + 3]
        names = [f"{p.order.indenter} on {p.order.sensor}, {-p.real.dz:.2f} mm, {-p.force[2]:.1f} N" for p in row]
        section.picture(png(*(rig.picture(p) for p in row)), "; ".join(names))
    return section


def figure_table(figures: list[Figure]) -> Section:
    """The figures as a table, missed ones marked, and what each is."""
    rows = [["" if f.met else "missed", f.name, float(f.value), f"{f.compare} {f.goal:g}", f.unit] for f in figures]
    notes = "\n".join(f"{f.name}: {f.note}" for f in figures if f.note)
    section = Section("Figures").table(["", "figure", "measured", "goal", "unit"], rows)
    return section.code(notes, "How each was measured")


def write_page(path, rig: Rig, reference: Path, pressings: list[Pressing], figures: list[Figure]) -> None:
    """Write the page: figures, pictures beside real ones, some presses of the plan, and where they still differ."""
    sections = [figure_table(figures), *beside_real(rig, reference), gallery(rig, pressings[:SHOWN])]
    differences = Section("Where they still differ")
    for line in DIFFERENCES:
        differences.text(line)
    sections.append(differences)
    lead = f"Unit {REFERENCE_UNIT} is fitted to the real no-contact image; the others differ from it as real ones do."
    write_text(path, render("virtual rig", lead, sections))
