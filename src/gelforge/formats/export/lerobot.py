"""LeRobot's dataset layout, codebase version v3.0 (https://huggingface.co/docs/lerobot, lerobot-dataset-v3).

A press on one sensor (rows that share a press_id) is an episode, and its images are the frames. `timestamp` is the
time since its first frame, by `time_utc` of the log; `fps` is the median rate. Episodes of a split are consecutive.
LeRobot has no agreed schema for touch yet (its proposals use point sets), so the features are ordinary ones:

| feature | type | meaning |
| --- | --- | --- |
| observation.images.gelsight | image | the image, as its original file |
| observation.forces | float32 (3 * rows * cols,) | N per cell, force along gel x, y, z: reshape to (3, rows, cols) |
| observation.state | float32 (7,) | pose of the indenter: x0, y0, z0, dx, dy, dz in mm, rotation in degrees |
| observation.wrench | float32 (6,) | total force of the label and its moment about the gel's apex along gel x, y, z, N and N m |
| sample_id, indenter, sensor_id, split | string | as in samples.csv |

Forces are flat, because readers other than LeRobot's own support only features of one dimension.
"""

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from gelforge.errors import BadInput
from gelforge.flow.files import write_json, write_text
from gelforge.formats.export.samples import Samples
from gelforge.records.image import decode
from gelforge.records.press import FORCE, MOMENT, POSE, TILT
from gelforge.records.samplefile import TRAINING, DatasetSample
from gelforge.records.table import read_table

VERSION = "v3.0"
SLOWEST = 1  # frames a second, at least; also where no episode has two frames
CHUNK_FILES = 1000  # files a chunk folder holds at most
MOST_PICTURES = 1000  # images sampled for the statistics; LeRobot itself samples as many of about 10 000
FILE_BYTES = 100e6  # approximate size at which a data file is closed
BLOCK = 256  # labels read at a time for the statistics
NAMES = ("sample_id", "indenter", "sensor_id", "split")
PATH = (*POSE, *TILT)
COMPONENTS = (*FORCE, *MOMENT)
PICTURE, FORCES, STATE, WRENCH = (
    "observation.images.gelsight",
    "observation.forces",
    "observation.state",
    "observation.wrench",
)
HOW_TIMES = "write it as 2026-04-08T12:25:19.040Z, with fractions of a second, or export as mcap or hdf5"
INDICES = ("frame_index", "episode_index", "index", "task_index")
TASK = "press the gel"
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
CARD = """---
license: other
task_categories:
- robotics
tags:
- LeRobot
- tactile
- gelsight
configs:
- config_name: default
  data_files: data/*/*.parquet
---

# {name}

Pictures of an optical tactile sensor with forces per cell, labelled by finite elements (gelforge).
{frames} pictures of {episodes} presses; splits are in the column `split` and, by episodes, in `meta/info.json`.

{about}

## What the numbers mean

```json
{facts}
```
"""


def features(samples: Samples) -> dict:
    """`features` of meta/info.json."""
    width, height = samples.info["image"]
    scalar = {"shape": [1], "names": None}
    return {
        PICTURE: {"dtype": "image", "shape": [height, width, 3], "names": ["height", "width", "channels"]},
        FORCES: {"dtype": "float32", "shape": [cells_of(samples)], "names": None},
        STATE: {"dtype": "float32", "shape": [len(PATH)], "names": list(PATH)},
        WRENCH: {"dtype": "float32", "shape": [len(COMPONENTS)], "names": list(COMPONENTS)},
        **{name: {"dtype": "string", **scalar} for name in NAMES},
        "timestamp": {"dtype": "float32", **scalar},
        **{name: {"dtype": "int64", **scalar} for name in INDICES},
    }


def schema(samples: Samples):
    """Schema of a data file, with the features that Hugging Face's `datasets` reads from it."""
    import pyarrow as pa

    known = {
        PICTURE: (pa.struct([("bytes", pa.binary()), ("path", pa.string())]), {"_type": "Image"}),
        FORCES: (pa.list_(pa.float32(), cells_of(samples)), sequence(cells_of(samples))),
        STATE: (pa.list_(pa.float32(), len(PATH)), sequence(len(PATH))),
        WRENCH: (pa.list_(pa.float32(), len(COMPONENTS)), sequence(len(COMPONENTS))),
        **{name: (pa.string(), {"dtype": "string", "_type": "Value"}) for name in NAMES},
        "timestamp": (pa.float32(), {"dtype": "float32", "_type": "Value"}),
        **{name: (pa.int64(), {"dtype": "int64", "_type": "Value"}) for name in INDICES},
    }
    about = {"info": {"features": {name: kind for name, (_, kind) in known.items()}}}
    return pa.schema([(name, kind) for name, (kind, _) in known.items()], {"huggingface": json.dumps(about)})


def cells_of(samples: Samples) -> int:
    """Number of values of a force map: three components of all cells."""
    return 3 * samples.grid[0] * samples.grid[1]


def sequence(length: int) -> dict:
    """A float32 list of fixed length, as `datasets` describes it."""
    return {"feature": {"dtype": "float32", "_type": "Value"}, "length": length, "_type": "List"}


def write(folder: Path, samples: Samples) -> None:
    """Write the dataset's folder."""
    episodes = in_order_of_splits(samples)
    times = times_of(samples, episodes)
    placed = write_data(folder, samples, episodes, times)
    write_episodes(folder, episodes, placed)
    write_tasks(folder)
    write_json(folder / "meta" / "stats.json", stats(samples))
    write_json(folder / "meta" / "info.json", info(samples, episodes, times))
    about = __doc__.split("\n\n", 1)[1].strip()
    text = CARD.format(
        name=samples.info["name"], frames=len(samples), episodes=len(episodes), about=about,
        facts=json.dumps(samples.facts(), indent=1),
    )  # fmt: skip
    write_text(folder / "README.md", text)


def in_order_of_splits(samples: Samples) -> list[list[int]]:
    """Episodes as lists of sample indices, grouped by split, train first."""
    presses = samples.frames_of_presses
    order = sorted({samples.rows[rows[0]]["split"] for rows in presses}, key=lambda split: (split != TRAINING, split))
    return [rows for split in order for rows in presses if samples.rows[rows[0]]["split"] == split]


def times_of(samples: Samples, episodes: list[list[int]]) -> list[list[float]]:
    """Seconds of each frame since the first one of its episode, by the log; BadInput where missing or not rising."""
    log = samples.data / "log.csv"
    known = {row["sample_id"]: row.get("time_utc", "") for row in read_table(log, "restore it")}
    found = []
    for rows in episodes:
        names = [samples.rows[at]["sample_id"] for at in rows]
        texts = [known.get(name, "") for name in names] if len(rows) > 1 else ["1970-01-01"]
        for name, text in zip(names, texts, strict=True):
            if not text:
                raise BadInput(
                    f"{log}: time_utc of {name} is empty; LeRobot needs the time of every frame: {HOW_TIMES}"
                )
        moments = [when if when.tzinfo else when.replace(tzinfo=UTC) for when in map(datetime.fromisoformat, texts)]
        seconds = [(moment - moments[0]).total_seconds() for moment in moments]
        for at in range(1, len(seconds)):
            if seconds[at] <= seconds[at - 1]:
                raise BadInput(
                    f"{log}: time_utc of {names[at]} is {texts[at]}, not after {texts[at - 1]} of the frame before it, {names[at - 1]}; LeRobot"
                    f" needs frames in order of time, without repeats: {HOW_TIMES}"
                )
        found.append(seconds)
    return found


def usual_rate(times: list[list[float]]) -> int:
    """Frames a second, by the median step between frames, at least SLOWEST; SLOWEST where no episode has two."""
    steps = np.concatenate([np.diff(each) for each in times])
    return max(SLOWEST, round(1 / float(np.median(steps)))) if len(steps) else SLOWEST


def write_data(
    folder: Path, samples: Samples, episodes: list[list[int]], times: list[list[float]]
) -> list[tuple[int, int]]:
    """Write the data files, whole episodes in each; return (chunk, file) of every episode."""
    import pyarrow.parquet as pq

    form, index, number, size = schema(samples), 0, 0, 0
    placed: list[tuple[int, int]] = []
    held: list = []

    def flush() -> None:
        nonlocal held, size, number
        if held:
            path = folder / DATA_PATH.format(chunk_index=number // CHUNK_FILES, file_index=number % CHUNK_FILES)
            path.parent.mkdir(parents=True, exist_ok=True)
            # Images are compressed already, and a dictionary would only duplicate them.
            compression = {**dict.fromkeys(leaves(form), "snappy"), f"{PICTURE}.bytes": "none"}
            pq.write_table(as_table(held, form), path, compression=compression, use_dictionary=list(NAMES))
            held, size, number = [], 0, number + 1

    for episode, rows in enumerate(episodes):
        placed.append((number // CHUNK_FILES, number % CHUNK_FILES))
        for frame, at in enumerate(rows):
            sample = samples.sample(at)
            held.append((sample, frame, episode, index, times[episode][frame]))
            size += len(sample.picture) + sample.label.nbytes
            index += 1
        if size >= FILE_BYTES:
            flush()
    flush()
    return placed


def leaves(form) -> list[str]:
    """Paths of a schema's columns as parquet names them."""
    return [*(name for name in form.names if name not in (PICTURE, FORCES, STATE, WRENCH)),
            f"{PICTURE}.bytes", f"{PICTURE}.path", f"{FORCES}.list.element",
            f"{STATE}.list.element", f"{WRENCH}.list.element"]  # fmt: skip


def as_table(held: list, form):
    """The frames of one data file as a table."""
    import pyarrow as pa

    samples = [sample for sample, *_ in held]
    pictures = pa.StructArray.from_arrays(
        [pa.array([sample.picture for sample in samples], pa.binary()),
         pa.array([Path(sample.row["image"]).name for sample in samples])],
        names=["bytes", "path"],
    )  # fmt: skip
    columns = {
        PICTURE: pictures,
        FORCES: fixed([sample.label.ravel() for sample in samples]),
        STATE: fixed([pose(sample.record) for sample in samples]),
        WRENCH: fixed([sample.wrench() for sample in samples]),
        **{name: pa.array([sample.row[name] for sample in samples]) for name in NAMES},
        "timestamp": pa.array(np.array([time for *_, time in held], np.float32)),
        "frame_index": pa.array([frame for _, frame, *_ in held], pa.int64()),
        "episode_index": pa.array([episode for _, _, episode, *_ in held], pa.int64()),
        "index": pa.array([index for *_, index, _ in held], pa.int64()),
        "task_index": pa.array(np.zeros(len(samples), np.int64)),
    }
    return pa.Table.from_arrays([columns[name] for name in form.names], schema=form)


def pose(sample: DatasetSample) -> list[float]:
    """Pose and path of a press, ordered as PATH."""
    return [*(getattr(sample.press, name) for name in POSE), *sample.press.tilt]


def fixed(rows: list):
    """Rows of equal length as a column of fixed-size lists."""
    import pyarrow as pa

    values = np.array(rows, np.float32)
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])


def write_episodes(folder: Path, episodes: list[list[int]], placed: list[tuple[int, int]]) -> None:
    """Write meta/episodes: the rows and the data file of each episode."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    lengths = np.array([len(rows) for rows in episodes])
    stops = np.cumsum(lengths)
    chunks, files = np.array(placed).T
    table = pa.table({
        "episode_index": np.arange(len(episodes)), "tasks": [[TASK]] * len(episodes), "length": lengths,
        "data/chunk_index": chunks, "data/file_index": files, "dataset_from_index": stops - lengths,
        "dataset_to_index": stops, "meta/episodes/chunk_index": np.zeros_like(stops),
        "meta/episodes/file_index": np.zeros_like(stops),
    })  # fmt: skip
    path = folder / "meta" / "episodes" / "chunk-000" / "file-000.parquet"
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, path)


def write_tasks(folder: Path) -> None:
    """Write meta/tasks.parquet: a pandas table indexed by the text of the task."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table({"task_index": pa.array([0], pa.int64()), "task": pa.array([TASK])})
    column = {"field_name": None, "metadata": None}
    about = {
        "index_columns": ["task"], "column_indexes": [], "pandas_version": "2.2.0",
        "columns": [column | {"name": "task_index", "field_name": "task_index", "pandas_type": "int64", "numpy_type": "int64"},
                    column | {"name": "task", "field_name": "task", "pandas_type": "unicode", "numpy_type": "object"}],
    }  # fmt: skip
    pq.write_table(table.replace_schema_metadata({"pandas": json.dumps(about)}), folder / "meta" / "tasks.parquet")


def stats(samples: Samples) -> dict:
    """meta/stats.json: statistics for LeRobot's normalisation; features with an unknown component are left out."""
    return {PICTURE: picture_stats(samples), **number_stats(samples)}


def picture_stats(samples: Samples) -> dict:
    """Statistics of image levels, 0 to 1, each (3, 1, 1) by colour, of at most MOST_PICTURES evenly spaced images."""
    rows = np.unique(np.linspace(0, len(samples) - 1, min(len(samples), MOST_PICTURES)).round().astype(int)).tolist()
    low, high, sums, squares, pixels = np.full(3, np.inf), np.full(3, -np.inf), np.zeros(3), np.zeros(3), 0
    for at in rows:
        sample = samples.sample(at)
        levels = decode(sample.picture, f"image of sample {sample.name}").reshape(-1, 3) / 255.0
        low, high = np.minimum(low, levels.min(0)), np.maximum(high, levels.max(0))
        sums, squares, pixels = sums + levels.sum(0), squares + (levels**2).sum(0), pixels + len(levels)
    mean = sums / pixels
    found = {"min": low, "max": high, "mean": mean, "std": np.sqrt(np.maximum(squares / pixels - mean**2, 0))}
    return {name: value.reshape(3, 1, 1).tolist() for name, value in found.items()} | {"count": [len(rows)]}


def number_stats(samples: Samples) -> dict:
    """Statistics of forces, poses and wrenches."""
    forces = samples.labels
    shape = forces.shape[1:]
    sums, squares, low, high = np.zeros(shape), np.zeros(shape), np.full(shape, np.inf), np.full(shape, -np.inf)
    for start in range(0, len(forces), BLOCK):
        block = np.asarray(forces[start : start + BLOCK], np.float64)
        sums, squares = sums + block.sum(0), squares + (block**2).sum(0)
        low, high = np.minimum(low, block.min(0)), np.maximum(high, block.max(0))
    mean = sums / len(forces)
    spread = np.sqrt(np.maximum(squares / len(forces) - mean**2, 0))
    found = {"min": low, "max": high, "mean": mean, "std": spread}
    cells = {name: value.ravel().tolist() for name, value in found.items()}
    state = np.array([pose(each) for each in samples.records])
    wrench = np.array([each.wrench for each in samples.records])
    count = {"count": [len(forces)]}
    numbers = {
        name: values for name, values in ((STATE, state), (WRENCH, wrench)) if np.isfinite(values).any(0).all()
    }
    return {FORCES: cells | count} | {name: ranges(values) | count for name, values in numbers.items()}


def ranges(values: np.ndarray) -> dict:
    """Minimum, maximum, mean and standard deviation of each column; every column must hold at least one number."""
    found: dict[str, Any] = {"min": np.nanmin, "max": np.nanmax, "mean": np.nanmean, "std": np.nanstd}
    return {name: of(values, axis=0).tolist() for name, of in found.items()}


def info(samples: Samples, episodes: list[list[int]], times: list[list[float]]) -> dict:
    """meta/info.json."""
    splits: dict[str, list[int]] = {}
    for number, rows in enumerate(episodes):
        splits.setdefault(samples.rows[rows[0]]["split"], []).append(number)
    return {
        "codebase_version": VERSION, "robot_type": "gelsight_mini", "total_episodes": len(episodes),
        "total_frames": len(samples), "total_tasks": 1, "chunks_size": CHUNK_FILES, "fps": usual_rate(times),
        "data_files_size_in_mb": int(FILE_BYTES / 1e6), "video_files_size_in_mb": 200,
        "splits": {name: f"{numbers[0]}:{numbers[-1] + 1}" for name, numbers in splits.items()},
        "data_path": DATA_PATH, "video_path": None, "features": features(samples), "gelforge": samples.facts(),
    }  # fmt: skip
