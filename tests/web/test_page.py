"""The page over HTTP: what it shows, what it sets, and whom it refuses."""

import json
import re
import socket
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from datetime import date, timedelta
from datetime import time as time_of_day
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path
from statistics import median

import pytest
from prometheus_client.parser import text_string_to_metric_families

from plugd import ledger
from plugd import page as opening
from plugd.adapters.hub import state
from plugd.config import parse
from plugd.domain import DayRule, Fault, Mode
from plugd.ports import Hub, Inbox
from plugd.remedies import KNOWN
from plugd.units import grams
from plugd.web.server import MOST_CONNECTIONS
from plugd.web.view import Tile, tiles
from tests.unit.deciding import HOME, minutes
from tests.web.serving import TOKEN, NoLine, Served


@pytest.fixture
def served() -> Iterator[Served]:
    """A page that may be written to, after the first step."""
    page = Served()
    page.room.step()
    yield page
    page.close()


@pytest.fixture(scope="module")
def standing() -> Iterator[Served]:
    """One page for all that is refused, and so changes nothing."""
    page = Served()
    page.room.step()
    yield page
    page.close()


@pytest.fixture
def guarded(standing: Served) -> Served:
    """The same, having refused nobody yet."""
    standing.page.gate.refused.clear()
    return standing


# -- what it shows --------------------------------------------------------------------------------


def test_the_page_says_what_is_done_and_why_and_draws_the_nights(served: Served) -> None:
    page = served.get()
    assert page.status == 200
    assert served.room.hub.decision is not None
    assert served.room.hub.decision.reason in page.text
    assert page.text.count("<svg") >= 2
    for words in ("Every morning at least", "Ready by", "A trip", "What it saved", "running since Mon 2 Jan, 23:00"):
        assert words in page.text


def test_a_plug_that_a_dead_plugd_leaves_off_is_marked(served: Served) -> None:
    marked = "The plug has no timer of its own: switched off, it stays off if plugd or the broker dies"
    for timed in (True, False):
        served.desk.household = replace(HOME, capability=replace(HOME.capability, dead_man=timed))
        served.later(minutes=1)
        assert (marked in served.get().text) is not timed


def test_forecasts_are_scored_beside_everything_else(served: Served) -> None:
    assert "<dd>12 g<small>8 %</small></dd>" in scored(served)


def scored(served: Served) -> str:
    """The page, once the scores are on it."""
    until = time.perf_counter() + 10.0
    while "0 to 6 h ahead" not in (text := served.get().text) and time.perf_counter() < until:
        pass
    return text


def test_page_and_state_have_the_figures_of_the_ledger(served: Served) -> None:
    served.room.run(served.room.clock.at + timedelta(hours=34))
    assert served.room.cycle.book is not None
    rows, nights = served.room.cycle.book.known()
    kwh = sum(row.kwh for row in rows)
    assert kwh > 1.0
    page, told = served.get().text, served.get("/api/state").document
    assert f"{kwh:.1f} kWh in {len(nights)} nights" in page
    saved_g = sum(night.saved_g for night in nights)
    assert told["saved_g_total"] == pytest.approx(saved_g, abs=0.06)
    for night in nights:
        assert f"<td>{night.kwh:.1f}</td>" in page
    assert f"{saved_g:.0f} g saved" in page


def test_every_number_of_what_was_saved_follows_from_the_half_hours(served: Served) -> None:
    served.room.run(served.room.clock.at + timedelta(days=4, hours=12))
    assert served.room.cycle.book is not None
    rows, nights = served.room.cycle.book.known()
    page = served.get().text
    table = re.search(r"<tbody>\n(<tr><td>.*?)</tbody>", page, re.DOTALL)
    assert table is not None
    shown = {
        cells[0]: cells[1:]
        for cells in (re.findall(r"<td[^>]*>(.*?)</td>", row) for row in table[1].split("</tr>"))
        if cells
    }
    assert len(shown) == len(nights) == 5
    whole = dict.fromkeys(("kwh", "ours", "arrival", "best"), 0.0)
    for night in nights:
        those = [row for row in rows if row.night == night.day]
        kwh, ours_g = sum(row.kwh for row in those), sum(row.kwh * row.carbon_g_per_kwh for row in those)
        arrival_g, best_g = night.on_arrival_g, night.best_g
        for key, value in zip(whole, (kwh, ours_g, arrival_g, best_g), strict=True):
            whole[key] += value
        morning = "" if night.morning_soc is None else f"{100 * night.morning_soc:.0f} %"
        flowed = kwh > 0.005
        figures = [f"{g / kwh:.0f}" if flowed else "-" for g in (ours_g, arrival_g, best_g)]
        saved = f"{arrival_g - ours_g:.0f} g" if flowed else "-"
        assert shown[f"{night.day:%a %-d %b}"] == [f"{kwh:.1f}", *figures, saved, morning]
        assert best_g <= ours_g + 0.01
    text = re.sub(r"<.*?>", "", page)
    per_kwh = {key: f"{grams_ / whole['kwh']:.0f}" for key, grams_ in whole.items() if key != "kwh"}
    assert f"{whole['kwh']:.1f} kWh in 5 nights at {per_kwh['ours']} g/kWh" in text
    assert f"would have been at {per_kwh['arrival']}: {grams(whole['arrival'] - whole['ours'])} saved" in text
    assert f"were at {per_kwh['best']}." in text


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("car", "told by the car, 2 h ago"),
        ("hub", "as you said, 2 h ago"),
        ("meter", "told 2 h ago, metered"),
        ("full", "full when it last stopped"),
        ("fleet", "told by fleet, 2 h ago"),
    ],
)
def test_who_says_how_full_the_battery_is(served: Served, source: str, words: str) -> None:
    snapshot = served.desk.snapshot
    assert snapshot is not None
    told = replace(snapshot.decision.memory.soc, source=source, told_at=snapshot.decision.at - timedelta(hours=2))
    decision = replace(snapshot.decision, memory=replace(snapshot.decision.memory, soc=told))
    shown = tiles(replace(snapshot, decision=decision), state(decision, None, HOME))
    assert shown[0] == Tile("battery", "60 %", words)


def test_the_tile_of_what_was_saved_is_the_ledgers(served: Served) -> None:
    served.room.run(served.room.clock.at + timedelta(hours=34))
    snapshot = served.desk.snapshot
    assert snapshot is not None
    total_g, month = snapshot.decision.saved, ledger.total(snapshot.nights)
    assert total_g is not None
    assert month.saved_pct is not None

    def tile(today_g: float) -> Tile:
        decision = replace(snapshot.decision, saved=replace(total_g, today_g=today_g))
        return tiles(replace(snapshot, decision=decision), served.get("/api/state").document)[-1]

    assert tile(0.0) == Tile("CO2 saved", grams(total_g.total_g), f"{month.saved_pct:.0f} % less than on arrival")
    assert tile(321.0).more in ("321 g last night", "321 g tonight")


def test_the_state_is_the_hubs_own(served: Served) -> None:
    snapshot = served.desk.snapshot
    assert snapshot is not None
    assert served.get("/api/state").document == state(snapshot.decision, snapshot.reading, HOME)


def test_only_what_is_new_is_sent_again(served: Served) -> None:
    version = served.get("/live").document["version"]
    assert served.get(f"/live?v={version}").status == 204
    served.room.hub.said.clear()
    served.later(minutes=30)
    news = served.get(f"/live?v={version}")
    assert news.status == 200
    assert news.document["version"] > version
    assert set(news.document["html"]) == {"tiles", "faults", "drawing", "trips", "nights", "scores"}


def test_faults_are_shown_with_what_to_do(served: Served) -> None:
    served.room.plug.warnings = (Fault("plug_protects", "plug ev has switched itself off (overtemp)"),)
    served.later(minutes=1)
    for text in (served.get().text, served.get("/live").document["html"]["faults"]):
        for words in ("The plug has switched itself off.", "plug ev has switched itself off (overtemp)"):
            assert words in text
        assert KNOWN["plug_protects"].remedy in text


def test_before_the_first_step_it_waits() -> None:
    page = Served()
    try:
        assert "just started" in page.get().text
        assert page.get("/live").status == 204
        assert page.get("/api/state").status == 503
        assert page.get("/healthz").status == 503
        assert page.get("/metrics").status == 200
    finally:
        page.close()


def test_health_is_that_of_the_cycle(served: Served) -> None:
    assert served.get("/healthz").status == 200
    served.room.clock.at += minutes(3)
    assert served.get("/healthz").status == 503


def test_metrics_are_the_states_figures(served: Served) -> None:
    served.room.run(served.room.clock.at + timedelta(hours=8))
    served.get("/", Host="evil.example")
    told, answer = served.get("/api/state").document, served.get("/metrics")
    assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    found = {
        (sample.name, *sample.labels.values()): sample.value
        for family in text_string_to_metric_families(answer.text)
        for sample in family.samples
    }
    assert found[("plugd_soc_ratio",)] == pytest.approx(told["soc_pct"] / 100)
    assert found[("plugd_intensity_grams_per_kwh",)] == told["intensity_g_per_kwh"]
    assert found[("plugd_energy_kwh_total",)] == told["energy_kwh"] > 0.0
    assert found[("plugd_mode", "smart")] == 1.0
    assert found[("plugd_page_refused_total", "host")] == 1.0


def test_all_of_it_is_small_and_sealed(served: Served) -> None:
    served.room.run(served.room.clock.at + timedelta(hours=30))
    static = [path.name for path in files("plugd.web").joinpath("static").iterdir()]
    replies = [served.get(), *(served.get(f"/static/{name}") for name in static)]
    assert all(reply.status == 200 for reply in replies)
    assert sum(len(reply.body) for reply in replies) < 150_000
    for reply in (*replies, served.get("/nothing"), served.get("/", Host="evil.example"), served.get("/live")):
        assert reply.headers["content-security-policy"].startswith("default-src 'none'")
        assert "unsafe" not in reply.headers["content-security-policy"]
        assert reply.headers["x-content-type-options"] == "nosniff"
        assert reply.headers["x-frame-options"] == "DENY"
        assert "server" not in reply.headers
    assert "style=" not in replies[0].text
    assert "http://" not in replies[0].text.replace("http://www.w3.org/2000/svg", "")
    assert served.get("/static/../app.py").status == 404
    assert served.get("/static/%2e%2e/app.py").status == 404


# -- what it sets ---------------------------------------------------------------------------------


def test_what_is_set_is_obeyed_and_answered(served: Served) -> None:
    told = served.set("minimum", "65")
    assert (told.status, told.document) == (
        200,
        {"command": "minimum", "ok": True, "message": "every morning has at least 65 %"},
    )
    assert served.set("mode", "now").document["ok"]
    assert served.set("ready_by", "06:15").document["ok"]
    assert served.set("soc", "44").document["ok"]
    assert served.set("horizon", "3").document["ok"]
    assert served.set("week", '{"sat": {"ready_by": "10:00"}}').document["ok"]
    assert served.set("connected", "ON").document["ok"]
    assert served.set("replan", "PRESS").document["ok"]
    overrides = served.room.cycle.memory.overrides
    assert (overrides.mode, overrides.minimum, overrides.horizon) == (Mode.NOW, 0.65, 3)
    assert overrides.week == ((5, DayRule(time_of_day(10))),)
    assert served.room.cycle.memory.soc.mean == pytest.approx(0.44, abs=0.01)
    assert served.room.plug.on
    assert 'aria-pressed="true">Now' in served.get().text
    assert [answer.command for answer in served.room.hub.answers] == [
        "minimum", "mode", "ready_by", "soc", "horizon", "week", "connected", "replan",
    ]  # fmt: skip


def test_a_trip_is_set_shown_and_cleared(served: Served) -> None:
    assert served.set("trip", json.dumps({"date": "2023-01-04", "minimum_pct": 70, "ready_by": "06:00"})).document["ok"]
    assert [(t.day, t.minimum) for t in served.room.cycle.memory.overrides.trips] == [(date(2023, 1, 4), 0.7)]
    assert "Wednesday 4 January: 70 %, ready by 06:00" in served.get().text
    assert served.set("trip", json.dumps({"date": "2023-01-05", "away": True})).document["ok"]
    assert served.set("trip", json.dumps({"date": "2023-01-04", "clear": True})).document["ok"]
    assert [t.day for t in served.room.cycle.memory.overrides.trips] == [date(2023, 1, 5)]
    assert served.set("trip", json.dumps({"clear": True})).document["message"] == "no trips are set"
    assert served.room.cycle.memory.overrides.trips == ()


def test_each_trip_has_a_button_with_its_own_date(served: Served) -> None:
    """The page's script sends that date back."""
    for day in ("2023-01-05", "2023-01-04", "2023-01-09"):
        assert served.set("trip", json.dumps({"date": day, "away": True})).document["ok"]
    for text in (served.get().text, served.get("/live").document["html"]["trips"]):
        shown = re.findall(r'<li>\w+ (\d) January: .*? data-clear="2023-01-0(\d)"', text)
        assert shown == [("4", "4"), ("5", "5"), ("9", "9")]


@pytest.mark.parametrize(
    ("command", "payload", "status"),
    [
        ("minimum", "150", 400),
        ("minimum", "nan", 400),
        ("minimum", "85", 409),
        ("mode", "full", 400),
        ("trip", "{", 400),
        ("trip", "[" * 2000, 400),
        ("rm", "1", 400),
        ("soc", "9" * 5000, 400),
    ],
)
def test_what_cannot_be_is_refused_in_words(guarded: Served, command: str, payload: str, status: int) -> None:
    before = guarded.room.cycle.memory.overrides
    reply = guarded.set(command, payload)
    assert reply.status == status
    assert reply.document["ok"] is False
    assert len(reply.document["message"]) < 400
    assert guarded.room.cycle.memory.overrides == before


def test_a_command_nobody_takes_is_not_waited_for_twice(served: Served) -> None:
    served.obeys = False
    assert not served.letterbox.pending()
    threads = [threading.Thread(target=served.set, args=("minimum", "60"), daemon=True) for _ in range(32)]
    for thread in threads:
        thread.start()
    deadline = time.perf_counter() + 8.0
    while len(served.desk._asked) < 32 and time.perf_counter() < deadline:
        threading.Event().wait(0.01)
    assert served.letterbox.pending()
    assert served.set("minimum", "60").status == 503
    served.later(seconds=1)
    for thread in threads:
        thread.join(10.0)
    assert served.room.cycle.memory.overrides.minimum == 0.6
    assert not served.letterbox.pending()


# -- whom it refuses ------------------------------------------------------------------------------

WRONG_HOSTS = ("evil.example", "localhost.evil.example", "127.0.0.1.nip.io", "", "plugpi.evil", "[::1", "2130706433x")


@pytest.mark.parametrize("host", WRONG_HOSTS)
def test_another_name_is_refused_and_counted(guarded: Served, host: str) -> None:
    for reply in (guarded.get("/", Host=host), guarded.get("/api/state", Host=host)):
        assert reply.status == 421
        assert b"<" not in reply.body
    assert guarded.set("mode", "off", Host=host, Origin=f"http://{host}").status == 421
    assert guarded.page.gate.refused == {"host": 3}
    assert guarded.room.cycle.memory.overrides.mode is Mode.SMART


@pytest.mark.parametrize("host", ["localhost:8480", "PlugPi", "plugpi.local:80", "192.168.1.7:8480", "[fe80::1]:8480"])
def test_its_own_names_and_addresses_are_let_in(guarded: Served, host: str) -> None:
    assert guarded.get("/", Host=host).status == 200
    assert guarded.set("minimum", "61", Host=host, Origin=f"https://{host}").status == 200


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "", "http://127.0.0.1", "file://"])
def test_another_origin_is_refused_and_counted(guarded: Served, origin: str) -> None:
    assert guarded.set("mode", "off", Origin=origin).status == 403
    assert guarded.page.gate.refused == {"origin": 1}
    assert guarded.room.cycle.memory.overrides.mode is Mode.SMART


def test_no_origin_is_refused_too(guarded: Served) -> None:
    assert guarded.ask("POST", "/command/mode", b"off", X_Plugd_Token=TOKEN).status == 403


@pytest.mark.parametrize("token", ["", "an old oa", "an old oaks", "AN OLD OAK", "*"])
def test_another_token_is_refused_and_counted(guarded: Served, token: str) -> None:
    assert guarded.set("mode", "off", X_Plugd_Token=token).status == 401
    assert guarded.page.gate.refused == {"token": 1}
    assert guarded.room.cycle.memory.overrides.mode is Mode.SMART


def test_no_token_at_all_is_refused(guarded: Served) -> None:
    assert guarded.ask("POST", "/command/mode", b"off", Origin=f"http://{guarded.host}").status == 401


def test_without_a_token_file_it_only_shows() -> None:
    page = Served(token=None)
    try:
        page.room.step()
        assert "This page only shows" in page.get().text
        assert "<form" not in page.get().text
        assert page.set("mode", "off").status == 403
        assert page.page.gate.refused == {"read_only": 1}
    finally:
        page.close()


def test_other_methods_do_nothing(guarded: Served) -> None:
    for method in ("PUT", "DELETE", "OPTIONS"):
        assert guarded.ask(method, "/command/mode", Origin=f"http://{guarded.host}").status == 405
    assert guarded.get("/command/mode").status == 405


XSS = (
    "<script>alert(1)</script>",
    "<ScRiPt src=//evil.example/x.js></sCrIpT>",
    "</script><script>alert(1)</script>",
    "</title><script>alert(1)</script>",
    "</textarea><script>alert(1)</script>",
    "</style><script>alert(1)</script>",
    "<img src=x onerror=alert(1)>",
    "<img/src=x/onerror=alert(1)>",
    '"><img src=x onerror=alert(1)>',
    "'><img src=x onerror=alert(1)>",
    '" onmouseover="alert(1)',
    "' onmouseover='alert(1)",
    "` onmouseover=`alert(1)",
    "<svg onload=alert(1)>",
    "<svg><script>alert(1)</script></svg>",
    "<svg><animate onbegin=alert(1) attributeName=x>",
    "<math><mtext></mtext><script>alert(1)</script></math>",
    "<iframe src=javascript:alert(1)>",
    "<iframe srcdoc='<script>alert(1)</script>'>",
    "<a href=javascript:alert(1)>x</a>",
    "<a href='data:text/html,<script>alert(1)</script>'>x</a>",
    "<body onload=alert(1)>",
    "<details open ontoggle=alert(1)>",
    "<video><source onerror=alert(1)></video>",
    "<object data=javascript:alert(1)>",
    "<base href=//evil.example/>",
    "<meta http-equiv=refresh content='0;url=//evil.example'>",
    "<link rel=stylesheet href=//evil.example/x.css>",
    "{{ 7 * 7 }}{% for x in ().__class__.__bases__ %}{{ x }}{% endfor %}",
    "\u003cscript\u003ealert(1)\u003c/script\u003e",
    "]]><script>alert(1)</script><!--",
    "<!--><script>alert(1)</script>-->",
)


class Tags(HTMLParser):
    """The page as a browser would take it apart."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.seen: list[tuple[str, tuple[str, ...]]] = []
        self.text = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep."""
        self.seen.append((tag, tuple(name for name, _ in attrs)))

    def handle_data(self, data: str) -> None:
        """Keep."""
        self.text += data


def test_there_are_thirty_of_them() -> None:
    assert len(set(XSS)) >= 30


@pytest.fixture(scope="module")
def vandal() -> Iterator[Served]:
    """A page whose names a test may spoil."""
    page = Served()
    page.room.step()
    scored(page)
    yield page
    page.close()


@pytest.mark.parametrize("text", XSS)
def test_no_name_or_topic_becomes_markup(vandal: Served, text: str) -> None:
    """As plugd's name, in a fault (a plug's topic is), as reason and as SOC source: always words, never tags."""
    snapshot = vandal.desk.snapshot
    assert snapshot is not None

    def shown(word: str) -> tuple[Tags, Tags]:
        memory = snapshot.decision.memory
        memory = replace(memory, soc=replace(memory.soc, source=word))
        fault = Fault("plug_silent", f"{word}: no answer; is the topic right?")
        decision = replace(snapshot.decision, reason=word, faults=(fault,), memory=memory)
        before = vandal.desk.snapshot
        assert before is not None
        vandal.desk.snapshot = replace(snapshot, version=before.version + 1, decision=decision)
        vandal.page.name = word
        parts = vandal.get("/live").document["html"]
        return Tags(vandal.get().text), Tags("".join(parts.values()))

    plain, spoilt = shown("word"), shown(text)
    assert [tags.seen for tags in spoilt] == [tags.seen for tags in plain]
    assert text in spoilt[0].text
    assert f"{text}: no answer; is the topic right?" in spoilt[1].text


@pytest.mark.parametrize("text", XSS)
def test_no_payload_comes_back_as_anything_but_json(guarded: Served, text: str) -> None:
    for reply in (guarded.set("mode", text), guarded.set("trip", json.dumps({"date": text}))):
        assert reply.status == 400
        assert reply.headers["content-type"] == "application/json"
        assert reply.document["ok"] is False
    assert guarded.page.gate.refused == {"command": 2}


# -- beside the cycle -----------------------------------------------------------------------------


def test_fifty_clients_do_not_hold_up_the_cycle(served: Served) -> None:
    def tick_s(count: int) -> float:
        found = []
        for _ in range(count):
            began = time.perf_counter()
            served.later(minutes=30)
            found.append(time.perf_counter() - began)
        return median(found)

    tick_s(3)
    alone_s = tick_s(9)
    stop = threading.Event()
    answered = []

    def hammer() -> None:
        while not stop.is_set():
            try:
                answered.append(served.get("/").status)
            except OSError:
                answered.append(0)

    threads = [threading.Thread(target=hammer) for _ in range(50)]
    for thread in threads:
        thread.start()
    try:
        hammered_s = tick_s(9)
    finally:
        stop.set()
        for thread in threads:
            thread.join(30.0)
    assert answered.count(200) > 20
    # Clients and cycle share one process and interpreter here, so this is far worse than any house.
    assert hammered_s < 20 * alone_s + 1.0


@pytest.mark.parametrize("trickle", [b"", b"1\r\n6\r\n"], ids=["stops", "trickles"])
def test_a_body_that_never_ends_is_cut(served: Served, monkeypatch: pytest.MonkeyPatch, trickle: bytes) -> None:
    """However slowly it goes on: the patience is for all of it."""
    monkeypatch.setattr("plugd.web.app.PATIENCE_S", 0.5)
    host, port = served.host.rsplit(":", 1)
    head = (
        *("POST /command/minimum HTTP/1.1", f"Host: {served.host}", f"Origin: http://{served.host}"),
        *(f"X-Plugd-Token: {TOKEN}", "Transfer-Encoding: chunked", "", "1", "6", ""),
    )
    with socket.create_connection((host, int(port)), timeout=0.1) as connection:
        connection.sendall("\r\n".join(head).encode())
        answer = b""
        for _ in range(100):
            try:
                answer = connection.recv(4096)
                break
            except TimeoutError:
                connection.sendall(trickle)
    assert answer.startswith(b"HTTP/1.1 408 ")
    assert served.page.gate.refused == {"slow": 1}
    assert served.room.cycle.memory.overrides.minimum is None
    assert served.get().status == 200


def test_half_open_connections_are_bounded(served: Served) -> None:
    host, port = served.host.rsplit(":", 1)
    open_ones = [socket.create_connection((host, int(port)), timeout=10.0) for _ in range(3 * MOST_CONNECTIONS)]
    try:
        served.later(minutes=1)
        alive = 0
        for connection in open_ones:
            connection.settimeout(0.05)
            try:
                alive += int(connection.recv(1) != b"")
            except TimeoutError:
                alive += 1
            except OSError:
                continue
        assert alive <= MOST_CONNECTIONS
    finally:
        for connection in open_ones:
            connection.close()


def test_without_the_extra_there_is_one_line_and_no_page(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, served: Served
) -> None:
    monkeypatch.setattr(opening, "find_spec", lambda name: None if name == "uvicorn" else object())
    before: Hub = served.room.cycle.hub
    line = NoLine()
    caplog.set_level("INFO", "plugd")
    with opening.opened_page(parse('[plug]\ntopic = "p"'), Path(), served.room.cycle, line) as inbox:
        found: Inbox = inbox
        assert found is line
    assert served.room.cycle.hub is before
    assert [record.message.split(":")[0] for record in caplog.records] == ["there is no page"]


def test_an_address_that_is_taken_costs_the_page_only(caplog: pytest.LogCaptureFixture, served: Served) -> None:
    line = NoLine()
    config = parse(f'[plug]\ntopic = "p"\n[web]\nbind = "{served.host}"')
    with opening.opened_page(config, Path(), served.room.cycle, line) as inbox:
        assert inbox is line
    assert f"{served.host}: Address already in use; set web.bind to a free address" in caplog.text


def test_what_is_no_http_any_more_is_refused_without_a_traceback(
    served: Served, caplog: pytest.LogCaptureFixture
) -> None:
    host, port = served.host.rsplit(":", 1)
    head = f"GET / HTTP/1.1\r\nHost: {served.host}\r\nTransfer-Encoding: chunked\r\n\r\n"
    with socket.create_connection((host, int(port)), timeout=10.0) as line:
        line.sendall(head.encode() + b"no length of a chunk\r\n")
        assert line.recv(100).startswith(b"HTTP/1.1 400")
    assert served.get("/").status == 200
    assert not [record for record in caplog.records if record.exc_info]
