"""Estimate core hours, disk and time of `make report` before it starts; nothing is solved.

The cost of a solve comes from records of this machine: of this dataset, if it has any, else of the dataset with the
same method and contact law that has the most rows. A solve taken from the store counts as when it was made. Without
any, it comes from MEASURED, measured on one core of a desktop computer. Rows that stage 10 will reject are counted as
well. For a log without images the estimate ends at labels and calibration.
"""

import math
import os
from argparse import Namespace
from dataclasses import dataclass

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow import layout
from gelforge.flow.cli import RESULTS, command, option, positive
from gelforge.flow.files import listed, read_csv, read_json
from gelforge.flow.layout import Layout
from gelforge.flow.params import read_parameters
from gelforge.flow.runs import duration
from gelforge.flow.tables import SHIPPED
from gelforge.labelling.grid import Grid
from gelforge.labelling.sensor import load_sensors
from gelforge.records.log import read_shard
from gelforge.records.networkkind import kind_of
from gelforge.records.press import RawRow, parse
from gelforge.records.samplefile import read_samples
from gelforge.records.solvestore import SolveStore
from gelforge.stages.train import resolve

# Processor seconds of a press straight down, by method, and the ratio of a sheared press to a straight one.
MEASURED = {"draft": 0.6, "label": 1.4, "fine": 27.0, "ccx": 8.7, "ccx-contact": 60.0, "auto": 2.0}
DRAGGED = 1.5
# Ratio of a press under Coulomb's law to one without slip: with hexahedra, both element sizes follow the load path.
SLIPPING = {"draft": 8.0, "label": 8.0, "fine": 8.0, "ccx": 2.0, "ccx-contact": 1.0, "auto": 8.0}
# Processor seconds of a row in the other stages; of the start of a process, and of a calibration.
EACH = {
    layout.POSES: 7e-3,
    layout.IMAGES: 0.03,
    layout.FORCES: 1e-3,
    layout.LABELS: 2e-3,
    layout.DATASET: 2e-3,
    layout.EVALUATE: 5e-3,
    layout.REPORT: 0.02,
}
START, CALIBRATE_ONCE = 3.0, 70.0
BYTES = {layout.POSES: 2e4, layout.FEA: 2e5, layout.FORCES: 5e4}  # of a row


@dataclass(frozen=True)
class Cost:
    """Cost of a stage for all rows: processor seconds, bytes, and cores used; source: of the estimate."""

    stage: str
    cpu: float
    disk: float = 0.0
    cores: int = 1
    source: str = "table"


def planned_rows(of: Layout) -> list[RawRow]:
    """Rows of all planned shards whose basic columns can be parsed."""
    rows = [row for name in of.names() for row in read_shard(of.shard(name))]
    return [row for row in rows if parse(row, "", ("sample_id", "indenter", "dz_mm"))[0] is not None]


def weights(rows: list[RawRow]) -> float:
    """Cost of rows in units of a straight press; rows whose shear cannot be parsed count as straight."""
    presses = (parse(row, "", ("dx_mm", "dy_mm"))[0] for row in rows)
    return sum(
        DRAGGED if press is not None and math.hypot(press.dx_mm, press.dy_mm) > 0.0 else 1.0 for press in presses
    )


def solved_by(of: Layout) -> tuple[str, str]:
    """Method and contact law of a dataset; empty where it was not planned yet."""
    path = of.parameters("fea")
    if not path.exists():
        return "", ""
    planned = read_json(path)
    return str(planned["fea"]["method"]), str(planned["interface"]["law"])


def recorded(of: Layout) -> tuple[float, float, float]:
    """Recorded cost of a dataset's solved shards: processor seconds, rows in straight presses, and number of rows."""
    cpu = worth = count = 0.0
    store = SolveStore(of.solves)
    for name in of.names():
        record = layout.metrics_of(of.fea(name))
        if of.fea(name).exists() and record.exists():
            rows, solves = read_shard(of.shard(name)), read_csv(of.fea(name))
            made = sum(store.cost(solve.get("key") or "").get("cpu_seconds", 0.0) for solve in solves)
            cpu += max(read_json(record)["cpu_seconds"], made)
            worth, count = worth + weights(rows), count + len(rows)
    return cpu, worth, count


def press_seconds(of: Layout) -> tuple[float, str]:
    """Processor seconds of a straight press of a dataset, and the source of this number."""
    (method, law), found = solved_by(of), []
    for root in (of.root, *(path for path in sorted(of.root.parent.iterdir()) if path != of.root)):
        other = Layout(root)
        if (root / layout.PLAN).is_dir() and solved_by(other) == (method, law):
            cpu, worth, count = recorded(other)
            if worth:
                found.append((root == of.root, count, cpu / worth, f"records of {root.name}"))
    if not found:
        return MEASURED[method] * (SLIPPING[method] if law == "coulomb" else 1.0), "table"
    return max(found)[2:]


def image_bytes(results: Layout, rows: list[RawRow]) -> int:
    """Bytes of an uncompressed image of the largest sensor that rows name; 0 where they name none."""
    sensors = load_sensors(results.params / "sensors.json")
    named = {row.cells.get("sensor_id") for row in rows}
    return max((3 * int(np.prod(one.image)) for name, one in sensors.items() if name in named), default=0)


def training(results: Layout, resolution: str, model: str, images: int) -> Cost:
    """Cost of training on `images` images and those of [train] also; BadInput for an unknown model."""
    tables = {path.stem: read_json(path)[path.stem] for path in listed(results.params / "models", "*.json")}
    of_train = read_parameters(results.params / "train.json").train
    table, settings = resolve(tables, model, of_train)
    others = (Layout(results.root.parent / name).dataset(resolution) / "samples.csv" for name in of_train.also)
    images += sum(len(read_samples(path)) for path in others)
    seen = min(images, settings.epoch_images or images) * settings.epochs
    return Cost(layout.TRAIN, START + kind_of(table).image_seconds * seen, 3e6)


def estimated(of: Layout, resolution: str, model: str, rows: list[RawRow], cores: int = 1) -> list[Cost]:
    """Cost of every stage for all rows of a dataset."""
    shards, count, grid = len(of.names()), len(rows), Grid.parse(resolution)
    cells = 4.0 * 3 * grid.rows * grid.cols
    each, source = press_seconds(of)

    def of_rows(stage: str, disk: float = 0.0) -> Cost:
        spread = stage in layout.OF_SHARDS
        return Cost(
            stage,
            EACH[stage] * count + START * (shards if spread else 1),
            disk * count,
            min(cores, shards) if spread else 1,
        )

    costs = [
        of_rows(layout.POSES, BYTES[layout.POSES]),
        Cost(
            layout.FEA, each * weights(rows) + START * shards, BYTES[layout.FEA] * count, min(cores, shards), source
        ),
        of_rows(layout.FORCES, BYTES[layout.FORCES]),
        of_rows(layout.LABELS, cells),
    ]
    branches = read_json(of.params / "report.json")["report"]["branches"]
    if "calibrate" in branches and any(row.cells.get("fz_n") for row in rows):
        costs.append(Cost(layout.CALIBRATE, CALIBRATE_ONCE, 2e7, cores))
    if not read_json(of.params / "poses.json")["poses"]["images"]:
        return costs  # a log without images has no report
    costs += [of_rows(layout.IMAGES), of_rows(layout.DATASET, image_bytes(of, rows) + cells)]
    if model != SHIPPED:
        costs.append(training(of, resolution, model, count))
    return [*costs, of_rows(layout.EVALUATE, cells / 2), of_rows(layout.REPORT, 4e4)]


def size(count: float) -> str:
    """Bytes as text with a unit and three digits; values that would round to 1000 take the next unit."""
    power = next((p for p in range(5) if float(f"{count / 1000**p:.3g}") < 1000), 5)
    return f"{count / 1000**power:.3g} {('B', 'kB', 'MB', 'GB', 'TB', 'PB')[power]}"


@command(
    RESULTS,
    option("--resolution", default="24x32"),
    option("--model", default=SHIPPED, help="network of the run; `shipped` is not trained"),
    option("--cores", type=positive, default=os.cpu_count(), help="cores that the run may use"),
)
def main(args: Namespace) -> None:
    of = Layout(args.results)
    rows = planned_rows(of)
    if not rows:
        raise BadInput(f"{of.log}: no row is left to solve; {of.command('poses')} says why each was rejected")
    costs = estimated(of, args.resolution, args.model, rows, args.cores)
    print(f"{'stage':14s} {'core hours':>10s} {'disk':>9s}  known from")
    for cost in costs:
        print(f"{cost.stage:14s} {cost.cpu / 3600:10.3f} {size(cost.disk):>9s}  {cost.source}")
    cpu, disk = sum(cost.cpu for cost in costs), sum(cost.disk for cost in costs)
    print(f"{'all':14s} {cpu / 3600:10.3f} {size(disk):>9s}")
    cores = f"{args.cores} cores" if args.cores > 1 else "1 core"
    print(
        f"{len(rows)} rows by {solved_by(of)[0]}: about {duration(sum(cost.cpu / cost.cores for cost in costs))} on {cores}"
    )


if __name__ == "__main__":
    main.exit()
