"""Every export comes back exactly through its format's own library, and none is left half-written."""

import errno
import json
import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

from gelforge.commands.export import FORMATS, export, whole_or_absent
from gelforge.errors import BadInput
from gelforge.flow.files import read_csv, read_json, write_csv
from gelforge.formats.export import lerobot, ros
from gelforge.formats.export.samples import Samples
from gelforge.records.image import decode
from tests.support.exported import READERS, lay, read_mcap
from tests.support.limited import limited, small_disk
from tests.support.no_locks import without_locks
from tests.support.refused import refused


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.processes
def test_what_was_exported_comes_back_exactly(tmp_path, form, block):
    """Row by row through the format's own library, also from a second block, file and folder of files."""
    samples = lay(tmp_path, 22)
    suffix, read = READERS[form]
    out = tmp_path / f"out{suffix}"
    export(samples, form, out)
    found, facts = read(out)
    assert set(found) == {row["sample_id"] for row in samples.rows}
    for sample in samples:
        row, picture, label, total = found[sample.name]
        assert row.items() <= sample.cells.items() and picture == sample.picture
        numbers = {name for name, value in row.items() if isinstance(value, float)}
        # numbers are numbers, not text; LeRobot's lie in features of their own
        assert form == "lerobot" or (numbers >= {"fx_n", "dz_mm", "rot_deg"} and "sample_id" not in numbers)
        assert label.dtype == np.float32 and np.array_equal(label, sample.label)
        # LeRobot's state is single precision.
        assert total == (pytest.approx(sample.wrench(), rel=1e-7) if form == "lerobot" else sample.wrench())
    assert facts == json.loads(samples.facts_text())
    assert {"units", "frame", "sensors", "calibration"} <= facts.keys() and set(facts["sensors"]) == {
        "mini_a",
        "mini_e",
    }


WRITES_ALL = """
from pathlib import Path
import sys
from gelforge.commands.export import FORMATS, export
from tests.support.exported import READERS, lay
samples = lay(Path(sys.argv[1]), 4)
for form in FORMATS:
    export(samples, form, Path(sys.argv[1]) / f"{form}{READERS[form][0]}")
"""


@pytest.mark.slow
@pytest.mark.processes
@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOTSUP])
def test_a_file_system_without_locks_takes_every_export(tmp_path, number):
    done = without_locks(number, sys.executable, "-c", WRITES_ALL, tmp_path)
    assert done.returncode == 0, done.stderr
    for form in FORMATS:
        suffix, read = READERS[form]
        assert len(read(tmp_path / f"{form}{suffix}")[0]) == 4


def test_frames_of_a_press_are_the_rows_that_share_its_name_and_sensor(tmp_path):
    """In the log's order: on its way sideways a frame may rise a little. A place pressed twice is two presses."""
    samples = lay(tmp_path, 6)
    for at, row in enumerate(samples.rows):
        row |= {
            "group": "0",
            "split": "train",
            "sensor_id": ("mini_a", "mini_e")[at // 4],
            "press_id": ("p", "p", "", "", "p", "p")[at],
        }
    assert samples.frames_of_presses == [[0, 1], [2], [3], [4, 5]]


@pytest.mark.parametrize(
    ("times", "said"),
    [
        (["2026-04-08T12:25:19Z", ""], "time_utc of s1 is empty"),
        (
            ["2026-04-08T12:25:19Z", "2026-04-08T12:25:19Z"],
            "time_utc of s1 is 2026-04-08T12:25:19Z, not after",
        ),
        (["2026-04-08T12:25:19.4Z", "2026-04-08T12:25:19.2"], "in order of time, without repeats"),
        (["2026-04-08T12:25:19Z", "2026-04-08T12:25:21.400+00:00"], ""),
    ],
)
def test_times_of_frames_are_true_ones_or_a_refusal(tmp_path, times, said):
    """Counted as 0, 0.1, 0.2 s they were wrong without a word."""
    samples = lay(tmp_path, 4)
    rows = [
        {"sample_id": f"s{k}", "time_utc": (times + ["2026-04-08T12:26:00Z", "2026-04-08T12:26:02.4Z"])[k]}
        for k in range(4)
    ]
    write_csv(samples.data / "log.csv", list(rows[0]), rows)
    if said:
        refused(said, export, samples, "lerobot", tmp_path / "out")
        assert not (tmp_path / "out").exists()
        return
    export(samples, "lerobot", tmp_path / "out")
    table = pyarrow.parquet.read_table(tmp_path / "out/data").to_pylist()
    assert [row["timestamp"] for row in table] == pytest.approx([0.0, 2.4, 0.0, 2.4])
    assert read_json(tmp_path / "out/meta/info.json")["fps"] == 1


@pytest.mark.parametrize("image", [(32, 24), (24, 32)], ids=["across", "upright"])
def test_lerobot_finds_episodes_splits_and_what_it_normalises_by(tmp_path, image, block):
    """Its factory wants min, max, mean, std and count of every feature."""
    samples = lay(tmp_path, 22, image=image)
    export(samples, "lerobot", tmp_path / "out")
    info = read_json(tmp_path / "out/meta/info.json")
    ends = sorted(tuple(map(int, run.split(":"))) for run in info["splits"].values())
    assert ends[0][0] == 0 and ends[-1][1] == info["total_episodes"] == 11
    assert all(before[1] == after[0] for before, after in pairwise(ends))
    assert info["codebase_version"] == "v3.0" and "tactile" in (tmp_path / "out/README.md").read_text()
    reported = read_json(tmp_path / "out/meta/stats.json")
    levels = np.stack([decode(sample.picture, sample.name) for sample in samples]).reshape(-1, 3) / 255
    for name, values, shape in (
        ("observation.forces", np.asarray(samples.labels, float).reshape(22, -1), (144,)),
        ("observation.wrench", [record.wrench for record in samples.records], (6,)),
        ("observation.images.gelsight", levels, (3, 1, 1)),
    ):
        assert reported[name].pop("count") == [22] and set(reported[name]) == {"min", "max", "mean", "std"}
        for what, of in (("min", np.min), ("max", np.max), ("mean", np.mean), ("std", np.std)):
            assert np.shape(reported[name][what]) == shape
            np.testing.assert_allclose(np.ravel(reported[name][what]), of(values, axis=0), rtol=1e-6, atol=1e-9)


def test_of_many_pictures_some_give_the_ranges(tmp_path, monkeypatch):
    monkeypatch.setattr(lerobot, "MOST_PICTURES", 5)
    reported = lerobot.picture_stats(lay(tmp_path, 22))
    assert reported["count"] == [5] and 0.4 < reported["mean"][0][0][0] < 0.6


LEROBOT = Path(__file__).parents[3] / ".venv-lerobot" / "ready"  # there where `make lerobot-env` made it


def opened_by_lerobot(folder: Path, home: Path) -> dict:
    """What LeRobot's training factory finds in an export, in an environment of its own; home: its caches."""
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    env |= {"HF_HUB_OFFLINE": "1", "HF_HOME": str(home / "hub"), "HOME": str(home)}
    command = [LEROBOT.parent / "bin" / "python", Path(__file__).with_name("lerobot_opens.py"), folder]
    ran = subprocess.run(command, capture_output=True, text=True, check=False, env=env, cwd=home)
    if ran.returncode:
        raise RuntimeError(ran.stderr[-3000:])
    return json.loads(ran.stdout.splitlines()[-1])


@pytest.mark.skipif(
    not LEROBOT.exists(), reason="no environment with LeRobot; `make lerobot-env` makes it, in minutes"
)
def test_lerobots_own_factory_opens_and_iterates_an_export(tmp_path):
    """With its defaults, for two policies and as a stream."""
    samples = lay(tmp_path, 22)
    export(samples, "lerobot", tmp_path / "out")
    found = opened_by_lerobot(tmp_path / "out", tmp_path)
    rows = [at for rows in lerobot.in_order_of_splits(samples) for at in rows]
    for policy, frames in (("act", 1), ("diffusion", 2)):
        of = found[policy]
        assert of["frames"] == 22 and of["episodes"] == 11 and of["task"] == "press the gel"
        assert of["sample_id"] == [samples.rows[at]["sample_id"] for at in rows]
        # a policy that looks back is given the frame before, too
        assert of["shape"] == ([3, 24, 32] if frames == 1 else [2, 3, 24, 32])
        now = np.array(of["wrench"]).reshape(4, frames, 6)[:, -1]
        np.testing.assert_allclose(now, [samples.sample(at).wrench() for at in rows[:4]], rtol=1e-6)
        assert 0.4 < of["mean"] < 0.6
    assert found["streamed"] == 22
    assert np.shape(found["stats"]["observation.images.gelsight"]["std"]) == (3, 1, 1)


def test_channels_are_named_by_the_axes_that_they_lie_along(tmp_path):
    facts = json.loads(lay(tmp_path, 2).facts_text())
    assert [words.split()[-1] for words in facts["channels"]] == ["x", "y", "z"]


def test_a_dataset_without_pictures_is_refused(tmp_path):
    samples = lay(tmp_path, 4)
    table = samples.dataset / "samples.csv"
    lines = table.read_text().splitlines()
    table.write_text("\n".join([lines[0], *(line.rsplit(",", 1)[0] + "," for line in lines[1:])]) + "\n")
    with pytest.raises(BadInput, match="no sample with a picture"):
        type(samples).open(samples.data, samples.dataset, tmp_path / "sensors.json")


@pytest.mark.processes
def test_a_lost_picture_is_named_and_nothing_is_left(tmp_path):
    samples = lay(tmp_path, 6)
    (samples.data / "images/s3.png").unlink()
    for form in FORMATS:
        refused(r"s3\.png", export, samples, form, tmp_path / "out" / "x")
        assert not list((tmp_path / "out").iterdir())


def test_a_picture_outside_the_dataset_is_not_read(tmp_path):
    samples = lay(tmp_path, 4)
    samples.rows[1]["image"] = "../../../etc/hostname.png"
    refused("points outside", samples.sample, 1)


def test_a_folder_that_no_export_wrote_is_never_replaced(tmp_path):
    samples, mine = lay(tmp_path, 4), tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.txt").write_text("five years")
    for form in FORMATS:
        refused("no export wrote", export, samples, form, mine)
    assert [path.name for path in mine.iterdir()] == ["thesis.txt"]


def test_an_earlier_export_stays_where_a_new_one_fails(tmp_path):
    path = tmp_path / "held"
    path.write_text("earlier")
    with pytest.raises(BadInput, match="free space"), whole_or_absent(path) as part:
        part.write_text("half")
        raise OSError(28, "No space left on device")
    assert path.read_text() == "earlier" and [p.name for p in tmp_path.iterdir()] == ["held"]


SLOW_BUT_HDF5 = [pytest.param(form, marks=() if form == "hdf5" else pytest.mark.slow) for form in FORMATS]


@pytest.mark.parametrize("form", SLOW_BUT_HDF5)
@pytest.mark.processes
def test_a_disk_that_is_full_or_fills_while_writing_is_a_sentence(tmp_path, form):
    """There is no room, or enough when the export begins and none later: then the limit is on the file, not on the disk."""
    samples = lay(tmp_path, 60)
    words = ["gelforge.commands.export", "--data", samples.data, "--dataset", samples.dataset, "--sensors",
             tmp_path / "sensors.json", "--format", form, "--out"]  # fmt: skip
    with small_disk(tmp_path / "disk") as disk:
        for out, kib in ((disk, 10**6), (tmp_path / "out", 32)):
            ran = limited(kib, *words, out / "x")
            assert ran.returncode == 2 and "free space" in ran.stderr and "Traceback" not in ran.stderr, ran.stderr
            assert "error: " in ran.stderr and not list(out.iterdir())


def test_an_unknown_format_is_one_sentence(tmp_path):
    refused("choose one of mcap", export, lay(tmp_path, 4), "xml", tmp_path / "out")


def test_a_dataset_without_poses_goes_to_lerobot(tmp_path):
    """What was imported with labels alone has none; the format's statistics then know nothing of them."""
    samples = lay(tmp_path, 12)
    table = samples.dataset / "samples.csv"
    rows = read_csv(table)
    poses = [name for name in rows[0] if name.endswith("_mm") or name == "rot_deg"]
    write_csv(table, list(rows[0]), [row | dict.fromkeys(poses, "") for row in rows])
    opened = Samples.open(samples.data, samples.dataset, tmp_path / "sensors.json")
    export(opened, "lerobot", tmp_path / "out")
    back = READERS["lerobot"][1](tmp_path / "out")[0]
    assert len(back) == 12
    stats = read_json(tmp_path / "out" / "meta" / "stats.json")
    assert any("force" in name for name in stats) and all(
        "NaN" not in json.dumps(values) for values in stats.values()
    )


NAMES = ["GelSight Mini R0B 2BNN", "GelSight-Mini-R0B-2BNN", "GelSight_Mini_R0B_2BNN", "2BNN", "größe", "指", "a__b_", "x" * 300,
         "x" * 301, "mini_a"]  # fmt: skip


def test_topics_have_names_that_ros_2_allows_and_no_two_sensors_share_one():
    tokens = ros.topic_tokens(NAMES)
    assert list(tokens) != [] and set(tokens) == set(NAMES) and len(set(tokens.values())) == len(NAMES)
    for token in tokens.values():
        assert token.isascii() and token.replace("_", "").isalnum() and not token[0].isdigit()
        assert "__" not in token and not token.endswith("_") and len(f"/{token}/image/compressed") < 247
    assert tokens["mini_a"] == "mini_a" and tokens["GelSight_Mini_R0B_2BNN"] == "GelSight_Mini_R0B_2BNN"
    assert ros.topic_tokens(NAMES[:1])[NAMES[0]] == "GelSight_Mini_R0B_2BNN"


def test_an_export_of_a_sensor_with_blanks_has_legal_topics_and_frames(tmp_path):
    from mcap_ros2.reader import read_ros2_messages

    samples = lay(tmp_path, 4)
    for row in samples.rows:
        row["sensor_id"] = "GelSight Mini R0B 2BNN" if row["sensor_id"] == "mini_a" else "GelSight-Mini R0B 2BNN"
    export(samples, "mcap", tmp_path / "out.mcap")
    found, _ = read_mcap(tmp_path / "out.mcap")
    assert {row["sensor_id"] for row, *_ in found.values()} == {row["sensor_id"] for row in samples.rows}
    topics = {}
    for message in read_ros2_messages(str(tmp_path / "out.mcap")):
        frame = getattr(getattr(message.ros_msg, "header", None), "frame_id", "")
        topics[message.channel.topic] = frame
    assert {topic.split("/")[1] for topic in topics} == {
        "facts", "GelSight_Mini_R0B_2BNN", "GelSight_Mini_R0B_2BNN_2",
    }  # fmt: skip
    assert all(set(topic) <= set("/_") | {c for c in topic if c.isascii() and c.isalnum()} for topic in topics)
    assert {frame for frame in topics.values() if frame} == {
        "GelSight_Mini_R0B_2BNN_gel",
        "GelSight_Mini_R0B_2BNN_2_gel",
    }
