"""A real browser without a window, for tests of pages."""

import shutil
import time
from contextlib import contextmanager

import pytest

from tests.support.waiting import HANG

FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--hide-scrollbars",
    "--disable-dev-shm-usage",  # containers have 64 MB of it
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--enable-unsafe-swiftshader",  # draws three dimensions without a graphics card
)  # fmt: skip
WIDTHS = (1280, 390)

needs_browser = pytest.mark.skipif(
    not (shutil.which("chromium") and shutil.which("chromedriver")),
    reason="no chromium and chromedriver on PATH, and envs/chromium.sh could not install them",
)


@contextmanager
def browser(width: int = 1280, height: int = 900):
    """A headless Chromium of that size, closed at the end."""
    from selenium import webdriver
    from selenium.webdriver.chrome.options import Options
    from selenium.webdriver.chrome.service import Service

    options = Options()
    options.binary_location = shutil.which("chromium")
    for flag in FLAGS:
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(service=Service(shutil.which("chromedriver")), options=options)
    resize(driver, width, height)
    try:
        yield driver
    finally:
        driver.quit()


def resize(driver, width: int, height: int = 900) -> None:
    """Give the page that size, px; a narrow one is a telephone's."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)


def console_errors(driver) -> list[str]:
    """Errors on the page's console since the last call."""
    return [entry["message"] for entry in driver.get_log("browser") if entry["level"] == "SEVERE"]


def wait_for(driver, script: str, seconds: float = HANG):
    """Result of a script as soon as it is truthy; AssertionError if it does not become so in time."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        found = driver.execute_script(script)
        if found:
            return found
        time.sleep(0.02)
    raise AssertionError(f"{script}: nothing within {seconds} s; console: {console_errors(driver)}")
