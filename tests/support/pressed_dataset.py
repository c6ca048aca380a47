"""A small dataset as stages 00 to 40 write it: a real gel mesh, forces of known tractions, images, poses."""

from pathlib import Path

import numpy as np

from gelforge.flow.files import canonical, read_json, read_toml, write_csv, write_if_changed, write_json
from gelforge.flow.layout import Layout
from gelforge.flow.params import plain
from gelforge.geometry.indenters import build
from gelforge.geometry.triangles import cropped, write_stl
from gelforge.mechanics.mesh.hexmesh import FineBox
from gelforge.mechanics.mesh.hexname import HexMeshName
from gelforge.records.forcefile import SampleForces, write_forces
from gelforge.records.press import COLUMNS
from tests.support.parameters import parameters, with_values, write_stage, write_used
from tests.support.patch import consistent_loads

ROOT = Path(__file__).resolve().parents[2]
SETTINGS = with_values(parameters().dataset, validation=0.1, test=0.2)
CATALOGUE = {"sphere_10": {"kind": "sphere"}, "cuboid_7": {"kind": "cuboid"}, "triangle_8": {"seen": False}}


def mesh_name(size: float = 1.2) -> HexMeshName:
    """The name of a mesh of uniform hexahedra."""
    return HexMeshName("gelsight_mini", FineBox(-10.0, 10.0, -12.0, 12.0, size), 2, 3.0, 1.5, 2.0)


HEXAHEDRA = mesh_name().name


def make_mesh(size: float = 1.2):
    """A gel of uniform hexahedra."""
    return mesh_name(size).mesh()


def bump(mesh, x, y, radius, force) -> np.ndarray:
    """Nodal forces (n, 3) of a round traction of resultant `force` (3,) N."""
    shape = consistent_loads(mesh, lambda u, v: np.maximum(0.0, 1.0 - ((u - x) ** 2 + (v - y) ** 2) / radius**2))
    return shape[:, None] / shape.sum() * np.asarray(force)


def write_pressed(
    folder, count: int = 24, shard_size: int = 8, seed: int = 0, failed=(), sensors=("mini_a",)
) -> dict:
    """Write data/made and results/made below `folder`; return the paths and the nodal forces by sample_id."""
    import cv2

    folder, rng, mesh = Path(folder), np.random.default_rng(seed), make_mesh()
    data, results = folder / "data" / "made", folder / "results" / "made"
    (data / "images").mkdir(parents=True)
    rows, loads, samples = [], {}, []
    for at in range(count):
        name, touch = f"s{at:03d}", rng.uniform(-4, 4, 2)
        indenter = list(CATALOGUE)[at % 3]
        force = rng.uniform(-1, 1), rng.uniform(-1, 1), -rng.uniform(0.5, 9.0)
        loads[name] = bump(mesh, *touch, 3.0, force)
        surface, image = mesh.surface_nodes, rng.integers(0, 255, (240, 320, 3), np.uint8)
        cv2.imwrite(str(data / "images" / f"{name}.png"), image)
        row = dict.fromkeys(COLUMNS, "") | {
            "sample_id": name,
            "sensor_id": sensors[at % len(sensors)],
            "gel_id": "g1",
            "indenter": indenter,
            "x0_mm": touch[0],
            "y0_mm": touch[1],
            "z0_mm": 0,
            "dx_mm": 0.1,
            "dy_mm": 0.2,
            "dz_mm": -1.0,
            "rot_deg": 0,
            "fx_n": force[0],
            "fy_n": force[1],
            "fz_n": force[2],
            "image": f"images/{name}.png",
        }
        rows.append(row)
        good = at not in failed
        samples.append(
            SampleForces(name, "OK", HEXAHEDRA, surface, loads[name][surface], -0.1 * np.abs(loads[name][surface]))
            if good
            else SampleForces.failed(name, "DIVERGED", HEXAHEDRA)
        )
    write_csv(data / "log.csv", COLUMNS, rows)
    vertices, faces = cropped(build("ball", {"kind": "sphere", "diameter": 10, "height": 10}), 2.0)
    for shard in range(0, count, shard_size):
        stem, part = f"{shard // shard_size:04d}", slice(shard, shard + shard_size)
        write_csv(results / "00_plan/shards" / f"{stem}.csv", COLUMNS, rows[part])
        (results / "10_poses" / stem).mkdir(parents=True)
        for row in rows[part]:
            row["stl"] = f"{stem}/{row['sample_id']}.stl"
            write_stl(results / "10_poses" / row["stl"], vertices + [row["x0_mm"], row["y0_mm"], row["z0_mm"]], faces)
        write_csv(results / "10_poses" / f"{stem}.csv", [*COLUMNS, "stl"], rows[part])
        write_forces(results / "40_forces" / f"{stem}.npz", samples[part], 0.0725, {"c10_interval68": [0.07, 0.075]})
    write_csv(
        results / "00_plan/shards.csv",
        ["sample_id", "shard"],
        [{"sample_id": row["sample_id"], "shard": at // shard_size} for at, row in enumerate(rows)],
    )
    write_stage(results / "00_plan/params", "labels")
    write_stage(results / "00_plan/params", "dataset", dataset=plain(SETTINGS))
    write_json(results / "00_plan/params/indenters.json", CATALOGUE)
    write_json(results / "00_plan/params/gels.json", {})
    return {"folder": folder, "data": data, "results": results, "mesh": mesh, "loads": loads, "rows": rows}


def place_sensors(of: Layout, file: Path) -> None:
    """Write the sensors of a file where stages read them, if they differ from those there."""
    tables = read_json(file) if file.suffix == ".json" else read_toml(file)
    write_if_changed(of.parameters("sensors"), canonical(tables))


def label(made: dict, resolution: str, sensors=ROOT / "workflow/sensors.toml") -> Path:
    """Run stage 50 on all shards; return the folder of labels."""
    from gelforge.stages import labels

    of = Layout(made["results"])
    place_sensors(of, sensors)
    for shard in of.names():
        write_used(of, shard, sensors=read_json(of.parameters("sensors")), indenters=CATALOGUE)
        labels.main([str(of.root), resolution, shard])
    return of.labels(resolution, "0000").parent


def collect(made: dict, resolution: str, *flags: str, **settings) -> Path:
    """Run stage 60 with options, and some of its settings changed; return the dataset's folder."""
    from gelforge.stages import dataset

    of = Layout(made["results"])
    place_sensors(of, ROOT / "workflow/sensors.toml")
    noise = {"judge_images": False}  # the images are noise
    write_stage(of.params, "dataset", dataset=plain(SETTINGS) | settings, poses=noise)
    write_json(of.images(), {"left_out": {}})
    dataset.main([str(of.root), resolution, *flags])
    return of.dataset(resolution)
