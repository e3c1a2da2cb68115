"""`plugd init`: whatever it accepts loads, and nothing is left where it does not end well."""

import io
import os
import pty
import subprocess
import sys
import threading
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import time
from pathlib import Path
from typing import Self

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from plugd.adapters.mqtt import Message
from plugd.cli import main
from plugd.cli.init import Terminal
from plugd.config import Config, load, parse, password
from plugd.errors import PlugdError, UsageError
from plugd.first_run.answers import DEFAULTS, KINDS, Answers, nested
from plugd.first_run.interview import Draft, Found, interview
from plugd.first_run.looking import look, plugs_in
from plugd.first_run.places import REGIONS, region_of
from plugd.first_run.questions import KIND_WORDS, TOPIC_WORDS
from plugd.first_run.writing import toml, write
from plugd_hil.broker import Mosquitto, free_port
from tests.programs import PATIENCE_S, Listener, Program, environment

STATE = "/var/lib/plugd"
PLAIN = ["", "", "", "", "", "", "ev-plug", "", "", "", "", "", "", "", "", ""]
"""Enter to everything but the plug's topic."""
CALLED = {
    "Region": 0, "host": 1, "TLS": 2, "Port": 3, "User": 4, "Kind": 5, "topic": 6, "draws": 7, "Battery": 8,
    "Driven": 9, "most": 10, "least": 11, "plugged": 12, "unplugged": 13, "Ready": 14, "Folder": 15,
}  # fmt: skip


def answered(more: Sequence[str] = (), after: str = "", **answers: str) -> str:
    """Lines for stdin: Enter, or what is given for a question; `more` lines behind that of `after`."""
    lines = list(PLAIN)
    for question, text in answers.items():
        lines[CALLED[question]] = text
    if after:
        lines[CALLED[after] + 1 : CALLED[after] + 1] = more
    return "".join(f"{line}\n" for line in lines)


@dataclass(frozen=True, slots=True)
class Run:
    """What became of `plugd init`."""

    status: int
    out: str
    err: str


@pytest.fixture
def init(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> "Init":
    return Init(capsys, monkeypatch, tmp_path / "plugd.toml")


@dataclass(frozen=True, slots=True)
class Init:
    """The command with its answers on stdin."""

    capsys: pytest.CaptureFixture[str]
    monkeypatch: pytest.MonkeyPatch
    path: Path

    def __call__(self, lines: str, path: Path | None = None) -> Run:
        self.monkeypatch.setattr(sys, "stdin", io.StringIO(lines))
        self.capsys.readouterr()
        status = main(["init", "--out", str(path or self.path)])
        out, err = self.capsys.readouterr()
        return Run(status, out, err)

    def left(self) -> list[str]:
        """What is in the folder."""
        return sorted(each.name for each in self.path.parent.iterdir())


# -- answers on stdin -----------------------------------------------------------------------------


def test_enter_is_the_defaults_and_every_key_that_was_asked_is_written(init: Init) -> None:
    run = init(answered())
    assert (run.status, run.err) == (0, "")
    config, expected = load(init.path), parse('[plug]\ntopic = "ev-plug"\n')
    state = str(config.state.dir)
    assert config == expected.model_copy(update={"state": config.state})
    found = tomllib.loads(init.path.read_text())
    assert found["car"] == {
        "capacity_kwh": 50,
        "daily_use_kwh": 5.8,
        "daily_use_sd_kwh": 2.67,
        "soc_max_pct": 80,
    }
    assert found["nights"] == {"plug_in": "18:00", "plug_out": "09:00", "morning_minimum_pct": 50}
    assert found["state"] == {"dir": state}
    assert "home" not in found
    assert "relay" not in found
    assert init.left() == ["plugd.toml"]


def test_what_is_answered_is_what_is_loaded(init: Init) -> None:
    run = init(
        answered(
            Region="london", host="192.168.1.2", Port="1884", Kind="2", topic="garage/plug", draws="2 kW",
            Battery="64 kWh", Driven="10000 miles", most="90 %", least="60", plugged="17:30", unplugged="8:15",
            Ready="7:00", Folder="/srv/plugd",
        )
    )  # fmt: skip
    assert (run.status, run.err) == (0, "")
    config = load(init.path)
    assert config.home.region_id == 13
    assert (config.broker.host, config.broker.port) == ("192.168.1.2", 1884)
    assert (config.plug.kind, config.plug.topic, config.plug.power_kw) == ("shelly2", "garage/plug", 2.0)
    assert (config.car.capacity_kwh, config.car.soc_max_pct) == (64.0, 90.0)
    assert config.car.daily_use_kwh == pytest.approx(10_000 * 1.609344 * 0.2 / 365.25, abs=0.05)
    assert config.car.daily_use_sd_kwh == pytest.approx(config.car.daily_use_kwh * 2.67 / 5.8, abs=0.01)
    nights = config.nights
    assert (nights.plug_in, nights.plug_out, nights.ready_by) == (time(17, 30), time(8, 15), time(7, 0))
    assert nights.morning_minimum_pct == 60
    assert config.state.dir == Path("/srv/plugd")
    assert "region_id = 13  # London" in init.path.read_text()
    assert "car.daily_use_kwh = 8.8" in run.out


def test_every_key_of_the_file_has_a_reason_above_it_or_above_the_one_before(init: Init) -> None:
    init(answered())
    for block in init.path.read_text().split("\n\n")[1:]:
        assert block.splitlines()[1].startswith("# "), block


@pytest.mark.parametrize(
    ("question", "wrong", "said", "right"),
    [
        ("Region", "18", "home.region_id = 18: must be at most 17", "17"),
        ("Region", "somewhere", 'or the first half of a postcode, like "SW1"', "RG10 9AB"),
        ("Region", "Lodnon", "did you mean London?", "London"),
        ("Region", "north", "did you mean North Scotland or North West England or North East England or", "north wa"),
        ("Region", "RG100", 'must be the first half of a postcode, like "SW1"', "RG10"),
        ("TLS", "perhaps", "y or n is wanted", "n"),
        ("Port", "99999", "broker.port = 99999: must be at most 65535", "1883"),
        ("Port", "mqtt", "a number is wanted", "1883"),
        ("Kind", "9", "must be one of 'tasmota'", "8"),
        ("Kind", "shely2", "did you mean 'shelly2'?", "shelly2"),
        ("topic", "", "this has no default; an answer is needed", "ev-plug"),
        ("topic", "tele/#", "must be a plain MQTT topic", "ev-plug"),
        ("draws", "2300", "looks like W; write 2.3", "2.3"),
        ("Battery", "0", "car.capacity_kwh = 0: must be at least 1", "1e2"),
        ("Battery", "nan", "must be a finite number", "50"),
        ("Driven", "12 parsecs", 'a distance a year, like "8000 miles"', "5,000 km a year"),
        ("Driven", "60", "is more than car.capacity_kwh holds; lower it", "49"),
        ("most", "0.8", "looks like a fraction; write percent: 80", "80"),
        ("most", "20", "must be more than car.soc_min_pct; raise it", "80"),
        ("least", "81", "is more than car.soc_max_pct; lower it", "80"),
        ("plugged", "7pm", "a time of 24 hours is wanted, like 07:30\n", '"19:00"'),
        ("plugged", "24:00", "a time of 24 hours is wanted, like 07:30\n", "18:00"),
        ("unplugged", "18:00", "is the same as nights.plug_in", "09:00"),
        ("Ready", "18:00", "is the same as nights.plug_in", "07:00"),
        ("Folder", "~nobody-of-this-name/x", "write the whole path", "/srv/x"),
    ],
)
def test_a_wrong_answer_is_asked_again_with_the_reason(
    init: Init, question: str, wrong: str, said: str, right: str
) -> None:
    run = init(answered([right], after=question, **{question: wrong}))
    assert (run.status, run.err) == (0, "")
    assert said in run.out
    assert load(init.path).plug.topic == "ev-plug"


def test_a_region_may_be_told_in_several_ways() -> None:
    assert sorted(REGIONS) == list(range(1, 18))
    assert all(region_of(name.upper()) == number for number, name in REGIONS.items())
    assert [region_of(word) for word in ("yorks", "north", "SW1", "scot", "north w")] == [5, None, None, 16, None]


@pytest.mark.parametrize("lines", ["", "\n", "".join(answered().splitlines(keepends=True)[:-1])])
def test_too_few_answers_are_one_line_and_nothing_is_written(init: Init, lines: str) -> None:
    run = init(lines)
    assert run.status == 2
    assert len(run.err.splitlines()) == 1
    assert "the answers ended before the questions; give one a line" in run.err
    assert init.left() == []


@pytest.mark.parametrize(("line", "question"), [("y", "Region"), ("13", "Encrypted"), ("", "Its topic")])
def test_answers_without_end_are_given_up_on(init: Init, line: str, question: str) -> None:
    run = init(f"{line}\n" * 500)
    assert run.status == 2
    assert run.err.startswith(f"plugd: init: 20 answers to '{question}")
    assert run.err.endswith("and none that can be taken; nothing was written\n")
    assert len(run.err.splitlines()) == 1
    assert init.left() == []


def test_a_question_before_the_first_is_given_up_on_too(init: Init) -> None:
    init.path.write_text("mine")
    run = init("maybe\n" * 500)
    assert (run.status, init.path.read_text()) == (2, "mine")
    assert "20 answers to" in run.err


def test_a_file_that_is_there_is_replaced_only_after_a_yes(init: Init) -> None:
    init.path.write_text("mine")
    for lines in ("\n", "n\n", "", f"what?\nn\n{answered()}"):
        run = init(lines)
        assert run.status == 1
        assert run.err == f"plugd: {init.path}: left as it is; name another file with --out\n"
        assert init.path.read_text() == "mine"
    assert init(f"y\n{answered()}").status == 0
    assert load(init.path).plug.topic == "ev-plug"
    assert init.left() == ["plugd.toml"]


def test_a_file_that_comes_while_questions_are_answered_is_left_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "plugd.toml"
    path.write_text("somebody's")
    answers: Answers = {"plug.topic": "ev-plug", "broker.username": "me"}
    with pytest.raises(PlugdError, match="has come meanwhile"):
        write(path, Draft({**answers, "broker.password_file": str(tmp_path / "p")}, "secret"), replace=False)
    assert [each.name for each in tmp_path.iterdir()] == ["plugd.toml"]


def test_a_password_goes_to_a_file_of_its_own(init: Init) -> None:
    secret = init.path.parent / "mqtt_password"
    run = init(answered(["tab\there", "hunter2"], after="User", User="me"))
    assert (run.status, run.err) == (0, "")
    assert "must hold the secret alone, on one line" in run.out
    assert "hunter2" not in run.out + init.path.read_text()
    assert secret.read_text() == "hunter2\n"
    assert secret.stat().st_mode & 0o777 == 0o600
    config = load(init.path)
    found = password(config)
    assert found is not None
    assert (config.broker.username, found.get_secret_value()) == ("me", "hunter2")
    again = init("y\n" + answered([""], after="User", User="me"))
    assert again.status == 0
    assert f"Enter: the one in {secret}" in again.out
    assert secret.read_text() == "hunter2\n"
    assert init("y\n" + answered(["other"], after="User", User="me")).status == 0
    assert secret.read_text() == "other\n"
    assert init.left() == ["mqtt_password", "plugd.toml"]


def test_without_a_password_there_is_no_file_for_it(init: Init) -> None:
    assert init(answered([""], after="User", User="me")).status == 0
    assert load(init.path).broker.password_file is None
    assert init.left() == ["plugd.toml"]


def test_tls_asks_for_an_authority_and_another_port(init: Init) -> None:
    assert init(answered([""], after="TLS", TLS="yes")).status == 0
    config = load(init.path)
    assert (config.broker.tls, config.broker.port, config.broker.ca_file) == (True, 8883, None)


def test_more_than_a_13_a_plug_bears_is_asked_about(init: Init) -> None:
    run = init(answered(["", "16"], after="draws", draws="3.6"))
    assert run.status == 0
    assert "3.6 kW is 15.7 A. A 13 A plug bears no more than 10.5 A all night" in run.out
    assert load(init.path).plug.max_current_a == 16


def test_more_than_the_plug_would_let_flow_is_asked_about_again(init: Init) -> None:
    run = init(answered(["7", "3.6", "16"], after="draws", draws="10"))
    assert (run.status, run.err) == (0, "")
    assert "plug.power_kw = 10: is 43.5 A at 230 V, and the plug is cut off above plug.max_current_a = 7" in run.out
    plug = load(init.path).plug
    assert (plug.power_kw, plug.max_current_a) == (3.6, 16)
    assert init("y\n" + answered(["7", "1.5"], after="draws", draws="10")).status == 0
    assert "max_current_a" not in init.path.read_text()


def test_a_charger_has_a_current_and_one_on_can_a_battery_to_bear_it(init: Init) -> None:
    assert init(answered([""], after="draws", Kind="openevse", topic="openevse")).status == 0
    plug = load(init.path).plug
    assert (plug.power_kw, plug.max_current_a) == (7.36, 32)
    lines = answered(["", "", "", "", "", "403.2", "9"], after="draws", Kind="can_elcon").split("\n")
    del lines[CALLED["topic"]]
    assert init("y\n" + "\n".join(lines)).status == 0
    config = load(init.path)
    assert (config.plug.kind, config.plug.topic, config.can.max_voltage_v) == ("can_elcon", None, 403.2)


def test_where_nothing_can_be_written_is_said_before_the_first_question(init: Init, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for path, said in (
        (tmp_path / "file" / "plugd.toml", "is no folder; name another file with --out"),
        (tmp_path, "is a folder; name the file with --out"),
    ):
        run = init("", path)
        assert run.status == 1
        assert said in run.err
        assert run.out == ""


def test_a_folder_of_somebody_else_is_refused(init: Init, tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    if os.access(tmp_path, os.W_OK):
        pytest.skip("this user may write everywhere")
    run = init("")
    tmp_path.chmod(0o700)
    assert run.status == 1
    assert "this user may not write there; use sudo, or name another file with --out" in run.err


def test_folders_are_made_and_a_link_stays_one(init: Init, tmp_path: Path) -> None:
    link = tmp_path / "link.toml"
    link.symlink_to(tmp_path / "deep" / "er" / "plugd.toml")
    assert init(answered(), link).status == 0
    assert link.is_symlink()
    assert load(tmp_path / "deep" / "er" / "plugd.toml") == load(link)


def test_at_a_terminal_it_ends_with_a_check_where_that_is_wanted(init: Init, monkeypatch: pytest.MonkeyPatch) -> None:
    checked: list[Path] = []

    class Sitting(Terminal):
        """Somebody who is there, and takes the plug that is found."""

        def __init__(self) -> None:
            super().__init__()
            self.present = True

        def ask(self, prompt: str) -> str:
            return self._line(prompt, shown=True)

    monkeypatch.setattr("plugd.cli.init.Terminal", Sitting)
    monkeypatch.setattr(
        "plugd.first_run.looking.look", lambda _: Found(plugs=(("tasmota", "bad/#"), ("shelly2", "garage")))
    )
    monkeypatch.setattr("plugd.cli.check.told", lambda config, path, click: checked.append(path))
    lines = answered().splitlines(keepends=True)
    del lines[CALLED["topic"]]  # Enter to the list is the one plug that can be
    for end, times in (("", 1), ("y\n", 2), ("n\n", 2)):
        init.path.unlink(missing_ok=True)
        run = init("".join(lines) + (end or "\n"))
        assert (run.status, run.err) == (0, "")
        assert load(init.path).plug.topic == "garage"
        assert checked == [init.path] * times
        assert run.out.splitlines()[-1].startswith(f"Next: `plugd -c {init.path} check --click`")


# -- whatever is accepted loads -------------------------------------------------------------------

WORDS = (
    "y n 0 1 2 3 5 13 London SW1 GB localhost 8883 2.3 3.7 50 80 07:30 7:30 18:00 can0 socketcan 500000 ev-plug inf -1"
)
LIKELY = st.sampled_from(
    ["", *WORDS.split(), "64 kWh", "8000 miles", "12,000 km a year", "100 %", "mqtt", "openevse", "~/x", "/srv/plugd"]
) | st.sampled_from(['a"b', "a\\b", "\x7f\x01", "é ü/€", "1e400", "'''", "# no"])
STEADY = {
    "Region": "13", "MQTT broker": "localhost", "Encrypted": "n", "Port": "1883", "User": "", "Kind": "1",
    "Its topic": "ev-plug", "What the car": "7.36", "At most, in A": "80", "CAN interface": "socketcan",
    "CAN channel": "can0", "CAN bits": "250000", "The battery's": "403.2", "Its highest": "9", "Battery": "50",
    "Driven": "0.5", "Charge": "100", "Have": "0", "Usually plugged": "17:59", "Usually unplugged": "08:59",
    "Ready": "06:59", "Folder": "/srv", "File": "/etc/ca.pem", "Which": "1", "Tell": "n", "Password": "",
}  # fmt: skip
"""What each question takes, whatever was answered before."""


@dataclass(slots=True)
class Babbler:
    """Somebody who answers anything, and comes to reason when asked a third time in a row, or a sixth."""

    data: st.DataObject
    present: bool
    said: list[str] = field(default_factory=list)
    _last: tuple[str, int] = ("", 0)
    _asked: Counter[str] = field(default_factory=Counter)

    def say(self, text: str) -> None:
        self.said.append(text)

    def ask(self, prompt: str) -> str:
        name, times = self._last
        self._last = prompt, times + 1 if prompt == name else 1
        assert self._last[1] < 5, f"{prompt!r} takes no answer: {self.said[-2:]}"
        self._asked[prompt] += 1
        if self._last[1] > 2 or self._asked[prompt] > 5:
            return next(text for start, text in STEADY.items() if prompt.startswith(start))
        return self.data.draw(LIKELY | st.text(st.characters(exclude_characters="\r\n"), max_size=12))

    ask_secret = ask


FOUND = st.builds(
    Found,
    st.none() | st.just("refused"),
    st.lists(st.tuples(st.sampled_from(KINDS), LIKELY | st.text(max_size=8)), max_size=3).map(tuple),
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
@given(data=st.data(), present=st.booleans())
def test_whatever_is_accepted_is_written_and_loads_as_it_was_meant(
    tmp_path: Path, data: st.DataObject, present: bool
) -> None:
    path = tmp_path / "plugd.toml"
    (tmp_path / "mqtt_password").unlink(missing_ok=True)
    draft = interview(Babbler(data, present), tmp_path, STATE, lambda _: data.draw(FOUND))
    meant = Config.model_validate(nested(draft.answers), context={"folder": tmp_path})
    assert parse(toml(draft.answers), folder=tmp_path) == meant
    write(path, draft, replace=True)
    assert path.read_text("utf-8") == toml(draft.answers)
    if meant.broker.ca_file is None:
        config = load(path)
        secret = password(config)
        assert config == meant
        assert (secret.get_secret_value() if secret else None) == draft.password
    path.unlink()


@given(lines=st.lists(LIKELY | st.text(max_size=12), max_size=14))
def test_answers_that_end_too_early_never_make_a_file(lines: list[str]) -> None:
    class Lines:
        present = False
        left = iter(lines)

        def say(self, text: str) -> None:
            pass

        def ask(self, prompt: str) -> str:
            for line in self.left:
                return line
            raise EOFError

        ask_secret = ask

    with pytest.raises(UsageError, match="nothing was written"):
        interview(Lines(), Path("/srv"), STATE, lambda _: Found())


def test_every_kind_of_plug_has_its_words() -> None:
    assert set(KIND_WORDS) == set(KINDS)
    assert set(TOPIC_WORDS) == set(KINDS) - {"can_elcon"}
    assert DEFAULTS.plug.kind == KINDS[0]


# -- a look at the broker -------------------------------------------------------------------------


def test_plugs_that_say_they_are_there_are_found_and_nothing_else() -> None:
    said = {
        "tele/one/LWT": "Online", "tele/gone/LWT": "Offline", "shellyplus1-a1/online": "true", "evcc/online": "yes",
        "shellies/plug-s/online": "true", "shellies/old/online": "false",
        "openevse/announce/55ad": '{"state":"connected","mqtt":"garage/evse"}',
        "openevse/announce/1": '{"state":"disconnected","mqtt":"x"}', "openevse/announce/2": "[]",
        "openevse/announce/3": "{", "openevse/announce/4": '{"state":"connected","mqtt":5}',
    }  # fmt: skip
    messages = tuple(Message(topic, payload.encode(), True) for topic, payload in said.items())
    assert plugs_in(messages) == (
        ("tasmota", "one"),
        ("shelly2", "shellyplus1-a1"),
        ("shelly1", "plug-s"),
        ("openevse", "garage/evse"),
    )


def test_a_broker_is_looked_at_as_it_was_told(mosquitto: Mosquitto, monkeypatch: pytest.MonkeyPatch) -> None:
    listener = Listener(mosquitto.host, mosquitto.port, ["none"])
    listener.send("tele/ev-plug/LWT", "Online", retain=True)
    listener.send("tele/other/LWT", "Online")
    listener.close()
    there: Answers = {"broker.host": mosquitto.host, "broker.port": mosquitto.port}
    assert look(Draft({**there, "broker.username": "me", "broker.password_file": "/nowhere"}, "hunter2")) == Found(
        plugs=(("tasmota", "ev-plug"),)
    )
    monkeypatch.setattr("plugd.first_run.looking.AGAIN_S", 0.1)
    refused = look(Draft({**there, "broker.port": free_port()})).refusal
    assert refused is not None
    assert "refuses the connection" in refused


class Thinks:
    """Somebody whose broker lets nobody in at first; they answer what they are listed with, else Enter."""

    present = True

    def __init__(self, **answers: Sequence[str]) -> None:
        self.answers = {start: iter(texts) for start, texts in answers.items()}
        self.asked: list[str] = []

    def say(self, text: str) -> None:
        pass

    def ask(self, prompt: str) -> str:
        self.asked.append(prompt)
        return next((next(texts, "") for start, texts in self.answers.items() if prompt.startswith(start)), "")

    ask_secret = ask


def refused_once() -> Callable[[Draft], Found]:
    said = iter([Found(refusal="it refuses the password")])
    return lambda _: next(said, Found())


def test_who_thinks_again_is_offered_what_was_told_before(tmp_path: Path) -> None:
    person = Thinks(Port=["1884"], User=["me"], Password=["hunter2"], Its=["ev-plug"])
    draft = interview(person, tmp_path, STATE, refused_once())
    assert [draft.answers[f"broker.{key}"] for key in ("port", "username")] == [1884, "me"]
    assert draft.password == "hunter2"
    assert [prompt for prompt in person.asked if prompt.startswith(("Port", "User", "Pass"))] == [
        "Port [1883]: ", "User [Enter: it asks for none]: ", "Password of me [Enter: it needs none]: ",
        "Port [1884]: ", "User [me]: ", "Password of me [Enter: as before]: ",
    ]  # fmt: skip


def test_who_thinks_again_may_take_it_back(tmp_path: Path) -> None:
    """The usual port goes with the encryption; a dash is no user."""
    person = Thinks(Encrypted=["n", "y"], User=["me", "-"], Password=["hunter2"], Its=["ev-plug"])
    draft = interview(person, tmp_path, STATE, refused_once())
    assert draft.answers["broker.port"] == 8883
    assert not [key for key in draft.answers if key in ("broker.username", "broker.password_file")]
    assert draft.password is None


def test_another_users_password_is_not_the_first_ones(tmp_path: Path) -> None:
    person = Thinks(User=["me", "you"], Password=["hunter2", ""], Its=["ev-plug"])
    assert interview(person, tmp_path, STATE, refused_once()).password is None


# -- at a terminal --------------------------------------------------------------------------------

CONTROLLED = "import fcntl, os, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); os.execv(sys.argv[1], sys.argv[1:])"
"""Makes the terminal on stdin that of a new session, so that Ctrl-C and a hidden password are as in life."""


class Seat:
    """A person at a terminal of their own. A prompt that is wider, as with a long path, scrolls out of sight."""

    def __init__(self, path: Path, columns: int = 200) -> None:
        self._ours, theirs = pty.openpty()
        command = [sys.executable, "-m", "plugd", "init", "--out", str(path)]
        self.process = subprocess.Popen(
            [sys.executable, "-c", CONTROLLED, *command],
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            start_new_session=True,
            env=environment(TERM="dumb", COLUMNS=str(columns)),
        )
        os.close(theirs)
        self._seen, self._read = "", 0
        self._news = threading.Condition()
        self._reader = threading.Thread(target=self._hear, daemon=True)
        self._reader.start()

    def _hear(self) -> None:
        with suppress(OSError):  # how a terminal ends
            while heard := os.read(self._ours, 4096):
                with self._news:
                    self._seen += heard.decode("utf-8", "replace")
                    self._news.notify_all()

    def until(self, words: str) -> str:
        """What came up to these words, after what was read before."""
        with self._news:
            if not self._news.wait_for(lambda: words in self._seen[self._read :], PATIENCE_S):
                raise TimeoutError(f"{words!r} does not come: {self._seen[self._read :]!r}")
            end = self._seen.index(words, self._read) + len(words)
            came, self._read = self._seen[self._read : end], end
            return came

    def type(self, text: str) -> None:
        """Keys, and Enter."""
        os.write(self._ours, f"{text}\r".encode())

    def enter(self, times: int) -> None:
        """Enter, at each question when it is asked: keys that come between two may be lost."""
        for _ in range(times):
            self.type("")
            self.until("]: ")

    def press(self, key: bytes) -> None:
        """One key that ends it: again where it came between the prompt and the reading of keys, and was lost."""
        for _ in range(int(PATIENCE_S)):
            os.write(self._ours, key)
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(1.0)
                return

    def ends(self) -> tuple[int, str]:
        """Its status, and all that was seen."""
        status = self.process.wait(PATIENCE_S)
        self._reader.join(PATIENCE_S)
        return status, self._seen

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.ends()
        os.close(self._ours)


@pytest.fixture
def plugged(mosquitto: Mosquitto) -> Iterator[Mosquitto]:
    """A broker with a plug on it."""
    with Program("plugd_hil.plug", "--broker", f"{mosquitto.host}:{mosquitto.port}", "--stdin") as plug:
        plug.said.until(lambda line: line.get("ready"))
        yield mosquitto


def test_a_terminal_breaks_no_line_within_a_word(tmp_path: Path) -> None:
    with Seat(tmp_path / "plugd.toml", columns=80) as seat:
        seat.until(": ")
        seat.type("Londn")
        said = seat.until("did you") + seat.until("]: ")
    lines = said.splitlines()
    assert lines[-2] == "  did you mean London?"
    assert max(map(len, lines)) <= 80


def test_a_person_at_a_terminal_is_led_through(plugged: Mosquitto, tmp_path: Path) -> None:
    path = tmp_path / "plugd.toml"
    with Seat(path) as seat:
        seat.until("all of Great Britain]: ")
        seat.type("13")
        seat.until("host [localhost]: ")
        seat.type("127.0.0.1")
        seat.until("[n]: ")
        seat.type("")
        seat.until("Port [1883]: ")
        closed = free_port()
        seat.type(str(closed))
        seat.until("User ")
        seat.type("")
        assert "refuses the connection" in seat.until("Tell me about the broker again? [Y/n]: ")
        seat.type("")
        seat.until("host [127.0.0.1]: ")
        seat.type("")
        seat.until("[n]: ")
        seat.type("")
        seat.until(f"Port [{closed}]: ")
        seat.type(str(plugged.port))
        seat.until("User ")
        seat.type("me")
        seat.until("Password of me ")
        seat.type("hunter2")
        assert "1 tasmota      ev-plug" in seat.until("or 0 for another [1]: ")
        seat.type("7")
        assert "a number from 0 to 1 is wanted" in seat.until("[1]: ")
        seat.type("")
        seat.until("[2.3]: ")
        seat.type("")
        seat.until("Battery, in kWh [50]: ")
        seat.type("40 kWh")
        seat.until('miles" [5.8]: ')
        seat.type("a lot")
        assert "kWh a day are wanted" in seat.until("[5.8]: ")
        seat.enter(5)
        seat.type("")
        seat.until("Folder for what plugd learns [")
        seat.type(str(tmp_path / "state"))
        assert f"{path} is written" in seat.until("Look now whether all of it works? [Y/n]: ")
        seat.type("n")
        status, seen = seat.ends()
    assert status == 0
    assert "hunter2" not in seen
    assert f"plugd -c {path} check --click" in seen
    config = load(path)
    assert (config.plug.kind, config.plug.topic, config.car.capacity_kwh) == ("tasmota", "ev-plug", 40.0)
    assert (config.broker.port, config.broker.username) == (plugged.port, "me")
    assert (tmp_path / "mqtt_password").stat().st_mode & 0o777 == 0o600


def test_ctrl_c_leaves_nothing_behind_and_ctrl_d_says_why(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "plugd.toml"
    for key, status, said in ((b"\x03", 130, "Nothing was written."), (b"\x04", 2, "nothing was written")):
        with Seat(path) as seat:
            seat.until("Great Britain]: ")
            seat.type("13")
            seat.until("host [localhost]: ")
            seat.press(key)
            assert seat.ends()[0] == status
            assert said in seat.ends()[1]
            assert "Traceback" not in seat.ends()[1]
        assert list(tmp_path.iterdir()) == []
