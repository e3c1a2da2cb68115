"""The bench itself: its script, what a stub says wrong when told to, and that every promise can be broken."""

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path
from xml.etree import ElementTree as ET
from zoneinfo import ZoneInfo

import pytest

from plugd.errors import UsageError
from plugd_hil import bench, scenario
from plugd_hil.account import Line
from plugd_hil.outlet import Said
from plugd_hil.plug_faults import PlugFaults
from plugd_hil.promises import CHECKS, Seen, parsed
from plugd_hil.script import Script, event, moment

ZONE = ZoneInfo("Europe/London")
START = datetime(2023, 7, 3, 16, 0, tzinfo=UTC)  # 17:00 in London
SCENARIOS = sorted((Path(__file__).resolve().parents[2] / "hil" / "scenarios").glob("*.yaml"))


def at(hour: int, minute: int = 0) -> datetime:
    """Of that night, by London's clock."""
    return moment(f"{hour:02}:{minute:02}", START, ZONE)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("18:30", datetime(2023, 7, 3, 17, 30, tzinfo=UTC)),
        ("02:10", datetime(2023, 7, 4, 1, 10, tzinfo=UTC)),
        ("02:10:05", datetime(2023, 7, 4, 1, 10, 5, tzinfo=UTC)),
        ("17:00", START),
        ("1/02:10", datetime(2023, 7, 5, 1, 10, tzinfo=UTC)),
        ("1/18:30", datetime(2023, 7, 4, 17, 30, tzinfo=UTC)),
        ("+90", START + timedelta(seconds=90)),
    ],
)
def test_a_time_is_the_first_after_the_start(text: str, expected: datetime) -> None:
    assert moment(text, START, ZONE) == expected


@pytest.mark.parametrize("text", [130, "25:00", "2:1", "", None, "+x"])
def test_what_is_no_time_is_refused(text: object) -> None:
    with pytest.raises(UsageError):
        moment(text, START, ZONE)


def test_a_script_gives_each_order_once_and_only_to_whom_it_is_for(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text('faults:\n- {at: "+20", plug: unmute}\n- {at: "+10", plug: mute}\n- {at: "+5", neso: "500"}\n')
    script = Script.read(path, "plug", START, "Europe/London")
    assert script.due() == START + timedelta(seconds=10)
    assert script.take(START + timedelta(seconds=9)) == []
    assert script.take(START + timedelta(seconds=30)) == ["mute", "unmute"]
    assert script.due() is None


@pytest.mark.parametrize("row", [{"at": "+1"}, {"at": "+1", "cat": "miaow"}, {"plug": "mute"}, "mute"])
def test_a_row_that_says_nothing_is_refused(row: object) -> None:
    with pytest.raises(UsageError):
        event(row, START, ZONE)


def test_lies_change_what_is_said_and_nothing_else() -> None:
    faults = PlugFaults(0)
    sensor = Said("tele/p/SENSOR", '{"Time":"x","ENERGY":{"Total":7.5,"Power":2300}}')
    assert faults.told("lie power 1000000") == []
    assert json.loads(faults.pass_on([sensor], START)[0].payload)["ENERGY"] == {"Total": 7.5, "Power": 1e6}
    faults.told("truth")
    faults.told("reset")
    totals = (json.dumps({"ENERGY": {"Total": total}}) for total in (7.5, 8.0))
    said = [faults.pass_on([sensor._replace(payload=text)], START)[0].payload for text in totals]
    assert [json.loads(text)["ENERGY"]["Total"] for text in said] == [0.0, 0.5]
    faults.told("truth")
    assert json.loads(faults.pass_on([sensor], START)[0].payload) == json.loads(sensor.payload)


@pytest.mark.parametrize(
    ("topic", "payload", "lied"),
    [
        ("stat/p/POWER", "OFF", "ON"),
        ("stat/p/RESULT", '{"POWER":"OFF"}', '{"POWER":"ON"}'),
        ("p/events/rpc", '{"params":{"switch:0":{"output":false}}}', '{"params":{"switch:0":{"output":true}}}'),
        ("shellies/p/relay/0", "off", "on"),
        ("p", '{"state":"OFF","power":3}', '{"state":"ON","power":3}'),
        ("tele/p/LWT", "Online", "Online"),
    ],
)
def test_a_lie_about_the_relay_is_in_the_plugs_own_word(topic: str, payload: str, lied: str) -> None:
    faults = PlugFaults(0)
    faults.told("lie relay on")
    assert faults.pass_on([Said(topic, payload)], START)[0].payload == lied


def test_a_lie_leaves_noise_as_it_is() -> None:
    faults = PlugFaults(0)
    faults.told("lie energy 1")
    noise = Said("tele/p/SENSOR", "[" * 100_000)
    assert faults.pass_on([noise], START)[0] == noise


def test_what_is_late_comes_in_order_and_at_its_time() -> None:
    faults = PlugFaults(0)
    faults.told("late 3")
    assert faults.pass_on([Said("a", "1"), Said("b", "2")], START) == []
    assert faults.due() == START + timedelta(seconds=3)
    assert [one.topic for one in faults.pass_on([], START + timedelta(seconds=3))] == ["a", "b"]


def _state(percent: float, *faults: str) -> dict[str, object]:
    shown = [{"code": code, "text": f"{code} since noon"} for code in faults]
    return {"soc_pct": percent, "reason": "Charging now.", "mode": "smart", "faults": shown}


SEEN = Seen(
    ledger=(
        Line(START, "start", 0.3, 0.0, False, True),
        Line(at(2), "on", 0.3, 0.0, True, True),
        Line(at(6), "off", 0.6, 16.0, False, True),
        Line(at(7, 30), "slot", 0.6, 16.0, False, True),
    ),
    states=((START, _state(30)), (at(3), _state(37, "plug_silent")), (at(4), _state(45))),
    words=((at(2), "cmnd/p/POWER", "ON"), (at(6), "cmnd/p/POWER", "OFF")),
    presence=((START, "online"), (at(5), "offline")),
    asked={"voltage_v": 405.0, "current_a": 11.0, "invalid": 0, "opened_under_load": 0, "longest_silence_s": 1.0},
    zone=ZONE,
)


@pytest.mark.parametrize(
    ("kept", "broken"),
    [
        ({"morning": 60, "to": "07:00"}, {"morning": 61, "to": "07:00"}),
        ({"never_above_pct": 60}, {"never_above_pct": 59}),
        ({"shows": "plug_silent", "from": "02:59", "within_s": 60}, {"shows": "plug_silent", "from": "02:50"}),
        (
            {"shows": "plug_silent", "from": "03:00", "saying": "since noon"},
            {"shows": "plug_silent", "from": "03:00", "saying": "gone"},
        ),
        ({"clears": "plug_silent", "from": "03:30", "within_s": 1800}, {"clears": "plug_silent", "from": "03:30"}),
        ({"never_shows": "any", "from": "04:00"}, {"never_shows": "any", "from": "03:30"}),
        ({"says": "Charging"}, {"says": "Waiting"}),
        ({"state": {"mode": "smart"}}, {"state": {"mode": "off"}}),
        ({"relay": True, "from": "02:00", "to": "05:59"}, {"relay": True, "from": "02:00", "to": "06:00"}),
        ({"relay": False, "from": "01:00", "to": "01:59"}, {"relay": False, "from": "01:00", "to": "02:00"}),
        ({"moves_at_most": 2}, {"moves_at_most": 1}),
        ({"words_at_most": 1, "from": "03:00"}, {"words_at_most": 1}),
        ({"soc_within": 3, "from": "03:00", "to": "04:00"}, {"soc_within": 3, "to": "07:00"}),
        ({"presence": "offline", "from": "05:00"}, {"presence": "offline", "from": "05:01", "within_s": 60}),
        ({"volts_at_most": 405}, {"volts_at_most": 404}),
        ({"amps_at_most": 11}, {"amps_at_most": 10.9}),
        ({"invalid_at_most": 0}, {"invalid_at_most": -1}),
        ({"opened_under_load_at_most": 0}, {"opened_under_load_at_most": -1}),
        ({"silence_s_at_most": 1}, {"silence_s_at_most": 0.9}),
    ],
)
def test_every_promise_can_be_kept_and_broken(kept: dict[str, object], broken: dict[str, object]) -> None:
    first, second = (parsed(row, START, at(7, 30), ZONE) for row in (kept, broken))
    assert CHECKS[first.name](first, SEEN) is None
    assert CHECKS[second.name](second, SEEN)


@pytest.mark.parametrize("row", [{"morning": 50, "relay": True}, {"from": "02:00"}, {"mourning": 50}])
def test_a_promise_that_nobody_looks_after_is_refused(row: dict[str, object]) -> None:
    with pytest.raises(UsageError):
        parsed(row, START, at(7, 30), ZONE)


def test_a_night_at_natural_speed_is_refused_with_the_reason(capsys: pytest.CaptureFixture[str]) -> None:
    (night,) = (path for path in SCENARIOS if path.stem == "plug_silent")
    assert bench.main(["--natural", str(night)]) == 2
    assert "only those with `seconds`" in capsys.readouterr().err


def test_there_are_scenarios_enough_each_with_a_promise_and_a_line() -> None:
    found = [scenario.load(path) for path in SCENARIOS]
    assert len(found) >= 25
    assert sum(one.written.seconds is not None for one in found) >= 5
    assert all(one.promises and one.written.line for one in found)


@pytest.mark.requires("mosquitto")
def test_a_broken_promise_is_said_and_in_the_junit_file(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    from plugd_hil import bench  # noqa: PLC0415 # it draws, which is slow to import

    path = tmp_path / "short.yaml"
    path.write_text(
        "title: a press\nline: Button\nseconds: 30\ncar: connected\nfaults:\n"
        '- {at: "+5", say: plugd/ev/mode/set now}\n- {at: "+15", plug: press}\npromises:\n'
        '- {relay: on, from: "+5", within_s: 2, to: "+14"}\n- {relay: on, from: "+5", within_s: 2}\n'
    )
    assert bench.main([str(path), "--out", str(tmp_path / "out")]) == 1
    assert "not kept: relay True, from +5, within_s 2\n" in capfd.readouterr().out
    suite = ET.parse(tmp_path / "out" / "junit.xml").getroot()[0]
    assert (suite.get("tests"), suite.get("failures")) == ("3", "1")
    assert (tmp_path / "out" / "short" / "timeline.png").stat().st_size > 1000
