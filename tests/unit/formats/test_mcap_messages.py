"""A damaged MCAP file is refused, or gives exactly what the whole one gave."""

import pytest
from mcap.writer import CompressionType, Writer

from gelforge.errors import BadInput
from gelforge.formats.export import ros
from gelforge.formats.mcap_messages import messages, recordings_of
from tests.support.refused import refused

KIND = "geometry_msgs/msg/WrenchStamped"
COUNT = 12


def record(path, compression="LZ4", profile="ros2", encoding="ros2msg"):
    """Wrenches of 0 to 11 N in several chunks."""
    with path.open("wb") as stream:
        writer = Writer(stream, 600, compression=CompressionType[compression])
        writer.start(profile, "test")
        schema = writer.register_schema(KIND, encoding, ros.schema(KIND).encode())
        channel = writer.register_channel("/ft", "cdr" if encoding == "ros2msg" else "ros1", schema)
        for k in range(COUNT):
            said = ros.encode(ros.wrench(ros.header(k * 10**7, "ft"), [0.0, 0.0, -k, 0.0, 0.0, 0.0]))
            writer.add_message(channel, k * 10**7, said, k * 10**7)
        writer.finish()
    return path


def read(path):
    return [(time, said.wrench.force.z, said.header.stamp.nanosec) for _, time, said in messages(path, ["/ft"])]


@pytest.mark.parametrize("compression", ["NONE", "LZ4"])
def test_one_flipped_bit_is_refused_or_changes_nothing(tmp_path, compression):
    """At every eleventh byte of the file: of 12 imports 11 changed images or lost rows and said nothing."""
    path = record(tmp_path / "a.mcap", compression)
    whole, expected = path.read_bytes(), read(path)
    assert [z for _, z, _ in expected] == [-k for k in range(COUNT)]
    lost = []
    for at in range(0, len(whole), 11):
        harmed = bytearray(whole)
        harmed[at] ^= 1 << at % 8
        path.write_bytes(harmed)
        try:
            assert read(path) == expected, at
        except BadInput as error:
            lost.append(at)
            assert str(error).startswith(f"{path}: ") and ("mcap recover" in str(error) or "convert" in str(error))
    chunk = whole.index(b"\x06", 100) + 80
    assert any(abs(at - chunk) < 20 for at in lost)  # within a chunk's data


def test_what_is_no_recording_of_ros_2_is_one_sentence(tmp_path):
    whole = record(tmp_path / "a.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.mcap").write_text("not a recording")
    record(tmp_path / "old.mcap", profile="ros1", encoding="ros1msg")
    for name, said in (
        ("cut.mcap", "repair it with `mcap recover`"),
        ("text.mcap", "repair it with `mcap recover`"),
        ("old.mcap", "neither ROS 2, protobuf nor JSON .*rosbags-convert"),
        ("none.mcap", "cannot be read"),
    ):
        refused(f"{name}: .*{said}", read, tmp_path / name)


def test_nothing_in_a_folder_is_passed_over_without_a_word(tmp_path):
    """A bag without metadata.yaml and a .bag.active were; `._one.mcap` of a Mac ended the import."""
    record(tmp_path / "good.mcap")
    (tmp_path / "._good.mcap").write_bytes(b"\x00\x05\x16\x07")
    (tmp_path / "killed.bag.active").write_bytes(b"#ROSBAG V2.0\n")
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "bag_0.db3").write_bytes(b"SQLite format 3\x00")
    (tmp_path / "notes.txt").write_text("of the lab")
    found, notes = recordings_of(tmp_path)
    assert [path.name for path in found] == ["bag", "good.mcap", "killed.bag.active"]
    assert any("._good.mcap" in note for note in notes) and any("notes.txt" in note for note in notes)
    for name, cure in (
        ("killed.bag.active", "run `rosbag reindex killed.bag.active`"),
        ("bag", "without its metadata.yaml: run `ros2 bag reindex bag`"),
        ("bag/bag_0.db3", "ros2 bag reindex"),
    ):
        refused(f"{name}: cannot be read: .*{cure}", read, tmp_path / name)
    (tmp_path / "cut.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(40))
    refused("rosbag reindex cut.bag", read, tmp_path / "cut.bag")


def test_a_folder_of_mcap_without_metadata_is_read(tmp_path):
    (tmp_path / "bag").mkdir()
    path = record(tmp_path / "bag" / "bag_0.mcap")
    assert recordings_of(tmp_path / "bag") == ([path], [])


def test_files_of_a_bag_that_its_metadata_do_not_name_are_not_lost(tmp_path):
    """The metadata of a recording that was cut into files may name the last one alone."""
    bag = tmp_path / "bag"
    bag.mkdir()
    for name in ("bag_0.mcap", "bag_10.mcap"):
        record(bag / name)
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  relative_file_paths:\n    - bag_10.mcap\n")
    refused("does not name bag_0.mcap, which lies beside it: run `ros2 bag reindex bag`", read, bag)
