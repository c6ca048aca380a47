"""Pictures of the README, made from what they show; beside each lies the digest of its data, so that a test can check it."""

import os
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.flow.cli import command, option
from gelforge.flow.files import digest_of, digest_of_value, publish, read_json, read_toml, write_json
from tests.support.figures import PUBLISHED_DATA

PRESSED = 1.4, (0.5, 1.0), (0.4, -0.3)  # depth, place and way sideways of the press that is shown, mm
ARROW_MM = 2.5  # length of the largest force
SENSOR = "mini_b"  # virtual sensor of the image beside it
INDENTER = "triangle_10"  # of the press, in workflow/indenters.toml
FILMS = "cheese_tube_3_camera_0.avi", "tin_box_2_camera_2.avi", "wooden_statue_5_camera_2.avi"  # of real sensors
LEAST_SHOWN = 0.005  # % of error: smaller ones are drawn there


def digest(source: str) -> str | None:
    """Digest of a file, or of one table of a TOML file by the name FILE#TABLE; None where the file is not here."""
    name, _, table = source.partition("#")
    if not Path(name).exists():
        return None
    if not table:
        return digest_of(Path(name))
    return digest_of_value(read_toml(name).get(table))


def publish_picture(out: Path, content: bytes, data: Sequence[Path | str]) -> None:
    """Write a picture, and beside it what it was made from."""
    with publish(out) as part:
        part.write_bytes(content)
    write_json(out.with_suffix(".json"), {"data": {str(source): digest(str(source)) for source in data}})


def outdated(picture: Path) -> list[str]:
    """Data of a picture that are here and are no longer what it shows."""
    known = read_json(picture.with_suffix(".json"))["data"]
    return [name for name, held in known.items() if digest(name) not in (None, held)]


def hardest_frame(film: Path, model):
    """Of the frame of a film with the largest force that is not flagged: image and cells (3, rows, cols), as far as the camera sees.

    And why it is flagged once it has lost its colours.
    """
    import cv2

    from gelforge.reading.reader import Reader
    from gelforge.records.film import frames, numbered, open_source
    from gelforge.records.nocontactimage import find_nocontact

    with open_source(film, None) as (source, announced):
        seen = (cv2.cvtColor(frame, cv2.COLOR_BGR2RGB) for frame in frames(source, announced, str(film), None))
        picture, at_rest_and_after = find_nocontact(numbered(seen), str(film))
        predictor = Reader(picture, model=model)
        read = [(found := predictor(frame.image), found.image, frame.image) for frame in at_rest_and_after]
    frame = predictor.frame
    found, shown, image = max((one for one in read if not one[0].flag), key=lambda one: -one[0].cells[2].sum())
    grey = np.repeat(image.mean(axis=2, keepdims=True).astype(np.uint8), 3, axis=2)
    return (
        shown[frame.shown],
        found.cells[(slice(None), *frame.cells_shown(found.cells.shape[1:]))],
        predictor(grey).reason,
    )


def real(args: Namespace) -> None:
    """Frames of real sensors above the force maps that the shipped network reads in them, in one scale, and one that lost its colours."""
    import textwrap

    from gelforge.reading.model import load_model
    from gelforge.reporting.canvas import canvas_with_axes, to_png
    from gelforge.reporting.forcemaps import draw_pressure

    model = load_model(None)
    films = [args.reference / "gripper_videos" / name for name in FILMS]
    shown = [hardest_frame(film, model) for film in films]
    figure, axes = canvas_with_axes(2, len(shown) + 1, 3.1 * (len(shown) + 1) + 0.8, 4.9)
    most = max(float(-cells[2].min()) for _, cells, _ in shown)
    for (above, below), (image, cells, _) in zip(axes.T, shown, strict=False):
        above.imshow(image)
        drawn = draw_pressure(below, cells[2], most)
        below.set_title(f"{-float(cells[2].sum()):.1f} N", fontsize=15)
    image, cells, reason = shown[-1]
    above, below = axes[:, -1]
    above.imshow(image.mean(axis=2), cmap="gray", vmin=0, vmax=255)
    below.imshow(np.full((*cells.shape[1:], 3), 255, np.uint8))
    below.set_title("flagged", fontsize=15)
    below.text(0.5, 0.5, textwrap.fill(reason, 30), fontsize=12, ha="center", va="center", transform=below.transAxes)
    for axis in axes.ravel():
        axis.set_xticks([])
        axis.set_yticks([])
    figure.colorbar(drawn, ax=axes, shrink=0.6).set_label("N per cell", fontsize=12)
    # from the project's root, because the record of the picture is tracked and no machine's
    publish_picture(args.out, to_png(figure), [*args.data, *map(os.path.relpath, films)])


def press(args: Namespace) -> None:
    """A press in a row: the image of a virtual sensor, the gel with the indenter and the forces on it, the map of normal force."""
    from gelforge.api import label, solve
    from gelforge.geometry.indenters import load_catalogue
    from gelforge.labelling.sensor import load_sensors
    from gelforge.reporting.canvas import canvas, to_png
    from gelforge.reporting.forcemaps import draw_pressure

    catalogue, rig = args.data
    body = load_catalogue(catalogue, [INDENTER])[INDENTER]
    solved, sensor = solve(body, *PRESSED, method="label"), load_sensors(catalogue.with_name("sensors.toml"))[SENSOR]
    normal = label(solved, sensor=sensor)[2]
    figure = canvas(12.5, 3.6)
    left, middle, right = figure.subplots(1, 3, width_ratios=(1.0, 1.25, 1.15))
    left.imshow(image_of(body, solved, sensor, rig))
    middle.imshow(trimmed(view_of(body, solved)))
    shown = draw_pressure(right, normal, float(-normal.min()))
    bar = figure.colorbar(shown, ax=right, shrink=0.8)
    bar.set_label("N per cell", fontsize=12)
    total = -float(normal.sum())
    for axis, title in zip(
        (left, middle, right),
        ("image of the sensor", "gel, indenter, forces", f"normal force: {total:.1f} N"),
        strict=True,
    ):
        axis.set_title(title, fontsize=15)
        axis.set_xticks([])
        axis.set_yticks([])
        for side in axis.spines.values():
            side.set_visible(axis is not middle)
    publish_picture(args.out, to_png(figure), [f"{catalogue}#{INDENTER}", f"{rig}#{SENSOR}"])


def image_of(body, solved, sensor, rig: Path) -> np.ndarray:
    """What a virtual sensor sees of a solved press, (240, 320, 3) uint8 RGB."""
    from gelforge.geometry.gel import Gel
    from gelforge.records.press import Press
    from gelforge.virtualrig.appearance import read_appearances
    from gelforge.virtualrig.fields import body_of, field_of, surface_of
    from gelforge.virtualrig.render import Pressed, Renderer

    depth, at, shear = PRESSED
    press, gel = Press(*at, 0.0, *shear, -depth, 0.0), Gel()
    # markers that move with the gel, because this solve does not keep what the way down alone moved
    appearance = replace(read_appearances(rig)[SENSOR], normal_motion=1.0)
    camera = Renderer(appearance, sensor.projection, gel)
    field = field_of(gel, surface_of(solved.mesh, solved.displacement, press))
    return camera.image(field, Pressed(body_of(body, 0.03, 0.65, 45.0), press), np.random.default_rng(1))


def trimmed(image: np.ndarray) -> np.ndarray:
    """An image (h, w, 3) uint8 RGB without its white border."""
    rows, cols = (np.flatnonzero((image < 250).any(axis=(axis, 2))) for axis in (1, 0))
    return image[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]


def view_of(body, solved) -> np.ndarray:
    """A picture (h, w, 3) uint8 RGB of a press: the gel's surface, arrows of force, the indenter cut open above the gel."""
    import pyvista as pv

    mesh, moved = solved.mesh, solved.mesh.nodes + solved.displacement
    gel = pv.PolyData.from_regular_faces(moved, mesh.faces[:, : 4 if mesh.kind == "hex8" else 3])
    # a force points where it pushes and ends on the gel
    acting = np.flatnonzero(solved.forces.any(axis=1))
    strongest = np.linalg.norm(solved.forces, axis=1).max()
    scale = ARROW_MM / strongest
    arrows = pv.PolyData(moved[acting] - scale * solved.forces[acting])
    arrows["force"] = solved.forces[acting]
    vertices, faces = body.surface()
    depth, at, shear = PRESSED
    tool = pv.PolyData.from_regular_faces(vertices + (at[0] + shear[0], at[1] + shear[1], -depth), faces)

    view: Any = pv.Plotter(off_screen=True, window_size=[1300, 900])
    view.set_background("white")
    view.add_mesh(gel, color="#dfe7ef", show_edges=True, edge_color="#9fb0c2", line_width=0.6, smooth_shading=True)
    half = tool.clip("z", origin=(0, 0, 4.0)).clip("y", origin=(0, at[1] + shear[1], 0), invert=False)
    view.add_mesh(half, color="#2f6db3", opacity=0.55)
    view.add_mesh(half.extract_feature_edges(25), color="#16406f", line_width=2)
    view.add_mesh(arrows.glyph(orient="force", scale="force", factor=scale), color="firebrick")
    view.camera_position = [(13, -20, 15), (0, 0.3, -0.6), (0, 0, 1)]
    image = np.asarray(view.screenshot(return_img=True))
    view.close()
    return image


METHODS = {"draft": "#4292c6", "label": "#084594", "fine": "#9ecae1", "ccx": "#d1603d", "ccx-contact": "#7a7a7a",
           "reference": "#111111"}  # fmt: skip


def exact(args: Namespace) -> None:
    """Processor time of presses whose force is known against their error, by method.

    A dot or, under Coulomb's law, a triangle is a press; large ones are medians.
    """
    from gelforge.mechanics.contact.law import Coulomb
    from gelforge.reporting.canvas import canvas_with_axes, to_png
    from gelforge.reporting.charts import plain_ticks

    figure, axes = canvas_with_axes(1, 2, 12, 5.8)
    presses = [row for row in read_json(args.data[0])["presses"] if row["total"] is not None]
    for axis, (kind, what) in zip(
        axes[0], (("total", "total force"), ("rings", "rings of 0.5 mm, summed")), strict=True
    ):
        for method, colour in METHODS.items():
            own = [row for row in presses if row["method"] == method and row[kind] is not None]
            for law, small, large in (("", ".", "o"), ("Coulomb", "^", "^")):
                of_law = [row for row in own if (row.get("interface") == Coulomb.name) == bool(law)]
                x, y = [row["seconds"] for row in of_law], [max(abs(row[kind]), LEAST_SHOWN) for row in of_law]
                if not of_law:
                    continue
                axis.plot(x, y, small, color=colour, ms=5, alpha=0.55)
                label = f"{method}, {len(of_law)} presses" + (f", {law}" if law else "")
                axis.plot([np.median(x)], [np.median(y)], large, color=colour, ms=11, mec="black", mew=1.2,
                          label=label if kind == "total" else None)  # fmt: skip
        plain_ticks(axis)
        axis.set(xlabel="processor seconds of a press, one thread", ylabel=f"error of {what}, %")
        axis.grid(alpha=0.25, which="both")
    figure.legend(loc="outside lower center", ncols=len(METHODS) // 2, fontsize=11)
    figure.suptitle(
        "Axisymmetric presses of known force; large: medians; triangles: presses that slip in part (Coulomb's law)",
        fontsize=12,
    )
    publish_picture(args.out, to_png(figure), args.data)


PICTURES = {"press": press, "real": real, "exact": exact}


@command(
    option("picture", choices=PICTURES),
    option("--data", nargs="+", type=Path, help="files that it shows"),
    option("--reference", type=Path, default=PUBLISHED_DATA, help="folder of the real films"),
    option("--out", type=Path),
)
def main(args: Namespace) -> None:
    PICTURES[args.picture](args)


if __name__ == "__main__":
    main.exit()
