"""Core hours, disk and time of `make report` before it starts, from a few of its presses.

The presses of the log, sorted by depth, are divided into equal groups, and the middle press of each group is a pilot. Pilots
go through poses, fea, forces and labels in a temporary folder; a filmed press takes all of its rows along. Later stages are
estimated from their times on other datasets, branches that solve presses from the time of a pilot's solve. For a log without
images the estimate ends at labels and calibration.
"""

import os
import resource
import shutil
import subprocess
import sys
from argparse import Namespace
from dataclasses import dataclass, replace
from math import isnan
from pathlib import Path

import numpy as np

from gelforge.commands.sample import prepared, steps
from gelforge.errors import BadInput, last_words
from gelforge.flow import layout
from gelforge.flow.files import bytes_of, listed, read_csv, read_json, write_json
from gelforge.flow.forecast import Cost, on_cores, pilots, presses_an_hour, table, wall_seconds
from gelforge.flow.layout import Layout
from gelforge.flow.main import RESULTS, command, option, positive
from gelforge.flow.params.stages import ForCalibrate, ForPoses, ForReport, ForTrain, read_parameters
from gelforge.flow.params.tables import SHIPPED
from gelforge.flow.runs import duration
from gelforge.labelling.grid import Grid
from gelforge.labelling.sensor import load_sensors
from gelforge.mechanics.material import REFERENCE_C10
from gelforge.records.frames import presses_of
from gelforge.records.log import read_shard
from gelforge.records.networkkind import kind_of
from gelforge.records.press import POSE, RawRow, parse
from gelforge.records.samplefile import read_samples
from gelforge.records.solvetable import read_solves
from gelforge.stages.train import resolve

STAGES = {
    "poses": layout.POSES,
    "meshes": layout.MESHES,
    "fea": layout.FEA,
    "forces": layout.FORCES,
    "labels": layout.LABELS,
}
# Measured, processor seconds: an image through an evaluation; a press in the report.
EVALUATE_EACH, REPORT_EACH = 5e-3, 0.02
# Measured in presses on hexahedra as the pilots solved them: a press of a calibration.
CALIBRATE_EACH = 18.0
# A row in the stages beside the solves, where a few pilots take no longer than the start of the process does.
ROW_EACH = {"poses": 7e-3, "meshes": 3e-2, "forces": 1e-3, "labels": 2e-3}
NEEDED = ("sample_id", "sensor_id", "indenter", *POSE)  # cells without which a row is no press
START = 1.5  # of a process with torch or the drawing libraries, in starts of stage 50


@dataclass(frozen=True)
class Pace:
    """Processor seconds that what was not run is counted in: of one press on hexahedra, and of the start of stage 50."""

    hex_press: float = 1.0
    start: float = 2.0


def planned_rows(results: Path) -> list[RawRow]:
    """Rows of all planned shards, but for those that stage 10 rejected there, or will because a cell cannot be read."""
    of, found = Layout(results), []
    for name in of.names():
        table, known = of.rejected(name), set()
        if layout.written(str(table)) >= layout.written(str(of.shard(name))):
            known = {cells.get("row") for cells in read_csv(table)}
        rows = (row for row in read_shard(of.shard(name)) if str(row.row) not in known)
        found += [row for row in rows if parse(row, "", NEEDED)[0] is not None]
    return found


def depth(row: RawRow) -> float:
    """Depth of a raw row, mm; rows that cannot be read count as no contact, because stage 10 rejects them."""
    press, _ = parse(row, "", ("dz_mm",))
    return 0.0 if press is None else -press.dz_mm


def pilot_presses(rows: list[RawRow]) -> list[list[RawRow]]:
    """Presses that stand for all, each with all its rows."""
    presses = presses_of(rows)
    return [presses[k] for k in pilots([max(map(depth, press)) for press in presses])]


def spend(module: str, words: list[str]) -> float:
    """Run a stage in a process of its own; return its processor seconds, children included."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    ran = subprocess.run(
        [sys.executable, "-m", f"gelforge.stages.{module}", *words], capture_output=True, text=True, check=False
    )  # fmt: skip
    if ran.returncode:
        raise BadInput(f"a pilot press failed in stage {module}: {last_words(ran.stderr, ran.returncode)}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def row_and_start(module: str, words: list[str], rows: int) -> tuple[float, float]:
    """Run a stage on a shard of so many rows; processor seconds of each of them, and of the process's start."""
    cpu = spend(module, words)
    # a second run of the solves finds every press solved, and only starts
    each = ROW_EACH[module] if module in ROW_EACH else (cpu - spend(module, words)) / rows
    each = min(max(each, 0.0), cpu / rows)
    return each, cpu - each * rows


def with_stiffness(work: Layout) -> None:
    """Give the parameters of stage 40 a stiffness in numbers, where the run will find it first: it costs no time."""
    table = read_json(work.parameters("forces"))
    table["material"] |= {"c10": REFERENCE_C10}
    write_json(work.parameters("forces"), table)


def on_hexahedra(table: Path) -> float:
    """Fraction of the time of solves that went into hexahedra: all of it, but where CalculiX followed."""
    solves = [solve for solve in read_solves(table) if solve.number("seconds") > 0.0]
    whole = sum(solve.number("seconds") for solve in solves)
    known = [solve.number("kinematics_seconds") for solve in solves]
    own = sum(solve.number("seconds") if isnan(part) else part for solve, part in zip(solves, known, strict=True))
    return own / whole if whole else 1.0


def pilot(of: Layout, work: Layout, rows: list[RawRow], resolution: str) -> tuple[list[Cost], Pace]:
    """What each stage takes of a row, from a shard of the rows given, and what starting its processes takes; its pace."""
    shards = len(of.names())
    shutil.rmtree(work.root, ignore_errors=True)
    prepared(work, rows)
    if not of.calibration().exists():
        with_stiffness(work)
    found, pace = [], Pace()
    for module, words, out in steps(work, resolution):
        # the first run makes the meshes that are missing, once for all shards
        made = spend(module, words) if module == "meshes" else 0.0
        each, start = row_and_start(module, words, len(rows))
        starts = start * (1 if STAGES[module] == layout.LABELS else shards)
        written = bytes_of(work.folder(STAGES[module]))
        # operators are of meshes and sensors, whatever the number of presses
        once = sum(bytes_of(folder) for folder in out.parent.glob("operators"))
        if module == "meshes":
            starts += max(0.0, made - each * len(rows) - start)
            once = bytes_of(of.meshes)
            written += once
        found.append(Cost(STAGES[module], each, starts, (written - once) / len(rows), once))
        if module == "poses" and not read_csv(out):
            command = of.command("status")
            raise BadInput(f"all {len(rows)} rows that were tried were rejected; {command} says why")
        if module == "fea":
            pace = replace(pace, hex_press=each * on_hexahedra(out))
        if module == "labels":
            pace = replace(pace, start=start)
    return found, pace


def measured(of: Layout, rows: list[RawRow], resolution: str) -> tuple[list[Cost], Pace]:
    """What stages 10 to 50 take of each row, from a shard of pilots, and their pace."""
    presses = pilot_presses(rows)
    print(f"solving {len(presses)} of {len(presses_of(rows))} presses to see what they take", flush=True)
    chosen = [row for press in presses for row in press]
    work = Layout(of.folder(layout.ESTIMATE))
    try:
        return pilot(of, work, chosen, resolution)
    finally:
        shutil.rmtree(work.root, ignore_errors=True)


def training(results: Layout, resolution: str, model: str, presses: int, start: float = Pace.start * START) -> Cost:
    """What a network takes to learn from so many presses, and from those of [train] also; BadInput for one that there is not."""
    tables = {path.stem: read_json(path)[path.stem] for path in listed(results.params / "models", "*.json")}
    of_train = read_parameters(results.params / "train.json", ForTrain).train
    table, settings = resolve(tables, model, of_train)
    beside = sum(made_presses(Layout(results.root.parent / name), resolution) for name in of_train.also)
    every = presses + beside
    fraction = min(1.0, (settings.epoch_images or every) / every)  # of all, that an epoch visits
    each = kind_of(table).image_seconds * settings.epochs * fraction
    return Cost(layout.TRAIN, each, start + each * beside, bytes_once=3e6)


def made_presses(results: Layout, resolution: str) -> int:
    """Presses of another dataset that networks also learn from."""
    found = results.dataset(resolution) / "samples.csv"
    if not found.exists():
        command = f"{results.command('dataset')} RES={resolution}"
        raise BadInput(f"{found} is missing, and [train] also names {results.root.name}: {command} first")
    return len(read_samples(found))


def image_bytes(results: Layout, rows: list[RawRow]) -> int:
    """Bytes of an image of the largest sensor that rows name, as it lies in the dataset; 0 where they name none."""
    sensors = load_sensors(results.params / "sensors.json")
    named = {row.cells.get("sensor_id") for row in rows}
    return max((3 * int(np.prod(one.image)) for name, one in sensors.items() if name in named), default=0)


def later_costs(results: Layout, resolution: str, model: str, rows: list[RawRow], pace: Pace = Pace()) -> list[Cost]:
    """What the stages after the labels take of rows with a network, from other datasets and the pace of this one's pilots.

    A branch that the log cannot feed, as `calibrate` without force readings, is none.
    """
    start = START * pace.start
    params, presses = results.params, len(rows)
    report = read_parameters(params / "report.json", ForReport).report
    grid = Grid.parse(resolution)
    cells = 4 * 3 * grid.rows * grid.cols
    images = read_parameters(params / "poses.json", ForPoses).poses.images
    branches = []
    if "calibrate" in report.branches and any(row.cells.get("fz_n") for row in rows):
        solved = read_parameters(params / "calibrate.json", ForCalibrate).calibrate.max_presses
        branches.append(Cost(layout.CALIBRATE, cpu_once=CALIBRATE_EACH * solved * pace.hex_press, bytes_once=2e7))
    if not images:
        return branches  # a log without pictures has no report
    return [
        Cost(layout.DATASET, 2e-3, start, image_bytes(results, rows) + cells),
        *([training(results, resolution, model, presses, start)] if model != SHIPPED else []),
        Cost(layout.EVALUATE, EVALUATE_EACH, start, cells / 2),
        *branches,
        Cost(layout.REPORT, REPORT_EACH, start, 4e4, 3e6),
    ]


def estimated(of: Layout, resolution: str, model: str, rows: list[RawRow]) -> list[Cost]:
    """What every stage of a dataset takes of a row, the rows given being all that it has."""
    # first: a wrong word must not wait for the pilots
    later_costs(of, resolution, model, rows)
    costs, pace = measured(of, rows, resolution)
    return [*costs, *later_costs(of, resolution, model, rows, pace)]


@command(
    RESULTS,
    option("--resolution", default="24x32"),
    option("--model", default=SHIPPED, help="network of the run; `shipped` is not trained"),
    option("--cores", type=positive, default=os.cpu_count(), help="cores that the run may use"),
)
def main(args: Namespace) -> None:
    of = Layout(args.results)
    rows = planned_rows(args.results)
    if not rows:
        raise BadInput(f"{of.log}: no row is left to solve; {of.command('status')} says why each was rejected")
    costs = estimated(of, args.resolution, args.model, rows)
    shards = len(of.names())
    print("\n".join(table(costs, len(rows))))
    an_hour = presses_an_hour(costs, args.cores) * len(presses_of(rows)) / len(rows)
    print(f"{an_hour:.0f} presses an hour become labels {on_cores(args.cores)}")
    print(f"about {duration(wall_seconds(costs, len(rows), args.cores, shards))} {on_cores(args.cores)}")


if __name__ == "__main__":
    main.exit()
