"""Frames of one press: rows of a log that share a press_id, in order of time along a path down and then sideways."""

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import TypeVar

import numpy as np

from gelforge.records.press import TILT, PressRecord, RawRow, Rejection, reject

Record = TypeVar("Record", bound=PressRecord | RawRow)

# Differences below the resolution of a bench that reads its axes while they move count as none.
NEAR_MM = 0.01
NEAR_DEG = 0.05
# A compliant machine frame moves by some hundredths of a mm in depth while a press goes sideways.
NEAR_DEPTH_MM = 0.05
# How far an accepted frame may end beyond the last one of its press. In depth 2 NEAR_MM are added, because the z0 of
# two rows may differ from the first row's in opposite directions.
MOST_DEEPER_MM = NEAR_DEPTH_MM + 2.0 * NEAR_MM
MOST_FARTHER_MM = NEAR_MM
SAME = ("indenter", "sensor_id", "gel_id", "mounting")
PLACE = {"x0_mm": NEAR_MM, "y0_mm": NEAR_MM, "z0_mm": NEAR_MM, **dict.fromkeys(("rot_deg", *TILT), NEAR_DEG)}


def presses_of(records: Sequence[Record]) -> list[list[Record]]:
    """Records grouped by press_id, in the order of first rows; a record without press_id is a press of its own."""
    found: dict[str, list[Record]] = {}
    for at, record in enumerate(records):
        found.setdefault(f"id {record.press_id}" if record.press_id else f"at {at}", []).append(record)
    return list(found.values())


def check_frames(records: Sequence[PressRecord], file: str) -> list[Rejection]:
    """Rejections of rows that cannot be a later frame of the press with their press_id.

    The first row of a press is accepted. Each later one must have its indenter, sensor, gel, mounting, place and rotation, no
    earlier time, and lie further along its path than all accepted rows before it.
    """
    wrong = []
    for press in presses_of(records):
        path = np.array([[frame.dx_mm, frame.dy_mm, frame.dz_mm] for frame in press])
        stands = [0]
        for at, frame in enumerate(press[1:], 1):
            last = press[stands[-1]]
            fault = _differs(press[0], frame) or _earlier(last, frame) or _off_path(path[stands], path[at])
            if fault:
                column, reason = fault
                hint = f"give it another press_id than row {last.row} has, or correct the cell"
                wrong.append(reject(frame, file, column, reason, hint))
            else:
                stands.append(at)
    return wrong


def _differs(first: PressRecord, frame: PressRecord) -> tuple[str, str] | None:
    for column in SAME:
        if getattr(first, column) != getattr(frame, column):
            return column, "differs from the first row of its press_id"
    for column, near in PLACE.items():
        if abs((getattr(first, column) or 0.0) - (getattr(frame, column) or 0.0)) > near:
            return column, "differs from the first row of its press_id"
    return None


def _earlier(last: PressRecord, frame: PressRecord) -> tuple[str, str] | None:
    """The fault of a frame with an earlier time than the last accepted row, else None; missing times are no fault."""
    times = [getattr(record, "time_utc", "") for record in (last, frame)]
    if not all(times):
        return None
    before, now = (_in_utc(datetime.fromisoformat(time)) for time in times)
    if now < before:
        return "time_utc", "is earlier than the row before it of its press"
    return None


def _in_utc(time: datetime) -> datetime:
    """A time without zone is in UTC, as the column's name states."""
    return time if time.tzinfo else time.replace(tzinfo=UTC)


def _off_path(path: np.ndarray, now: np.ndarray) -> tuple[str, str] | None:
    """The fault of a point (3,) mm that is not further along a path, else None.

    path: (n, 3) mm, dx, dy, dz of accepted rows. The point is compared with the extreme of all rows, not with the
    last one: a slowly filmed press could otherwise go back in steps below the tolerance.
    """
    fault = _depth_fault(path, now) or _sideways_fault(path[:, :2], now[:2])
    if fault is None and (now == path[-1]).all():
        return "dz_mm", "is the same point of the path as the row before it"
    return fault


def _depth_fault(path: np.ndarray, now: np.ndarray) -> tuple[str, str] | None:
    aside = np.hypot(path[:, 0], path[:, 1]) > NEAR_MM
    near = NEAR_DEPTH_MM if np.hypot(now[0], now[1]) > NEAR_MM else NEAR_MM
    if now[2] > path[:, 2].min() + near:
        return "dz_mm", "rises within its press: a press goes down, then sideways"
    if aside.any() and now[2] < path[aside][0, 2] - near:
        return "dz_mm", "goes deeper after the press moved sideways: a press goes down, then sideways"
    return None


def _sideways_fault(path: np.ndarray, now: np.ndarray) -> tuple[str, str] | None:
    farthest = path[np.argmax(np.hypot(*path.T))]
    moved, goes = np.hypot(*farthest), np.hypot(*now)
    if moved <= NEAR_MM:
        return None
    column = "dx_mm" if abs(now[0] - farthest[0]) >= abs(now[1] - farthest[1]) else "dy_mm"
    if now @ farthest < (moved - NEAR_MM) * moved:
        return column, "goes back within its press: a press moves sideways in one direction"
    # the farthest point defines the line of the press most accurately, and all others must lie on it
    x, y = now / goes if goes > moved else farthest / moved
    if np.abs(np.vstack([path, now]) @ [-y, x]).max() > NEAR_MM:
        return column, "leaves the line of its press: a press moves sideways in one direction"
    return None
