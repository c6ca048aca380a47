"""Reference solutions of the chart's scenes, kept as plain files because solving one on fine tetrahedra takes hours.

One file per scene holds the force in every cell. KEYS holds two digests per scene: of the inputs of its reference,
and of its file. Where the scene, the cells, ReferenceTable (flow/tables.py) or the file have changed, the reference is invalid and
is solved again.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import digest_of, digest_of_value, read_csv, read_json, write_csv, write_json
from gelforge.flow.params import plain
from gelforge.flow.tables import ReferenceTable
from gelforge.labelling.sensor import Sensor
from gelforge.mechanics.scene import Scene
from gelforge.records.press import FORCE
from gelforge.sweeps.deviation import errors
from gelforge.sweeps.methods import DOUBLED, REFERENCE
from gelforge.sweeps.scenes import parse_scene

KEYS = "keys.json"
COLUMNS = ("row", "column", *FORCE)
OUTSIDE = -1  # row and column of the force outside the image
LEAST_N = 5e-8  # cells with less force are not written
IMAGES = ((-1, 1), (1, -1), (-1, -1))  # mirror images, as signs of x and y
# Number and range of random points at which a scene is compared with its mirror image, and the tolerance.
POINTS, REACH_MM, LEAST_MM = 4000, 12.0, 1e-6


def reference_key(scene: dict, nu: float, sensor: Sensor, table: ReferenceTable) -> str:
    """Digest of a reference's inputs: table of the scene, Poisson's ratio, cells, element sizes and load steps."""
    return digest_of_value([scene, nu, sensor.image, sensor.projection.tolist(), plain(table)])


def reference_rows(record: dict) -> list[dict]:
    """Rows of a scene's reference: force in N of each loaded cell, and outside the image; BadInput if it failed."""
    if record["status"] != "OK":
        raise BadInput(
            f"the reference of {record['scene']} is {record['status']}: {record['reason']}; run make pareto"
        )
    cells = np.array(record["cells"])
    held = np.argwhere(np.abs(cells).max(axis=0) > LEAST_N)
    rows = [_row(int(r), int(c), cells[:, r, c]) for r, c in held]
    return [*rows, _row(OUTSIDE, OUTSIDE, np.array(record["outside"]))]


def _row(row: int, column: int, force: np.ndarray) -> dict:
    return dict(zip(COLUMNS, (row, column, *(f"{value:.7f}" for value in force)), strict=True))


def keep_references(charted: Iterable[dict], folder: Path, nu: float) -> None:
    """Write references from scenes of the chart (pareto/scenes/*.json), one file each; delete those of other scenes.

    A scene that is its own mirror image gets the mean of its forces and their mirror images, because meshes are not
    symmetric. `elements_doubled`: difference of a solve with elements and load steps of twice the size. nu: Poisson's
    ratio.
    """
    keys = {}
    for scene in charted:
        record = scene["methods"].get(REFERENCE)
        if record is None:
            raise BadInput(
                f"the chart of scene {scene['scene']} has no solve by method {REFERENCE}, so another version made it; remove"
                f" pareto/scenes/{scene['scene']}.json in the results folder and run make fea-references"
            )
        path = folder / f"{scene['scene']}.csv"
        if record.get("cells") is not None:
            images = images_of(parse_scene(scene["scene"], scene["table"], nu).scene)
            record = record | averaged(record, images)
        write_csv(path, COLUMNS, reference_rows(record))
        check = scene["methods"].get(DOUBLED)
        moved = errors(check, record) if check else scene.get("reference_check")
        keys[scene["scene"]] = {"key": record["key"], "sha256": digest_of(path), "elements_doubled": moved}
    for path in folder.glob("*.csv"):
        if path.stem not in keys:
            path.unlink()
    write_json(folder / KEYS, keys)


def averaged(record: dict, images: list[tuple[int, int]]) -> dict:
    """Cells (3, rows, columns) N and force outside (3,) N of a reference, averaged over its mirror images."""
    cells, outside = (np.asarray(record[key], float) for key in ("cells", "outside"))
    every = [(1, 1), *images]
    return {
        "cells": np.mean([image_of(cells, signs) for signs in every], axis=0),
        "outside": np.mean([outside * [*signs, 1.0] for signs in every], axis=0),
    }


def elements_doubled(folder: Path) -> dict[str, dict | None]:
    """By scene, relative differences {"total", "cells"} of a solve with elements and load steps of twice the size."""
    return {name: of.get("elements_doubled") for name, of in read_json(folder / KEYS).items()}


def kept_reference(folder: Path, scene: str, key: str, shape: tuple[int, int]) -> dict | None:
    """The reference of a scene that was solved under the same key, as a record of the chart; else None.

    shape: rows and columns of its cells. The record has no cost, because it was solved elsewhere.
    """
    path = folder / f"{scene}.csv"
    try:
        known = read_json(folder / KEYS)[scene]
        if (known["key"], known["sha256"]) != (key, digest_of(path)):
            return None
    except (OSError, ValueError, LookupError, TypeError):
        return None
    cells, outside = np.zeros((3, *shape)), np.zeros(3)
    for row in read_csv(path):
        at, force = (int(row["row"]), int(row["column"])), np.array([float(row[name]) for name in FORCE])
        if at[0] == OUTSIDE:
            outside = force
        else:
            cells[:, at[0], at[1]] = force
    total = cells.sum(axis=(1, 2)) + outside
    return {
        "status": "OK",
        "reason": "",
        "total": total.tolist(),
        "cells": cells.tolist(),
        "outside": outside.tolist(),
    }


# -- scenes that are their own mirror image: mesh errors cancel in the mean of the forces and their images


def images_of(scene: Scene) -> list[tuple[int, int]]:
    """Those of IMAGES under which the scene's gel, body and path are unchanged."""
    rng = np.random.default_rng(7)
    points = rng.uniform(-REACH_MM, REACH_MM, (POINTS, 3)) * [1.0, 1.0, 0.3]
    rotation, start = scene.press.pose(0.0, 0.0)
    _, end = scene.press.pose(1.0, 1.0)
    path = np.stack([start, end])[:, :2]

    def shape(at: np.ndarray) -> np.ndarray:
        body, _ = scene.indenter.distance((at - start) @ rotation)
        return np.concatenate([body, scene.gel.top(at[:, 0], at[:, 1])])

    own = shape(points)
    return [
        signs
        for signs in IMAGES
        if np.allclose(path * signs, path, atol=LEAST_MM)
        and np.abs(shape(points * [*signs, 1.0]) - own).max() < LEAST_MM
    ]


def image_of(cells: np.ndarray, signs: tuple[int, int]) -> np.ndarray:
    """The mirror image of cells (3, rows, columns) N along gel x, y, z; rows run along x and columns along y."""
    return cells[:, :: signs[0], :: signs[1]] * np.array([*signs, 1.0])[:, None, None]
