"""Score forces of any simulator against the references of this folder; python score.py FOLDER [--out score.json].

FOLDER holds one NAME.csv for each scene or exact press that was solved, in one of these forms, distinguished by the header:
  row,column,fx_n,fy_n,fz_n   of a scene: force per cell in N
  ring,fz_n                   of an exact press: force per ring around the axis in N
  x_mm,y_mm,fx_n,fy_n,fz_n    of both: forces in N at points of the undeformed surface; each counts where it lies
and, if times shall be shown, seconds.csv with the columns scene,seconds. Needs NumPy and nothing else.
"""

import argparse
import csv
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
FORCE = ("fx_n", "fy_n", "fz_n")
CELLS, RINGS, POINTS = ("row", "column", *FORCE), ("ring", "fz_n"), ("x_mm", "y_mm", *FORCE)  # columns of a table
OUTSIDE = (-1, -1)  # row and column of the force that acts outside of the picture
MOST_RINGS = 10_000


class Unusable(Exception):
    """What was submitted cannot be scored; the message says where and why."""


def read_table(path: Path, forms: tuple[tuple[str, ...], ...]) -> tuple[tuple[str, ...], np.ndarray]:
    """The columns of the first of `forms` that a table has, and its numbers in these columns (n, columns)."""
    try:
        return read_rows(path, forms)
    except (UnicodeDecodeError, csv.Error) as error:
        raise Unusable(f"{path}: no table of commas in UTF-8 ({error}); save it as such") from error


def read_rows(path: Path, forms: tuple[tuple[str, ...], ...]) -> tuple[tuple[str, ...], np.ndarray]:
    """What `read_table` returns, of a file that is text."""
    with path.open(newline="", encoding="utf-8-sig") as stream:
        reader = csv.DictReader(stream)
        named = set(reader.fieldnames or ())
        form = next((form for form in forms if named >= set(form)), None)
        if form is None:
            raise Unusable(
                f"{path}: columns are {sorted(named)}; give {' or '.join(','.join(form) for form in forms)}"
            )
        rows = []
        for row in reader:
            try:
                rows.append([float(row[name]) for name in form])
            except (TypeError, ValueError):
                raise Unusable(f"{path}, line {reader.line_num}: not {len(form)} numbers") from None
    numbers = np.array(rows, float).reshape(-1, len(form))
    if not np.isfinite(numbers).all():
        raise Unusable(f"{path}: holds NaN or infinity")
    return form, numbers


def to_cells(path: Path, challenge: dict) -> tuple[np.ndarray, np.ndarray]:
    """Force per cell (rows, columns, 3) and outside of them (3,), N."""
    form, numbers = read_table(path, (CELLS, POINTS))
    shape = tuple(challenge["cells"])
    cells, outside = np.zeros((*shape, 3)), np.zeros(3)
    if form == CELLS:
        at = numbers[:, :2].astype(int)
        if (at != numbers[:, :2]).any():
            raise Unusable(f"{path}: rows and columns are whole numbers, from 0")
    else:
        at = cell_of(numbers[:, :2], challenge)
    inside = ((at >= 0) & (at < shape)).all(axis=1)
    if form == CELLS and (at[~inside] != OUTSIDE).any():
        raise Unusable(f"{path}: a cell outside of {shape[0]} x {shape[1]}; what acts outside is row -1, column -1")
    np.add.at(cells, tuple(at[inside].T), numbers[inside, 2:])
    return cells, outside + numbers[~inside, 2:].sum(axis=0)


def cell_of(points: np.ndarray, challenge: dict) -> np.ndarray:
    """Row and column (n, 2) of the cells that undeformed points (n, 2) in mm lie in, which may be outside."""
    mapped = np.column_stack([points, np.ones(len(points))]) @ np.array(challenge["projection"]).T
    (width, height), (rows, columns) = challenge["image"], challenge["cells"]
    pixel = mapped[:, :2] / mapped[:, 2:]
    return np.floor(np.column_stack([pixel[:, 1] / height * rows, pixel[:, 0] / width * columns])).astype(int)


def errors(path: Path, reference: Path, challenge: dict) -> dict[str, Any]:
    """Errors of one scene over the reference's total force: of the total, and summed over the cells and over 2 x 2 of them.

    reference: how far a solve of the reference on elements and load steps of twice the size is from it, summed over the cells;
    None where there is none.
    """
    cells, outside = to_cells(path, challenge)
    right, beside = to_cells(reference, challenge)
    total, expected = cells.sum(axis=(0, 1)) + outside, right.sum(axis=(0, 1)) + beside
    size = np.linalg.norm(expected)
    larger = [sum(grid[i::2, j::2] for i in (0, 1) for j in (0, 1)) for grid in (cells, right)]
    return {
        "total": float(np.linalg.norm(total - expected) / size),
        "cells": float(np.linalg.norm(cells - right, axis=2).sum() / size),
        "cells_2x2": float(np.linalg.norm(larger[0] - larger[1], axis=2).sum() / size),
        "reference": (challenge["elements_doubled"].get(reference.stem) or {}).get("cells"),
    }


def to_rings(path: Path, width: float) -> np.ndarray:
    """Normal force (k,) N of each ring around the axis, the first one a disc; width: mm."""
    form, numbers = read_table(path, (RINGS, POINTS))
    at = numbers[:, 0] if form == RINGS else np.floor(np.hypot(numbers[:, 0], numbers[:, 1]) / width)
    if (at != np.floor(at)).any() or (at < 0).any() or (at >= MOST_RINGS).any():
        raise Unusable(f"{path}: rings are whole numbers, from 0, below {MOST_RINGS}")
    return np.bincount(at.astype(int), numbers[:, -1], minlength=1)


def ring_errors(path: Path, reference: Path, width: float) -> dict[str, float]:
    """Errors of one exact press over its force: of the total (signed), and the amounts of those of its rings summed."""
    own, right = to_rings(path, width), to_rings(reference, width)
    rings = np.zeros((2, max(len(own), len(right))))
    rings[0, : len(own)], rings[1, : len(right)] = own, right
    return {
        "total": float(own.sum() / right.sum() - 1.0),
        "rings": float(np.abs(rings[0] - rings[1]).sum() / abs(right.sum())),
    }


def read_seconds(folder: Path) -> dict[str, float]:
    """Seconds of each scene, where they were given."""
    path = folder / "seconds.csv"
    if not path.exists():
        return {}
    with path.open(newline="", encoding="utf-8-sig") as stream:
        try:
            return {row["scene"]: float(row["seconds"]) for row in csv.DictReader(stream)}
        except (KeyError, TypeError, ValueError) as error:
            raise Unusable(
                f"{path}: not a table of scene,seconds ({error}); give a header and a number a row"
            ) from error


def score(folder: Path, challenge: dict) -> dict:
    """Errors and seconds of all that was submitted, their medians and worst, and what is missing."""
    scenes = {path.stem: path for path in sorted((HERE / "references").glob("*.csv"))}
    presses = {path.stem: path for path in sorted((HERE / "exact" / "rings").glob("*.csv"))}
    there = {name for name in {**scenes, **presses} if (folder / f"{name}.csv").exists()}
    if not there:
        raise Unusable(f"{folder}: no NAME.csv of {', '.join([*scenes, *presses])}")
    found = {name: errors(folder / f"{name}.csv", path, challenge) for name, path in scenes.items() if name in there}
    width = challenge["ring_mm"]
    exact = {
        name: ring_errors(folder / f"{name}.csv", path, width) for name, path in presses.items() if name in there
    }
    summary: dict[str, float] = {}
    for of, kinds, before in ((found, ("total", "cells", "cells_2x2"), ""), (exact, ("total", "rings"), "exact_")):
        for kind in kinds if of else ():
            values = [abs(each[kind]) for each in of.values()]
            summary |= {f"{before}{kind}_median": float(np.median(values)), f"{before}{kind}_worst": max(values)}
    missing = [name for name in {**scenes, **presses} if name not in there]
    return {"scenes": found, "exact": exact, "missing": missing, "seconds": read_seconds(folder), **summary}


def table(result: dict) -> str:
    """The score as text."""
    lines, seconds = [], {name: f"{value:.1f}" for name, value in result["seconds"].items()}
    if result["scenes"]:
        lines.append(f"{'scene':20} {'total force':>12} {'cells':>8} {'2 x 2':>8} {'reference':>10} {'seconds':>9}")
        for name, scene in result["scenes"].items():
            own = "unknown" if scene["reference"] is None else f"{scene['reference']:.2%}"
            errors = f"{scene['total']:12.2%} {scene['cells']:8.2%} {scene['cells_2x2']:8.2%}"
            lines.append(f"{name:20} {errors} {own:>10} {seconds.get(name, ''):>9}")
        for kind in ("median", "worst"):
            total, cells, larger = (result[f"{what}_{kind}"] for what in ("total", "cells", "cells_2x2"))
            lines.append(f"{kind:20} {total:12.2%} {cells:8.2%} {larger:8.2%}")
    if result["exact"]:
        lines.append(f"{'exact press':48} {'total force':>12} {'rings':>8} {'seconds':>9}")
        for name, press in result["exact"].items():
            lines.append(f"{name:48} {press['total']:+12.2%} {press['rings']:8.2%} {seconds.get(name, ''):>9}")
        for kind in ("median", "worst"):
            lines.append(f"{kind:48} {result[f'exact_total_{kind}']:12.2%} {result[f'exact_rings_{kind}']:8.2%}")
    if result["missing"]:
        lines.append(f"not submitted: {', '.join(result['missing'])}")
    return "\n".join(lines)


def main() -> int:
    """Score a folder; 2 where it cannot be scored."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    try:
        result = score(given.folder, json.loads((HERE / "challenge.json").read_text(encoding="utf-8")))
    except (Unusable, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(table(result))
    if given.out:
        given.out.write_text(json.dumps(result, indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
