"""The scenes of the chart as an open benchmark of plain files, against which any simulator can be compared.

Nothing in the folder needs gelforge: scenes are JSON and STL, references are CSV, and the script that scores is NumPy's.
The folder also holds axisymmetric presses whose forces are known, in the same kind of files.
"""

import shutil
from dataclasses import asdict
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import read_json, write_csv, write_json
from gelforge.geometry.triangles import write_stl
from gelforge.labelling.sensor import Sensor
from gelforge.mechanics.material import REFERENCE_C10, Material
from gelforge.sweeps.keptreferences import KEYS, elements_doubled
from gelforge.sweeps.scenes import NamedScene
from gelforge.sweeps.trial import GRID

# Beside the references: how to take part, the script that scores, and the programs that solved presses independently.
TEXTS = ("README.md", "score.py", "axisymmetric.py", "outside_getfem.py")
GEL_SIZE_MM = 0.5  # of the triangles of gel.stl
EXACT = "exact.json"  # among the references: axisymmetric presses whose forces are known
TOLD = (
    "name", "thickness_mm", "nu", "interface", "mu", "depth_mm", "force_n", "contact_radius_mm", "elements_halved", "pulling",
    "slipping",
)  # fmt: skip


def write_challenge(scenes: list[NamedScene], sensor: Sensor, references: Path, out: Path) -> None:
    """Write the whole folder, challenge.json last; a scene without a reference, or the reverse, raises BadInput."""
    names, held = {scene.name for scene in scenes}, {path.stem for path in references.glob("*.csv")}
    if names != held:
        raise BadInput(
            f"{references}: has references of {', '.join(sorted(held))} and the scenes are {', '.join(sorted(names))}; "
            "run make fea-references"
        )
    for name in ("references", "scenes", "exact"):  # may hold scenes that no longer exist
        shutil.rmtree(out / name, ignore_errors=True)
    for text in TEXTS:
        shutil.copyfile(references / text, out / text)
    beside = shutil.ignore_patterns(KEYS, EXACT, *TEXTS)
    shutil.copytree(references, out / "references", ignore=beside, dirs_exist_ok=True)
    first = scenes[0].scene
    write_stl(out / "gel.stl", *first.gel.surface(GEL_SIZE_MM))
    for scene in scenes:
        law = scene.scene.interface
        if law.contact.slips:
            raise BadInput(f"{scene.name}: the challenge is about presses without slip, this one is {law.law}")
        write_scene(scene, out / "scenes" / scene.name)
    known = read_json(references / EXACT)
    write_exact(known, out / "exact")
    write_json(out / "challenge.json", {
        "gel": asdict(first.gel), "c10_mpa": REFERENCE_C10, "nu": first.material.nu, "d1_per_mpa": first.material.d1,
        "cells": list(GRID.shape), "image": list(sensor.image), "projection": sensor.projection.tolist(),
        "scenes": sorted(names), "ring_mm": known["ring_mm"],
        "elements_doubled": elements_doubled(references),
    })  # fmt: skip


def write_scene(named: NamedScene, folder: Path) -> None:
    """Write one scene: its path as numbers, its indenter as a surface at the pose it starts from, tip on the path's start."""
    scene = named.scene
    press, law = scene.press, scene.interface
    rotation, start = press.pose(0.0, 0.0)
    vertices, faces = scene.indenter.surface()
    folder.mkdir(parents=True, exist_ok=True)
    write_stl(folder / "indenter.stl", np.asarray(vertices) @ rotation.T + start, faces)
    write_json(folder / "scene.json", {
        "scene": named.name, "indenter": named.table["indenter"], "start_mm": start.tolist(), "rot_deg": press.rot_deg,
        "legs_mm": [[0.0, 0.0, press.dz], [press.dx, press.dy, 0.0]], "interface": law.law.replace("_", " "),
    } | ({"mu": law.mu} if law.contact.has_coefficient else {}))  # fmt: skip


def write_exact(known: dict, folder: Path) -> None:
    """Write the presses whose forces are known: presses.json, and in rings/NAME.csv the force on the gel per ring, N."""
    (folder / "rings").mkdir(parents=True, exist_ok=True)
    presses = []
    for path in known["paths"]:
        for press in path["presses"]:
            told = {key: press[key] for key in TOLD} | {"d1_per_mpa": Material(press["nu"]).d1, "body": path["body"]}
            presses.append(told)
            rings = [{"ring": ring, "fz_n": -force} for ring, force in enumerate(press["rings_n"])]
            write_csv(folder / "rings" / f"{press['name']}.csv", ("ring", "fz_n"), rings)
    write_json(folder / "presses.json", presses)
