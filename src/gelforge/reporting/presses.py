"""All presses of a dataset as one table of columns, which the page filters, sorts and draws."""

import numpy as np

from gelforge.records.axes import CHANNEL_OF_AXIS
from gelforge.records.press import POSE

AXES = ("fx", "fy", "fz")
TEXTS = ("indenter", "sensor", "split", "status", "reason", "fidelity", "mesh", "group", "shard")
NUMBERS = (
    *POSE,
    *(f"{kind}_{axis}" for kind in ("label", "network", "measured") for axis in AXES),
    "seconds",
    "peak_mib",
)  # fmt: skip
# Digits behind the point: micrometres, tenths of a millinewton.
DIGITS = 4


def number(text) -> float:
    """A cell as a number, NaN where it is empty or none."""
    try:
        return float(text)
    except (TypeError, ValueError):
        return float("nan")


def press_rows(poses, rejected, solved: dict, samples: dict, totals: dict) -> list[dict]:
    """One dict a press, rejected rows of the log last.

    poses, rejected: rows of stage 10 with their `shard`. solved, samples: rows of stages 30 and 60 by sample_id.
    totals: (3,) N by sample_id that the network read, in its channel order.
    """
    rows = [_press(row, solved.get(row["sample_id"], {}), samples.get(row["sample_id"], {}),
                   totals.get(row["sample_id"])) for row in poses]  # fmt: skip
    by_row: dict[tuple, dict] = {}
    for fault in rejected:
        text = f"{fault['column']}: {fault['reason']}; {fault['remedy']}"
        entry = by_row.setdefault((fault["shard"], fault["row"]), {
            "id": fault["sample_id"] or f"row {fault['row']}", "status": "REJECTED", "reason": "", "shard": fault["shard"],
        })  # fmt: skip
        entry["reason"] = "; ".join(filter(None, [entry["reason"], text]))
    return rows + list(by_row.values())


def _press(pose: dict, solve: dict, sample: dict, total) -> dict:
    row = {"id": pose["sample_id"], "indenter": pose["indenter"], "sensor": pose["sensor_id"], "shard": pose["shard"]}
    row |= {"split": sample.get("split", ""), "group": sample.get("group", "")}
    row |= {"status": solve.get("status", "PENDING")}
    row |= {name: solve.get(name, "") for name in ("reason", "fidelity", "mesh", "seconds", "peak_mib")}
    row |= {name: pose[name] for name in (*POSE, "stl")}
    for axis, channel in zip(AXES, CHANNEL_OF_AXIS, strict=True):
        row[f"measured_{axis}"] = pose.get(f"{axis}_n", "")
        # Forces of the label, or of the solve where the press has no picture and so no place in the dataset.
        row[f"label_{axis}"] = sample.get(f"{axis}_n", solve.get(f"{axis}_n", ""))
        row[f"network_{axis}"] = "" if total is None else total[channel]
    return row


def as_columns(rows: list[dict]) -> dict:
    """The table by columns: `id` as text, NUMBERS as lists with None where unknown, TEXTS as (names, at)."""
    table = {"id": [row["id"] for row in rows]}
    for name in NUMBERS:
        values = np.round([number(row.get(name)) for row in rows], DIGITS)
        table[name] = [None if np.isnan(value) else value for value in values.tolist()]
    for name in TEXTS:
        values = [row.get(name) or "" for row in rows]
        names = sorted(set(values))
        place = {value: at for at, value in enumerate(names)}
        table[name] = {"names": names, "at": [place[value] for value in values]}
    return table
