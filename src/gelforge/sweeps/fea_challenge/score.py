"""Score forces of any simulator against the references of this folder; python score.py FOLDER [--out score.json].

FOLDER holds one SCENE.csv for each scene that was solved, in one of two forms, distinguished by the header:
  row,column,fx_n,fy_n,fz_n   force per cell in N
  x_mm,y_mm,fx_n,fy_n,fz_n    forces in N at points of the undeformed surface; each counts for the cell it lies in
and, if times shall be shown, seconds.csv with the columns scene,seconds. Needs NumPy and nothing else.
"""

import argparse
import csv
import json
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
FORCE = ("fx_n", "fy_n", "fz_n")
OUTSIDE = (-1, -1)  # row and column of the force that acts outside of the picture


class Unusable(Exception):
    """What was submitted cannot be scored; the message says where and why."""


def read_table(path: Path) -> tuple[tuple[str, str], np.ndarray]:
    """The two columns that say where, and the numbers (n, 5): where and force."""
    try:
        return read_rows(path)
    except (UnicodeDecodeError, csv.Error) as error:
        raise Unusable(f"{path}: no table of commas in UTF-8 ({error}); save it as such") from error


def read_rows(path: Path) -> tuple[tuple[str, str], np.ndarray]:
    """What `read_table` returns, of a file that is text."""
    with path.open(newline="", encoding="utf-8-sig") as stream:
        reader = csv.DictReader(stream)
        named = set(reader.fieldnames or ())
        places = [pair for pair in (("row", "column"), ("x_mm", "y_mm")) if named >= {*pair, *FORCE}]
        if not places:
            raise Unusable(
                f"{path}: columns are {sorted(named)}; give row,column or x_mm,y_mm with {','.join(FORCE)}"
            )
        rows = []
        for row in reader:
            try:
                rows.append([float(row[name]) for name in (*places[0], *FORCE)])
            except (TypeError, ValueError):
                raise Unusable(f"{path}, line {reader.line_num}: not five numbers") from None
    numbers = np.array(rows, float).reshape(-1, 5)
    if not np.isfinite(numbers).all():
        raise Unusable(f"{path}: holds NaN or infinity")
    return places[0], numbers


def to_cells(
    where: tuple[str, str], numbers: np.ndarray, challenge: dict, path: Path
) -> tuple[np.ndarray, np.ndarray]:
    """Force per cell (rows, columns, 3) and outside of them (3,), N."""
    shape = tuple(challenge["cells"])
    cells, outside = np.zeros((*shape, 3)), np.zeros(3)
    if where == ("row", "column"):
        at = numbers[:, :2].astype(int)
        if (at != numbers[:, :2]).any():
            raise Unusable(f"{path}: rows and columns are whole numbers, from 0")
    else:
        at = cell_of(numbers[:, :2], challenge)
    inside = ((at >= 0) & (at < shape)).all(axis=1)
    if where == ("row", "column") and (at[~inside] != OUTSIDE).any():
        raise Unusable(f"{path}: a cell outside of {shape[0]} x {shape[1]}; what acts outside is row -1, column -1")
    np.add.at(cells, tuple(at[inside].T), numbers[inside, 2:])
    return cells, outside + numbers[~inside, 2:].sum(axis=0)


def cell_of(points: np.ndarray, challenge: dict) -> np.ndarray:
    """Row and column (n, 2) of the cells that undeformed points (n, 2) in mm lie in, which may be outside."""
    mapped = np.column_stack([points, np.ones(len(points))]) @ np.array(challenge["projection"]).T
    (width, height), (rows, columns) = challenge["image"], challenge["cells"]
    pixel = mapped[:, :2] / mapped[:, 2:]
    return np.floor(np.column_stack([pixel[:, 1] / height * rows, pixel[:, 0] / width * columns])).astype(int)


def errors(path: Path, reference: Path, challenge: dict) -> dict[str, float]:
    """Errors of one scene over the reference's total force: of the total, and summed over the cells and over 2 x 2 of them.

    scatter: how far the solves were apart whose mean the reference is, None where it is a single one.
    """
    cells, outside = to_cells(*read_table(path), challenge, path)
    right, beside = to_cells(*read_table(reference), challenge, reference)
    total, expected = cells.sum(axis=(0, 1)) + outside, right.sum(axis=(0, 1)) + beside
    size = np.linalg.norm(expected)
    larger = [sum(grid[i::2, j::2] for i in (0, 1) for j in (0, 1)) for grid in (cells, right)]
    return {
        "total": float(np.linalg.norm(total - expected) / size),
        "cells": float(np.linalg.norm(cells - right, axis=2).sum() / size),
        "cells_2x2": float(np.linalg.norm(larger[0] - larger[1], axis=2).sum() / size),
        "scatter": challenge.get("scatter", {}).get(reference.stem),
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
    """Errors and seconds of every scene that was submitted, their medians and worst, and what is missing."""
    found = {}
    references = {path.stem: path for path in sorted((HERE / "references").glob("*.csv"))}
    for name, reference in references.items():
        path = folder / f"{name}.csv"
        if path.exists():
            found[name] = errors(path, reference, challenge)
    if not found:
        raise Unusable(f"{folder}: no SCENE.csv of {', '.join(references)}")
    summary: dict[str, float] = {}
    for kind in ("total", "cells", "cells_2x2"):
        values = [scene[kind] for scene in found.values()]
        summary |= {f"{kind}_median": float(np.median(values)), f"{kind}_worst": max(values)}
    missing = [name for name in references if name not in found]
    return {"scenes": found, "missing": missing, "seconds": read_seconds(folder), **summary}


def table(result: dict) -> str:
    """The score as text."""
    lines = [f"{'scene':20} {'total force':>12} {'cells':>8} {'2 x 2':>8} {'reference':>10} {'seconds':>9}"]
    for name, scene in result["scenes"].items():
        time = f"{result['seconds'][name]:.1f}" if name in result["seconds"] else ""
        own = "unknown" if scene["scatter"] is None else f"{scene['scatter']:.2%}"
        errors = f"{scene['total']:12.2%} {scene['cells']:8.2%} {scene['cells_2x2']:8.2%}"
        lines.append(f"{name:20} {errors} {own:>10} {time:>9}")
    for kind in ("median", "worst"):
        total, cells, larger = (result[f"{what}_{kind}"] for what in ("total", "cells", "cells_2x2"))
        lines.append(f"{kind:20} {total:12.2%} {cells:8.2%} {larger:8.2%}")
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
