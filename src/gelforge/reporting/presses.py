"""All presses of a dataset as one table, which the page filters, sorts and draws."""

from typing import Any

import numpy as np

from gelforge.records.axes import CHANNELS, MOMENTS
from gelforge.records.press import N_M, POSE, TILT, PosedPress
from gelforge.records.samplefile import DatasetSample
from gelforge.records.solvetable import Solved

TEXTS = ("indenter", "sensor", "gel", "split", "status", "reason", "method", "mesh", "group", "shard")
NUMBERS = (
    *POSE,
    *TILT,
    *(f"{kind}_{axis}" for kind in ("label", "network", "measured") for axis in (*CHANNELS, *MOMENTS)),
    "error_n",
    "friction_error_n",
    "slipping",
    "seconds",
    "peak_mib",
)  # fmt: skip
# Decimal places: tenths of a micrometre, and of a millinewton.
DIGITS = 4


def press_rows(
    presses: list[tuple[str, PosedPress]],
    rejected: list[dict],
    solved: dict[str, Solved],
    samples: dict[str, DatasetSample],
    wrenches: dict,
    gels: dict[str, str],
) -> list[dict]:
    """One dict a press, rejected rows of the log last.

    presses: (shard, press) of the pose tables. rejected: rows of the tables of rejections, with their shard. solved,
    samples: of stages 30 and 60, by sample_id. wrenches: the network's force and moment (6,) N and N mm, by sample_id. gels: name of
    the gel of each sensor.
    """
    rows = [
        _press(
            shard,
            press,
            gels[press.sensor_id],
            solved.get(press.sample_id),
            samples.get(press.sample_id),
            wrenches.get(press.sample_id),
        )
        for shard, press in presses
    ]
    by_row: dict[tuple, dict] = {}
    for fault in rejected:
        text = f"{fault['column']}: {fault['reason']}; {fault['hint']}"
        entry = by_row.setdefault((fault["shard"], fault["row"]), {
            "id": fault["sample_id"] or f"row {fault['row']}", "status": "REJECTED", "reason": "", "shard": fault["shard"],
        })  # fmt: skip
        entry["reason"] = "; ".join(filter(None, [entry["reason"], text]))
    return rows + list(by_row.values())


def _press(
    shard: str, press: PosedPress, gel: str, solve: Solved | None, sample: DatasetSample | None, wrench
) -> dict:
    row: dict[str, Any] = {
        "id": press.sample_id,
        "indenter": press.indenter,
        "sensor": press.sensor_id,
        "gel": gel,
        "mounting": press.mounting,
        "shard": shard,
    }
    row |= {"split": sample.split, "group": sample.group} if sample else {}
    row |= {"status": solve.status.name if solve else "PENDING"}
    if solve:
        row |= {name: getattr(solve, name) for name in ("reason", "method", "mesh")}
        row |= {name: solve.number(name) for name in ("seconds", "peak_mib")}
    row |= {name: getattr(press, name) for name in (*POSE, "stl")} | dict(zip(TILT, press.tilt, strict=True))
    # Force (N) and moment (N mm) of the label, or of the solve for a press without an image, which is not in the dataset.
    unit, known = np.repeat([1.0, N_M], 3), np.full(6, np.nan)
    if sample:
        known = sample.wrench / unit
    elif solve and solve.status.valid:
        known = np.array([*solve.total, *solve.moment])
    row["outside_fz"] = np.nan_to_num(sample.outside)[2] if sample else 0.0
    network = np.full(6, np.nan) if wrench is None else wrench
    for at, axis in enumerate((*CHANNELS, *MOMENTS)):
        row[f"measured_{axis}"], row[f"label_{axis}"] = press.wrench[at] / unit[at], known[at]
        row[f"network_{axis}"] = network[at]
    if solve:
        row |= {name: solve.number(name) for name in ("error_n", "friction_error_n", "slipping")}
    return row


def as_columns(rows: list[dict]) -> dict:
    """The table by columns: `id` as text, NUMBERS with None where unknown, TEXTS as names and indices into them."""
    table: dict[str, Any] = {"id": [row["id"] for row in rows]}
    for name in NUMBERS:
        values = np.round([row.get(name, np.nan) for row in rows], DIGITS)
        table[name] = [None if np.isnan(value) else value for value in values.tolist()]
    for name in TEXTS:
        texts = [row.get(name) or "" for row in rows]
        names = sorted(set(texts))
        place = {text: at for at, text in enumerate(names)}
        table[name] = {"names": names, "at": [place[text] for text in texts]}
    return table
