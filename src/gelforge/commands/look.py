"""Draw one sample, and write files for ParaView: the press, the indenter, the deformation of the gel, the label."""

from argparse import Namespace
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.cli import command, option
from gelforge.flow.files import publish, read_json
from gelforge.flow.layout import LOOK, Layout, command_for
from gelforge.geometry.gel import load_gel, use_gels_of
from gelforge.geometry.indenters import build
from gelforge.geometry.sampled import notes_of
from gelforge.geometry.standing import TIP_MM
from gelforge.geometry.stlfile import read_stl
from gelforge.geometry.triangles import Mesh, write_stl
from gelforge.labelling.grid import Grid
from gelforge.labelling.sensor import Sensor, find_sensor, load_sensors
from gelforge.mechanics.mesh.basemesh import use_meshes_of
from gelforge.mechanics.mesh.names import load_mesh
from gelforge.records.finder import ONLY, find
from gelforge.records.forcefile import ForceFile
from gelforge.records.image import read_logged_image
from gelforge.records.labelfile import read_labels
from gelforge.records.log import read_poses
from gelforge.records.press import PosedPress, check_id

INK = "#12181f"


@dataclass(frozen=True)
class Pictured:
    """One sample with its label (3, rows, cols), force outside the image (3,), image (h, w, 3) or None, and sensor.

    moment: of the label about the gel's apex, (3,) N mm.
    indenter: the part of its surface that the gel can touch, at the end of the path, in the gel frame, mm.
    """

    press: PosedPress
    label: np.ndarray
    outside: np.ndarray
    moment: np.ndarray
    image: np.ndarray | None
    sensor: Sensor
    resolution: str
    indenter: Mesh


def shard_paths(results: Path, sample_id: str, resolution: str) -> dict[str, Path]:
    """Files of a sample's shard, or of `make sample` where the shard has no label of it; BadInput where none has."""
    of, found = Layout(results), find(results, sample_id, resolution)
    if found.imported:
        raise BadInput(
            f"the label of {sample_id} came with the dataset, in {found.imported}: a press that was not solved here has no deformed"
            f" gel to look at; {of.command('report')} shows a network's prediction from its image"
        )
    found.refuse_rejected()
    for own, name in ((found.of, found.shard), (of.sample(sample_id), ONLY)):
        paths = {"poses": own.poses(name), "forces": own.forces(name), "labels": own.labels(resolution, name)}
        # the shard's labels may be older than a row that was added to the log
        if all(paths[kind].exists() for kind in paths) and sample_id in read_labels(paths["labels"]).sample_id:
            return paths
    one, all_of_them = (of.command(f"{goal} RES={resolution}") for goal in (f"sample ID={sample_id}", "labels"))
    raise BadInput(f"sample {sample_id} has no label at {resolution} yet; run {one}, or {all_of_them}")


def load(data: Path, paths: dict, sample_id: str, sensors: dict, resolution: str) -> Pictured:
    """Read a sample's press, label and image."""
    found = read_labels(paths["labels"])
    at = found.index(sample_id)
    press = next((press for press in read_poses(paths["poses"]) if press.sample_id == sample_id), None)
    if press is None:
        raise BadInput(
            f"{paths['poses']}: has no sample {sample_id}; run {command_for('poses labels', paths['poses'])}"
        )
    if not found.status[at].valid:
        raise BadInput(
            f"sample {sample_id} has no valid state ({found.status[at].name}); {command_for('provenance ID=' + sample_id, paths['poses'])} says why"
        )
    sensor = find_sensor(sensors, press.sensor_id, str(paths["poses"]))
    image = read_logged_image(data, press.image, sensor.image) if press.image else None
    surface = paths["poses"].parent / press.stl
    if not surface.exists():
        raise BadInput(
            f"{surface}: not found; delete {paths['poses']} and run {command_for('poses', paths['poses'])}"
        )
    vertices, faces = read_stl(surface)
    indenter = vertices + [press.dx_mm, press.dy_mm, press.dz_mm], faces
    return Pictured(
        press, found.label[at].astype(float), found.outside[at], found.moment[at], image, sensor, resolution, indenter
    )


def export_vtu(path, paths: dict, sample_id: str) -> None:
    """Write the gel of a sample with displacement, interpolated at inner nodes, and nodal force."""
    from gelforge.formats.vtu import fill_inside, write_vtu

    with ForceFile(paths["forces"]) as forces:
        at = forces.index(sample_id)
        name = str(forces.mesh[at])
        if forces.surface_ptr[at] == forces.surface_ptr[at + 1]:
            raise BadInput(f"sample {sample_id} has no state ({forces.status[at]}), so there is nothing to export")
        mesh = load_mesh(name)
        sample = forces.sample(at, mesh.surface_nodes)
    force, known = np.zeros_like(mesh.nodes), np.zeros(len(mesh.nodes), bool)
    force[sample.nodes], known[sample.nodes], known[mesh.base] = sample.force, True, True
    write_vtu(path, mesh, fill_inside(mesh, sample.nodes, sample.displacement), force, known)


def outline(look: Pictured) -> np.ndarray:
    """Intersection of the indenter at the end of its path with the unloaded gel's surface: lines (n, 2, 2) px."""
    vertices, faces = look.indenter
    above = vertices[:, 2] - load_gel(look.sensor.gel).top(vertices[:, 0], vertices[:, 1])
    start, end = vertices[faces], vertices[np.roll(faces, -1, axis=1)]
    high, low = above[faces], above[np.roll(faces, -1, axis=1)]
    cut = (high > 0.0) != (low > 0.0)  # none or two edges of each triangle
    part = (high[cut] / (high[cut] - low[cut]))[:, None]
    points = start[cut] + part * (end[cut] - start[cut])
    return look.sensor.project(points[:, :2]).reshape(-1, 2, 2)


def lowest(look: Pictured) -> np.ndarray:
    """Centre (2,) mm of the indenter's lowest TIP_MM, in the gel frame."""
    vertices, _ = look.indenter
    low = vertices[vertices[:, 2] < vertices[:, 2].min() + TIP_MM, :2]
    return (low.min(axis=0) + low.max(axis=0)) / 2.0


def draw(look: Pictured) -> Any:
    """Matplotlib figure: the image with pressure and indenter outline, and the force components over a grey image."""
    from matplotlib.collections import LineCollection

    from gelforge.reporting.canvas import canvas_with_axes
    from gelforge.reporting.forcemaps import draw_component

    (width, height), press = look.sensor.image, look.press
    figure, axes = canvas_with_axes(2, 2, 12.4, 9.2)
    extent = (0, width, height, 0)
    for axis in axes.ravel():
        axis.set(
            xlim=(0, width), ylim=(height, 0), xlabel="u, px", ylabel="v, px", aspect="equal", facecolor="#e6e8ea"
        )
    first, *others = axes.ravel()
    if look.image is not None:
        first.imshow(look.image, extent=extent)
    pressure = np.maximum(-look.label[2], 0.0)
    rows, cols = pressure.shape
    if pressure.max() > 0 and min(rows, cols) > 1:
        u, v = (np.arange(cols) + 0.5) * width / cols, (np.arange(rows) + 0.5) * height / rows
        levels = pressure.max() * np.array([0.05, 0.35, 0.65])
        first.contour(u, v, pressure, levels=levels, colors=INK if look.image is None else "white", linewidths=0.9)
    first.add_collection(LineCollection([*outline(look)], colors="#3fd0ff", linewidths=1.2))
    first.plot(*look.sensor.project(lowest(look)[None])[0], "+", color="#3fd0ff", markersize=11, markeredgewidth=1.6)
    first.set_title(
        "indenter (blue, + at its lowest part)\npressure (contours at 5, 35, 65 % of its peak)", fontsize=10
    )
    for channel, axis in enumerate(others):
        if look.image is not None:
            axis.imshow(look.image.mean(axis=2), cmap="gray", vmin=-120, vmax=255, extent=extent)
        size, missing = np.abs(look.label[channel]), look.outside[channel]
        reach = max(float(size.max()), 1e-9)
        alpha = np.clip(0.25 + 0.75 * size / reach, 0, 0.92) * (size > 0.003 * reach)
        note = f", outside {missing:+.3f} N" if abs(missing) > 5e-4 else ""
        draw_component(axis, look.label[channel], channel, note, extent=extent, alpha=alpha, interpolation="nearest")
    figure.suptitle(
        f"{press.sample_id}: {press.indenter} on {press.sensor_id}, {-press.dz_mm:.2f} mm deep,"
        f" shear ({press.dx_mm:.2f}, {press.dy_mm:.2f}) mm\nlabel {look.resolution},"
        f" moment ({', '.join(f'{value:.1f}' for value in look.moment)}) N mm",
        fontsize=12,
    )
    return figure


@command(
    option("--data", type=Path, help="data/DATASET"),
    option("--results", type=Path, help="results/DATASET"),
    option("--id", help="sample_id"),
    option("--resolution", nargs="+", default=["24x32"]),
    option("--sensors", type=Path, default=Path("workflow/sensors.toml")),
    option("--workflow", type=Path, default=Path("workflow"), help="folder of gels.toml"),
    option("--out", type=Path, help="folder (default results/DATASET/look)", default=None),
)
def main(args: Namespace) -> None:
    if not args.id:
        raise BadInput(f"no sample named; say {Layout(args.results).command('look ID=SAMPLE_ID')}")
    from gelforge.reporting.canvas import save_png

    check_id(args.id)
    use_gels_of(args.workflow)
    use_meshes_of(Layout(args.results).meshes)
    sensors, out = load_sensors(args.sensors), args.out or args.results / LOOK
    paths, indenter = {}, out / f"{args.id}-indenter.stl"
    for resolution in map(str, map(Grid.parse, args.resolution)):
        paths = shard_paths(args.results, args.id, resolution)
        look = load(args.data, paths, args.id, sensors, resolution)
        with publish(out / f"{args.id}-{resolution}.png") as part:
            save_png(part, draw(look))
        print(out / f"{args.id}-{resolution}.png")
        with publish(indenter) as part:
            write_stl(part, *look.indenter)
    of = Layout(args.results)
    table = read_json(of.parameters("indenters"))[look.press.indenter]
    if table.get("kind") == "stl":
        body = build(look.press.indenter, table, "indenter catalogue", of.workflow, of.surfaces)
        for line in notes_of(body):
            print(f"indenter {body.name}: {line}")
    export_vtu(out / f"{args.id}.vtu", paths, args.id)
    print(out / f"{args.id}.vtu", indenter, sep="\n")


if __name__ == "__main__":
    main.exit()
