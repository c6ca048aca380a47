"""Axisymmetric presses with known forces, and the program that solves them: `python -m tests.support.exact_scenes`.

A flat pad of 40 x 40 mm, C10 0.0725 MPa, bonded at its base. Every press is solved three times: as defined below,
with elements of half the size, and with twice the load steps. The stored forces are those with elements of half the
size; the differences of both refined solves from the first are stored beside them. Presses that are stored for the
same numbers are not solved again.
"""

import dataclasses
import os
from argparse import Namespace
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from gelforge.flow.cli import command, option
from gelforge.flow.files import read_json, write_json
from tests.support.axisymmetric import RING, Body, Fineness, Layer, Pressed, cone, press, punch, sphere, tube

KEPT = Path("data/fea_challenge/exact.json")
BODIES = {"sphere": sphere, "punch": punch, "tube": tube, "cone": cone}


@dataclass(frozen=True)
class Series:
    """One body pressed to several depths. shape: kind and arguments in BODIES. edge: radii where contact ends, mm."""

    shape: tuple
    depths: tuple[float, ...]
    edge: tuple[float, float]
    fine: float
    nu: float = 0.475
    thickness: float = 4.0
    stick: bool = True

    @property
    def name(self) -> str:
        """A unique name, to which a press adds its depth."""
        kind, *sizes = self.shape
        parts = [kind, *(f"{size:g}" for size in sizes), f"nu{self.nu:g}", f"pad{self.thickness:g}"]
        return "-".join([*parts, "no_slip" if self.stick else "frictionless"])

    @property
    def body(self) -> Body:
        """The body in the (r, z) half-plane."""
        return BODIES[self.shape[0]](*self.shape[1:])


def _punch(diameter: float, fillet: float, *depths: float, **other) -> Series:
    return Series(
        ("punch", diameter, fillet),
        depths,
        (diameter / 2 - 1.1 * fillet, diameter / 2),
        max(0.12 * fillet, 0.024),
        **other,
    )


def _sphere(diameter: float, most: float, *depths: float, **other) -> Series:
    return Series(("sphere", diameter), depths, (0.0, most), max(0.05, most / 25), **other)


# The largest depth is a third of the gel's thickness, or less if elements invert in the sharp fold at a small fillet.
SERIES = (
    _sphere(15, 4.0, 0.05, 0.2, 0.4, 1.0, 1.333),
    _punch(10, 0.3, 0.05, 0.1, 0.3, 0.5),
    _punch(10, 1.0, 0.05, 0.1, 0.3, 0.8, 1.333),
    _sphere(200, 7.0, 0.05, 0.1, 0.3),
    Series(("tube", 10, 7, 0.7), (0.05, 0.2, 0.5, 1.0), (3.5, 5.0), 0.07),
    _sphere(200, 7.0, 0.1, 0.3, nu=0.49),
    _punch(6, 1.0, 0.1, 0.5, 1.333),
    _punch(6, 0.3, 0.1, 0.5, 0.8),
    _sphere(4, 1.9, 0.05, 0.3, 1.0, 1.333),
    _sphere(60, 7.0, 0.05, 0.3, 1.0),
    Series(("cone", 30, 0.5), (0.1, 0.5, 1.0, 1.333), (0.0, 2.2), 0.1),
    _punch(10, 1.0, 0.1, 0.3, stick=False),
    _sphere(15, 4.0, 0.2, 1.0, stick=False),
    _punch(10, 0.3, 0.1, 0.3, nu=0.49),
    _punch(6, 0.3, 0.05, 0.2, 0.4, thickness=2.0),
    _sphere(15, 3.3, 0.05, 0.2, 0.66, thickness=2.0),
    _punch(10, 0.1, 0.05, 0.1, 0.3),
    _punch(6, 0.1, 0.1, 0.3),
    _punch(10, 1.0, 0.1, 0.5, nu=0.45),
    _sphere(15, 4.0, 0.1, 1.0, nu=0.49),
    Series(("cone", 30, 0.5), (0.5,), (0.0, 1.2), 0.06, nu=0.45),
    _sphere(60, 6.0, 0.3, nu=0.45, stick=False),
    Series(("tube", 10, 7, 0.7), (0.2, 0.5), (3.5, 5.0), 0.07, nu=0.49, stick=False),
    _sphere(200, 5.5, 0.1, thickness=2.0),
    _punch(6, 1.0, 0.2, 0.66, thickness=2.0, nu=0.49),
)  # fmt: skip


def solved(path: Series) -> list[dict]:
    """The presses of one series, with the differences between their three solves."""
    layer, plain = Layer(path.thickness, path.nu), Fineness(path.edge, path.fine)
    ways = (plain, plain.halved(), dataclasses.replace(plain, steps=24))
    found = [press(path.body, layer, list(path.depths), way, path.stick) for way in ways]
    return [_record(path, *row) for row in zip(*found, strict=True)]


def _record(path: Series, coarse: Pressed, fine: Pressed, slow: Pressed) -> dict:
    def apart(other: Pressed) -> dict:
        rings = np.zeros((2, max(len(other.rings), len(coarse.rings))))
        rings[0, : len(other.rings)], rings[1, : len(coarse.rings)] = other.rings, coarse.rings
        return {
            "total": float(f"{abs(other.force / coarse.force - 1.0):.2g}"),
            "rings": float(f"{np.abs(rings[0] - rings[1]).sum() / coarse.force:.2g}"),
        }

    return {
        "name": f"{path.name}-{fine.depth:g}mm", "kind": path.shape[0], "sizes_mm": list(path.shape[1:]), "depth_mm": fine.depth,
        "thickness_mm": path.thickness, "nu": path.nu, "interface": "no_slip" if path.stick else "frictionless",
        "force_n": float(f"{fine.force:.6g}"), "rings_n": [float(f"{ring:.5g}") for ring in fine.rings],
        "contact_radius_mm": float(f"{fine.contact_radius:.3f}"), "pulling": float(f"{fine.pulling:.1e}"),
        "elements_halved": apart(fine), "steps_doubled": apart(slow),
    }  # fmt: skip


def key(path: Series) -> dict:
    """The numbers on which the presses of a series depend."""
    return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(path).items()}


def body_of(path: Series) -> dict:
    """The body in numbers: all points within a radius of a polyline of (r, z), its tip at z = 0."""
    core = [[float(f"{value:.6g}") for value in point] for point in path.body.core]
    return {"core_mm": core, "radius_mm": path.body.radius}


@command(
    option("--out", type=Path, default=KEPT),
    option("--processes", type=int, default=1),
)
def main(args: Namespace) -> None:
    """Solve the series that are not stored yet."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    kept = {group["path"]["name"]: group for group in read_json(args.out)["paths"]} if args.out.exists() else {}
    left = [path for path in SERIES if kept.get(path.name, {}).get("path") != key(path) | {"name": path.name}]
    with ProcessPoolExecutor(args.processes) as pool:
        for path, records in zip(left, pool.map(solved, left), strict=True):
            kept[path.name] = {"path": key(path) | {"name": path.name}, "body": body_of(path), "presses": records}
            groups = [kept[each.name] for each in SERIES if each.name in kept]
            write_json(args.out, {"c10_mpa": 0.0725, "pad_mm": [40.0, 40.0], "ring_mm": RING, "paths": groups})
            for record in records:
                print(
                    record["name"], record["force_n"], record["elements_halved"], record["steps_doubled"], flush=True
                )


if __name__ == "__main__":
    main.exit()
