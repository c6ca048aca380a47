"""The live page in a real browser, fed with readings; and who may look at it."""

import json
import re
import socket
import urllib.error
import urllib.request
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from gelforge.errors import BadInput
from gelforge.live.foxglove import FoxgloveServer
from gelforge.live.topics import RosMessages
from gelforge.live.webpage import KEPT, WEB, PageServer
from gelforge.reporting.forcemaps import FULL_COLOUR_N
from tests.support.browser import WIDTHS, console_errors, needs_browser, resize, wait_for
from tests.support.readings import reading
from tests.support.waiting import HANG

SCRIPT = (WEB / "live.js").read_text(encoding="utf-8")
INKED = "const c = el('curve'); return c.getContext('2d').getImageData(0, 0, c.width, c.height).data.some((v) => v)"


@contextmanager
def served(host="127.0.0.1"):
    server = PageServer(host, 0)
    try:
        yield server
    finally:
        server.stop()


def show(driver, server, *shown):
    """Send readings to a page, each when the one before is drawn."""
    for each in shown:
        server.send(each)
        wait_for(driver, f"return document.body.dataset.frame === '{each.frame}'")


@needs_browser
@pytest.mark.parametrize("width", WIDTHS)
def test_a_person_sees_what_is_read_and_how_it_ended(chromium, width):
    resize(chromium, width)
    with served() as server:
        chromium.get(server.url)
        assert chromium.find_element("id", "flag").text == "no frame yet"
        show(chromium, server, *map(reading, range(1, 4)))
        wait_for(chromium, INKED)  # from the second frame on
        assert chromium.execute_script("return el('normal').width") == 5
        assert "90 %" in chromium.find_element("id", "band").text
        assert chromium.find_element("id", "z").text == "-3.00 ± 0.30"
        assert chromium.find_element("id", "my").text == "-4.5 ± 1.2"
        server.announce(f"{'a_folder_without_a_space/' * 9}film.avi: ended after 3 frames")
        wait_for(chromium, "return el('said').textContent.includes('ended after 3')")
        server.send(reading(4))  # what was said stays
        wait_for(chromium, "return document.body.dataset.frame === '4'")
        assert "ended after 3" in chromium.find_element("id", "said").text
        assert chromium.execute_script("return document.documentElement.scrollWidth <= innerWidth")
        heights = chromium.execute_script(
            "return [...document.querySelectorAll('figure')].map((f) => f.lastElementChild.offsetTop - f.offsetTop)"
        )
        assert len(heights) == 4 and np.ptp(heights) <= 1  # px, as rounded
        assert not console_errors(chromium)


@needs_browser
def test_flags_edges_and_colours_are_those_of_the_reading(chromium):
    """A released gel is shown on the scale of pictures: what is read in it is noise."""
    cropped, unknown = (
        replace(reading(k), found=replace(reading(k).found, edge_peak=at)) for k, at in ((2, 0.423), (3, np.nan))
    )
    with served() as server:
        chromium.get(server.url)
        for each, flag, edge, normal in (
            (reading(0), "nothing seems wrong with the image", "0 %", FULL_COLOUR_N[2]),
            (reading(1, flag=True), "dark", "0 %", 1.0),
            (cropped, "the image crops a contact: the forces are those of the visible part", "42 %", 2.0),
            (unknown, "nothing seems wrong with the image", "\u2013", 3.0),
        ):
            show(chromium, server, each)
            assert [chromium.find_element("id", name).text for name in ("flag", "edge")] == [flag, edge]
            for name, full in (("normal", normal), ("short", FULL_COLOUR_N[0]), ("long", FULL_COLOUR_N[1])):
                assert f"± {full:.3f} N a cell" in chromium.find_element("id", f"cap-{name}").text


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
def test_the_curve_has_the_sign_of_the_tiles_and_is_grey_while_frames_are_flagged(chromium):
    colour = {name: re.search(rf'{name}[^#]*"(#\w+)"', SCRIPT)[1] for name in ("fz_n", "FLAGGED")}
    with served() as server:
        chromium.get(server.url)
        show(chromium, server, *(reading(number, flag=number == 2, half_width=None) for number in range(5)))
        assert float(chromium.find_element("id", "z").text) == -4.0
        early, flagged, late = (curve_pixels(chromium, fraction) for fraction in (0.2, 0.52, 0.8))
        assert rows_of(early, colour["fz_n"]).mean() < rows_of(late, colour["fz_n"]).mean()
        assert len(rows_of(flagged, colour["FLAGGED"])) > 100
        assert not any(len(rows_of(pixels, colour["FLAGGED"])) > 10 for pixels in (early, late))


@needs_browser
def test_a_stream_ends_on_its_strongest_press_and_a_click_or_a_replay_shows_its_moments(chromium):
    from selenium.webdriver.common.action_chains import ActionChains

    presses = [
        replace(each, found=replace(each.found, total=np.array([0.0, 0.0, -force])))
        for each, force in zip(map(reading, range(6)), (0.0, 1.0, 3.0, 2.0, 1.0, 0.0), strict=True)
    ]
    with served() as server:
        chromium.get(server.url)
        show(chromium, server, *presses)
        server.announce("over")
        wait_for(chromium, "return el('state').textContent.includes('frame 2 ')")
        curve, replay = chromium.find_element("id", "curve"), chromium.find_element("id", "replay")
        for across, frame in ((-0.4, 0), (0.45, 5)):
            ActionChains(chromium).move_to_element_with_offset(
                curve, across * curve.size["width"], 0
            ).click().perform()
            wait_for(chromium, f"return el('state').textContent.includes('frame {frame} ')")
            assert chromium.find_element("id", "z").text.startswith("0.00")
        chromium.execute_script(
            "seen = []; new MutationObserver(() => seen.push(el('state').textContent)).observe(el('state'), {childList: true})"
        )
        replay.click()
        wait_for(chromium, "return seen.length >= 6 && !replaying")
        frames = [int(re.search(r"frame (\d+)", text)[1]) for text in chromium.execute_script("return seen")]
        assert frames == list(range(6)) and replay.text == "replay"
        assert not console_errors(chromium)


@needs_browser
def test_a_page_that_is_opened_after_the_end_shows_the_whole_curve(chromium):
    with served() as server:
        for number in range(8):
            server.send(reading(number))
        server.announce("over")
        chromium.get(server.url)
        wait_for(chromium, "return document.body.dataset.frame === '7'")
        assert chromium.execute_script("return history.map((e) => e.frame)") == list(range(8))
        assert chromium.execute_script(INKED) and chromium.find_element("id", "said").text == "over"


@needs_browser
@pytest.mark.parametrize(("fault", "shown"), [(False, "note"), (True, "reason")])
def test_a_small_screen_shows_image_and_curve_and_only_a_fault_is_red(chromium, fault, shown):
    resize(chromium, 1280, 760)
    with served() as server:
        chromium.get(server.url)
        show(chromium, server, *map(reading, range(1, 4)))
        server.announce("film.avi: ended after 3 frames", fault)
        wait_for(chromium, f"return el('said').className === '{shown}'")
        bottoms = chromium.execute_script(
            "return ['curve', 'image'].map((id) => el(id).getBoundingClientRect().bottom)"
        )
        assert max(bottoms) <= 760
    resize(chromium, WIDTHS[0])


@needs_browser
def test_ticks_stand_at_round_numbers_in_the_range(chromium):
    with served() as server:
        chromium.get(server.url)
        for most in (0.013, 0.9, 3.0, 47.0, 2600.0):
            found = np.array(chromium.execute_script("return ticks(-arguments[0], arguments[0], 4)", most))
            step = found[1] - found[0]
            assert 4 <= len(found) <= 11 and np.abs(found).max() <= most and 0.0 in found
            assert round(step / 10 ** np.floor(np.log10(step) + 1e-9)) in (1, 2, 5)


def get(address, **headers):
    with urllib.request.urlopen(urllib.request.Request(address, headers=headers), timeout=HANG) as answer:
        return answer.read().decode()


def test_the_page_is_for_this_machine_only_unless_another_address_is_named():
    """A foreign name that leads here (DNS rebinding) is refused."""
    with served() as server:
        assert server.url.startswith("http://127.0.0.1:") and "gelforge live" in get(server.url)
        for path in ("", "events"):
            with pytest.raises(urllib.error.HTTPError, match="403"):
                get(f"{server.url}{path}", Host="evil.example")
        with pytest.raises(urllib.error.HTTPError, match="404"):
            get(f"{server.url}../etc/passwd")
    with served("0.0.0.0") as server:
        assert "gelforge live" in get(f"http://127.0.0.1:{server.server_address[1]}/", Host="bench.lab")


def test_browsers_that_leave_do_not_stop_it():
    with served() as server:
        host, port = server.server_address
        for number in range(5):
            with socket.create_connection((host, port)) as line:
                line.sendall(f"GET /events HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode())
                line.recv(100)
            server.send(reading(number))
        with urllib.request.urlopen(f"{server.url}events", timeout=HANG) as stream:
            assert json.loads(stream.readline().removeprefix(b"data: "))["frame"] == 4


@pytest.mark.parametrize("serve", [PageServer, lambda host, port: FoxgloveServer(host, port, RosMessages("mini"))])
def test_a_port_that_cannot_be_served_is_one_sentence(serve):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        for port in (taken.getsockname()[1], -1, 99999):
            with pytest.raises(BadInput, match=f"port {port} of 127.0.0.1: cannot be served .*--port"):
                serve("127.0.0.1", port)


def test_a_slow_page_gets_the_latest_and_the_curve_has_an_end():
    server = PageServer("127.0.0.1", 0)
    try:
        for k in range(KEPT + 5):
            server.give({"frame": k, "image": "large", "forces": "large"})
        first = next(server.events())
        assert first["frame"] == KEPT + 4 and first["before"] == [{"frame": k} for k in range(4, KEPT + 4)]
    finally:
        server.stop()
