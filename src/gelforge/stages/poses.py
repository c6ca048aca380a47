"""Stage 10: check the raw log and place each indenter's surface where the CNC placed it.

The pose table holds the path of the tip relative to the gel; the commanded path stays in the raw log.
"""

import json
import sys
from argparse import Namespace
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.calibration import calibrated
from gelforge.flow.cli import stage
from gelforge.flow.files import publish, read_json
from gelforge.flow.layout import Layout, beside
from gelforge.flow.params import read_parameters
from gelforge.flow.tables import PosesTable
from gelforge.geometry import touch
from gelforge.geometry.gel import Gel, load_gel
from gelforge.geometry.sampled import INCH_MM, METRE_MM, size_of
from gelforge.geometry.triangles import cropped
from gelforge.labelling.sensor import sensor_of
from gelforge.records.frames import NEAR_MM, check_frames
from gelforge.records.image import bad_image
from gelforge.records.log import (
    read_shard,
    unknown_names,
    without_duplicates,
    write_poses,
    write_rejections,
)
from gelforge.records.press import (
    COLUMNS,
    SENSOR_TABLES,
    LoggedPress,
    PosedPress,
    RawRow,
    Rejection,
    parse,
    pull_fault,
    reject,
    summarised,
    with_tilt,
)

VERSION = 10
# If the tip ends less than this below the apex, the force may be so small that the reading is all sensor error.
# A force that no gel bears: modulus of a layer that is confined sideways, of a gel of C10 0.3 MPa and nu 0.475; depth by which
# touch may be found too late; spacing at which the touched area is measured; smallest force that is judged.
STIFFEST_LAYER, TOUCH_MM, SPACING_MM, SMALL_N, GF_N = 12.8, 0.1, 0.25, 2.0, 9.80665e-3
FIRM_MM = 0.3


def yielded(sample: LoggedPress, file: str, params: PosesTable) -> tuple[LoggedPress, list[Rejection]]:
    """The sample with the path that its tip took relative to the gel, in place of the commanded one.

    Frame and gantry yield in proportion to the force read, and touch was found too high or too low: parameters
    `compliance_mm_per_n`, `shear_compliance_mm_per_n` and `touch_offset_mm` (positive: deeper), of which a mounting may
    have its own, as calibrate infers them from the commanded path. A sample without the force reading that this needs is rejected.
    """
    normal, sideways = params.compliance_mm_per_n, params.shear_compliance_mm_per_n
    needed = {"fx_n": sideways, "fy_n": sideways, "fz_n": normal}
    for column, compliance in needed.items():
        if compliance and getattr(sample, column) is None:
            hint = f"fill it in, or set the compliance of [poses], {compliance:g} mm/N, to 0"
            return sample, [reject(sample, file, column, "no force reading, which the compliance needs", hint)]
    # the force on the gel points along the motion, so the frame's deflection shortens the path
    given = {name: c * (getattr(sample, f"f{name[1]}_n") or 0.0)
           for name, c in (("dx_mm", sideways), ("dy_mm", sideways), ("dz_mm", normal))}  # fmt: skip
    moved = {name: getattr(sample, name) - shift for name, shift in given.items() if shift}
    if offset := params.mounting_touch_offset_mm.get(sample.mounting, params.touch_offset_mm):
        moved["z0_mm"] = sample.z0_mm - offset
    if moved.get("dz_mm", sample.dz_mm) >= 0.0:
        hint = f"check fz_n, or compliance_mm_per_n = {normal:g} in [poses]"
        return sample, [
            reject(sample, file, "dz_mm", "fz_n times the bench compliance exceeds the depth of the press", hint)
        ]
    path = replace(with_tilt(sample, params.tilt_deg, params.mounting_tilt_deg), **moved)
    return path, turned_round(sample, path, file, sideways)


def pulling(sample: LoggedPress, file: str, params: PosesTable) -> list[Rejection]:
    """The rejection of a press whose normal force is logged as a pull, most likely because its sign is inverted.

    Nothing computed from such a reading is right. With a bench compliance it would also move the tip deeper instead
    of less deep, so then a press shallower than FIRM_MM is rejected, too.
    """
    firm = -(sample.z0_mm + sample.dz_mm) >= FIRM_MM
    fault = pull_fault(sample.fz_n or 0.0)
    if not fault or not (firm or params.compliance_mm_per_n):
        return []
    reason, hint = fault
    if not params.compliance_mm_per_n:
        hint += ", and leave the cell empty where a reading failed"
    return [reject(sample, file, "fz_n", reason, hint)]


def turned_round(sample: LoggedPress, path: LoggedPress, file: str, compliance: float) -> list[Rejection]:
    """The rejection of a press whose corrected `path` moves sideways at 90 degrees or more to the commanded one.

    compliance: shear_compliance_mm_per_n, for the hint.
    """
    asked, left = (np.array([press.dx_mm, press.dy_mm]) for press in (sample, path))
    if np.hypot(*asked) <= NEAR_MM or asked @ left > 0.0:
        return []
    column = "dx_mm" if abs(asked[0]) >= abs(asked[1]) else "dy_mm"
    hint = (
        f"check shear_compliance_mm_per_n = {compliance:g} in [poses], and the sign of fx_n, fy_n: the force on the gel"
        " points along the motion"
    )
    return [
        reject(
            sample, file, column, "the sideways force times the bench compliance exceeds the sideways travel", hint
        )
    ]


def posed_points(press, points: np.ndarray) -> np.ndarray:
    """Points (n, 3) of the indenter frame in the gel frame at the beginning of the path, mm."""
    rotation, shift = press.pose(0.0, 0.0)
    return points @ rotation.T + shift


def geometric_faults(sample: LoggedPress, file: str, body, gel: Gel, params: PosesTable) -> list[Rejection]:
    """Rejections of a press that never touches the gel or leaves what it can represent."""
    press = sample.press
    # Reasons are the same for every sample, so that they can be counted; numbers go into the hint.
    sideways, farthest = float(np.hypot(press.dx, press.dy)), params.farthest_shear_mm
    if sideways > farthest:
        column = "dx_mm" if abs(press.dx) >= abs(press.dy) else "dy_mm"
        hint = f"it moves {sideways:.3g} mm; check the unit, or raise farthest_shear_mm = {farthest:g} in [poses]"
        return [reject(sample, file, column, "the indenter moves too far sideways", hint)]
    depth, limit = -(press.z0 + press.dz), params.deepest_share * gel.height
    depth += lowered(body, press)
    if depth > limit:
        hint = f"the tip ends {depth:.3g} mm below the apex, {limit:.3g} are allowed; check z0_mm and dz_mm"
        return [reject(sample, file, "dz_mm", "the press is deeper than the gel allows", hint)]
    if depth > body.height:
        hint = (
            f"the tip ends {depth:.3g} mm below the apex, and the body is {size_of(body.surface()[0])} large; is its file in"
            f" inches (scale = {INCH_MM:g}) or metres (scale = {METRE_MM:g}), or z0_mm or dz_mm in another unit?"
        )
        return [reject(sample, file, "indenter", "the indenter is lower than its press is deep", hint)]
    if touch.begins_inside(gel, body, press):
        hint = f"z0_mm = {press.z0:g} puts its tip there; give the path from before the touch on, z0_mm near 0"
        return [reject(sample, file, "z0_mm", "the press begins inside the gel", hint)]
    clear = touch.nearest(gel, body, press)
    if clear >= 0.0:
        where = f"stays {clear:.3g} mm clear of" if np.isfinite(clear) else "is never above"
        hint = f"it {where} the gel, whose apex is the origin; check x0_mm, y0_mm, z0_mm and dz_mm"
        return [reject(sample, file, "dz_mm", "the indenter never touches the gel", hint)]
    force = abs(sample.fz_n or 0.0)
    if force > SMALL_N and force > (most := bearable(gel, body, press, -clear)):
        hint = (
            f"no gel bears more than {most:.2g} N {-clear:.2g} mm below the touch of this body: check the unit of forces (N, not grams-force"
            f" or millinewtons; {force:.4g} gf are {GF_N * force:.2g} N) and of lengths (mm, not inches or metres)"
        )
        return [reject(sample, file, "fz_n", "the force is too large for the depth", hint)]
    return []


def bearable(gel: Gel, body, press, depth: float) -> float:
    """Normal force, N, that no gel exceeds: of a stiff layer that cannot move aside, under all that the body touches.

    depth: of the body below the undeformed surface, mm, where it is deepest.
    """
    points, shape = touch.under_path(gel, body, press, SPACING_MM)
    cell = float(np.prod(touch.spacing_of(points, shape)))
    area = cell * float(touch.touched(body, press, points, TOUCH_MM).sum() + 1)
    return STIFFEST_LAYER * area * (depth + TOUCH_MM) / gel.height


def lowered(body, press) -> float:
    """How much lower than its tip the lowest point of a tilted indenter is, mm; 0 for one that stands upright."""
    return float(-(body.surface()[0] @ press.pose(1.0, 1.0)[0][2]).min()) if press.tilted else 0.0


def reachable_height(body, press, params: PosesTable) -> float:
    """Height above the tip along the body's axis, mm, up to which the gel can touch it, rounded up to share crops."""
    reach = -(press.z0 + press.dz) + params.bulge_mm
    if press.tilted:  # the side that is tilted down lies deeper by up to radius times the sine of the tilt
        cosine = press.pose(1.0, 1.0)[0][2, 2]
        reach = (reach + body.radius() * float(np.sqrt(1.0 - cosine**2))) / cosine
    return float(max(1, np.ceil(reach / params.band_mm)) * params.band_mm)


def write_posed(path, body, press, params: PosesTable) -> None:
    """Write the reachable part of an indenter at the first position of its path as STL in the gel frame."""
    from gelforge.geometry.triangles import write_stl

    vertices, faces = cropped(body, reachable_height(body, press, params))
    with publish(path) as part:
        write_stl(part, posed_points(press, vertices), faces)


def judge_rows(rows: list[RawRow], file: str, data: Path, tables: dict, params: PosesTable, bodies: "Bodies"):
    """Good samples of raw rows, each with its body, and the rejections.

    tables: "sensors" and "indenters" as dicts of catalogue tables.
    """
    needed = [name for name in COLUMNS if params.images or name != "image"]
    parsed = [parse(row, file, needed) for row in rows]
    rejections = []
    for row, (_, wrong) in zip(rows, parsed, strict=True):
        if wrong:
            rejections += [*wrong, *beside_cells(row, wrong, file, data, tables, params)]
    samples, doubled = without_duplicates([s for s, _ in parsed if s], file)
    rejections += doubled
    good = []
    for sample in samples:
        wrong = name_and_image_faults(sample, file, data, tables, params)
        if not {"sensor_id", "indenter"} & {r.column for r in wrong}:
            sample, faults = path_faults(sample, file, tables["sensors"][sample.sensor_id], bodies, params)
            wrong += faults
        rejections += wrong
        if not wrong:
            good.append(sample)
    astray = check_frames(good, file)
    lost = {r.row for r in astray}
    whole = [(sample, bodies[sample.indenter]) for sample in good if sample.row not in lost]
    return whole, sorted([*rejections, *astray], key=lambda r: r.row)


def name_and_image_faults(sample: LoggedPress, file: str, data: Path, tables: dict, params: PosesTable):
    """Rejections of a press that names an unknown sensor or indenter, or an image that cannot be used."""
    known = tables.get("known", tables)  # all names of the catalogues, where the shard has one that is in none
    wrong = unknown_names(sample, file, known["sensors"], known["indenters"])
    if not params.images:
        return wrong
    size = None
    match tables["sensors"].get(sample.sensor_id):
        case {"image": [int(width), int(height)]}:
            size = (width, height)
    fault = bad_image(sample, file, data, size)
    return [*wrong, fault] if fault else wrong


def beside_cells(row: RawRow, wrong: list[Rejection], file: str, data: Path, tables: dict, params: PosesTable):
    """Further rejections of names in a row whose other cells are `wrong`, so that all faults are shown at once."""
    sample, _ = parse(row, file, ())
    found = name_and_image_faults(sample, file, data, tables, params) if sample else []
    return [each for each in found if each.column not in {r.column for r in wrong}]


def path_faults(sample: LoggedPress, file: str, sensor: dict, bodies, params: PosesTable):
    """The press with the path that its tip took, and rejections by its force, its path and its indenter's shape."""
    wrong = pulling(sample, file, params)
    if wrong:
        return sample, wrong
    path, wrong = yielded(sample, file, params)
    # a rejection quotes the cell as it stands in the log
    found = wrong or place_faults(path, file, sensor, bodies, params)
    return path, [reject(sample, file, each.column, each.reason, each.hint) for each in found]


def repeated_pictures(samples: list[LoggedPress], file: str, repeated: dict[str, str]) -> list[Rejection]:
    """Notes on samples whose image is also that of another press. repeated: that press, by the sample's row."""
    hint = "give each press its own picture, or remove its row; did the camera freeze?"
    return [
        reject(sample, file, "image", f"{repeated[str(sample.row)]} shows a picture of the same content", hint)
        for sample in samples
        if str(sample.row) in repeated
    ]


class Bodies:
    """Indenters by name, each built when first asked for; one that cannot be built raises the same BadInput again.

    folder: to which paths of STL files are relative. kept: folder of the measured surfaces of these files
    (`geometry.sampled`).
    """

    def __init__(self, catalogue: dict, folder, kept: Path | None = None):
        self.catalogue, self.folder, self.kept = catalogue, folder, kept
        self.built: dict[str, Any] = {}

    def __getitem__(self, name: str):
        from gelforge.geometry.indenters import build

        if name not in self.built:
            try:
                self.built[name] = build(name, self.catalogue[name], "indenter catalogue", self.folder, self.kept)
            except BadInput as error:
                self.built[name] = error
        if isinstance(self.built[name], BadInput):
            raise self.built[name]
        return self.built[name]


def place_faults(sample: LoggedPress, file: str, sensor: dict, bodies, params: PosesTable) -> list[Rejection]:
    """Rejections of a press by its sensor's table, its indenter's shape and its place."""
    try:
        known = sensor_of(SENSOR_TABLES, sample.sensor_id, sensor)
    except BadInput as error:
        return [reject(sample, file, "sensor_id", "its table cannot be used", str(error))]
    try:
        return geometric_faults(sample, file, bodies[sample.indenter], load_gel(known.gel), params)
    except BadInput as error:
        return [reject(sample, file, "indenter", "its shape cannot be used", str(error))]


def write_shard(good, rejections, out: Path, params: PosesTable) -> None:
    """Write a shard's surfaces, its rejections and, last, its pose table, which goes to `out`."""
    folder = beside(out, "")
    folder.mkdir(parents=True, exist_ok=True)
    posed = []
    for sample, body in good:
        name = f"{sample.sample_id}.stl"
        write_posed(folder / name, body, sample.press, params)
        facts = {key: value for key, value in vars(sample).items() if key != "time_utc"}
        posed.append(PosedPress(**facts, stl=f"{folder.name}/{name}"))
    kept = {f"{sample.sample_id}.stl" for sample, _ in good}
    for stale in folder.glob("*.stl"):
        if stale.name not in kept:
            stale.unlink()
    write_rejections(beside(out, ".rejected.csv"), rejections)
    write_poses(out, posed)


@stage(Layout.poses)
def main(args: Namespace) -> None:
    of, log = args.of, str(args.of.log)
    read = read_parameters(of.parameters("poses"))
    params = calibrated(read, of.base).poses
    tables = read_json(of.used(args.shard))
    rows = read_shard(of.shard(args.shard))
    bodies = Bodies(tables["indenters"], of.workflow, of.surfaces)
    good, rejections = judge_rows(rows, log, of.data, tables, params, bodies)
    planned = of.pictures(args.shard)
    repeated = read_json(planned).get("repeated", {}) if params.images and planned.exists() else {}
    doubtful = repeated_pictures([sample for sample, _ in good], log, repeated)
    write_shard(good, rejections, args.out, params)
    # what the commanded paths show was said by stage 15, which ran before the calibration
    before = (
        judge_rows(rows, log, of.data, tables, read.poses, bodies)[1] if read.calibration and params.images else []
    )
    said = {(r.row, r.column) for r in before}
    new = [r for r in rejections if (r.row, r.column) not in said]
    for line in [*summarised(new), *summarised(doubtful, "note: kept, in one split with those like it")]:
        print(line, file=sys.stderr)
    # a row that is wrong in several columns counts once
    reasons = {r.row: f"{r.column}: {r.reason}" for r in rejections}
    print(json.dumps({"done": len(good), "failed": Counter(reasons.values())}))


if __name__ == "__main__":
    main.exit()
