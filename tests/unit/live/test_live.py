"""`gelforge live`: what each output holds, that all hold the same, and what becomes of them when something goes wrong."""

import csv
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from argparse import Namespace
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from gelforge.commands import live
from gelforge.errors import BadInput
from gelforge.live.reading import APART, StartInDoubt, readings
from gelforge.live.recording import CsvTable, McapRecording
from gelforge.live.topics import RosMessages
from gelforge.live.weigh import Moment
from gelforge.reading.model import load_model
from gelforge.reading.reader import Reader
from gelforge.records.film import Film, Frame, open_source
from gelforge.records.image import decode
from gelforge.records.nocontactimage import SETTLING
from tests.support.browser import needs_browser, wait_for
from tests.support.films import write_film
from tests.support.foxglove_client import FoxgloveClient
from tests.support.limited import limited_python
from tests.support.readings import reading
from tests.support.refused import refused
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
FRAMES = 24


@pytest.fixture(scope="module")
def film(root, tmp_path_factory):
    """A gel at rest, then pictures of the demo, ten frames a second."""
    names = ["nocontact/mini_a.png", *(f"images/demo-{k:06d}.png" for k in range(6))]
    rest, *pictures = (cv2.imread(str(root / "data/demo" / name)) for name in names)
    shown = (rest if k < 16 else pictures[k % 6] for k in range(FRAMES))
    return write_film(tmp_path_factory.mktemp("film") / "film.avi", shown, 10.0)


def number_of(message) -> int:
    return int({pair.key: pair.value for pair in message.status[0].values}["frame"])


def recorded(path):
    """[(topic, time, message)] of an MCAP, and {topic: type}, by the library's own readers."""
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        found = [(c.topic, message.log_time, said) for _, c, message, said in reader.iter_decoded_messages()]
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
        return found, {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}


def outputs(stack, **asked):
    args = Namespace(**{"web": False, "foxglove": False, "record": None, "csv": None, "host": "127.0.0.1", "port": 0,
                        "sensor": None, "profile": None} | asked)  # fmt: skip
    return live.outputs_of(args, "film", stack)


@contextmanager
def running(*words):
    """The command, ended by an interrupt: yields (process, addresses of its servers, what it said)."""
    child = subprocess.Popen(
        [sys.executable, "-m", "gelforge.commands.live", *map(str, words)], stderr=subprocess.PIPE, text=True
    )
    said, wanted = [], {"--web", "--foxglove"} & set(words)
    addresses = []
    while len(addresses) < len(wanted):
        said.append(child.stderr.readline())
        assert said[-1] or child.poll() is None, said
        addresses += re.findall(r"(?:ws|http)://[\w.:]+\d", said[-1])
    try:
        yield child, addresses, said
    finally:
        child.send_signal(signal.SIGINT)
        said.append(child.communicate(timeout=HANG)[1])
        assert "Traceback" not in "".join(said), said


@pytest.mark.processes
def test_a_film_begins_when_its_page_is_opened(film):
    with running("--video", film, "--web", "--port", "0") as (child, (page,), _):
        time.sleep(1.0)  # far longer than sixteen frames take to read
        with urllib.request.urlopen(f"{page}/events", timeout=HANG) as stream:
            events = (json.loads(line.removeprefix(b"data: ")) for line in stream if line.strip())
            first = next(event for event in events if "frame" in event or event.get("before"))
        assert not first.get("before") and first["frame"] == SETTLING
        assert child.poll() is None


@needs_browser
@pytest.mark.processes
def test_all_outputs_of_one_run_hold_the_same(film, tmp_path, chromium):
    table = tmp_path / "new/folder/live.csv"
    with running("--video", film, "--web", "--foxglove", "--port", "0", "--record", tmp_path / "kept", "--csv", table) as (
        child, (page, foxglove), said,
    ):  # fmt: skip
        chromium.get(page)
        client, heard = FoxgloveClient(foxglove, HANG), []
        hearing = threading.Thread(target=lambda: heard.extend(client.messages()))
        hearing.start()
        wait_until(lambda: any("ended after 16 frames" in status for status in client.status), of=child)
        assert "ended after 16 frames" in wait_for(chromium, "return el('said').textContent")
        with urllib.request.urlopen(f"{page}/events", timeout=HANG) as stream:
            event = json.loads(stream.readline().removeprefix(b"data: "))
    hearing.join(HANG)
    assert child.returncode == 0 and "frames skipped before the no-contact image: 8" in "".join(said)
    wait_for(chromium, "return el('state').textContent.includes('does not answer')")
    with table.open() as stream:
        rows = list(csv.DictReader(stream))
    assert [int(row["frame"]) for row in rows] == list(range(SETTLING, FRAMES))
    assert [float(row["time_s"]) for row in rows] == pytest.approx([0.1 * int(row["frame"]) for row in rows])
    assert float(rows[-1]["fz_n"]) < -1.0 < float(rows[0]["fz_n"])
    assert f"16 frames read; {sum(row['flag'] == 'True' for row in rows)} flagged" in "".join(said)
    (path,) = (tmp_path / "kept").iterdir()
    kept, types = recorded(path)
    known = load_model(None).metadata.get("intervals", {}).get("total")
    expected = {f"/gelforge/{name}": kind for name, kind in TYPES.items() if known or "wrench/" not in name}
    assert types == expected == {topic: channel["schemaName"] for topic, channel in client.channels.items()}
    by_place = {(topic, time): repr(message) for topic, time, message in kept}
    assert all(repr(message) == by_place[topic, time] for topic, time, message in heard)
    of_flags = [message.status[0] for topic, _, message in kept if topic.endswith("/flag")]
    assert [{pair.key: pair.value for pair in status.values} for status in of_flags] == [
        {name: value if value else "" for name, value in row.items()} for row in rows
    ]
    assert event["fz_n"] == float(rows[-1]["fz_n"]) and event["frame"] == FRAMES - 1


def test_one_odd_frame_before_its_end_does_not_spoil_a_film(root, shipped):
    """Against a lightly pressed no-contact image a released gel reads less than both do once they change places, a deep press more."""
    names = ["images/demo-000024.png", "nocontact/mini_a.png", "images/demo-000032.png"]
    light, rest, deep = (
        np.ascontiguousarray(cv2.imread(str(root / "tests/data/presses" / name))[..., ::-1]) for name in names
    )
    predictor, shown = Reader(light, model=shipped), {"rest": rest, "deep": deep}
    total = {name: float(predictor(picture).total[2]) for name, picture in shown.items()}

    def read(*frames):
        start = StartInDoubt(predictor, "f.avi")
        for number, name in enumerate(frames):
            start.look(10 * number, shown[name], total[name])
        start.end()

    for good in ((), ("deep", "rest")):
        read(*good)
    for bad in (("rest",), ("deep", "rest", "rest")):
        refused("begins in a press", read, *bad)


def test_a_film_that_begins_in_a_press_is_refused_once_the_gel_reads_as_pressed(root, tmp_path):
    """Or as soon as its no-contact image shows the contact; the same film is read with its no-contact image."""
    table = tmp_path / "live.csv"
    words = ["--csv", str(table), "--video"]
    rest = cv2.imread(str(root / "data/demo/nocontact/mini_a.png"))
    said = "(begins in a press: .* N are predicted for frame|something seems to touch the gel) .*give a no-contact image with --nocontact"
    # the first is looked at twice: too few to be sure while the film goes on
    for press, released in ((9, APART + 1), (9, 14), (13, 14), (18, APART + 1)):
        pressed = cv2.imread(str(root / f"data/demo/images/demo-{press:06d}.png"))
        film = write_film(tmp_path / "film.avi", [pressed] * 14 + [rest] * released, 10.0)
        refused(said, live.main, [*words, str(film)])
        table.unlink(missing_ok=True)
    live.main([*words, str(film), "--nocontact", str(root / "data/demo/nocontact/mini_a.png")])
    recorded = table.read_text()
    refused("live.csv: exists already and would be replaced", live.main, [*words, str(film)])
    assert table.read_text() == recorded
    table.unlink()
    live.main([*words, str(write_film(tmp_path / "right.avi", [rest] * 14 + [pressed] * 14, 10.0))])


def test_a_message_says_what_was_read():
    """The bytes are read back by the library of MCAP for ROS 2."""
    read = reading(3, flag=True)
    messages = RosMessages("9 Mini R0B-2", start_ns=10**18)
    found = dict(messages(read)[1])
    top = "/sensor_9_Mini_R0B_2"
    assert found.keys() == {f"{top}/{name}" for name in TYPES}
    force, high, low = (
        np.array([getattr(found[f"{top}/wrench{end}"].wrench.force, axis) for axis in "xyz"])
        for end in ("", "/high", "/low")
    )
    assert force == pytest.approx(read.found.cells.sum((1, 2), dtype=np.float64))
    assert high - low == pytest.approx([0.2, 0.4, 0.6]) and (low + high) / 2 == pytest.approx(force)
    stamp = found[f"{top}/wrench"].header.stamp
    assert (stamp.sec, stamp.nanosec) == (10**9, 30_000_000)
    cells = found[f"{top}/forces/normal"].data.view("<f4").reshape(4, 5)
    assert np.array_equal(cells, read.found.cells[2])
    assert np.abs(decode(bytes(found[f"{top}/image/compressed"].data), "it").astype(int) - 90).max() <= 2
    (status,) = found[f"{top}/flag"].status
    assert status.level == 1 and status.message == "dark"
    assert messages(read)[0] == 10**18 + 30_000_000
    without = messages(reading(1, half_width=None))[1]
    assert not [topic for topic, _ in without if topic.endswith(("low", "high"))]


def test_viewers_that_leave_do_not_disturb_the_others(capfd):
    with ExitStack() as stack:
        to = outputs(stack, foxglove=True)
        stays, leaves = (FoxgloveClient(to.servers[0].url, HANG) for _ in range(2))
        heard = []
        hearing = [
            threading.Thread(target=lambda: heard.extend(stays.messages())),
            threading.Thread(target=lambda: list(leaves.messages())),
        ]
        for thread in hearing:
            thread.start()
        to.send([reading(0)])
        wait_until(lambda: len(stays.channels) == len(leaves.channels) == len(TYPES))
        to.send(map(reading, range(1, 21)))
        leaves.socket.sock.shutdown(socket.SHUT_RDWR)  # no farewell, as of a computer that was switched off
        to.send(map(reading, range(21, 41)))
        shown = []
        wait_until(lambda: shown.append(capfd.readouterr().err) or "left; the others go on" in "".join(shown))
        wait_until(lambda: heard and heard[-1][0].endswith("/flag") and number_of(heard[-1][2]) == 40)
    for thread in hearing:
        thread.join(HANG)
    seen = [number_of(said) for topic, _, said in heard if topic.endswith("/flag")]
    assert seen == list(range(seen[0], 41))


def test_a_recording_is_whole_or_absent(tmp_path, monkeypatch):
    """Two sensors of one gripper that begin in the same second keep each its own."""
    monkeypatch.setattr("gelforge.live.recording.time.strftime", lambda form: "20260101-120000")
    messages = RosMessages("mini", start_ns=0)
    (tmp_path / ".20260101-120000-2.mcap.part").touch()  # of a process that was killed
    left, right, third = (McapRecording(tmp_path, messages) for _ in range(3))
    left.send(reading(1))
    right.send(reading(2))
    assert "1 frames" in left.end() and "1 frames" in right.end() and "nothing is recorded" in third.end()
    kept = sorted(path.name for path in tmp_path.iterdir() if path.suffix == ".mcap")
    assert kept == ["20260101-120000-1.mcap", "20260101-120000.mcap"]
    assert [number_of(recorded(tmp_path / name)[0][-1][2]) for name in kept] == [2, 1]
    assert third.path.name == "20260101-120000-3.mcap"
    with pytest.raises(BadInput, match="nothing can be recorded there"):
        McapRecording(tmp_path / kept[0], messages)


@pytest.mark.parametrize(
    "spoil", [lambda made: made.part.unlink(), lambda made: made.path.mkdir()], ids=["gone", "taken"]
)
def test_a_recording_that_cannot_be_kept_leaves_nothing_and_all_hear_of_it(tmp_path, spoil, capsys):
    with ExitStack() as stack:
        to = outputs(stack, web=True, record=tmp_path / "kept", csv=tmp_path / "a.csv")
        assert to.send(map(reading, range(3))) == 3
        spoil(to.files[0])
        to.end("over")
        assert "the recording is lost" in to.servers[0].said["said"] and "the recording is lost" in str(to.fault)
    assert not [path for path in tmp_path.rglob("*") if path.is_file() and path.name != "a.csv"]
    assert len((tmp_path / "a.csv").read_text().splitlines()) == 4


FILL = """
import sys
from argparse import Namespace
from contextlib import ExitStack
from pathlib import Path
import numpy as np
from gelforge.commands.live import outputs_of
from tests.support.readings import reading
from tests.support.refused import refused
noise = np.random.default_rng(0).integers(0, 255, (240, 320, 3), np.uint8)
with ExitStack() as stack:
    to = outputs_of(Namespace(host="127.0.0.1", port=0, sensor=None, profile=None, foxglove=False, {asked}), "film", stack)
    print(to.send(reading(k, image=noise) for k in range(4000)), to.fault)
    to.end("over")
"""


@pytest.mark.parametrize("viewed", [False, True])
@pytest.mark.processes
def test_a_full_disk_leaves_no_recording_and_viewers_go_on(tmp_path, viewed):
    """The shell's limit on the size of a file stands for the disk."""
    asked = f"web={viewed}, record=Path(sys.argv[1]), csv=None"
    ran = limited_python(64, "-c", FILL.format(asked=asked).replace("4000", "40"), tmp_path / "kept")
    assert re.match(r"\d+ .*the recording is lost .*free space", ran.stdout), (ran.stdout, ran.stderr)
    assert (int(ran.stdout.split()[0]) == 40) == viewed and not list((tmp_path / "kept").iterdir())


@pytest.mark.processes
def test_a_full_disk_leaves_whole_rows(tmp_path):
    ran = limited_python(
        64, "-c", FILL.format(asked="web=False, record=None, csv=Path(sys.argv[1])"), tmp_path / "a.csv"
    )
    assert "cannot be written" in ran.stdout and "free space" in ran.stdout, ran.stderr
    text = (tmp_path / "a.csv").read_text()
    numbers = [int(row["frame"]) for row in csv.DictReader(text.splitlines())]
    assert text.endswith("\n") and 0 < len(numbers) < 4000 and numbers == list(range(len(numbers)))


def test_a_table_that_cannot_be_opened_changes_nothing(tmp_path):
    notes = tmp_path / "notes.csv"
    notes.write_text("not ours, and no last line break")
    with pytest.raises(BadInput, match="cannot be written"):
        CsvTable(notes / "live.csv")
    assert notes.read_text() == "not ours, and no last line break"


def shown(film, tmp_path, asked):
    """What `show` raises for a film in a camera's place, after three frames."""
    with open_source(film, None) as (capture, _), ExitStack() as stack:
        source = Film(capture, 0, "camera 0", 3, camera=True)
        seen = list(source)
        reader = Reader(cv2.cvtColor(seen[0].image, cv2.COLOR_BGR2RGB))
        live.show(outputs(stack, csv=tmp_path / "live.csv"), readings(reader, seen), source, threading.Event(), asked)


def test_a_camera_that_stops_is_reported_and_what_it_gave_is_kept(film, tmp_path):
    """It ends, as a camera does that is pulled out; one that was asked for three frames did all."""
    with pytest.raises(BadInput, match="camera 0: stopped after 3 frames"):
        shown(film, tmp_path, None)
    assert len((tmp_path / "live.csv").read_text().splitlines()) == 4
    shown(film, tmp_path, 3)


def test_an_interrupt_keeps_what_was_read(tmp_path):
    """It comes while a frame is awaited: what was read before is kept, and signals do afterwards what they did before."""

    def found():
        for k in range(8):
            if k == 4:
                os.kill(os.getpid(), signal.SIGINT)
            yield reading(k)

    before = signal.getsignal(signal.SIGINT)
    with live.stopping() as over, ExitStack() as stack:
        to = outputs(stack, csv=tmp_path / "a.csv")
        count = to.send(live.until(over, found()))
        to.end("over")
    assert count == 4 and len((tmp_path / "a.csv").read_text().splitlines()) == 5
    assert signal.getsignal(signal.SIGINT) is before


def test_what_cannot_be_made_is_refused_first(film, tmp_path):
    before = Path(film).read_bytes()
    for words, said in (
        (["--video", film], "give an output"),
        (["--video", film, "--camera", "0", "--csv", "-"], "give either"),
        (["--csv", "-"], "give either"),
        (["--video", film, "--csv", film], "would overwrite an input file"),
        (["--camera", "97", "--csv", tmp_path / "a.csv"], "camera 97"),
    ):
        with pytest.raises(BadInput, match=said):
            live.main([*map(str, words)])
    assert Path(film).read_bytes() == before and not list(tmp_path.iterdir())


def test_rows_go_to_standard_output_and_nothing_else_does(film, capfd):
    assert live.main(["--video", str(film), "--csv", "-", "--frames", "15"]) == 0
    found = list(csv.DictReader(capfd.readouterr().out.splitlines()))
    assert [int(row["frame"]) for row in found] == list(range(SETTLING, 15))


def test_each_row_on_a_pipe_can_be_read_as_soon_as_it_is_measured(monkeypatch):
    """A program that reads them must not wait for a buffer to fill."""
    there, here = os.pipe()
    with open(there, encoding="utf-8") as reading_end, open(here, "w", encoding="utf-8", buffering=1 << 20) as pipe:
        monkeypatch.setattr(sys, "stdout", pipe)
        os.set_blocking(there, False)
        table, rows = CsvTable(Path("-")), []
        for number in (1, 2, 3):
            table.send(reading(number))
            rows += list(csv.reader(reading_end))
            assert rows[-1][0] == str(number)
        assert rows[0][0] == "frame" and len(rows) == 4


def test_a_weighed_picture_is_the_mean_of_its_frames_in_its_own_colours():
    moment, image = Moment(), np.zeros((4, 6, 3), np.uint8)
    image[..., 0], image[..., 2] = 200, 40  # blue and red, as OpenCV orders them
    for more in (0, 1, 5):
        moment.frames.append(Frame(0, 0.0, image + np.uint8(more)))
    assert np.array_equal(moment.picture()[0, 0], [42, 2, 202])


def test_a_frame_that_repeats_the_one_before_is_flagged(root):
    """A camera that hangs gives its last frame again and again: a free gel was read with the force of a while ago."""
    rest, pressed = (
        cv2.imread(str(root / "data/demo" / name)) for name in ("nocontact/mini_a.png", "images/demo-000001.png")
    )
    frames = [Frame(k, 0.04 * k, image) for k, image in enumerate([rest, pressed, pressed, pressed, rest])]
    found = [one.found for one in readings(Reader(np.ascontiguousarray(rest[..., ::-1])), frames)]
    assert ["identical to the one before" in one.reason for one in found] == [False, False, True, True, False]
    assert np.array_equal(found[1].cells, found[2].cells)


def test_the_start_of_a_stream_is_judged_once(root):
    """It was asked for ever, at four times the price of a frame, and could end an hour's recording."""
    rest, pressed = (
        cv2.imread(str(root / "data/demo" / name))[..., ::-1]
        for name in ("nocontact/mini_a.png", "images/demo-000001.png")
    )
    start, asked = StartInDoubt(Reader(np.ascontiguousarray(rest)), "film"), []
    for number in range(0, 100, 5):
        start.look(number, np.ascontiguousarray(pressed), -10.0)
        asked.append(start.asked)
    assert asked[:4] == [1, 2, 3, 3] and asked[-1] == 3


def test_each_of_the_frames_that_are_weighed_must_be_good():
    """The last one alone was asked."""
    moment = Moment()
    for number in range(5):
        moment.found.append(replace(reading(5), frame=number))
    assert moment.fault() == ""
    moment.found[1] = replace(moment.found[1], found=replace(moment.found[1].found, reason="torn"))
    assert moment.fault() == "torn"


def test_a_frame_is_encoded_once_for_all_outputs(monkeypatch):
    count = []
    monkeypatch.setattr("gelforge.live.reading.encode_jpeg", lambda *given: count.append(1) or b"jpeg")
    one = reading(3)
    one.event(), RosMessages("a", 0)(one), RosMessages("b", 0)(one)
    assert len(count) == 1
