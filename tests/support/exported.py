"""A small dataset of stage 60 with image files, and readers of every export by the library of its format."""

import json

import cv2
import numpy as np

from gelforge.flow.files import write_csv, write_json
from gelforge.formats.export.samples import Samples

GRID = (6, 8)
SENSORS = {name: {"gel": "gelsight_mini", "image": [32, 24], "projection": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}
           for name in ("mini_a", "mini_e")}  # fmt: skip


def lay(folder, count: int, grid=GRID, image=(32, 24)):
    """Write a dataset of `count` samples, two frames per press, of two sensors; return it opened."""
    rng = np.random.default_rng(5)
    data, dataset = folder / "data" / "lab", folder / "results" / "lab" / "60_dataset" / "6x8"
    (data / "images").mkdir(parents=True)
    dataset.mkdir(parents=True)
    labels, rows = rng.normal(0, 0.1, (count, 3, *grid)).astype(np.float32), []
    for k in range(count):
        suffix = "jpg" if k % 5 == 4 else "png"
        picture = rng.integers(0, 255, (image[1], image[0], 3), np.uint8)
        cv2.imwrite(str(data / "images" / f"s{k}.{suffix}"), picture)
        split = ("train", "train", "val", "test")[k // 2 % 4]
        pose = {
            name: round(float(rng.normal()), 4) for name in ("x0_mm", "y0_mm", "z0_mm", "dx_mm", "dy_mm", "rot_deg")
        }
        rows.append({"sample_id": f"s{k}", "indenter": "ball, 3 mm", "sensor_id": ("mini_a", "mini_e")[k // 2 % 2],
                     "gel_id": "g", "split": split, "group": str(k // 2), "fx_n": 0.1 * k, "fy_n": -0.25, "fz_n": -1.5 * k,
                     "mx_nm": 0.01 * k, "my_nm": -0.02, "mz_nm": 0.003 * k,
                     "dz_mm": -0.5 - (k % 2), **pose, "press_id": f"p{k // 2}", "image": f"images/s{k}.{suffix}"})  # fmt: skip
    write_csv(dataset / "samples.csv", list(rows[0]), rows)
    times = [f"2026-04-08T12:25:{k // 2:02d}.{125 * (k % 2):03d}Z" for k in range(count)]
    write_csv(data / "log.csv", ["sample_id", "time_utc"],
              [{"sample_id": row["sample_id"], "time_utc": time} for row, time in zip(rows, times, strict=True)])  # fmt: skip
    np.save(dataset / "labels.npy", labels)
    write_json(dataset / "dataset.json", {"name": "lab", "image": list(image), "grid": list(grid), "c10": 0.08})
    write_json(folder / "sensors.json", SENSORS)
    return Samples.open(data, dataset, folder / "sensors.json")


def read_mcap(path):
    """{sample_id: (row, image, label, force and moment)}, and the metadata, with mcap's reader and its ROS 2 decoder."""
    from mcap_ros2.reader import read_ros2_messages

    found, facts, place = {}, None, {"along_x": 0, "along_y": 1, "normal": 2}
    for message in read_ros2_messages(str(path)):
        topic, said = message.channel.topic, message.ros_msg
        if topic == "/facts":
            facts = json.loads(said.data)
            continue
        sample = found.setdefault(message.log_time_ns, {"maps": {}})
        if topic.endswith("/image/compressed"):
            sample["picture"] = bytes(said.data)
            assert message.schema.name == "sensor_msgs/msg/CompressedImage" and said.format in ("png", "jpeg")
        elif topic.endswith("/wrench"):
            both = said.wrench.force, said.wrench.torque
            sample["wrench"] = [getattr(part, axis) for part in both for axis in "xyz"]
        elif topic.endswith("/sample"):
            sample["row"] = json.loads(said.data)
        else:
            grid = np.frombuffer(bytes(said.data), "<f4").reshape(said.height, said.width)
            sample["maps"][place[topic.rsplit("/", 1)[1]]] = grid
    return {s["row"]["sample_id"]: (s["row"], s["picture"], np.stack([s["maps"][k] for k in range(3)]), s["wrench"])
            for s in found.values()}, facts  # fmt: skip


def cell(value):
    """A text, or a number; None for NaN."""
    return value if isinstance(value, str) else None if np.isnan(value) else float(value)


def read_hdf5(path):
    """The same with h5py."""
    import h5py

    with h5py.File(path) as file:
        names = list(file["samples"])
        tables = {name: file[f"samples/{name}"] for name in names}
        columns = {
            name: table.asstr()[:] if h5py.check_string_dtype(table.dtype) else table[:]
            for name, table in tables.items()
        }
        facts = {
            name: value if name in ("dataset", "signs", "frame") else json.loads(value)
            for name, value in file.attrs.items()
        }
        return {
            str(columns["sample_id"][k]): ({name: cell(columns[name][k]) for name in names}, bytes(file["picture"][k]),
                                           file["forces"][k], [*file["total"][k].tolist(), *file["moment"][k].tolist()])
            for k in range(len(columns["sample_id"]))
        }, facts  # fmt: skip


def read_lerobot(folder):
    """The same with pyarrow, along the paths that meta/info.json and meta/episodes name."""
    import pyarrow.parquet as pq

    info = json.loads((folder / "meta" / "info.json").read_text())
    episodes = pq.read_table(folder / "meta/episodes").to_pylist()
    found = {}
    for episode in episodes:
        path = info["data_path"].format(
            chunk_index=episode["data/chunk_index"], file_index=episode["data/file_index"]
        )
        rows = pq.read_table(folder / path, filters=[("episode_index", "=", episode["episode_index"])]).to_pylist()
        assert [row["index"] for row in rows] == list(
            range(episode["dataset_from_index"], episode["dataset_to_index"])
        )
        assert [row["frame_index"] for row in rows] == list(range(episode["length"]))
        for row in rows:
            kept = {name: row[name] for name in ("sample_id", "indenter", "sensor_id", "split")}
            label = np.array(row["observation.forces"], np.float32).reshape(3, *info["gelforge"]["grid"])
            found[row["sample_id"]] = (
                kept,
                row["observation.images.gelsight"]["bytes"],
                label,
                row["observation.wrench"],
            )
    return found, info["gelforge"]


READERS = {
    "mcap": (".mcap", read_mcap), "hdf5": (".h5", read_hdf5), "lerobot": ("", read_lerobot),
}  # fmt: skip
