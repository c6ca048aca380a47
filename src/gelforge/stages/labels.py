"""Stage 50: labels of a shard, the force in each cell of an image grid, from nodal forces."""

import json
from argparse import Namespace
from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.cli import stage
from gelforge.flow.files import read_json
from gelforge.flow.layout import Layout, command_for
from gelforge.flow.params import read_parameters
from gelforge.labelling.cellsurface import SurfaceMap, surface_map, traction
from gelforge.labelling.grid import Grid
from gelforge.labelling.operator import Operator, assemble
from gelforge.labelling.sensor import Sensor, find_sensor, sensors_of
from gelforge.mechanics.mesh.gelmesh import GelMesh
from gelforge.mechanics.mesh.names import load_mesh
from gelforge.mechanics.result import moment_of_nodes
from gelforge.records.forcefile import ForceFile
from gelforge.records.labelfile import MOMENTS, Stream, to_float32, write_labels
from gelforge.records.log import read_poses
from gelforge.records.status import Status

VERSION = 5
OPERATORS_KEPT = 64  # operators in memory
BLOCK_BYTES = 64 * 2**20  # of float64 cells held at a time


def bin_samples(forces: ForceFile, members, operator: Operator) -> tuple[np.ndarray, np.ndarray]:
    """Labels (m, 3, rows, cols) float32 and force outside the image (m, 3) of the samples numbered `members`, N.

    Every sample must be on the operator's mesh.
    """
    starts, stops = forces.ptr[members], forces.ptr[np.asarray(members) + 1]
    rows = np.concatenate([np.arange(a, b) for a, b in zip(starts, stops, strict=True)])
    ptr = np.concatenate([[0], np.cumsum(stops - starts)])
    binned, samples, cells = (
        operator.spread(ptr, forces.node[rows], forces.force[rows]),
        len(members),
        operator.grid.cells,
    )
    row, inside = np.repeat(np.arange(3 * samples), np.diff(binned.indptr)), binned.indices < cells
    axis, sample = np.divmod(row, samples)
    label, outside = np.zeros((samples, 3, cells), np.float32), np.zeros((samples, 3))
    value = to_float32(binned.data[inside], row[inside], 3 * samples)
    label[sample[inside], axis[inside], binned.indices[inside]] = value
    outside[sample[~inside], axis[~inside]] = binned.data[~inside]
    return label.reshape(samples, 3, *operator.grid.shape), outside


def moments_of(forces: ForceFile, at: int, operator: Operator, mesh: GelMesh) -> tuple[np.ndarray, np.ndarray]:
    """Moments about the apex of one sample's force in the image and outside it, (3,) N mm each, from its nodes."""
    sample = forces.sample(at, mesh.surface_nodes)
    moment = moment_of_nodes(mesh.nodes[sample.nodes] + sample.displacement, sample.force)
    binned = operator.spread([0, len(sample.nodes)], sample.nodes, moment)
    outside = binned[:, -1].toarray().ravel()
    return moment.sum(axis=0) - outside, outside


def label_blocks(forces: ForceFile, operators: list, grid: Grid, outside: np.ndarray):
    """Yield the labels of consecutive samples and fill `outside` (n, 3).

    operators has one entry per sample, None where no force acts. Where `outside` is NaN, the sample has no
    valid state, and its label is NaN too.
    """
    size = max(1, BLOCK_BYTES // (3 * 8 * grid.cells))
    for start in range(0, len(forces), size):
        block = range(start, min(start + size, len(forces)))
        label = np.zeros((len(block), 3, *grid.shape), np.float32)
        label[np.isnan(outside[block.start : block.stop, 0])] = np.nan
        groups: dict[int, list[int]] = {}
        for sample in block:
            if operators[sample] is not None:
                groups.setdefault(id(operators[sample]), []).append(sample)
        for members in groups.values():
            cells, beyond = bin_samples(forces, members, operators[members[0]])
            label[np.array(members) - start], outside[members] = cells, beyond
        yield label


def note_small_cells(grid: Grid, sensor: Sensor) -> None:
    """Print a note if cells are smaller than a sensor's pixels: the solve has such detail, no image does."""
    width, height = sensor.image
    if grid.rows > height or grid.cols > width:
        print(
            f"note: RES={grid}, rows x columns, has cells smaller than the pixels of {sensor.name}'s images, {width} x"
            f" {height}: no image shows forces so finely; RES=24x32 is usual",
            flush=True,
        )


class Finder:
    """Operators and surface maps of meshes at one resolution; the latest ones are kept in memory.

    They are not written to files: nearly every press has its own mesh, and an operator takes only 0.02 s.
    """

    def __init__(self, sensors: dict, grid: Grid, where: str):
        self.sensors, self.grid, self.where = sensors, grid, where
        self.operator, self.fields = (
            lru_cache(OPERATORS_KEPT)(self._operator),
            lru_cache(OPERATORS_KEPT)(self._fields),
        )
        self.sensor = lru_cache(None)(self._sensor)
        self.mesh = lru_cache(1)(load_mesh)

    def _sensor(self, name: str) -> Sensor:
        found = find_sensor(self.sensors, name, self.where)
        note_small_cells(self.grid, found)
        return found

    def _operator(self, mesh: str, sensor: str) -> Operator:
        unit = self.sensor(sensor)
        return assemble(self.mesh(mesh), unit, self.grid)

    def _fields(self, name: str, sensor: str) -> tuple[SurfaceMap, Operator, GelMesh]:
        mesh = self.mesh(name)
        surface = surface_map(mesh, self.sensor(sensor), self.grid)
        return surface, self.operator(name, sensor), mesh


def field_streams(forces: ForceFile, find_maps: list, grid: Grid, channels) -> dict[str, Stream]:
    """Fields beside the forces that `channels` names, by name of their array: shape, and blocks of one sample each.

    find_maps has one entry per sample: a function without arguments that returns its `SurfaceMap`, the `Operator` of
    its forces, and its mesh, or None for a sample without a state, whose fields are NaN.
    """
    n = len(forces)

    def each(shape, of_sample):
        for at in range(n):
            if find_maps[at] is None:
                yield np.full((1, *shape, *grid.shape), np.nan, np.float32)
                continue
            surface, operator, mesh = find_maps[at]()
            sample = forces.sample(at, mesh.surface_nodes)
            moved = np.zeros_like(mesh.nodes)
            moved[sample.nodes] = sample.displacement
            force = operator.apply([0, len(sample.nodes)], sample.nodes, sample.force)[0][0]
            yield of_sample(surface, moved, force).astype(np.float32)[None]

    made: dict[str, dict[str, tuple[tuple[int, ...], Callable]]] = {
        "displacement": {"displacement": ((3,), lambda s, moved, force: s.displacement(moved))},
        "traction": {
            "traction": ((3,), lambda s, moved, force: traction(force, s.area())),
            "area": ((), lambda s, moved, force: s.area()),
        },
        "traction_deformed": {
            "traction_deformed": ((3,), lambda s, moved, force: traction(force, s.area(moved))),
            "area_deformed": ((), lambda s, moved, force: s.area(moved)),
        },
    }
    required = {name: how for channel in channels if channel != "force" for name, how in made[channel].items()}
    return {name: ((n, *shape, *grid.shape), each(shape, of)) for name, (shape, of) in required.items()}


def label_shard(forces_path, poses_path, find: Finder, grid: Grid, out, channels) -> dict:
    """Write the labels of one shard to `out` and return a summary of it.

    find.operator(mesh name, sensor name) gives the operator. Forces that are not finite, a sample without
    a pose, and a mesh or sensor that is missing raise BadInput with the file and the sample.
    """
    sensor_of = sensors_of_samples(poses_path)
    with ForceFile(forces_path) as forces:
        if not np.isfinite(forces.force).all():
            raise BadInput(
                f"{forces_path}: sample {_first_bad(forces)} has forces that are not finite;"
                " delete the file and its solve in 30_fea, then run make again"
            )
        operators, moments = [], np.zeros((2, len(forces), 3))
        for i in range(len(forces)):
            operators.append(_operator_of(forces, i, sensor_of, find.operator, poses_path))
            if operators[i] is not None:
                moments[:, i] = moments_of(forces, i, operators[i], find.mesh(str(forces.mesh[i])))
        valid = np.array([Status[str(status)].valid for status in forces.status], bool)
        outside = np.where(valid[:, None], np.zeros(3), np.nan)
        moments[:, ~valid] = np.nan
        others = {"sample_id": forces.sample_id, "status": forces.status, "outside": outside, "c10": forces.c10}
        others |= forces.numbers | dict(zip(MOMENTS, moments, strict=True))
        if forces.press_id.any():
            others["press_id"] = forces.press_id
        blocks = label_blocks(forces, operators, grid, outside)
        maps = [
            partial(find.fields, str(mesh), sensor_of.get(str(name), "")) if moved else None
            for mesh, name, moved in zip(forces.mesh, forces.sample_id, np.diff(forces.surface_ptr) > 0, strict=True)
        ]
        fields = field_streams(forces, maps, grid, channels)
        write_labels(out, blocks, (len(forces), 3, *grid.shape), {**others, **forces.intervals}, fields)
        return summarise(forces, outside)


def sensors_of_samples(poses_path) -> dict[str, str]:
    """The sensor of each sample of a pose table."""
    return {press.sample_id: press.sensor_id for press in read_poses(poses_path)}


def _operator_of(forces, sample, sensor_of, find_operator, poses_path):
    name = str(forces.sample_id[sample])
    if forces.ptr[sample] == forces.ptr[sample + 1]:
        return None
    if name not in sensor_of:
        command = command_for("poses forces", poses_path)
        raise BadInput(f"{poses_path}: has no sample {name}, which {forces.path} holds; run {command}")
    return find_operator(str(forces.mesh[sample]), sensor_of[name])


def _first_bad(forces: ForceFile) -> str:
    row = np.flatnonzero(~np.isfinite(forces.force).all(axis=1))[0]
    return str(forces.sample_id[np.searchsorted(forces.ptr, row, side="right") - 1])


def summarise(forces: ForceFile, outside: np.ndarray) -> dict:
    """Counts of a shard, and the sample with the largest fraction of its normal force outside the image."""
    fraction = np.abs(outside[:, 2]) / np.maximum(np.abs(forces.total[:, 2]), 1e-12)
    fraction = np.where(np.isfinite(fraction), fraction, 0.0)
    worst = int(fraction.argmax()) if len(fraction) else None
    return {
        "samples": len(forces),
        "failed": int(np.isnan(outside[:, 0]).sum()),
        "worst_sample": "" if worst is None else str(forces.sample_id[worst]),
        "worst_outside_share": 0.0 if worst is None else float(fraction[worst]),
    }


@stage(Layout.labels)
def main(args: Namespace) -> None:
    of = args.of
    params = read_parameters(of.parameters("labels")).labels
    grid, forces, poses = Grid.parse(args.resolution), of.forces(args.shard), of.poses(args.shard)
    find = Finder(sensors_of(read_json(of.used(args.shard))["sensors"], str(of.used(args.shard))), grid, str(poses))
    found = label_shard(forces, poses, find, grid, args.out, params.channels)
    if found["worst_outside_share"] > params.largest_outside_share:
        print(
            f"note: up to {found['worst_outside_share']:.1%} of the force of a press ({found['worst_sample']}) lies outside"
            " the image; labels leave it out, the array `outside` holds it"
        )
    print(json.dumps({"done": found["samples"] - found["failed"], "failed": {}}))


if __name__ == "__main__":
    main.exit()
