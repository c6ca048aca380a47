"""The report's page in a real browser: what a person does with it, at two widths, without one error."""

import json

import pytest

from tests.browser import WIDTHS, browser, console_errors, needs_browser, wait_for
from tests.explored import write_page

pytestmark = needs_browser


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return write_page(tmp_path_factory.mktemp("page"), 60)


@pytest.fixture(scope="module")
def lazy_page(tmp_path_factory):
    path = write_page(tmp_path_factory.mktemp("lazy"), 60, limit=0)
    assert next(path.parent.glob("parts-*/0.js")).exists()
    return path


def shown(driver, name):
    """Wait until the press of that name is drawn."""
    return wait_for(driver, f"return document.body.dataset.shown === {json.dumps(name)}")


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("kind", ["page", "lazy_page"])
def test_a_person_explores_the_presses(request, kind, width):
    with browser(width) as driver:
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
        wait_for(driver, "return document.getElementById('reason').textContent.includes('no equilibrium <b>at</b>')")
        assert driver.execute_script("return document.getElementById('count').textContent") == "7 of 61 presses"
        assert not console_errors(driver)


def test_a_click_on_the_map_chooses_the_press_below_it(page):
    with browser() as driver:
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


def test_numbers_of_the_page_are_those_that_were_packed(page):
    """The bump of press 3 is at row 4 + 3; the network reads a tenth more; difference, forces and frames follow."""
    with browser() as driver:
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


def test_filters_keep_what_they_say(page):
    with browser() as driver:
        driver.get(page.as_uri())
        shown(driver, "made-000000")
        kept = driver.execute_script(
            "state.filter = {indenter: 'cuboid_10', force_low: 6}; arrange();"
            "return state.order.map((i) => [COLUMNS.indenter[i], COLUMNS.force[i]])"
        )
        assert kept and all(name == "cuboid_10" and force >= 6 for name, force in kept)


def test_a_copied_table_is_csv(page):
    with browser() as driver:
        driver.get(page.as_uri())
        shown(driver, "made-000000")
        text = driver.execute_script("return csvText([['a', 'say \"x\", y'], [1, NaN]])")
        assert text == 'a,"say ""x"", y"\n1,\n'


def test_markup_in_data_stays_text(page):
    with browser() as driver:
        driver.get(page.as_uri())
        assert not driver.find_elements("css selector", "h1 i, #reason b")


def test_lost_parts_are_named(lazy_page, tmp_path):
    alone = tmp_path / "index.html"
    alone.write_bytes(lazy_page.read_bytes())
    with browser() as driver:
        driver.get(alone.as_uri())
        said = wait_for(driver, "return document.getElementById('press-note')?.textContent")
        assert "copy the whole folder" in said
