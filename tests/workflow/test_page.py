"""The report's page in a real browser: what a person does with it, at two widths, without one error."""

import json

import pytest
from selenium.webdriver import ActionChains

from tests.support.browser import WIDTHS, browser, console_errors, needs_browser, resize, wait_for
from tests.support.explored import write_page

pytestmark = needs_browser


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return write_page(tmp_path_factory.mktemp("page"), 60)


@pytest.fixture(scope="module")
def lazy_page(tmp_path_factory):
    path = write_page(tmp_path_factory.mktemp("lazy"), 60, limit=0)
    assert next(path.parent.glob("parts-*/0.js")).exists()
    return path


@pytest.fixture(scope="module")
def window():
    """One browser for all tests: to start it takes longer than most of them."""
    with browser() as driver:
        yield driver


@pytest.fixture
def driver(window):
    """That browser at its usual width, which shows nothing; nothing that a test shows is an error on the page's console."""
    resize(window, WIDTHS[0])
    window.get("about:blank")
    console_errors(window)
    yield window
    assert not console_errors(window)


def shown(driver, name):
    """Wait until the press of that name is drawn."""
    return wait_for(driver, f"return document.body.dataset.shown === {json.dumps(name)}")


@pytest.mark.parametrize("kind", ["page", "lazy_page"])
def test_a_person_explores_the_presses(request, kind, driver):
    for width in WIDTHS:
        driver.get("about:blank")
        resize(driver, width)
        driver.get(request.getfixturevalue(kind).as_uri())
        shown(driver, "made-000000")
        assert driver.execute_script("return document.documentElement.scrollWidth <= innerWidth")
        driver.find_element("id", "next").click()
        shown(driver, "made-000001")
        driver.find_element("id", "rows").send_keys("\ue015")  # arrow down
        shown(driver, "made-000002")
        driver.find_element("id", "worst").click()
        worst = driver.execute_script("return COLUMNS.id[[...COLUMNS.error.keys()].filter((i) => COLUMNS.error[i] >= 0)"
                                      ".sort((a, b) => COLUMNS.error[b] - COLUMNS.error[a])[0]]")  # fmt: skip
        shown(driver, worst)
        driver.find_element("id", "failed").click()
        wait_for(driver, "return FAILED[COLUMNS.id.indexOf(document.body.dataset.shown)]")
        assert "no equilibrium <b>at</b>" in driver.find_element("id", "reason").text
        assert driver.find_element("id", "count").text == "7 of 61 presses"


def test_a_click_on_the_map_chooses_the_press_below_it(page, driver):
    driver.get(page.as_uri())
    shown(driver, "made-000000")
    x, y = driver.execute_script("return onMap(20)")
    driver.execute_script(
        "const box = el('map').getBoundingClientRect();"
        "el('map').dispatchEvent(new MouseEvent('click', {clientX: box.left + arguments[0], clientY: box.top + arguments[1]}))",
        x, y,
    )  # fmt: skip
    shown(driver, "made-000020")
    assert "press=made-000020" in driver.current_url


def test_numbers_of_the_page_are_those_that_were_packed(page, driver):
    """The bump of press 3 is at row 4 + 3; the network reads a tenth more; difference, forces and frames follow."""
    driver.get(page.as_uri() + "#press=made-000003")
    shown(driver, "made-000003")
    found = driver.execute_script(
        "const m = mapsOf(), k = m.label.indexOf(Math.min(...m.label)), d = shown.arrays;"
        "return [Math.floor(k / 32), k % 32, m.label[k], m.network[k], m.difference[k], Math.min(...d.gel), d.points.length,"
        " GROUPS.get(COLUMNS.group[3] + '|' + COLUMNS.indenter[3]).length]"
    )
    assert found[:2] == [7, 16] and found[6] > 0
    assert found[2:5] == pytest.approx([-0.2, -0.22, -0.02], abs=1e-4)
    # No point of the grid lies on the dent's centre; the nearest is at most 0.25 mm away, where it has lost 1 %.
    assert -1 <= found[5] <= -0.99


def test_every_gel_is_drawn_as_thick_as_it_is(page, driver):
    """Presses take turns on two gels; the row of the log that was rejected names none and is drawn on the usual one."""
    lowest = (
        "return Math.min(...room.parts.children[1].geometry.attributes.position.array.filter((_, k) => k % 3 === 2))"
    )
    for name, height in {"made-000000": 4.0, "made-000003": 2.6, "row 7": 4.0}.items():
        driver.get("about:blank")
        driver.get(page.as_uri() + f"#press={name}")
        shown(driver, name)
        reported = driver.find_element("id", "facts").text.splitlines()
        assert ("gel 2.6 mm thick" in reported) == (height == 2.6)
        wait_for(driver, "return room && (room.none || room.parts.children.length >= 2)")
        if driver.execute_script("return Boolean(room.none)"):
            pytest.skip("this browser draws no three dimensions")
        assert driver.execute_script(lowest) == pytest.approx(-height, abs=1e-6)


def test_filters_keep_what_they_say(page, driver):
    driver.get(page.as_uri())
    shown(driver, "made-000000")
    for field, typed, kept in (
        ("by-indenter", "cuboid_10", "COLUMNS.indenter[i] === 'cuboid_10'"),
        ("by-sensor", "mini_b", "COLUMNS.sensor[i] === 'mini_b'"),
        ("by-split", "test", "COLUMNS.split[i] === 'test'"),
        ("by-force-low", "6", "COLUMNS.force[i] >= 6"),
        ("by-force-high", "6", "COLUMNS.force[i] <= 6"),
        ("by-error-low", "0.4", "COLUMNS.error[i] >= 0.4"),
    ):
        driver.find_element("id", field).send_keys(typed)
        found = f"[...Array(COUNT).keys()].filter((i) => {kept}).join()"
        order = "[...state.order].sort((a, b) => a - b).join()"
        wait_for(driver, f"return state.order.length < COUNT && {order} === {found}")
        assert driver.execute_script("return state.order.length") > 0, field
        driver.find_element("id", "reset").click()
        assert driver.find_element("id", "count").text == "61 presses"


def test_charts_flow_curve_and_provenance_are_drawn(page, driver):
    for width in WIDTHS:
        driver.get("about:blank")
        resize(driver, width)
        driver.get(page.as_uri() + "#press=made-000003")
        shown(driver, "made-000003")
        points = "[...document.querySelectorAll('#charts svg')].map((svg) => svg.querySelectorAll('circle').length)"
        # the splits it did not learn from, and three indenters
        assert driver.execute_script(f"return {points}")[:2] == [2, 3]
        assert "always the same guess: 4.00 N" in driver.find_element("css selector", "#charts .legend").text
        assert driver.execute_script("return document.querySelectorAll('#flow-graph svg path').length") == 3
        inked = "const c = el('curve'); return c.getContext('2d').getImageData(0, 0, c.width, c.height).data.some((v) => v)"
        assert driver.execute_script(inked)
        driver.find_element("css selector", "#detail details summary").click()
        rows = wait_for(driver, "return el('provenance').innerText")
        assert "results/made/10_poses/0000.csv" in rows and "fea.json" in rows


def test_the_gel_turns_by_hand(page, driver):
    driver.get(page.as_uri() + "#press=made-000003")
    shown(driver, "made-000003")
    wait_for(driver, "return room && (room.none || room.parts.children.length >= 3)")
    if driver.execute_script("return Boolean(room.none)"):  # a browser that draws no three dimensions says so
        assert "WebGL" in driver.find_element("id", "gel").text
        pytest.skip("this browser draws no three dimensions")
    gel = driver.find_element("css selector", "#gel canvas")
    before = gel.screenshot_as_png
    assert gel.screenshot_as_png == before
    ActionChains(driver).drag_and_drop_by_offset(gel, 120, 30).perform()
    assert gel.screenshot_as_png != before


def test_a_click_copies_the_presses_in_sight_as_csv(page, driver):
    driver.get(page.as_uri())
    shown(driver, "made-000000")
    driver.find_element("id", "failed").click()
    driver.execute_script(
        "window.copied = ''; document.addEventListener('copy', () => { copied = String(getSelection()) || document.activeElement.value; })"
    )
    driver.execute_script(
        "Object.defineProperty(navigator, 'clipboard', {value: undefined})"
    )  # a page from disk has none
    driver.find_element("id", "copy").click()
    lines = wait_for(driver, "return copied").splitlines()
    assert lines[0].startswith("id,") and len([line for line in lines if line]) == 1 + 7
    text = driver.execute_script("return csvText([['a', 'say \"x\", y'], [1, NaN]])")
    assert text == 'a,"say ""x"", y"\n1,\n'
    # markup in data stays text
    assert not driver.find_elements("css selector", "h1 i, #reason b")


def test_lost_parts_are_named(lazy_page, tmp_path, driver):
    alone = tmp_path / "index.html"
    alone.write_bytes(lazy_page.read_bytes())
    driver.get(alone.as_uri())
    said = wait_for(driver, "return document.getElementById('press-note')?.textContent")
    assert "copy the whole folder" in said
    assert ["ERR_FILE_NOT_FOUND" in error for error in console_errors(driver)] == [True]
