"""Moments of one press: rows of a log that share a press_id, in order of time along one path, down and then sideways."""

from collections.abc import Sequence
from datetime import datetime
from typing import TypeVar

import numpy as np

from gelforge.records.press import PressRecord, Rejection, reject

Record = TypeVar("Record", bound=PressRecord)

# A bench that films reads its axes while they move: what lies nearer than its resolution is the same place.
NEAR_MM = 0.01
NEAR_DEG = 0.05
# A frame that gives way moves by some hundredths while a press goes sideways.
NEAR_DEPTH_MM = 0.05
SAME = ("indenter", "sensor_id", "gel_id")
PLACE = {"x0_mm": NEAR_MM, "y0_mm": NEAR_MM, "z0_mm": NEAR_MM, "rot_deg": NEAR_DEG}


def presses_of(records: Sequence[Record]) -> list[list[Record]]:
    """Records grouped by press_id, in the order of their first rows; a record without one is a press of its own."""
    found: dict[str, list[Record]] = {}
    for at, record in enumerate(records):
        found.setdefault(f"id {record.press_id}" if record.press_id else f"at {at}", []).append(record)
    return list(found.values())


def check_frames(records: Sequence[PressRecord], file: str) -> list[Rejection]:
    """Rejections of rows that are no later moment of the press whose press_id they have.

    The first row of a press stands; each later one must have its indenter, sensor, gel, place and rotation, and lie
    further along its path than the row before it that stands.
    """
    wrong = []
    for press in presses_of(records):
        stands = [press[0]]
        for frame in press[1:]:
            fault = _differs(stands[0], frame) or _earlier(stands[-1], frame) or _goes_back(stands[-1], frame)
            if fault:
                column, reason = fault
                remedy = f"give it another press_id than row {stands[-1].row} has, or correct the cell"
                wrong.append(reject(frame, file, column, reason, remedy))
            else:
                stands.append(frame)
    return wrong


def _differs(first: PressRecord, frame: PressRecord) -> tuple[str, str] | None:
    for column in SAME:
        if getattr(first, column) != getattr(frame, column):
            return column, "differs from the first row of its press_id"
    for column, near in PLACE.items():
        if abs(getattr(first, column) - getattr(frame, column)) > near:
            return column, "differs from the first row of its press_id"
    return None


def _earlier(last: PressRecord, frame: PressRecord) -> tuple[str, str] | None:
    """Whether the log gives a frame an earlier time than the row before it; rows without a time are in order."""
    times = [getattr(record, "time_utc", "") for record in (last, frame)]
    if not all(times):
        return None
    before, now = (datetime.fromisoformat(time) for time in times)
    if (before.tzinfo is None) == (now.tzinfo is None) and now < before:
        return "time_utc", "is earlier than the row before it of its press"
    return None


def _goes_back(last: PressRecord, frame: PressRecord) -> tuple[str, str] | None:
    """Whether a frame is no later point of the path that the row before it is on."""
    before, now = (np.array([r.dx_mm, r.dy_mm]) for r in (last, frame))
    moved, goes = np.hypot(*before), np.hypot(*now)
    column = "dx_mm" if abs(now[0] - before[0]) >= abs(now[1] - before[1]) else "dy_mm"
    near = NEAR_DEPTH_MM if goes > NEAR_MM else NEAR_MM
    if frame.dz_mm > last.dz_mm + near:
        return "dz_mm", "rises within its press: a press goes down, then sideways"
    if moved > NEAR_MM and frame.dz_mm < last.dz_mm - near:
        return "dz_mm", "goes deeper after the press moved sideways: a press goes down, then sideways"
    if goes < moved - NEAR_MM:
        return column, "goes back within its press: a press moves sideways in one direction"
    if moved > NEAR_MM and abs(before[0] * now[1] - before[1] * now[0]) > NEAR_MM * moved:
        return column, "leaves the line of its press: a press moves sideways in one direction"
    if moved > NEAR_MM and before @ now < 0.0:
        return column, "goes back within its press: a press moves sideways in one direction"
    if np.linalg.norm(now - before) <= 0.0 and frame.dz_mm == last.dz_mm:
        return "dz_mm", "is the same point of the path as the row before it"
    return None
