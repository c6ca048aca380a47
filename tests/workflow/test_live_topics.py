"""`gelforge live` to Foxglove and to MCAP: a real client of the protocol, the recording beside it, and what goes wrong."""

import re
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from gelforge.commands import live
from gelforge.commands.live_topics import send
from gelforge.errors import BadInput
from gelforge.live.foxglove import FoxgloveServer
from gelforge.live.reading import Reading
from gelforge.live.recording import McapRecorder
from gelforge.live.topics import RosMessages
from gelforge.networks.inference.predictor import load_for_use
from gelforge.records.forcereading import ForceReading
from gelforge.records.image import decode
from tests.support.films import write_film
from tests.support.foxglove_client import FoxgloveClient
from tests.support.limited import limited_python
from tests.support.waiting import HANG, wait_until

TYPES = {
    "image/compressed": "sensor_msgs/msg/CompressedImage",
    "wrench": "geometry_msgs/msg/WrenchStamped",
    "wrench/low": "geometry_msgs/msg/WrenchStamped",
    "wrench/high": "geometry_msgs/msg/WrenchStamped",
    "forces/normal": "sensor_msgs/msg/Image",
    "forces/along_x": "sensor_msgs/msg/Image",
    "forces/along_y": "sensor_msgs/msg/Image",
    "flag": "diagnostic_msgs/msg/DiagnosticArray",
}


TOPICS = {f"/gelforge/{name}": kind for name, kind in TYPES.items()}


def reading(number, image=None, **other):
    """A reading of a frame, 25 of which are a second."""
    forces = np.random.default_rng(number).normal(0, 0.1, (3, 4, 5)).astype(np.float32)
    picture = np.full((6, 8, 3), 90, np.uint8) if image is None else image
    said = {"reason": "dark" if number % 2 else "", "half_width": np.array([0.1, 0.2, 0.3]), "edge_peak": 0.0}
    total = forces.sum((1, 2), dtype=np.float64)
    found = ForceReading(cells=forces, total=total, ood_score=1.0, image=picture, **(said | other))
    return Reading(number, 0.04 * number, found, ms=3.0)


def number_of(message) -> int:
    return int({pair.key: pair.value for pair in message.status[0].values}["frame"])


def recorded(path):
    """[(topic, time, message)] of an MCAP, and {topic: type}."""
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        found = [(c.topic, message.log_time, said) for _, c, message, said in reader.iter_decoded_messages()]
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
        return found, {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}


@contextmanager
def server():
    found = FoxgloveServer("127.0.0.1", 0)
    try:
        yield found
    finally:
        found.stop()


def hear(client, last, found):
    """Read messages until the flag of the frame `last`."""
    for topic, stamp, said in client.messages():
        found.append((topic, stamp, said))
        if topic.endswith("/flag") and number_of(said) == last:
            return


def frames_of(heard):
    return [number_of(said) for topic, _, said in heard if topic.endswith("/flag")]


def test_a_client_reads_every_topic_and_the_recording_holds_the_same(tmp_path):
    recorder, topics, heard, last = McapRecorder(tmp_path), RosMessages("gelforge"), [], 60
    recorder.start()
    with server() as serving:
        client = FoxgloveClient(serving.url, HANG)
        hearing = threading.Thread(target=hear, args=(client, last, heard))
        hearing.start()
        send(iter([reading(0)]), topics, serving, recorder)  # announces the topics
        wait_until(lambda: len(client.channels) == len(TOPICS))
        pause = (time.sleep(0.02) or reading(k) for k in range(1, last + 1))
        assert send(pause, topics, serving, recorder) == (last, None)
        hearing.join(HANG)
        client.close()
    recorder.stop()
    (path,) = tmp_path.iterdir()
    kept, types = recorded(path)
    assert types == TOPICS == {topic: channel["schemaName"] for topic, channel in client.channels.items()}
    assert {channel["encoding"] for channel in client.channels.values()} == {"cdr"}
    by_place = {(topic, time): repr(said) for topic, time, said in kept}
    assert len(by_place) == len(TOPICS) * (last + 1)
    assert all(repr(said) == by_place[topic, time] for topic, time, said in heard)
    seen = frames_of(heard)
    assert seen == list(range(seen[0], last + 1)) and seen[0] <= 2  # none is missing once topics are subscribed to


def test_a_message_says_what_was_read():
    topics = RosMessages("9 Mini R0B-2", start_ns=10**18)
    read = reading(1)
    found = {topic: said for topic, _, said in topics.messages(read, 10**18)}
    top = "/sensor_9_Mini_R0B_2"
    assert found.keys() == {f"{top}/{name}" for name in TYPES}
    along_y, along_x, normal = read.found.cells.sum((1, 2), dtype=np.float64)
    assert found[f"{top}/wrench"]["wrench"]["force"] == pytest.approx({"x": along_x, "y": along_y, "z": normal})
    high, low = (found[f"{top}/wrench/{name}"]["wrench"]["force"] for name in ("high", "low"))
    assert {axis: high[axis] - low[axis] for axis in "xyz"} == pytest.approx({"x": 0.4, "y": 0.2, "z": 0.6})
    assert np.array_equal(
        np.frombuffer(found[f"{top}/forces/along_x"]["data"], "<f4").reshape(4, 5), read.found.cells[1]
    )
    assert np.abs(decode(found[f"{top}/image/compressed"]["data"], "it").astype(int) - 90).max() <= 2
    (status,) = found[f"{top}/flag"]["status"]
    assert status["level"] == 1 and status["message"] == "dark"
    assert topics(read)[0] == 10**18 + 40_000_000
    without = reading(1, half_width=None)
    assert not [topic for topic, _, _ in topics.messages(without, 0) if topic.endswith(("low", "high"))]


def test_viewers_that_leave_do_not_disturb_the_others(capfd):
    topics, heard = RosMessages("gelforge"), []
    with server() as serving:
        stays, leaves = FoxgloveClient(serving.url, HANG), FoxgloveClient(serving.url, HANG)
        hearing = [
            threading.Thread(target=hear, args=(client, 40, found))
            for client, found in ((stays, heard), (leaves, []))
        ]
        for thread in hearing:
            thread.start()
        send(iter([reading(0)]), topics, serving, None)
        wait_until(lambda: len(stays.channels) == len(leaves.channels) == len(TOPICS))
        send((reading(k) for k in range(1, 21)), topics, serving, None)
        leaves.socket.sock.shutdown(socket.SHUT_RDWR)  # no farewell, as of a computer that was switched off
        send((reading(k) for k in range(21, 41)), topics, serving, None)
        for thread in hearing:
            thread.join(HANG)
        shown = [capfd.readouterr().err]
        wait_until(lambda: shown.append(capfd.readouterr().err) or "left; the others go on" in "".join(shown))
    seen = frames_of(heard)
    assert seen == list(range(seen[0], 41))


def test_a_port_in_use_is_one_sentence():
    with server() as first, pytest.raises(BadInput, match=r"port \d+ of 127.0.0.1: cannot be served .*--port"):
        FoxgloveServer("127.0.0.1", int(first.url.rpartition(":")[2]))


@pytest.mark.parametrize("port", [-1, 99999])
def test_a_number_that_no_port_has_is_one_sentence(port):
    with pytest.raises(BadInput, match=f"port {port} of .*--port"):
        FoxgloveServer("127.0.0.1", port)


FILL = """
import sys
from pathlib import Path
from gelforge.commands.live_topics import send
from gelforge.live.recording import McapRecorder
from gelforge.live.topics import RosMessages
from tests.workflow.test_live_topics import reading
import numpy as np
recorder = McapRecorder(Path(sys.argv[1]))
recorder.start()
noise = np.random.default_rng(0).integers(0, 255, (240, 320, 3), np.uint8)
print(*send((reading(k, noise) for k in range(40)), RosMessages("gelforge"), None, recorder))
"""


def test_a_full_disk_leaves_no_recording(tmp_path):
    """The shell's limit on the size of a file stands for the disk."""
    ran = limited_python(64, "-c", FILL, tmp_path / "kept")
    assert re.match(r"\d+ .*the recording is lost .*free space", ran.stdout), (ran.stdout, ran.stderr)
    assert int(ran.stdout.split()[0]) < 40 and not list((tmp_path / "kept").iterdir())


def test_a_recording_that_is_lost_ends_and_the_next_one_is_whole(tmp_path):
    recorder, topics = McapRecorder(tmp_path), RosMessages("mini", start_ns=0)
    recorder.start()
    recorder.add(topics(reading(0)))
    (tmp_path / f"{recorder.name}.mcap").mkdir()
    with pytest.raises(BadInput, match="the recording is lost"):
        recorder.stop()
    name = recorder.start()
    recorder.add(topics(reading(0)))
    assert recorder.stop() == 1 and len(recorded(tmp_path / f"{name}.mcap")[0]) == len(TYPES)
    assert not list(tmp_path.glob(".*.part"))


def test_recording_beside_lines_is_asked_about(tmp_path):
    args = ["--video", tmp_path / "a.avi", "--record", tmp_path, "--jsonl", tmp_path / "a.jsonl"]
    with pytest.raises(BadInput, match="--jsonl or --csv do not go together"):
        live.main([str(word) for word in args])


def test_the_command_serves_a_film_and_records_it(root, tmp_path):
    rest, press = (
        cv2.imread(str(root / "data/demo" / name)) for name in ("nocontact/mini_a.png", "images/demo-000000.png")
    )
    film = write_film(tmp_path / "film.avi", [rest] * 16 + [press] * 4)
    command = [sys.executable, "-m", "gelforge.commands.live", "--video", film, "--foxglove", "--port", "0"]
    child = subprocess.Popen(
        [*command, "--record", tmp_path / "kept"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    client = FoxgloveClient(re.match(r"(ws://\S+) shows", child.stdout.readline())[1], HANG)
    hearing = threading.Thread(target=lambda: list(client.messages()))
    hearing.start()
    wait_until(lambda: any("ended after 12 frames" in said for said in client.status), of=child)
    child.send_signal(signal.SIGINT)
    said, shown = child.communicate(timeout=HANG)
    hearing.join(HANG)
    assert child.returncode == 0 and "Traceback" not in shown, shown
    (path,) = (tmp_path / "kept").iterdir()
    # those before the no-contact image are not read
    assert f"{path}: 12 frames" in said and frames_of(recorded(path)[0]) == list(range(8, 20))
    known = load_for_use(None).metadata.get("intervals", {}).get("total")
    ends = set() if known else {f"/gelforge/wrench/{end}" for end in ("low", "high")}
    assert client.channels.keys() == TOPICS.keys() - ends
