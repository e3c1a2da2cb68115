"""The pictures of the page in docs/, anew: `make pictures`. Ten simulated days; a broker and a browser are needed.

The page is that of `plugd demo --page`, stopped on an evening instead of at noon, with a trip and a Sunday set on it.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

import requests
from selenium import webdriver
from selenium.webdriver.chrome.options import Options as Flags
from selenium.webdriver.chrome.service import Service

from plugd_hil.broker import HOST, free_port
from plugd_hil.demo import run
from plugd_hil.demo_run import Options
from tests.conftest import find_chromedriver, find_chromium
from tests.hub.hubs import end_in_order, say

DOCS = Path(__file__).resolve().parents[2] / "docs"
EVENING = datetime(2023, 1, 11, 21, 10, tzinfo=UTC)
"""Of the synthetic year: the car is home, and is held back for a cleaner night."""
DAYS = 10
SET = (
    ("trip", '{"date": "2023-01-14", "minimum_pct": 75, "ready_by": "06:30"}'),
    ("week", '{"sun": {"ready_by": "10:00"}}'),
)
SHOTS = (
    ("page.png", 980, 985, "light", 1.0),
    ("page-dark.png", 980, 985, "dark", 1.0),
    ("page-phone.png", 390, 844, "light", 1.0),
)
"""(file, width, height, scheme, pixels a point)"""
PATIENCE_S = 600.0


def stand(port: int) -> None:
    """The demo, to its evening, and on at the speed of the world until it is ended."""
    end_in_order()
    run(Options(days=DAYS, start=EVENING - timedelta(days=DAYS), page=port))


@contextmanager
def demo() -> Iterator[str]:
    """The page's address, once its time has come."""
    port = free_port()
    house = subprocess.Popen(
        [sys.executable, "-m", "tests.web.pictures", "--stand", str(port)], stderr=subprocess.PIPE, text=True
    )
    try:
        said = house.stderr.readline() if house.stderr else ""
        if "The page is at" not in said:
            raise RuntimeError(f"the demo did not come to its evening: {said}")
        yield f"http://{HOST}:{port}"
    finally:
        house.terminate()
        house.wait(60)


@contextmanager
def browser(chromium: Path, driver: Path) -> Iterator[webdriver.Chrome]:
    """A browser with an empty profile."""
    flags = Flags()
    flags.binary_location = str(chromium)
    with tempfile.TemporaryDirectory() as profile:
        for flag in ("--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars"):
            flags.add_argument(flag)
        flags.add_argument(f"--user-data-dir={profile}")
        found = webdriver.Chrome(flags, Service(str(driver), env={**os.environ, "LANGUAGE": "en_GB"}))
        try:
            yield found
        finally:
            found.quit()


def shoot(chrome: webdriver.Chrome, url: str, folder: Path) -> None:
    """Every picture."""
    for name, width, height, scheme, dots in SHOTS:
        size = {"width": width, "height": height, "deviceScaleFactor": dots, "mobile": width < 500}
        chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        media = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
        chrome.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
        chrome.get(url)
        chrome.execute_script("localStorage.setItem('plugd-token', 'demo')")
        chrome.get(url)
        chrome.save_screenshot(str(folder / name))
        say(f"{folder / name}: {(folder / name).stat().st_size / 1000:.0f} kB")


def main() -> int:
    """The program. Returns the exit status."""
    p = argparse.ArgumentParser(prog="tests.web.pictures", description=__doc__)
    p.add_argument("--out", type=Path, default=DOCS, metavar="DIR", help="where the pictures go (docs)")
    p.add_argument("--stand", type=int, metavar="PORT", help=argparse.SUPPRESS)
    options = p.parse_args()
    if options.stand is not None:
        stand(options.stand)
        return 0
    chromium, driver = find_chromium(), find_chromedriver()
    if chromium is None or driver is None:
        say("no browser: sudo apt install chromium chromium-driver")
        return 1
    with demo() as url, browser(chromium, driver) as chrome:
        for command, payload in SET:
            headers = {"Origin": url, "X-Plugd-Token": "demo"}
            requests.post(f"{url}/command/{command}", payload, headers=headers, timeout=20).raise_for_status()
        shoot(chrome, url, options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
