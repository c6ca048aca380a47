"""References of the chart's scenes kept as plain files, so that nobody has to solve them again: hours on fine tetrahedra.

A file for each scene holds its force in every cell; one beside them says by a digest what each is a reference of, and by
another what it holds. Where the scene, the cells, [pareto.reference] or the file itself have changed since, a reference is
none any more and is solved anew.
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
OUTSIDE = -1  # row and column of what acts outside of the picture
LEAST_N = 5e-8  # less in a cell is written as none
IMAGES = ((-1, 1), (1, -1), (-1, -1))  # signs of x and y
# Random points at which a scene is compared with its mirror image, how far they reach, and what counts as equal.
POINTS, REACH_MM, LEAST_MM = 4000, 12.0, 1e-6


def reference_key(scene: dict, nu: float, sensor: Sensor, table: ReferenceTable) -> str:
    """Digest of what a reference is one of: table of the scene, Poisson's ratio, cells, element sizes and load steps."""
    return digest_of_value([scene, nu, sensor.projection.tolist(), plain(table)])


def reference_rows(record: dict) -> list[dict]:
    """Rows of a scene's reference: force in N of each cell that has one, and what acts outside of the picture."""
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
    """Write references from scenes of the chart (pareto/scenes/*.json), one file each; those of other scenes go.

    A scene that is its own mirror image gets the mean of its forces and their images, which a mesh keeps apart. By how much a
    solve on elements and load steps of twice the size differs from it is its `elements_doubled`. nu: Poisson's ratio.
    """
    keys = {}
    for scene in charted:
        record = scene["methods"].get(REFERENCE)
        if record is None:
            raise BadInput(
                f"the chart of {scene['scene']} has no {REFERENCE}; the small chart's reference is none here"
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
    """Cells (3, rows, columns) N and force outside (3,) N of a reference, the mean of its mirror images."""
    cells, outside = (np.asarray(record[key], float) for key in ("cells", "outside"))
    every = [(1, 1), *images]
    return {
        "cells": np.mean([image_of(cells, signs) for signs in every], axis=0),
        "outside": np.mean([outside * [*signs, 1.0] for signs in every], axis=0),
    }


def elements_doubled(folder: Path) -> dict[str, dict | None]:
    """By scene, {"total", "cells"} by what share of the force a solve on elements and load steps of twice the size differs."""
    return {name: of.get("elements_doubled") for name, of in read_json(folder / KEYS).items()}


def kept_reference(folder: Path, scene: str, key: str, shape: tuple[int, int]) -> dict | None:
    """The reference of a scene that was solved under the same key, as a record of the chart; else None.

    shape: rows and columns of its cells. The record has no cost: it was spent elsewhere.
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


# -- scenes that are their own mirror image: what a mesh adds to their forces cancels in the mean of both


def images_of(scene: Scene) -> list[tuple[int, int]]:
    """Those of IMAGES that take the scene's gel, body and path to themselves."""
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
