"""Presses as records and logs as text, for tests."""

from pathlib import Path

from gelforge.records.press import COLUMNS, FORCES, POSE, LoggedPress

PLAIN = {
    "sample_id": "a", "time_utc": "", "sensor_id": "gelsight_mini", "gel_id": "g", "indenter": "sphere_15",
    **dict.fromkeys(POSE, 0.0), "dz_mm": -1.0, **dict.fromkeys(FORCES), "image": "images/a.png",
}  # fmt: skip


def press_record(row: int = 2, **cells) -> LoggedPress:
    """A press of 1 mm at the apex, with the given cells changed."""
    return LoggedPress(row=row, **{**PLAIN, **cells})


def log_line(columns=COLUMNS, **cells) -> str:
    """A line of a log with the press of `press_record`."""
    return ",".join("" if (value := {**PLAIN, **cells}.get(name)) is None else str(value) for name in columns)


def write_lines(path: Path, *lines: str, columns=COLUMNS) -> Path:
    """Write a log with a header and these lines."""
    path.write_text("\n".join([",".join(columns), *lines]) + "\n", encoding="utf-8")
    return path
