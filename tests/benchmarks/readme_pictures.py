"""Pictures of the README, made from what they show; beside each lies the digest of its data, so that a test can check it."""

import os
import shutil
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import digest_of, publish, read_json, read_toml, write_json
from gelforge.flow.main import command, group, option
from gelforge.flow.params import digest_of_value
from gelforge.records.image import encode_png

SHIPPED = Path("src/gelforge/networks/weights/default.onnx")
PRESSED = 1.4, (0.5, 1.0), (0.4, -0.3)  # depth, place and way sideways of the press that is shown, mm
ARROW_MM = 2.0  # length of the largest force
SHOWN = 3  # frames of a film, where it presses hardest


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


def hardest_frames(film: Path, model):
    """(image, forces) of a film's frames with the largest force, one each third of it, as far as the camera sees."""
    import cv2

    from gelforge.networks.inference.predictor import Predictor
    from gelforge.records.film import frames, numbered, open_source
    from gelforge.records.nocontactimage import find_nocontact

    with open_source(film, None) as (source, announced):
        seen = (cv2.cvtColor(frame, cv2.COLOR_BGR2RGB) for frame in frames(source, announced, str(film), None))
        picture, at_rest_and_after = find_nocontact(numbered(seen), str(film))
        predictor = Predictor(model, picture)
        read = [predictor.predict(frame.image) for frame in at_rest_and_after]
    frame = predictor.prepare.frame
    for part in np.array_split(np.arange(len(read)), SHOWN):
        hardest = max((read[at] for at in part), key=lambda one: -one.cells[2].sum())
        cells = hardest.cells[(slice(None), *frame.cells_shown(hardest.cells.shape[1:]))]
        yield hardest.image[frame.shown], cells


@command(option("films", nargs="+", type=Path), option("--out", type=Path))
def real(args: Namespace) -> None:
    """Real sensor pictures beside the force maps that the shipped network reads in them."""
    from gelforge.networks.inference.predictor import load_for_use
    from gelforge.reporting.canvas import canvas_with_axes, to_png
    from gelforge.reporting.forcemaps import draw_pressure

    model = load_for_use(None)
    rows = [list(hardest_frames(film, model)) for film in args.films]
    figure, axes = canvas_with_axes(len(rows), 2 * SHOWN, 12, 1.6 * len(rows) + 0.3)
    for line, pairs in zip(axes, rows, strict=True):
        most = max(float(-forces[2].min()) for _, forces in pairs)  # one scale for the frames of a film
        for axis in line:
            axis.set_axis_off()
        for k, (image, forces) in enumerate(pairs):
            line[2 * k].imshow(image)
            draw_pressure(line[2 * k + 1], forces[2], most)
            pressed = round(-float(forces[2].sum()), 1) + 0.0  # no minus before a zero
            line[2 * k + 1].set_title(f"{pressed} N", fontsize=9)
    # from the project's root, because the record of the picture is tracked and no machine's
    films = [os.path.relpath(film) for film in args.films]
    publish_picture(args.out, to_png(figure), [SHIPPED, *films])


@command(
    option("--chart", type=Path, help="chart that a branch drew"),
    option("--data", type=Path),
    option("--out", type=Path),
)
def copy(args: Namespace) -> None:
    """A branch's chart as it was drawn."""
    if not (args.chart.exists() and args.data.exists()):
        raise BadInput(f"{args.chart}: not there; draw it with make pareto and make stability, which take hours")
    args.out.parent.mkdir(parents=True, exist_ok=True)
    publish_picture(args.out, args.chart.read_bytes(), [args.data])
    shutil.copystat(args.chart, args.out)


@command(
    option("--catalogue", type=Path, help="file of indenters"),
    option("--name", help="name of one of them"),
    option("--out", type=Path),
)
def press(args: Namespace) -> None:
    """A press of an indenter: the gel's surface by how far it is pushed in, and the forces that act on it."""
    from gelforge.api import solve
    from gelforge.geometry.indenters import load_catalogue

    body = load_catalogue(args.catalogue, [args.name])[args.name]
    image = picture_of(body, solve(body, *PRESSED, quality="label"))
    publish_picture(args.out, encode_png(image), [f"{args.catalogue}#{args.name}"])


def picture_of(body, solved) -> np.ndarray:
    """A picture (h, w, 3) uint8 RGB of a press: the gel's surface, arrows of force, the indenter cut open above the gel."""
    import pyvista as pv

    mesh, moved = solved.mesh, solved.mesh.nodes + solved.displacement
    gel = pv.PolyData.from_regular_faces(moved, mesh.faces[:, : 4 if mesh.kind == "hex8" else 3])
    gel.point_data["downward motion, mm"] = -solved.displacement[:, 2]
    # a force points where it pushes and ends on the gel
    acting = np.flatnonzero(solved.forces.any(axis=1))
    scale = ARROW_MM / np.linalg.norm(solved.forces, axis=1).max()
    arrows = pv.PolyData(moved[acting] - scale * solved.forces[acting])
    arrows["force"] = solved.forces[acting]
    vertices, faces = body.surface()
    depth, at, shear = PRESSED
    tool = pv.PolyData.from_regular_faces(vertices + (at[0] + shear[0], at[1] + shear[1], -depth), faces)

    view: Any = pv.Plotter(off_screen=True, window_size=[1300, 640])
    view.set_background("white")
    bar = {
        "color": "black",
        "position_x": 0.68,
        "position_y": 0.03,
        "width": 0.28,
        "height": 0.14,
        "n_labels": 3,
        "fmt": "%.1f",
    }
    view.add_mesh(gel, cmap="viridis", scalar_bar_args=bar, show_edges=True, edge_color="#4a5568", line_width=0.5)
    view.add_mesh(tool.clip("z", origin=(0, 0, 2.5)), color="lightgrey", opacity=0.25, smooth_shading=True)
    view.add_mesh(arrows.glyph(orient="force", scale="force", factor=scale), color="firebrick")
    view.camera_position = [(19, -27, 21), (0, -0.5, -1), (0, 0, 1)]
    image = np.asarray(view.screenshot(return_img=True))
    view.close()
    return image


main = group(real=real, copy=copy, press=press)


if __name__ == "__main__":
    main.exit()
