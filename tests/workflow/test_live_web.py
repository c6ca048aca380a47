"""The live page in a real browser, with a film as the camera; and what happens when things go wrong."""

import csv
import json
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from argparse import Namespace
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelforge.commands.live_readings import keep_readings, write_files
from gelforge.errors import BadInput
from gelforge.live.reading import Reading
from gelforge.live.recording import Recorder, paced
from gelforge.live.server import KEPT, WEB, Hub, Server, serve
from gelforge.networks.inference.predictor import Predictor, load_for_use
from gelforge.records.film import Film, open_source
from gelforge.records.forcereading import ForceReading
from gelforge.records.nocontactimage import SETTLING
from gelforge.reporting.forcemaps import FULL_COLOUR_N
from tests.support.browser import WIDTHS, browser, console_errors, needs_browser, wait_for
from tests.support.films import write_film
from tests.support.limited import limited
from tests.support.waiting import HANG, wait_until

HAS_INTERVALS = bool(load_for_use(None).metadata.get("intervals", {}).get("total"))  # of the shipped network

SCRIPT = (WEB / "live.js").read_text(encoding="utf-8")
LIVE = [sys.executable, "-m", "gelforge.commands.live"]
INKED = "const c = el('curve'); return c.getContext('2d').getImageData(0, 0, c.width, c.height).data.some((v) => v)"


@pytest.fixture(scope="module")
def film(root, tmp_path_factory):
    """Pictures of the demo as a film of twenty minutes, ten frames a second: longer than a busy machine needs."""
    names = ["nocontact/mini_a.png", *(f"images/demo-{k:06d}.png" for k in range(6))]
    rest, *pictures = (cv2.imread(str(root / "data/demo" / name)) for name in names)
    shown = (rest if k < 16 else pictures[k % 6] for k in range(12000))
    return write_film(tmp_path_factory.mktemp("film") / "film.avi", shown, 10.0)


@contextmanager
def live_page(film, folder):
    """`gelforge live --web` on a free port, ended by an interrupt; yields (address, process)."""
    command = [*LIVE, "--video", film, "--web", "--port", "0", "--record", folder]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield re.match(r"(http://\S+)", child.stdout.readline())[1], child
    finally:
        child.send_signal(signal.SIGINT)
        said = child.communicate(timeout=HANG)[1]
        assert child.returncode == 0 and "Traceback" not in said, said


@pytest.fixture
def served(film, tmp_path):
    """(address, folder of recordings) of a page that is served."""
    with live_page(film, tmp_path / "recordings") as (address, _):
        yield address, tmp_path / "recordings"


@needs_browser
@pytest.mark.parametrize("width", WIDTHS)
def test_a_person_watches_records_and_replays(served, width):
    address, folder = served
    with browser(width) as driver:
        driver.get(address)
        wait_for(driver, "return Number(document.body.dataset.frame) > 6")
        assert driver.execute_script("return document.documentElement.scrollWidth <= innerWidth")
        assert (
            driver.execute_script("return el('normal').width") == 32
            and "N a cell" in driver.find_element("id", "cap-normal").text
        )
        assert driver.find_element("id", "flag").text != "no frame yet"
        assert ("90 %" in driver.find_element("id", "band").text) == HAS_INTERVALS
        wait_for(driver, INKED)  # from the second frame on
        driver.find_element("id", "record").click()
        wait_for(driver, "return el('record').textContent === 'Stop recording'")
        seen = driver.execute_script("return Number(document.body.dataset.frame)")
        wait_for(driver, f"return Number(document.body.dataset.frame) > {seen + 3}")
        driver.find_element("id", "record").click()
        name = wait_for(driver, "return el('which').value")
        lines = (folder / f"{name}.jsonl").read_text().splitlines()
        assert lines and {"forces", "image", "grid_z_n", "half_width"} <= json.loads(lines[0]).keys()
        driver.find_element("id", "replay").click()
        wait_for(driver, "return document.body.dataset.ended")
        assert f"ended after {len(lines)} readings" in driver.find_element("id", "state").text
        assert not console_errors(driver)


def get(address, **headers):
    with urllib.request.urlopen(urllib.request.Request(address, headers=headers), timeout=HANG) as answer:
        return answer.read().decode()


def test_the_page_is_for_this_machine_and_its_own_page_only(served):
    address, folder = served
    assert address.startswith("http://127.0.0.1:")
    with pytest.raises(urllib.error.HTTPError, match="403"):
        get(address, Host="evil.example")
    with pytest.raises(urllib.error.HTTPError, match="403"):  # a POST of a foreign page lacks our header
        urllib.request.urlopen(urllib.request.Request(f"{address}record", method="POST"), timeout=HANG)
    assert '"ended": "recording' in get(f"{address}replay/..%2f..%2fetc%2fpasswd")
    assert not folder.exists()


def test_browsers_that_leave_do_not_stop_it(served):
    address = served[0]
    for _ in range(5):
        host, port = re.match(r"http://(.+):(\d+)/", address).groups()
        with socket.create_connection((host, int(port))) as line:
            line.sendall(f"GET /events HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode())
            line.recv(100)
    assert "gelforge live" in get(address)


def test_a_port_in_use_is_one_sentence(film, tmp_path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        ran = subprocess.run(
            [*LIVE, "--video", film, "--web", "--port", port], capture_output=True, text=True, check=False
        )
    assert (
        ran.returncode == 2
        and f"port {port}" in ran.stderr
        and "--port" in ran.stderr
        and "Traceback" not in ran.stderr
    )


@pytest.mark.parametrize("port", ["-1", "99999"])
def test_a_number_that_no_port_has_is_one_sentence(film, port):
    ran = subprocess.run(
        [*LIVE, "--video", film, "--web", "--port", port], capture_output=True, text=True, check=False
    )
    assert ran.returncode == 2 and f"port {port}" in ran.stderr and "Traceback" not in ran.stderr


@pytest.mark.parametrize("asked", [None, 3])
def test_a_camera_that_stops_is_reported_and_what_it_gave_is_kept(film, tmp_path, asked):
    """A film in a camera's place: it ends, as a camera does that is pulled out; one that was asked for 3 frames did all."""
    args = Namespace(camera=0, frames=asked, jsonl=tmp_path / "live.jsonl", csv=None)
    said = pytest.raises(BadInput, match="camera 0: stopped after 3 frames") if asked is None else nullcontext()
    with open_source(film, None) as (capture, _):
        source = Film(capture, 0, "camera 0", 3, camera=True)
        seen = list(source)
        predictor = Predictor(load_for_use(None, None), cv2.cvtColor(seen[0].image, cv2.COLOR_BGR2RGB))
        with said:
            keep_readings(args, predictor, iter(seen), source, "camera 0", threading.Event())
    assert len((tmp_path / "live.jsonl").read_text().splitlines()) == 3


def test_a_full_disk_leaves_whole_lines(film, tmp_path):
    """The shell's limit on the size of a file stands for the disk."""
    lines = tmp_path / "live.jsonl"
    ran = limited(2, "gelforge.commands.live", "--video", film, "--jsonl", lines, "--frames", "24")
    assert ran.returncode == 2 and "free space" in ran.stderr and "Traceback" not in ran.stderr, ran.stderr
    kept = lines.read_text()
    assert kept.endswith("\n") and 0 < len([json.loads(line) for line in kept.splitlines()]) < 24


def test_without_a_display_lines_and_rows_are_written(film, tmp_path):
    lines, table = tmp_path / "live.jsonl", tmp_path / "live.csv"
    command = [*LIVE, "--video", film, "--jsonl", lines, "--csv", table, "--frames", "24"]
    ran = subprocess.run(command, check=True, capture_output=True, text=True)
    reported = [json.loads(line) for line in lines.read_text().splitlines()]
    with table.open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(reported) == len(rows) == 16 and [row["frame"] for row in reported] == list(range(SETTLING, 24))
    assert [row["time_s"] for row in reported] == pytest.approx([0.1 * row["frame"] for row in reported])
    assert "frames before the no-contact image are not read: 8" in ran.stderr
    assert [float(row["grid_z_n"]) for row in rows] == [row["grid_z_n"] for row in reported]
    assert min(row["grid_z_n"] for row in reported[8:]) < -1.0 < reported[0]["grid_z_n"]
    assert f"16 frames read; {sum(row['flag'] for row in reported)} flagged" in ran.stderr


def test_how_many_frames_are_flagged_is_counted_where_they_are_written(tmp_path):
    """A film shows it; who has rows alone would have to look for it."""
    found = (reading(number, flag=number in (1, 4)) for number in range(6))
    assert write_files(found, None, tmp_path / "live.csv") == (6, 2)


def reading(number, flag=False):
    forces = np.zeros((3, 4, 5), np.float32)
    forces[2, 1, 1] = -number
    found = ForceReading(
        forces, forces.sum((1, 2)), None, "dark" if flag else "", 0.0, 1.0, np.zeros((6, 8, 3), np.uint8)
    )
    return Reading(number, 0.01 * number, found, 1.0)


def full(recorder):
    """The disk of a recording that runs is full from now on."""
    recorder.stream.close()
    recorder.stream = Path("/dev/full").open("w", encoding="utf-8")  # noqa: SIM115, the recorder closes it


def test_a_recording_is_whole_or_absent(tmp_path):
    recorder = Recorder(tmp_path)
    recorder.add(reading(1).event())
    assert recorder.stop() == 0 and not list(tmp_path.iterdir())
    name = recorder.start()
    assert recorder.start() == name and recorder.names() == []
    for k in range(3):
        recorder.add(reading(k).event())
    assert recorder.stop() == 3 and recorder.names() == [name]
    assert [event["grid_z_n"] for event in recorder.read(name)] == [0.0, -1.0, -2.0]
    assert "3 readings" in list(paced(recorder.read(name)))[-1]["ended"]
    with pytest.raises(BadInput, match="none of that name"):
        recorder.read("../secret")
    with (tmp_path / f"{name}.jsonl").open("a") as stream:
        stream.write('{"no": "time"}\n[1]\nhalf a li')
    with (tmp_path / f"{name}.jsonl").open("ab") as stream:
        stream.write(b"\n\xff\xff\n")
    assert len(list(recorder.read(name))) == 3
    recorder.start()
    assert recorder.stop() == 0 and [path.suffix for path in tmp_path.iterdir()] == [".jsonl"]


def test_two_sensors_that_record_into_one_folder_keep_each_its_own(tmp_path, monkeypatch):
    """As those of the two fingers of a gripper, started in the same second; one recording took the other's name and place."""
    monkeypatch.setattr("gelforge.live.recording.time.strftime", lambda form: "20260101-120000")
    left, right = Recorder(tmp_path), Recorder(tmp_path)
    names = left.start(), right.start()
    for recorder, sensor in ((left, "left"), (right, "right"), (left, "left")):
        recorder.add({"time_s": 0.0, "sensor": sensor})
    assert (left.stop(), right.stop()) == (2, 1)
    kept = [[event["sensor"] for event in left.read(name)] for name in names]
    assert kept == [["left", "left"], ["right"]]
    (tmp_path / ".20260101-120000-2.part").touch()  # of a process that was killed
    assert left.start() == "20260101-120000-3"


@pytest.mark.skipif(not shutil.which("bash"), reason="needs /dev/full")
def test_a_full_disk_ends_the_recording_and_leaves_nothing(tmp_path):
    recorder = Recorder(tmp_path)
    recorder.start()
    full(recorder)
    with pytest.raises(BadInput, match="free space"):
        recorder.add(reading(1).event())
    assert not recorder.on and not list(tmp_path.iterdir())


def at_its_end(recorder):
    """A disk that is full when the last of a recording is written."""
    full(recorder)
    recorder.stream.write("the last reading")


def folder_gone(recorder):
    shutil.rmtree(recorder.folder)


def place_taken(recorder):
    (recorder.folder / f"{recorder.name}.jsonl").mkdir()


@pytest.mark.parametrize("spoil", [at_its_end, folder_gone, place_taken])
def test_a_recording_that_cannot_be_kept_leaves_nothing_and_the_next_one_is(tmp_path, spoil):
    recorder = Recorder(tmp_path / "recordings")
    recorder.start()
    recorder.add(reading(1).event())
    spoil(recorder)
    with pytest.raises(BadInput, match=r"recordings: the recording is lost \(.+\); free space"):
        recorder.stop()
    assert not recorder.on and recorder.names() == [] and not list(tmp_path.rglob("*.part"))
    name = recorder.start()
    recorder.add(reading(2).event())
    assert recorder.stop() == 1 and recorder.names() == [name]


def test_recordings_that_cannot_be_read_are_one_sentence(tmp_path):
    recorder = Recorder(tmp_path)
    name = recorder.start()
    recorder.add(reading(1).event())
    recorder.stop()
    events = recorder.read(name)
    (tmp_path / f"{name}.jsonl").unlink()
    with pytest.raises(BadInput, match=f"{name}.jsonl: the recording cannot be read"):
        next(events)
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(BadInput, match="file: cannot be read as a folder.*--record"):
        Recorder(tmp_path / "file").names()


@contextmanager
def page_server(recorder):
    """The page's server in this process; yields (address, hub)."""
    server = Server("127.0.0.1", 0, Hub(), recorder)
    server.start()
    try:
        yield server.url, server.hub
    finally:
        server.shutdown()
        server.server_close()


def next_event(address):
    """The first event that a page gets which opens now."""
    with urllib.request.urlopen(f"{address}events", timeout=HANG) as stream:
        return json.loads(stream.readline().removeprefix(b"data: "))


def kept(recorder, numbers):
    """Name of a recording of readings of these numbers, a hundredth of a second apart."""
    name = recorder.start()
    for number in numbers:
        recorder.add(reading(number).event())
    recorder.stop()
    return name


@needs_browser
@pytest.mark.parametrize("width", WIDTHS)
def test_a_long_path_stays_within_the_page_and_captions_in_one_line(tmp_path, width):
    with page_server(Recorder(tmp_path)) as (address, hub), browser(width) as driver:
        driver.get(address)
        serve([reading(1)], hub, Recorder(tmp_path))
        wait_for(driver, "return document.body.dataset.frame === '1'")
        hub.send(hub.latest | {"ended": f"{'a_folder_without_a_space/' * 9}film.avi: ended after 1 frames"})
        wait_for(driver, "return document.body.dataset.ended")
        assert driver.execute_script("return document.documentElement.scrollWidth <= innerWidth")
        heights = driver.execute_script(
            "return [...document.querySelectorAll('figure')].map((f) => f.lastElementChild.offsetTop - f.offsetTop)"
        )
        assert len(heights) == 4 and np.ptp(heights) <= 1  # px, as rounded


@needs_browser
def test_a_recording_that_went_meanwhile_is_reported_where_it_was_to_be_replayed(tmp_path):
    recorder = Recorder(tmp_path)
    name = kept(recorder, range(3))
    with page_server(recorder) as (address, _), browser() as driver:
        driver.get(address)
        wait_for(driver, "return el('which').value")
        (tmp_path / f"{name}.jsonl").unlink()
        driver.find_element("id", "replay").click()
        assert "there is none of that name" in wait_for(
            driver, "return document.body.dataset.ended && el('state').textContent"
        )
        assert not console_errors(driver)


def wait_for_button(driver, words, disabled=False):
    """Wait until the record button says so, and can be pressed or not."""
    expected = json.dumps([words, str(words == "Stop recording").lower(), disabled])
    says = (
        "JSON.stringify([el('record').textContent, el('record').getAttribute('aria-pressed'), el('record').disabled])"
    )
    wait_for(driver, f"return {says} === JSON.stringify({expected})")


@needs_browser
def test_the_record_button_shows_what_the_recorder_does_now(tmp_path):
    recorder = Recorder(tmp_path)
    kept(recorder, range(0, 60_000, 100))  # a second apart: it is replayed as long as the test lasts
    with browser() as driver:
        with page_server(recorder) as (address, hub):
            driver.get(address)
            wait_for_button(driver, "Record")
            serve([reading(1)], hub, recorder)
            wait_for(driver, "return document.body.dataset.frame === '1'")
            driver.find_element("id", "record").click()
            wait_for_button(driver, "Stop recording")
            driver.find_element("id", "replay").click()
            wait_for(driver, "return Number(document.body.dataset.frame) >= 100")
            assert driver.find_element("id", "record").text == "Stop recording" and recorder.on
            full(recorder)
            serve([reading(2)], hub, recorder)
            wait_for_button(driver, "Record")
            assert "the recording is lost" in driver.find_element("id", "trouble").text
            driver.find_element("id", "record").click()
            wait_for_button(driver, "Stop recording")
            assert not driver.find_element("id", "trouble").text
            driver.find_element("id", "back").click()
            wait_for(driver, "return document.body.dataset.frame === '2'")
            recorder.stop()
            hub.send(hub.latest | {"ended": "the film ended"})
            wait_for_button(driver, "Record", disabled=True)
            recorder.start()  # by another page
            wait_for_button(driver, "Stop recording")
            assert not console_errors(driver)
        wait_for_button(driver, "Record", disabled=True)
        assert "does not answer" in driver.find_element("id", "state").text


@needs_browser
def test_a_flag_is_reported_in_its_own_words(tmp_path):
    with page_server(Recorder(tmp_path)) as (address, hub), browser() as driver:
        driver.get(address)
        for number, words in ((1, "dark"), (2, "nothing seems wrong with the picture")):
            serve([reading(number, flag=number == 1)], hub, Recorder(tmp_path))
            wait_for(driver, f"return document.body.dataset.frame === '{number}'")
            assert driver.find_element("id", "flag").text == words


@needs_browser
def test_how_much_lies_at_the_edge_is_reported_where_a_map_shows_it(tmp_path):
    with page_server(Recorder(tmp_path)) as (address, hub), browser() as driver:
        driver.get(address)
        for number, (fraction, words) in enumerate(((0.423, "42 %"), (float("nan"), "\u2013")), 1):
            one = reading(number)
            serve([replace(one, found=replace(one.found, edge_peak=fraction))], hub, Recorder(tmp_path))
            wait_for(driver, f"return document.body.dataset.frame === '{number}'")
            assert driver.find_element("id", "edge").text == words


def curve_pixels(driver, fraction):
    """Pixels (height, 3) of a column of the curve, at a fraction of the time that it shows, from the top."""
    script = """
        const c = el('curve'), ratio = c.width / c.clientWidth;
        const x = Math.round(ratio * (50 + (c.clientWidth - 60) * arguments[0]));
        return [...c.getContext('2d').getImageData(x, 0, 1, c.height).data];"""
    return np.reshape(driver.execute_script(script, fraction), (-1, 4))[:, :3]


def rows_of(pixels, colour):
    """Rows of pixels (height, 3) that are of a colour such as #1f6f8b, or nearly so."""
    expected = [int(colour[at : at + 2], 16) for at in (1, 3, 5)]
    return np.flatnonzero(np.abs(pixels - expected).max(axis=1) < 12)


@needs_browser
def test_the_curve_has_the_sign_of_the_tiles_and_is_grey_while_frames_are_flagged(tmp_path):
    colour = {name: re.search(rf'{name}[^#]*"(#\w+)"', SCRIPT)[1] for name in ("grid_z_n", "FLAGGED")}
    with page_server(Recorder(tmp_path)) as (address, hub), browser() as driver:
        driver.get(address)
        for number in range(5):
            serve([reading(number, flag=number == 2)], hub, Recorder(tmp_path))
            wait_for(driver, f"return document.body.dataset.frame === '{number}'")
        assert float(driver.find_element("id", "z").text) == -4.0
        early, flagged, late = (curve_pixels(driver, fraction) for fraction in (0.2, 0.52, 0.8))
        assert rows_of(early, colour["grid_z_n"]).mean() < rows_of(late, colour["grid_z_n"]).mean()
        assert len(rows_of(flagged, colour["FLAGGED"])) > 100
        assert not any(len(rows_of(pixels, colour["FLAGGED"])) > 10 for pixels in (early, late))


@needs_browser
def test_a_released_gel_is_shown_on_the_scale_of_pictures(tmp_path):
    with page_server(Recorder(tmp_path)) as (address, hub), browser() as driver:
        driver.get(address)
        for number, normal in ((0, FULL_COLOUR_N[2]), (1, 1.0)):
            serve([reading(number)], hub, Recorder(tmp_path))
            wait_for(driver, f"return document.body.dataset.frame === '{number}'")
            for name, full in (("normal", normal), ("short", FULL_COLOUR_N[1]), ("long", FULL_COLOUR_N[0])):
                assert f"± {full:.3f} N a cell" in driver.find_element("id", f"cap-{name}").text


@needs_browser
def test_a_program_that_ended_offers_no_recording(film, tmp_path):
    with browser() as driver:
        with live_page(film, tmp_path / "recordings") as (address, _):
            driver.get(address)
            wait_for_button(driver, "Record")
            driver.find_element("id", "record").click()
            wait_for_button(driver, "Stop recording")
        wait_for_button(driver, "Record", disabled=True)


def test_a_lost_recording_is_reported_to_all_pages_until_the_next_one_begins(tmp_path):
    recorder = Recorder(tmp_path)
    with page_server(recorder) as (address, hub):
        recorder.start()
        full(recorder)
        assert serve(map(reading, range(4)), hub, recorder) == 4
        late, listed = next_event(address), json.loads(get(f"{address}recordings"))
        assert late["frame"] == 3
        for reported in (late, listed):
            assert "the recording is lost" in reported["trouble"] and reported["recording"] is False
        recorder.start()
        assert next_event(address).items() >= {"frame": 3, "trouble": "", "recording": True}.items()


def test_a_recording_that_cannot_begin_is_reported_to_all_pages(tmp_path):
    (tmp_path / "file").write_text("no folder")
    recorder = Recorder(tmp_path / "file")
    with page_server(recorder) as (address, hub):
        with pytest.raises(BadInput, match="nothing can be recorded there"):
            recorder.start()
        serve([reading(0)], hub, recorder)
        assert "nothing can be recorded there" in next_event(address)["trouble"]
        listed = json.loads(get(f"{address}recordings"))
        assert "cannot be read as a folder" in listed["error"] and listed["names"] == []


def test_a_recording_that_is_lost_at_the_end_is_reported(film, tmp_path):
    with live_page(film, tmp_path / "recordings") as (address, child):
        record = urllib.request.Request(f"{address}record", method="POST", headers={"X-Gelforge": "1"})
        urllib.request.urlopen(record, timeout=HANG).close()
        wait_until(lambda: any(path.stat().st_size for path in (tmp_path / "recordings").iterdir()), of=child)
        shutil.rmtree(tmp_path / "recordings")
        child.send_signal(signal.SIGINT)
        said = child.stderr.read()
    assert "ended after" in said and "the recording is lost" in said


def test_a_slow_page_gets_the_latest(tmp_path):
    hub = Hub()
    for k in range(5):
        hub.send({"frame": k})
    assert hub.after(2, 0.1) == (5, {"frame": 4}) and hub.after(5, 0.05) == (5, None)


def test_the_curve_of_what_was_before_is_kept_without_pictures_and_has_an_end():
    hub = Hub()
    for k in range(KEPT + 5):
        hub.send({"frame": k, "image": "large", "forces": "large"})
    assert hub.before() == [{"frame": k} for k in range(4, KEPT + 4)]


@needs_browser
def test_a_page_that_is_opened_after_the_end_shows_the_whole_curve(tmp_path):
    with page_server(Recorder(tmp_path)) as (address, hub), browser() as driver:
        serve([reading(number) for number in range(8)], hub, Recorder(tmp_path))
        hub.send(hub.latest | {"ended": "over"})
        driver.get(address)
        wait_for(driver, "return document.body.dataset.ended")
        frames = driver.execute_script("return history.map((e) => e.frame)")
        assert sorted(set(frames)) == list(range(8))
        assert driver.execute_script(INKED)


def test_a_server_outside_this_machine_must_be_asked_for(tmp_path):
    server = Server("127.0.0.1", 0, Hub(), Recorder(tmp_path))
    server.server_close()
    assert server.local and server.url.startswith("http://127.0.0.1:")


def test_a_server_for_the_network_answers_by_its_name_there(tmp_path):
    server = Server("0.0.0.0", 0, Hub(), Recorder(tmp_path))
    server.start()
    try:
        assert not server.local
        assert "gelforge live" in get(f"http://127.0.0.1:{server.server_address[1]}/", Host="bench.lab")
    finally:
        server.shutdown()
        server.server_close()


def test_a_file_that_was_not_opened_is_left_as_it_is(tmp_path):
    notes = tmp_path / "notes.csv"
    notes.write_text("not ours, and no last line break")
    with pytest.raises(BadInput, match="its folder cannot be made"):
        write_files(iter(()), notes / "live.jsonl", notes)
    assert notes.read_text() == "not ours, and no last line break"
