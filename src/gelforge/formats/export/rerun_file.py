"""Rerun recordings (.rrd, https://rerun.io): pictures, force maps and totals on the timeline `sample`.

Entities of each sensor, /SENSOR/…: `image` (EncodedImage), `forces` (Tensor of (3, rows, cols), N per cell), `total`
(Scalars along gel x, y, z in N) and `row` (the row of samples.csv as JSON). /facts says what the numbers mean.
"""

import json
from pathlib import Path

import numpy as np

from gelforge.formats.export.samples import Samples

BLOCK = 64


def write(path: Path, samples: Samples) -> None:
    """Write one file."""
    import rerun as rr

    recording = rr.RecordingStream("gelforge", recording_id=f"gelforge-{samples.info['name']}")
    recording.save(path)
    recording.log(
        "facts", rr.TextDocument(samples.facts_text(), media_type="application/json"), static=True, strict=True
    )
    by_sensor: dict[str, list[int]] = {}
    for at, row in enumerate(samples.rows):
        by_sensor.setdefault(row["sensor_id"], []).append(at)
    for sensor, rows in by_sensor.items():
        for start in range(0, len(rows), BLOCK):
            send(recording, sensor, rows[start : start + BLOCK], samples)
    try:
        recording.flush()
    except RuntimeError as error:  # its writer stopped, which it does where a disk is full
        raise OSError(str(error)) from error
    recording.disconnect()


def send(recording, sensor: str, rows: list[int], samples: Samples) -> None:
    """Send a block of samples of one sensor, column by column."""
    import rerun as rr

    block, time = [samples.sample(at) for at in rows], rr.TimeColumn("sample", sequence=rows)
    pictures = rr.EncodedImage.columns(
        blob=[np.frombuffer(s.picture, np.uint8) for s in block], media_type=[s.media_type for s in block]
    )
    recording.send_columns(f"{sensor}/image", [time], pictures, strict=True)
    for at, sample in zip(rows, block, strict=True):  # tensors are not taken as columns
        recording.set_time("sample", sequence=at)
        tensor = rr.Tensor(np.ascontiguousarray(sample.label), dim_names=["channel", "row", "column"])
        recording.log(f"{sensor}/forces", tensor, strict=True)
    totals = np.array([s.total() for s in block])
    recording.send_columns(
        f"{sensor}/total", [time], rr.Scalars.columns(scalars=totals.ravel()).partition([3] * len(block)), strict=True
    )
    recording.send_columns(
        f"{sensor}/row", [time], rr.TextDocument.columns(text=[json.dumps(s.cells) for s in block]), strict=True
    )
