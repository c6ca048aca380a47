"""Writes data/DATASET as a bench does, press by press, and beside it the truth, for the evaluation of forces."""

import json
import math
import re
import time
import tomllib
from dataclasses import asdict, astuple
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import read_json, read_toml, write_csv, write_json, write_text
from gelforge.labelling.sensor import Sensor
from gelforge.records.image import write_png
from gelforge.records.log import fixed, read_presses, write_log
from gelforge.records.press import FORCE, FORCES, MOMENT, POSE, TILT, LoggedPress
from gelforge.records.status import VALID
from gelforge.records.table import read_table
from gelforge.virtualrig.rigplan import Order, Plan

if TYPE_CHECKING:  # checking a plan or finding it complete needs no solver
    from gelforge.virtualrig.bench import Pressing

# Lengths to 0.1 micrometre, forces to 0.1 mN, moments to 1 mN mm.
DECIMALS = {**dict.fromkeys((*POSE, *TILT, *FORCE), 4), **dict.fromkeys(MOMENT, 6)}
FRAME_S = 0.1  # between frames of one press
PUBLISHED_EVERY_S = 10.0  # a run that is killed loses at most the presses of this time
TRUTH_COLUMNS = ("sample_id", "status", *POSE, *TILT, *FORCES, "newton_iterations", "load_steps")


class Dataset:
    """One dataset folder that grows press by press; every file in it is complete at any time."""

    def __init__(self, folder, plan: Plan):
        self.folder, self.plan = Path(folder), plan
        self.log_path, self.truth_path = self.folder / "log.csv", self.folder / "truth" / "presses.csv"
        self.plan_path = self.folder / "truth" / "truth.json"
        ours = self.log_path.exists() and self.plan_path.exists()
        presses = read_presses(self.log_path) if ours else []
        self.log = {press.sample_id: press for press in presses}
        self.truth = self._rows(self.truth_path)
        self._published = -math.inf

    def _rows(self, path) -> dict[str, dict]:
        hint, needed = "remove it, and its presses are repeated", ("sample_id", "status")
        rows = read_table(path, hint, needed) if path.exists() else []
        return {row["sample_id"]: row for row in rows}

    def _before(self) -> dict:
        """truth.json of the plan that wrote the folder; BadInput if it cannot be read."""
        try:
            before = read_json(self.plan_path)
        except (OSError, ValueError) as error:
            raise self._unknown_plan(str(error)) from error
        if not isinstance(before, dict) or not {"plan", "shapes", "looks"} <= before.keys():
            raise self._unknown_plan("it names no plan, no shapes or no looks")
        return before

    def _unknown_plan(self, fault: str) -> BadInput:
        return BadInput(
            f"{self.plan_path}: does not state which plan wrote the folder ({fault}); restore it from a copy, or "
            "remove the folder"
        )

    def check_same_plan(self, shapes: dict[str, str], appearances: dict[str, str]) -> None:
        """Raise BadInput if the folder was written by another plan; a plan with more presses is the same.

        shapes, appearances: digest by name of each indenter's shape and each sensor's appearance. Another digest than
        when existing presses were computed or existing images drawn counts as another plan.
        """
        if not self.plan_path.exists():
            if self.log_path.exists():
                raise BadInput(
                    f"{self.log_path} was not written by the virtual rig; choose another `dataset` in the plan"
                )
            return
        before = self._before()
        if before["plan"] != self.plan.identity():
            raise BadInput(
                f"{self.folder}: was written by another plan (only `presses` may change); "
                "name another `dataset` in the plan or remove the folder"
            )
        changed = differing(before["shapes"], shapes) if self.log else []
        if changed:
            raise BadInput(
                f"{self.folder}: indenter {changed[0]} had another shape when presses were made with it; "
                "give the new shape a name of its own, or remove the folder"
            )
        changed = differing(before["looks"], appearances) if self._has_pictures() else []
        if changed:
            raise BadInput(
                f"{self.folder}: the appearance of sensor {changed[0]} has changed since its images were drawn; "
                "remove images/ and nocontact/ there to draw all again"
            )

    def _has_pictures(self) -> bool:
        return any(any((self.folder / name).glob("*.png")) for name in ("images", "nocontact"))

    def begin(self, shapes: dict[str, str], appearances: dict[str, str]) -> None:
        """Write what does not depend on the presses; shapes and appearances as of `check_same_plan`."""
        of = self.plan.mountings
        truth = {
            "truth": asdict(self.plan.truth),
            "mountings": {name: asdict(self.plan.truth_of(name)) for name in of.names(self.plan.presses)}
            if of
            else {},
            "plan": self.plan.identity(),
            "shapes": shapes,
            "looks": appearances,
        }
        write_json(self.plan_path, truth)
        description = self.folder / "dataset.toml"
        if not description.exists():
            write_text(description, describe(self.plan))
        elif read_toml(description) != tomllib.loads(describe(self.plan)):
            print(
                f"{description} differs from what the plan would write and is kept; remove it to get the plan's version"
            )

    def missing(self, orders: list[Order]) -> list[Order]:
        """Orders that are not yet carried out, or whose image is missing."""
        return [order for order in orders if not self._done(order)]

    def _done(self, order: Order) -> bool:
        row = self.truth.get(order.sample_id)
        if row is None:
            return False
        if order.sample_id not in self.log:
            return row["status"] not in VALID
        return (self.folder / image_name(order)).is_file()

    def solved(self, order: Order) -> bool:
        """Whether everything but the image of an order exists."""
        there = order.sample_id in self.log and order.sample_id in self.truth
        return there and (self.folder / surface_name(order)).is_file()

    def add(self, rows: list[tuple[Order, LoggedPress | None, dict]]) -> None:
        """Add one press: (order, record of the log or None, row of the truth) for each sensor that saw it.

        Tables are written every PUBLISHED_EVERY_S only, because each is rewritten as a whole; call `publish` at the
        end.
        """
        self.truth |= {order.sample_id: truth for order, _, truth in rows}
        self.log |= {order.sample_id: log for order, log, _ in rows if log is not None}
        if time.monotonic() > self._published + PUBLISHED_EVERY_S:
            self.publish()

    def publish(self) -> None:
        """Write both tables, the truth first: a valid press counts as done only once the log has its row."""
        write_csv(self.truth_path, TRUTH_COLUMNS, _ordered(self.truth))
        if self.log:  # a log without rows cannot be read back
            write_log(self.log_path, _ordered(self.log), DECIMALS)
        self._published = time.monotonic()


def differing(before: dict[str, str], now: dict[str, str]) -> list[str]:
    """Names whose digest has changed; new and missing names do not count."""
    return sorted(name for name, digest in before.items() if now.get(name, digest) != digest)


def _ordered(rows: dict) -> list:
    return [rows[name] for name in sorted(rows)]


def image_name(order: Order) -> str:
    """Path of a press's image below the dataset's folder."""
    return f"images/{order.sample_id}.png"


def nocontact_name(sensor: str) -> str:
    """Path of the no-contact image of a sensor below the dataset's folder."""
    return f"nocontact/{sensor}.png"


def surface_name(order: Order) -> str:
    """Path below the dataset's folder of a frame's surface, from which its images can be drawn again."""
    frame = f"-f{order.frame + 1:02d}" if order.film_id else ""
    return f"truth/surfaces/{order.press_id}{frame}.npz"


def save_image(path, image: np.ndarray) -> None:
    """Write an RGB image as PNG, whole or not at all."""
    write_png(path, image, compression=4)


def time_of(order: Order) -> str:
    """Time of an order as text for the log; frames of one press are FRAME_S apart."""
    if not order.film_id:
        return order.time_utc
    time = datetime.fromisoformat(order.time_utc) + timedelta(seconds=FRAME_S * order.frame)
    return time.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def logged(pressing: "Pressing") -> LoggedPress:
    """Row of the log: the path that the bench reports and what its load cell read."""
    order, log = pressing.order, pressing.log
    path = (log.x0, log.y0, log.z0, log.dx, log.dy, log.dz, log.rot_deg)
    read = (*path, *pressing.read_force, *pressing.read_moment)
    values: dict[str, Any] = {name: float(value) for name, value in zip((*POSE, *FORCES), read, strict=True)}
    return LoggedPress(
        row=0, sample_id=order.sample_id, time_utc=time_of(order), sensor_id=order.sensor, gel_id=order.gel,
        indenter=order.indenter, image=image_name(order), press_id=order.film_id, mounting=order.mounting,
        **values,
    )  # fmt: skip


def truth_row(pressing: "Pressing") -> dict:
    """Row of the truth: real path, force and moment, and the cost of the solve."""
    real, evidence = pressing.real, pressing.result.evidence
    values = [*astuple(real), *pressing.force, *pressing.moment]
    cost = [evidence["newton_iterations"], evidence["load_steps"]]
    texts = [fixed(value, DECIMALS[name]) for name, value in zip((*POSE, *TILT, *FORCES), values, strict=True)]
    row = [pressing.order.sample_id, pressing.result.status.name, *texts, *cost]
    return dict(zip(TRUTH_COLUMNS, row, strict=True))


def describe(plan: Plan) -> str:
    """Text of dataset.toml."""
    lines = [
        f"# Written by the virtual rig from plan `{plan.dataset}`, seed {plan.seed}.",
        f'sensor = "{plan.sensors[0]}"  # of rows that name none',
        f'gel = "{plan.gel}"',
        f'catalogue = "{plan.catalogue}"',
    ]
    params = dict(plan.params)
    if plan.held_out_sensors:
        params["dataset"] = {"unseen_sensors": list(plan.held_out_sensors)} | params.get("dataset", {})
    if plan.units:  # some of the drawn sensors are lit so unevenly that their no-contact images seem to show a touch
        params["poses"] = {"judge_images": False} | params.get("poses", {})
    return "\n".join(lines + _tables("params", params)) + "\n"


def write_sensors(path: Path, sensors: dict[str, Sensor]) -> None:
    """Write a dataset's own sensors as tables of a sensors.toml."""
    lines = ["# Virtual units drawn by the rig."]
    for name, sensor in sensors.items():
        projection = [[float(f"{value:.9g}") for value in row] for row in sensor.projection]
        table = {"gel": sensor.gel, "image": list(sensor.image), "projection": projection, "markers": sensor.markers}
        lines += _tables(name, table)
    write_text(path, "\n".join(lines) + "\n")


def _tables(name: str, table: dict) -> list[str]:
    """Lines of a TOML table of numbers, texts, lists of them and subtables; name: its dotted key."""
    own = [f"{_key(key)} = {_value(value)}" for key, value in table.items() if not isinstance(value, dict)]
    lines = ["", f"[{name}]", *own] if own else []
    for key, value in table.items():
        if isinstance(value, dict):
            lines += _tables(f"{name}.{_key(key)}", value)
    return lines


def _key(name: str) -> str:
    """A key of TOML: a bare key as it is, any other quoted, such as "0.7", which would otherwise be a dotted key."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _value(name)


def _value(value) -> str:
    """A number, a text or a list of them as TOML, which is JSON but for two kinds of characters.

    JSON may escape characters beyond 16 bits as surrogate pairs, which TOML refuses, and does not escape DEL (0x7f).
    """
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
