"""Chromium without a window, driven by tests; Debian's packages chromium and chromium-driver."""

import json
import shutil
from contextlib import contextmanager

from opengl import skip_or_fail

ARGUMENTS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --hide-scrollbars "
    "--disable-background-networking --disable-component-update --disable-sync "
    "--window-size=960,640"
).split()


@contextmanager
def chromium(profile):
    """Yields a driver of a fresh Chromium; skips the test if none is installed.

    profile : a new folder
    """
    programs = [shutil.which(name) for name in ("chromium", "chromedriver")]
    if not all(programs):
        skip_or_fail("Debian's packages chromium and chromium-driver are missing")
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = programs[0]
    for argument in (*ARGUMENTS, f"--user-data-dir={profile}"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options, webdriver.ChromeService(programs[1]))
    driver.set_script_timeout(60)
    try:
        yield driver
    finally:
        driver.quit()


def console_errors(driver):
    """What the page's console said so far that is an error: a list of texts."""
    return [line["message"] for line in driver.get_log("browser") if line["level"] == "SEVERE"]


def requested(driver, document):
    """The addresses that a document has requested so far, without those of its own bytes."""
    found = []
    for line in driver.get_log("performance"):
        message = json.loads(line["message"])["message"]
        if message["method"] == "Network.requestWillBeSent":
            if message["params"]["documentURL"] == document:
                found.append(message["params"]["request"]["url"])
    return [one for one in found if not one.startswith(("data:", "blob:"))]
