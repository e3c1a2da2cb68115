"""The page in a real browser: it loads, keeps itself fresh, sets what is set, and fits a phone."""

from collections.abc import Callable, Iterator
from datetime import date, time, timedelta
from pathlib import Path

import pytest
from selenium import webdriver
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.ui import WebDriverWait

from plugd.domain import DayRule, Fault, Mode, Overrides, SetHorizon, SetWeek
from tests.web.serving import TOKEN, Served

pytestmark = [pytest.mark.requires("chromium"), pytest.mark.timeout(180)]

FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-dev-shm-usage"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--hide-scrollbars"),
)
PATIENCE_S = 20.0
PHONES = ((390, 844), (320, 568))
"""A usual one, and the narrowest that people still have (or a wide one at four times the letters)."""


@pytest.fixture(scope="module")
def browser(chromium: Path, chromedriver: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[webdriver.Chrome]:
    """A browser with an empty profile."""
    options = Options()
    options.binary_location = str(chromium)
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}", "--window-size=1000,1400"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options, Service(str(chromedriver)))
    driver.set_page_load_timeout(60.0)
    yield driver
    driver.quit()


class Sight:
    """What a person does with the page."""

    def __init__(self, browser: webdriver.Chrome, served: Served) -> None:
        self.browser, self.served = browser, served
        browser.get_log("browser")  # type: ignore[no-untyped-call]
        browser.get(f"http://{served.host}/")
        browser.execute_script("localStorage.clear()")

    def one(self, css: str) -> WebElement:
        """An element."""
        return self.browser.find_element(By.CSS_SELECTOR, css)

    def until(self, holds: Callable[[], bool]) -> None:
        """Wait for it, as a person would."""
        WebDriverWait(self.browser, PATIENCE_S, 0.1).until(lambda _: holds())

    def says(self, css: str, words: str) -> None:
        """Wait until it says so."""
        self.until(lambda: words in self.one(css).text)

    def token(self, word: str = TOKEN) -> None:
        """Type the token."""
        self.one("#token").send_keys(word, Keys.ENTER)
        self.says("#answer", "kept in this browser")

    def type(self, css: str, text: str) -> None:
        """Into a field, in place of what stands there."""
        field = self.one(css)
        field.clear()
        field.send_keys(text)

    def fill(self, css: str, value: str) -> None:
        """A date or time, whose keys depend on the browser's language."""
        self.browser.execute_script(
            "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input', {bubbles: true}))",
            self.one(css), value,
        )  # fmt: skip

    def complaints(self) -> list[str]:
        """What the console says."""
        entries = self.browser.get_log("browser")  # type: ignore[no-untyped-call]
        return [str(entry["message"]) for entry in entries]


@pytest.fixture
def sight(browser: webdriver.Chrome) -> Iterator[Sight]:
    """The page, freshly opened, with a clean console at the end."""
    browser.set_window_size(1000, 1400)
    served = Served()
    served.room.step()
    seen = Sight(browser, served)
    yield seen
    complaints = seen.complaints()
    browser.get("about:blank")
    served.close()
    assert complaints == []


def test_it_loads_and_says_why(sight: Sight) -> None:
    assert sight.served.room.hub.decision is not None
    assert sight.one("#reason").text == sight.served.room.hub.decision.reason
    drawing = sight.one("#drawing svg.wide")
    assert drawing.is_displayed()
    assert not sight.one("#drawing svg.narrow").is_displayed()
    assert drawing.aria_role in ("img", "image")
    assert "Planned:" in str(drawing.get_property("textContent"))
    assert sight.one("#nights-title").text == "The next nights"


def test_it_keeps_itself_fresh(sight: Sight) -> None:
    sight.served.room.plug.warnings = (Fault("plug_socket", "the socket is warm"),)
    sight.served.later(minutes=30)
    sight.says("#faults", "the socket is warm")
    sight.says("#faults", "Look at plugd's log.")
    sight.says("#at", "23:30")
    sight.served.room.plug.warnings = ()
    sight.served.later(minutes=30)
    sight.until(lambda: sight.one("#faults").text == "")


def test_what_somebody_types_is_not_overwritten(sight: Sight) -> None:
    sight.type("#minimum", "7")
    sight.served.later(minutes=30)
    sight.says("#at", "23:30")
    assert sight.one("#minimum").get_property("value") == "7"


def test_the_minimum_is_set_with_the_keyboard_alone(sight: Sight) -> None:
    sight.token()
    sight.type("#minimum", "65")
    sight.one("#minimum").send_keys(Keys.ENTER)
    sight.says("#answer", "every morning has at least 65 %")
    sight.says("#tiles", "at least 65 %")
    assert sight.served.room.cycle.memory.overrides.minimum == 0.65


def test_a_boost_charges_and_is_shown(sight: Sight) -> None:
    sight.token()
    sight.one("[data-command=mode][data-value=now]").click()
    sight.says("#answer", "mode is now")
    sight.says("#status", "charging now")
    assert sight.served.room.plug.on
    sight.until(lambda: sight.one("[data-command=mode][data-value=now]").get_attribute("aria-pressed") == "true")
    sight.one("[data-command=mode][data-value=smart]").click()
    sight.says("#answer", "mode is smart")
    assert sight.served.room.cycle.memory.overrides.mode is Mode.SMART


def test_a_trip_is_set_and_removed(sight: Sight) -> None:
    sight.token()
    sight.fill("[name=date]", "2023-01-04")
    sight.type("[name=minimum_pct]", "75")
    sight.fill("[data-command=trip] [name=ready_by]", "06:15")
    sight.one("[data-command=trip] .row button").click()
    sight.says("#trips", "Wednesday 4 January: 75 %, ready by 06:15")
    assert [trip.day for trip in overrides(sight).trips] == [date(2023, 1, 4)]
    for day in (5, 6):
        sight.fill("[name=date]", f"2023-01-0{day}")
        sight.type("[name=minimum_pct]", "75")
        sight.one("[data-command=trip] .row button").click()
        sight.says("#trips", f" {day} January: 75 %")
    sight.one("#trips li:nth-child(2) button").click()
    sight.until(lambda: "5 January" not in sight.one("#trips").text)
    assert [trip.day for trip in overrides(sight).trips] == [date(2023, 1, 4), date(2023, 1, 6)]
    for left in (1, 0):
        sight.one("#trips button").click()
        sight.until(lambda count=left: len(sight.browser.find_elements(By.CSS_SELECTOR, "#trips li")) == count)  # type: ignore[misc]
    assert overrides(sight).trips == ()


def overrides(sight: Sight) -> Overrides:
    return sight.served.room.cycle.memory.overrides


def test_the_week_is_set_and_given_back(sight: Sight) -> None:
    sight.token()
    sight.one("#more summary").send_keys(Keys.ENTER)
    sight.type("#sat-minimum_pct", "65")
    sight.fill("#sat-ready_by", "10:00")
    sight.one("#sun-away").click()
    sight.one("[data-command=week] button:not([type])").click()
    sight.says("#answer", "2 days of the week differ")
    week = (5, DayRule(time(10), 0.65)), (6, DayRule(away=True))
    assert overrides(sight).week == week
    sight.one("button[data-command=week]").click()
    sight.says("#answer", "the week is the configured one")
    assert overrides(sight).week is None
    sight.until(lambda: sight.one("#sat-ready_by").get_property("value") == "")
    assert not sight.one("#sun-away").is_selected()


def test_what_is_rarely_used_is_folded_and_works(sight: Sight) -> None:
    assert not sight.one("#horizon").is_displayed()
    sight.token()
    sight.one("#more summary").click()
    sight.type("#horizon", "2")
    sight.one("#horizon").send_keys(Keys.ENTER)
    sight.says("#answer", "2 nights are planned together")
    for word, there in (("ON", True), ("OFF", False)):
        sight.one(f"[data-command=connected][data-value={word}]").click()
        sight.says("#answer", "the car is here" if there else "the car is not here")
        assert sight.served.room.cycle.memory.presence.connected is there
        pressed = f"[data-command=connected][data-value={word}][aria-pressed=true]"
        sight.until(lambda css=pressed: bool(sight.browser.find_elements(By.CSS_SELECTOR, css)))  # type: ignore[misc]
    sight.one("[data-command=replan]").click()
    sight.says("#answer", "planned anew")
    assert sight.served.room.cycle.memory.overrides.horizon == 2


def test_what_is_set_elsewhere_is_shown_in_the_fields(sight: Sight) -> None:
    sight.served.room.hub.said.append(SetWeek(((6, DayRule(away=True)),)))
    sight.served.room.hub.said.append(SetHorizon(3))
    sight.served.later(seconds=10)
    sight.until(lambda: sight.one("#horizon").get_property("value") == "3")
    assert sight.one("#sun-away").is_selected()


def test_the_soc_is_told(sight: Sight) -> None:
    sight.token()
    sight.type("#soc", "42")
    sight.one("[data-command=soc] button").click()
    sight.says("#tiles", "42 %")
    assert sight.served.room.cycle.memory.soc.mean == pytest.approx(0.42, abs=0.005)


def test_a_wrong_token_changes_nothing_and_says_so(sight: Sight) -> None:
    sight.token("guessed")
    sight.one("[data-command=mode][data-value=off]").click()
    sight.says("#answer", "that is not the token")
    assert sight.served.room.cycle.memory.overrides.mode is Mode.SMART
    told = sight.complaints()  # the browser itself says that a request was refused
    assert len(told) == 1
    assert "401" in told[0]


def test_a_token_that_no_header_carries_is_refused_in_words(sight: Sight) -> None:
    sight.one("#token").send_keys("five €", Keys.ENTER)
    sight.says("#answer", "not a token this page can send")


@pytest.mark.parametrize("phone", PHONES, ids=lambda size: f"{size[0]} px")
def test_it_fits_a_phone(sight: Sight, phone: tuple[int, int]) -> None:
    sight.browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": phone[0], "height": phone[1], "deviceScaleFactor": 2, "mobile": True},
    )
    sight.served.room.run(sight.served.room.clock.at + timedelta(days=2))
    try:
        sight.browser.get(f"http://{sight.served.host}/")
        for column in sight.browser.find_elements(By.CSS_SELECTOR, "#nights th"):
            if column.is_displayed():
                assert column.location["x"] + column.size["width"] <= phone[0], column.text
        assert {"saved", "morning"} <= set(sight.one("#nights thead").text.split())
        sight.one("#more summary").click()
        width = sight.browser.execute_script("return document.documentElement.scrollWidth")
        assert width <= phone[0]
        for field in sight.browser.find_elements(By.CSS_SELECTOR, ".week input"):
            assert 0 <= field.location["x"] <= phone[0] - field.size["width"], field.get_attribute("id")
        assert sight.one("#drawing svg.narrow").is_displayed()
        assert not sight.one("#drawing svg.wide").is_displayed()
        for button in sight.browser.find_elements(By.CSS_SELECTOR, "[data-command=mode]"):
            assert button.size["height"] >= 40
    finally:
        sight.browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_every_control_has_a_name_and_can_be_reached_by_tab(sight: Sight) -> None:
    sight.one("#more summary").send_keys(Keys.ENTER)
    controls = sight.browser.find_elements(By.CSS_SELECTOR, "main button, main summary, main input:not([hidden])")
    assert len(controls) >= 40
    assert [c.get_attribute("outerHTML") for c in controls if not c.accessible_name] == []
    reached = set()
    for _ in range(90):
        sight.browser.switch_to.active_element.send_keys(Keys.TAB)
        reached.add(sight.browser.switch_to.active_element.id)
    assert {c.id for c in controls} <= reached


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_words_stand_out_from_their_ground(sight: Sight, scheme: str) -> None:
    """WCAG AA: 4.5 to 1, in either scheme."""
    media = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    sight.served.room.plug.warnings = (Fault("plug_protects", "the plug is hot"),)
    sight.served.later(minutes=1)
    sight.says("#faults", "the plug is hot")
    sight.one("#more summary").click()
    sight.browser.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
    ratios = sight.browser.execute_script(CONTRAST)
    sight.browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
    assert len(ratios) > 8
    assert {name: ratio for name, ratio in ratios.items() if ratio < 4.5} == {}


CONTRAST = """
const light = (css) => {
  const linear = (v) => v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  const [r, g, b] = css.match(/[0-9.]+/g).map((v) => linear(v / 255));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
};
const ground = (e) => {
  const css = getComputedStyle(e).backgroundColor;
  return css === "rgba(0, 0, 0, 0)" && e.parentElement ? ground(e.parentElement) : css;
};
const found = {};
const WORDS = "h1, h2, p, dt, dd, small, th, td, button, label, legend, a, li, strong, summary, svg.wide text";
for (const e of document.querySelectorAll(WORDS)) {
  if (!e.textContent.trim() || e.classList.contains("unseen")) continue;
  const style = getComputedStyle(e);
  const [a, b] = [light(e instanceof SVGElement ? style.fill : style.color), light(ground(e))];
  const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
  const name = e.tagName + "." + e.classList;
  found[name] = Math.min(found[name] ?? 99, ratio);
}
return found;
"""
