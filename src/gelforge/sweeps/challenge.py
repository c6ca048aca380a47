"""The scenes of the chart as an open benchmark of plain files, which any simulator can be held against.

Nothing in the folder needs gelforge: scenes are JSON and STL, references are CSV, and the script that scores is NumPy's.
"""

import shutil
from dataclasses import asdict
from pathlib import Path

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import write_json
from gelforge.geometry.triangles import write_stl
from gelforge.labelling.sensor import Sensor
from gelforge.mechanics.material import REFERENCE_C10
from gelforge.sweeps.keptreferences import KEYS, scatters
from gelforge.sweeps.scenes import NamedScene
from gelforge.sweeps.trial import GRID

TEXTS = Path(__file__).parent / "fea_challenge"  # what the folder holds as it stands: how to take part, the script
GEL_SIZE_MM = 0.5  # of the triangles of gel.stl


def write_challenge(scenes: list[NamedScene], sensor: Sensor, references: Path, out: Path) -> None:
    """Write the whole folder, challenge.json last; a scene without a reference, or one too many, raises BadInput."""
    names, held = {scene.name for scene in scenes}, {path.stem for path in references.glob("*.csv")}
    if names != held:
        raise BadInput(
            f"{references}: has references of {', '.join(sorted(held))} and the scenes are {', '.join(sorted(names))}; "
            "run make fea-references"
        )
    for name in ("references", "scenes"):  # of scenes that there were
        shutil.rmtree(out / name, ignore_errors=True)
    for text in TEXTS.iterdir():
        if text.is_file():
            shutil.copyfile(text, out / text.name)
    shutil.copytree(references, out / "references", ignore=shutil.ignore_patterns(KEYS), dirs_exist_ok=True)
    first = scenes[0].scene
    write_stl(out / "gel.stl", *first.gel.surface(GEL_SIZE_MM))
    for scene in scenes:
        write_scene(scene, out / "scenes" / scene.name)
    write_json(out / "challenge.json", {
        "gel": asdict(first.gel), "c10_mpa": REFERENCE_C10, "nu": first.material.nu, "d1_per_mpa": first.material.d1,
        "cells": list(GRID.shape), "image": list(sensor.image), "projection": sensor.projection.tolist(),
        "scenes": sorted(names), "scatter": scatters(references),
    })  # fmt: skip


def write_scene(named: NamedScene, folder: Path) -> None:
    """Write one scene: its path as numbers, its indenter as a surface at the pose it starts from, tip on the path's start."""
    scene = named.scene
    if scene.interface.contact.slips:
        raise BadInput(
            f"{named.name}: the challenge is about presses without slip, this one is {scene.interface.law}"
        )
    press = scene.press
    rotation, start = press.pose(0.0, 0.0)
    vertices, faces = scene.indenter.surface()
    folder.mkdir(parents=True, exist_ok=True)
    write_stl(folder / "indenter.stl", np.asarray(vertices) @ rotation.T + start, faces)
    write_json(folder / "scene.json", {
        "scene": named.name, "indenter": named.table["indenter"], "start_mm": start.tolist(), "rot_deg": press.rot_deg,
        "legs_mm": [[0.0, 0.0, press.dz], [press.dx, press.dy, 0.0]], "interface": "no slip",
    })  # fmt: skip
