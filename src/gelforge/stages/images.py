"""Stage 15: whether the images of a log, singly and together, show what its rows describe (`evidence.images`).

Rows are judged as stage 10 judges them, but by their commanded paths: a calibration, which solves presses for minutes,
comes after this stage. A finding that would make all labels wrong stops make here. Rows whose image is wrong are left out
of the dataset, and all other findings are notes.
"""

import sys
from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from gelforge.errors import BadInput
from gelforge.evidence.images import Seen, Shapes, findings, row_list
from gelforge.evidence.imprints import Window
from gelforge.evidence.leaning import FEWEST, MOST_FLAT, MOST_ROUND, Shaded, leaning, tilt_notes
from gelforge.evidence.logimages import KEEP, LogImages, nocontact_path, read_nocontact
from gelforge.flow.cli import JOBS, stage
from gelforge.flow.files import read_json, write_json
from gelforge.flow.jobs import in_slots
from gelforge.flow.layout import Layout
from gelforge.flow.params import read_parameters
from gelforge.geometry.indenters import bodies_of, build
from gelforge.geometry.solids import Body, feels_tilt
from gelforge.labelling.sensor import sensor_of
from gelforge.reading.frame import colour_fault
from gelforge.records.log import read_shard
from gelforge.records.press import SENSOR_TABLES, PressRecord
from gelforge.stages.poses import Bodies, judge_rows, summarised

VERSION = 8
LEAST_MM = 0.2  # depth of a press whose image shows a tilt, and most sideways travel of it
CHUNK = 200  # presses per task of a process


def look(presses: list[PressRecord], data: Path, tables: dict, workflow: Path, kept: Path) -> list[Seen]:
    """What the images of some presses show."""
    names = sorted({press.sensor_id for press in presses})
    sensors = {name: sensor_of(SENSOR_TABLES, name, tables["sensors"][name]) for name in names}
    images, bodies = LogImages(data, sensors), bodies_of(presses, tables["indenters"], workflow, kept)
    every = (images.see(press, bodies[press.indenter]) for press in presses)
    return [one for one in every if one is not None]


def in_chunks(presses: list[PressRecord]) -> Iterator[list[PressRecord]]:
    """Presses in chunks, one per task of a process."""
    for start in range(0, len(presses), CHUNK):
        yield presses[start : start + CHUNK]


def used_tables(of: Layout) -> dict[str, dict]:
    """Tables of the sensors and indenters that the planned shards use."""
    tables: dict[str, dict] = {"sensors": {}, "indenters": {}}
    for shard in of.names():
        used = read_json(of.used(shard))
        for kind, table in tables.items():
            table |= used[kind]
    return tables


def shapes_of(
    presses: Mapping[str, PressRecord],
    tables: Mapping[str, dict],
    bodies: Mapping[str, Body],
    beside: Mapping[str, dict] = MappingProxyType({}),
) -> Shapes:
    """Expected imprints in any press of a log, by the indenters that it names and by those of the tables `beside`."""
    windows: dict[str, Window] = {}
    known: dict[str, Body | None] = dict(bodies)

    def body_of(name: str) -> Body | None:
        if name not in known:
            try:
                known[name] = build(name, beside[name])
            except BadInput:
                known[name] = None  # an invalid table matters only to datasets that use it
        return known[name]

    def window_of(name: str) -> Window:
        if name not in windows:
            windows[name] = Window(sensor_of(SENSOR_TABLES, name, tables["sensors"][name]))
        return windows[name]

    def expected(seen: Seen, name: str) -> np.ndarray:
        body = body_of(name)
        if body is None:
            return np.zeros_like(seen.expected)
        return window_of(seen.sensor).expected(body, presses[seen.sample_id].press)

    def turned(seen: Seen, turn: Callable[[float], float]) -> np.ndarray:
        press = presses[seen.sample_id].press
        return window_of(seen.sensor).expected(bodies[seen.indenter], replace(press, rot_deg=turn(press.rot_deg)))

    return Shapes(sorted({*bodies, *beside}), expected, turned)


def judge(seen: list[Seen], shapes: Shapes | None, where: str) -> dict:
    """Contents of images.json; findings about several rows whose images are wrong raise BadInput."""
    found = findings(seen, shapes)
    stopping = [one.text for one in found if one.wrong and len(one.rows) > 1]
    if stopping:
        raise BadInput(f"{where}: {'; '.join(stopping)}. Correct it, {KEEP}")
    names = {one.row: one.sample_id for one in seen}
    judged = [one for one in seen if one.telling]
    return {
        "judged": len(judged),
        "likeness": {
            name: round(float(np.median([one.likeness for one in judged if one.sensor == name])), 3)
            for name in sorted({one.sensor for one in judged})
        },
        "left_out": {one.sample_id: one.fault for one in seen if one.fault}
        | {names[one.rows[0]]: one.text for one in found if one.wrong},
        "notes": [one.text for one in found if not one.wrong],
    }


def tilts(presses: Sequence[PressRecord], images: LogImages, bodies: Mapping[str, Body]) -> list[dict]:
    """Tilt of each sensor's mountings by the images of `presses`, degrees.

    Presses that move sideways by more than LEAST_MM or are less deep are left out. A mounting with too few flat presses,
    or without a no-contact image, is none of the result.
    """
    straight = [one for one in presses if np.hypot(one.dx_mm, one.dy_mm) < LEAST_MM < -one.dz_mm]
    of: dict[tuple[str, str], list[PressRecord]] = {}
    for one in straight:
        of.setdefault((one.sensor_id, one.mounting), []).append(one)
    found = []
    for (sensor, mounting), every in sorted(of.items()):
        flat = [one for one in every if feels_tilt(bodies[one.indenter])]
        others = [one for one in every if not feels_tilt(bodies[one.indenter])]
        shown = [
            [Shaded(*shade, bodies[one.indenter], one.press) for one in some if (shade := images.shading(one))]
            for some in (flat[:MOST_FLAT], others[:MOST_ROUND])
        ]
        if len(shown[0]) < FEWEST:
            continue
        seen = leaning(*shown)
        found.append({
            "sensor": sensor, "mounting": mounting, "presses": len(shown[0]), "tilt_deg": seen.tilt.tolist(),
            "error_deg": seen.error.tolist(),
        })  # fmt: skip
    return found


def told(found: dict, seen: list[Seen]) -> list[str]:
    """Contents of images.json as lines for a person."""
    rows: dict[str, list[int]] = {}
    for one in seen:
        if one.sample_id in found["left_out"]:
            rows.setdefault(found["left_out"][one.sample_id], []).append(one.row)
    kept = "its label is kept, but not in the dataset"
    return [
        *(f"rejected: {text} (row {row_list(at)}); {kept}" for text, at in rows.items()),
        *(f"note: {text}" for text in found["notes"]),
    ]


@stage(Layout.images, JOBS)
def main(args: Namespace) -> None:
    of = args.of
    read = read_parameters(of.parameters("images"))
    judged = read.poses
    seen, shapes = [], None
    tables = used_tables(of)
    rows = sorted((row for shard in of.names() for row in read_shard(of.shard(shard))), key=lambda row: row.row)
    bodies = Bodies(tables["indenters"], of.workflow, of.surfaces)
    good, rejected = judge_rows(rows, str(of.log), of.data, tables, judged, bodies)
    if read.calibration:  # stage 10 says it as late as the calibration is known
        print(*summarised(rejected), sep="\n", end="\n" * bool(rejected), file=sys.stderr)
    presses = [press for press, _ in good]
    sensors = {name: sensor_of(SENSOR_TABLES, name, table) for name, table in tables["sensors"].items()}
    if judged.images and judged.judge_images:
        parts = [(part, of.data, tables, of.workflow, of.surfaces) for part in in_chunks(presses)]
        seen = [one for part in in_slots(look, parts, args.jobs) for one in part]
        if seen:
            by_id = {press.sample_id: press for press in presses}
            built = {press.indenter: body for press, body in good}
            shapes = shapes_of(by_id, tables, built, read_json(of.parameters("spare")))
    found = judge(seen, shapes, str(of.log))
    if seen:
        kept = [one for one in presses if one.sample_id not in found["left_out"]]
        shown = tilts(kept, LogImages(of.data, sensors), built)
        if read.calibration:  # which may find the tilt of a mounting: stage 60 compares both
            found["tilts"] = shown
        else:
            found["notes"] += tilt_notes(shown, kept, sensors)
    for name in sorted({press.sensor_id for press in presses}) if judged.images else ():
        picture = read_nocontact(of.data, name, sensors[name].image)
        if picture is not None:
            found["notes"] += [f"{nocontact_path(of.data, name)}: {fault}" for fault in colour_fault(picture)]
    for line in told(found, seen):
        print(line, file=sys.stderr)
    write_json(args.out, found)


if __name__ == "__main__":
    main.exit()
