"""The configuration file: its example, its refusals, and that nothing else ever comes out."""

import re
import tomllib
from datetime import time
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from plugd.config import Config, household, known_keys, load, parse, password, token
from plugd.domain import Capability, DayRule, Household, Nights
from plugd.errors import ConfigError

EXAMPLE = Path(__file__).resolve().parents[2] / "etc" / "plugd.toml"
PLUG = '[plug]\ntopic = "ev-plug"\n'


def refusal(text: str) -> str:
    """What is said about `text`: always one line that begins with the file's name."""
    with pytest.raises(ConfigError) as caught:
        parse(text, "my.toml")
    said = str(caught.value)
    assert said.startswith("my.toml: ")
    assert len(said.splitlines()) == 1
    return said.removeprefix("my.toml: ")


# -- the example ----------------------------------------------------------------------------------


def test_the_example_is_the_defaults() -> None:
    assert load(EXAMPLE) == parse(PLUG)


def test_the_example_with_every_comment_opened_is_a_configuration_too() -> None:
    text = re.sub(r"(?m)^# (\w+ = )", r"\1", EXAMPLE.read_text())
    text = text.replace('postcode = "SW1"\n', "").replace('soc = "pylontech"\n', "")
    text = text.replace("tls = false", "tls = true")
    text = text.replace('kind = "tasmota"', 'kind = "mqtt"')
    config = parse(text)
    assert config.home.region_id == 13
    assert config.nights.ready_by == time(7, 0)
    assert config.nights.week["sat"].minimum_pct == 60
    assert config.nights.week["sun"].away


def test_the_example_names_every_key() -> None:
    opened = tomllib.loads(re.sub(r"(?m)^# (\w+ = )", r"\1", EXAMPLE.read_text()))

    def dotted(table: dict[str, object], under: str = "") -> set[str]:
        keys: set[str] = set()
        for name, value in table.items():
            keys.add(under + name)
            if isinstance(value, dict):
                keys |= dotted(value, f"{under}{name}.")
        return keys

    any_day = {re.sub(r"^nights\.week\.\w+", "nights.week.*", key) for key in known_keys()}
    assert {re.sub(r"^nights\.week\.\w+", "nights.week.*", key) for key in dotted(opened)} == any_day


def test_every_key_of_the_example_says_why() -> None:
    blocks = re.split(r"\n\n|\n(?=\[)", EXAMPLE.read_text())
    keyed = [block for block in blocks if re.search(r"(?m)^\w+ = ", block)]
    assert len(keyed) > 8
    for block in keyed:
        assert re.search(r"(?m)^# [A-Z1]", block), block


# -- what comes out -------------------------------------------------------------------------------


def test_only_the_topic_of_the_plug_must_be_given() -> None:
    assert parse(PLUG).plug.topic == "ev-plug"
    assert refusal("").startswith("plug.topic: write topic =")
    assert parse('[plug]\nkind = "can_elcon"').plug.topic is None


def test_defaults_are_the_household_of_the_paper() -> None:
    capability = Capability(power_max_kw=2.3, dead_man=True)
    learning = Household(nights=Nights(learn=True), capability=capability, max_current_a=10.5)
    assert household(parse(PLUG), capability) == learning


def test_percent_minutes_and_weekdays_become_what_the_core_works_with() -> None:
    capability = Capability(power_max_kw=7.4, modulating=True, power_min_kw=1.4)
    house = household(
        parse(
            PLUG + "[car]\nsoc_max_pct = 90\n[relay]\nmin_on_min = 20\nrandom_delay_s = 0\n"
            '[nights.week]\nsun = {away = true}\nsat = {ready_by = "10:00", minimum_pct = 60}\n'
        ),
        capability,
    )
    assert house.car.soc_max == pytest.approx(0.9)
    assert (house.relay.min_on_s, house.relay.random_delay_s, house.guard_margin_s) == (1200, 0, 1800)
    assert house.nights.week == ((5, DayRule(ready_by=time(10), minimum=0.6)), (6, DayRule(away=True)))
    assert house.capability is capability


def test_times_are_text_or_what_toml_calls_a_time() -> None:
    nights = parse(PLUG + '[nights]\nplug_in = 17:30:00\nplug_out = "07:05"').nights
    assert (nights.plug_in, nights.plug_out) == (time(17, 30), time(7, 5))
    window = parse(PLUG + '[nights]\ndefault_window = "22:00 - 05:30"').nights.default_window
    assert window == (time(22), time(5, 30))


def test_a_configuration_cannot_be_changed() -> None:
    config = parse(PLUG)
    with pytest.raises(ValidationError, match="frozen"):
        config.car.capacity_kwh = 60


def test_small_kindnesses() -> None:
    config = parse('\r\n[home]\r\npostcode = "rg10"\r\n[forecast]\r\nbase_url = "http://127.0.0.1:8000/"\r\n' + PLUG)
    assert config.home.postcode == "RG10"
    assert config.forecast.base_url == "http://127.0.0.1:8000"


# -- what is refused ------------------------------------------------------------------------------

REFUSED = [
    # unknown keys: the nearest, the right table, or the list
    ('plug.topik = "x"', 'plug.topik = "x"', "did you mean plug.topic?"),
    ("capacity_kwh = 40", "capacity_kwh = 40", "did you mean car.capacity_kwh?"),
    ("[plug]\nhorizon = 4", "plug.horizon = 4", "did you mean nights.horizon?"),
    ('[plug]\nready_by = "07:00"', 'plug.ready_by = "07:00"', "did you mean nights.ready_by?"),
    ("[cars]", "cars = (a table)", "did you mean car?"),
    ("[state]\nxyzzy = 1", "state.xyzzy = 1", "known in [state]: dir"),
    ("[nights.week]\nsat = {minimum = 60}", "nights.week.sat.minimum = 60", "nights.week.sat.minimum_pct"),
    ("[nights.week]\nsaturday = {}", "nights.week.saturday", "did you mean 'sat'?"),
    ("[nights.week]\nxyz = {}", "nights.week.xyz", "'sat' or 'sun'"),
    # wrong types
    ('car.capacity_kwh = "50"', 'car.capacity_kwh = "50"', "must be a number, without quotes"),
    ("broker.port = 1883.5", "broker.port = 1883.5", "must be a whole number"),
    ("home.region_id = true", "home.region_id = true", "must be a whole number"),
    ('web.enabled = "yes"', 'web.enabled = "yes"', "must be true or false"),
    ("name = 3", "name = 3", "must be text in quotes"),
    ("plug = 3", "plug = 3", "must be a table: [plug]"),
    ("nights.week = []", "nights.week = (a list)", "must be a table: [nights.week]"),
    ("state.dir = 3", "state.dir = 3", "must be the path"),
    ("car.capacity_kwh = nan", "car.capacity_kwh = nan", "must be a finite number"),
    ("car.daily_use_kwh = inf", "car.daily_use_kwh = inf", "must be a finite number"),
    (f"car.capacity_kwh = 0x{'f' * 5000}", "car.capacity_kwh = (a huge number)", "must be a number"),
    # wrong units
    ("car.capacity_kwh = 50000", "car.capacity_kwh = 50000", "looks like Wh; write 50"),
    ("car.daily_use_kwh = 5800", "car.daily_use_kwh = 5800", "looks like Wh; write 5.8"),
    ("plug.power_kw = 2300", "plug.power_kw = 2300", "looks like W; write 2.3"),
    ("plug.max_current_a = 10500", "plug.max_current_a = 10500", "looks like mA; write 10.5"),
    ("car.efficiency = 90", "car.efficiency = 90", "looks like percent; write 0.9"),
    ("nights.confidence = 98", "nights.confidence = 98", "looks like percent; write 0.98"),
    ("car.soc_max_pct = 0.8", "car.soc_max_pct = 0.8", "looks like a fraction; write percent: 80"),
    ("nights.morning_minimum_pct = 0.5", "nights.morning_minimum_pct = 0.5", "write percent: 50"),
    ("relay.min_on_min = 900", "relay.min_on_min = 900", "looks like seconds; write 15"),
    ("can.bitrate = 250", "can.bitrate = 250", "looks like kbit/s; write 250000"),
    # a charger
    ("plug.min_current_a = 5", "plug.min_current_a = 5", "must be at least 6"),
    ("plug.mains_voltage_v = 400", "plug.mains_voltage_v = 400", "must be at most 260"),
    ('[plug]\nkind = "can_elcon"\nmin_current_a = 16', "plug.min_current_a = 16.0", "more than plug.max_current_a"),
    ('[plug]\nkind = "can_elcon"\npower_kw = 1.2', "plug.power_kw = 1.2", "less than plug.min_current_a gives"),
    ('can.interface = "vcan"', 'can.interface = "vcan"', "did you mean 'slcan'?"),
    ("can.period_s = 5", "can.period_s = 5", "must be at most 2"),
    ("can.max_voltage_v = 5000", "can.max_voltage_v = 5000", "must be at most 1000"),
    ("can.max_current_a = 0", "can.max_current_a = 0", "must be at least 0.5"),
    ('can.soc = "pylon"', 'can.soc = "pylon"', "did you mean 'pylontech'?"),
    ('[can]\nsoc = "orion"\nsoc_dbc = "a"\nsoc_signal = "b"', 'can.soc = "orion"', "stands beside can.soc_dbc"),
    ('can.soc_signal = "SOC"', 'can.soc_signal = "SOC"', "belong together"),
    ('can.soc_dbc = "own.dbc"', "can.soc_signal", "belong together"),
    # out of range
    ("car.capacity_kwh = 0", "car.capacity_kwh = 0", "must be at least 1"),
    ("car.capacity_kwh = 600", "car.capacity_kwh = 600", "must be at most 500"),
    ("car.efficiency = 0", "car.efficiency = 0", "must be at least 0.3"),
    ("car.soc_max_pct = 101", "car.soc_max_pct = 101", "must be at most 100"),
    ("car.soc_min_pct = -1", "car.soc_min_pct = -1", "must be at least 0"),
    ("home.region_id = 0", "home.region_id = 0", "must be at least 1"),
    ("home.region_id = 18", "home.region_id = 18", "must be at most 17"),
    ("nights.horizon = 0", "nights.horizon = 0", "must be at least 1"),
    ("nights.horizon = 8", "nights.horizon = 8", "must be at most 7"),
    ("nights.confidence = 0.4", "nights.confidence = 0.4", "must be at least 0.5"),
    ("nights.confidence = 1.0", "nights.confidence = 1.0", "must be at most 0.999"),
    ("broker.port = 0", "broker.port = 0", "must be at least 1"),
    ("broker.port = 65536", "broker.port = 65536", "must be at most 65535"),
    ("plug.dead_man_s = 9", "plug.dead_man_s = 9", "must be at least 10"),
    ("plug.dead_man_s = 64801", "plug.dead_man_s = 64801", "must be at most 64800"),
    ("relay.max_switch_on = 0", "relay.max_switch_on = 0", "must be at least 1"),
    ("car.soc_max_age_min = 0", "car.soc_max_age_min = 0", "must be more than 0"),
    # text of the wrong shape
    ('name = ""', 'name = ""', "letters, digits"),
    ('name = "a/b"', 'name = "a/b"', "letters, digits"),
    ('name = "ev\\n"', 'name = "ev\\n"', "letters, digits"),
    ('broker.host = ""', 'broker.host = ""', "must not be empty"),
    ('broker.topic = "a/+"', 'broker.topic = "a/+"', "plain MQTT topic"),
    ('broker.topic = "/a"', 'broker.topic = "/a"', "plain MQTT topic"),
    ('plug.kind = "tasmotta"', 'plug.kind = "tasmotta"', "did you mean 'tasmota'?"),
    ('plug.kind = "xyzzy"', 'plug.kind = "xyzzy"', "must be one of 'tasmota', 'shelly2'"),
    ('plug.mqtt.power_unit = "MW"', 'plug.mqtt.power_unit = "MW"', "must be one of 'W' or 'kW'"),
    ('plug.mqtt.state_topic = "a/#"', 'plug.mqtt.state_topic = "a/#"', "plain MQTT topic"),
    ('plug.mqtt.state_topik = "a"', 'plug.mqtt.state_topik = "a"', "did you mean plug.mqtt.state_topic?"),
    ('home.timezone = "Europe/Londn"', 'home.timezone = "Europe/Londn"', "write Europe/London"),
    ('home.timezone = "Europe"', 'home.timezone = "Europe"', "is no time zone"),
    ('home.timezone = "../../etc/passwd"', 'home.timezone = "../../etc/passwd"', "is no time zone"),
    ('home.timezone = "/etc/passwd"', 'home.timezone = "/etc/passwd"', "is no time zone"),
    ('home.timezone = "\\u0000"', "home.timezone = ", "is no time zone"),
    ('home.postcode = "SW1A 1AA"', 'home.postcode = "SW1A 1AA"', 'first half of a postcode, like "SW1"'),
    ('nights.ready_by = "7:00"', 'nights.ready_by = "7:00"', '24 hours in quotes, like "07:30"'),
    ('nights.ready_by = "24:00"', 'nights.ready_by = "24:00"', 'like "07:30"'),
    ('nights.ready_by = "07:0²"', 'nights.ready_by = "07:0²"', 'like "07:30"'),
    ('nights.plug_in = "6 pm"', 'nights.plug_in = "6 pm"', 'like "07:30"'),
    ("nights.plug_in = 18", "nights.plug_in = 18", 'like "07:30"'),
    ("nights.plug_in = 18:00:30", 'nights.plug_in = "18:00"', 'like "07:30"'),
    ('nights.default_window = "23:00"', 'nights.default_window = "23:00"', 'like "23:00-06:00"'),
    ('nights.default_window = "23:00-6"', 'nights.default_window = "23:00-6"', 'like "07:30"'),
    ('nights.default_window = "01:00-01:00"', "nights.default_window", "two different times"),
    ('forecast.base_url = "api.example"', 'forecast.base_url = "api.example"', "http:// or https://"),
    ('forecast.base_url = "http://[::1"', 'forecast.base_url = "http://[::1"', "http:// or https://"),
    ('forecast.base_url = "http://h:99999"', 'forecast.base_url = "http://h:99999"', "http://"),
    ('forecast.base_url = "file:///etc"', 'forecast.base_url = "file:///etc"', "http://"),
    ('broker.host = "mqtt://a"', 'broker.host = "mqtt://a"', "must be a name or an address alone"),
    ('broker.host = "me:secret@a"', 'broker.host = "***@a"', "must be a name or an address alone"),
    ('web.bind = "8480"', 'web.bind = "8480"', 'like "127.0.0.1:8480"'),
    ('web.bind = "a:65536"', 'web.bind = "a:65536"', 'like "127.0.0.1:8480"'),
    ('state.dir = "~/plugd"', 'state.dir = "~/plugd"', "~ is not expanded"),
    ('state.dir = "a\\u0000b"', 'state.dir = "a', "must be the path"),
    # impossible together
    ("[car]\nsoc_min_pct = 80", "car.soc_max_pct = 80", "more than car.soc_min_pct"),
    ("car.daily_use_kwh = 60", "car.daily_use_kwh = 60", "more than car.capacity_kwh holds"),
    ("nights.morning_minimum_pct = 90", "nights.morning_minimum_pct = 90", "more than car.soc_max_pct"),
    ('nights.plug_out = "18:00"', 'nights.plug_out = "18:00"', "same as nights.plug_in"),
    ('nights.ready_by = "18:00"', 'nights.ready_by = "18:00"', "same as nights.plug_in"),
    ('[home]\nregion_id = 1\npostcode = "SW1"', 'home.postcode = "SW1"', "keep one of them"),
    ('car.soc_json_key = "soc"', 'car.soc_json_key = "soc"', "write car.soc_topic"),
    ('broker.password_file = "/x"', 'broker.password_file = "/x"', "write broker.username"),
    ('broker.ca_file = "/x"', 'broker.ca_file = "/x"', "write broker.tls = true"),
    ('[plug]\ntopic = "a"\nmqtt.state_on = "1"', "plug.mqtt", "counts only for plug.kind mqtt, shelly1"),
    ('[plug]\ntopic = "a"\nkind = "mqtt"\nmqtt.command_on = ""', 'plug.mqtt.command_on = ""', "must not be empty"),
    ('[plug]\ntopic = "a"\nkind = "openevse"\npower_kw = 1.2', "plug.power_kw = 1.2", "less than plug.min_current_a"),
    (
        '[plug]\ntopic = "a"\nkind = "openevse"\nmax_current_a = 5',
        "plug.min_current_a = 6",
        "more than plug.max_current_a",
    ),
    ("[nights.week]\nsat = {minimum_pct = 81}", "nights.week", "above car.soc_max_pct"),
    ('[nights.week]\nsat = {away = true, ready_by = "10:00"}', "nights.week", "remove one or the other"),
]


@pytest.mark.parametrize(("text", "key_and_value", "remedy"), REFUSED, ids=[row[0][:40] for row in REFUSED])
def test_a_refusal_names_key_value_and_remedy(text: str, key_and_value: str, remedy: str) -> None:
    said = refusal(text if text.startswith(("plug", "[plug]")) else f"{text}\n{PLUG}")
    assert said.startswith(key_and_value), said
    assert remedy in said.removeprefix(key_and_value), said


def test_the_first_of_several_mistakes_is_told_and_the_others_counted() -> None:
    assert refusal(PLUG + "[car]\nefficiency = 90\nsoc_max_pct = 0.8\n").endswith("(and 1 more)")


@pytest.mark.parametrize("key", ["password", "Password", "passwd", "mqtt_pass", "token", "secret"])
def test_a_secret_in_the_wrong_place_is_not_repeated(key: str) -> None:
    said = refusal(f'[broker]\n{key} = "hunter2"')
    assert "hunter2" not in said
    assert f"broker.{key} = ***" in said


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("[plug\n", "line 1, column 6: not TOML"),
        (PLUG + "a b", "line 3, column 3: not TOML"),
        ("[nights]\nplug_in = 18:00\n", "line 2, column 13: not TOML"),
        ("a = 1\na = 2\n", "line 2, column"),
        ('a = "', "line 1, column 6: not TOML"),
        ("a = [1,\n2,", "line 2, column 3: not TOML"),
    ],
)
def test_a_syntax_error_has_line_and_column(text: str, place: str) -> None:
    said = refusal(text)
    assert said.startswith(place), said
    assert "`key = value`" in said


@pytest.mark.parametrize("text", ["a = " + "9" * 5000, "a = " + "[" * 5000, "a = " + "{a=" * 5000])
def test_what_breaks_the_parser_itself_is_refused(text: str) -> None:
    assert "not TOML" in refusal(text)


# -- the file -------------------------------------------------------------------------------------


def file_refusal(path: Path) -> str:
    with pytest.raises(ConfigError) as caught:
        load(path)
    said = str(caught.value)
    assert said.startswith(f"{path}: ")
    assert len(said.splitlines()) == 1
    return said.removeprefix(f"{path}: ")


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    assert "no such file; plugd init writes one" in file_refusal(tmp_path / "none.toml")


def test_a_folder_in_the_file_s_place(tmp_path: Path) -> None:
    assert "cannot be read" in file_refusal(tmp_path)


def test_a_name_no_file_can_have() -> None:
    with pytest.raises(ConfigError, match="not a file name"):
        load(Path("a\0b"))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"# caf\xe9\n", "line 1: not UTF-8"),
        (b"\n\n\xff\xfe", "line 3: not UTF-8"),
        (b"#" * (256 * 1024 + 1), "longer than 256 KiB"),
    ],
)
def test_a_file_that_is_no_text_of_ours(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "plugd.toml"
    path.write_bytes(content)
    assert said in file_refusal(path)


def test_an_endless_file_ends() -> None:
    assert "longer than" in file_refusal(Path("/dev/zero"))


def test_a_byte_order_mark_is_no_mistake(tmp_path: Path) -> None:
    path = tmp_path / "plugd.toml"
    path.write_bytes(b"\xef\xbb\xbf" + PLUG.encode())
    assert load(path).plug.topic == "ev-plug"


def test_relative_paths_count_from_the_file(tmp_path: Path) -> None:
    path = tmp_path / "plugd.toml"
    path.write_text(PLUG + '[state]\ndir = "state"\n')
    assert load(path).state.dir == tmp_path / "state"


# -- secrets --------------------------------------------------------------------------------------


def with_secrets(folder: Path, content: bytes, mode: int = 0o600) -> Path:
    secret = folder / "secret"
    secret.write_bytes(content)
    secret.chmod(mode)
    path = folder / "plugd.toml"
    path.write_text(PLUG + '[broker]\nusername = "me"\npassword_file = "secret"\n[web]\ntoken_file = "secret"\n')
    return path


@pytest.mark.parametrize("mode", [0o600, 0o400, 0o440])
def test_a_secret_is_read_and_never_shown(tmp_path: Path, mode: int) -> None:
    config = load(with_secrets(tmp_path, b"hunter2\n", mode))
    for secret in (password(config), token(config)):
        assert secret is not None
        assert secret.get_secret_value() == "hunter2"
        assert "hunter2" not in f"{secret} {secret!r} {config!r} {config.model_dump_json()}"


def test_what_systemd_hands_over_under_the_files_name_goes_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    handed = tmp_path / "credentials"
    handed.mkdir()
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(handed))
    path = with_secrets(tmp_path, b"file\n")
    for content, secret in ((None, "file"), ("\n", "file"), ("handed over\n", "handed over")):
        if content is not None:
            (handed / "secret").unlink(missing_ok=True)
            (handed / "secret").write_text(content)
            (handed / "secret").chmod(0o440)
        config = load(path)
        assert [s.get_secret_value() for s in (password(config), token(config)) if s] == [secret, secret]


def test_no_secret_file_is_no_secret() -> None:
    assert password(parse(PLUG)) is None
    assert token(parse(PLUG)) is None


@pytest.mark.parametrize(
    ("content", "mode", "remedy"),
    [
        (b"hunter2\n", 0o644, "everyone may read it; chmod 600"),
        (b"hunter2\n", 0o604, "everyone may read it; chmod 600"),
        (b"\n", 0o600, "must hold the secret alone"),
        (b"hunter2\nhunter3\n", 0o600, "must hold the secret alone"),
        (b"hunter2\xff", 0o600, "not UTF-8"),
        (b"hunter2" * 1000, 0o600, "longer than 4096 bytes"),
    ],
)
def test_a_secret_that_cannot_be_used(tmp_path: Path, content: bytes, mode: int, remedy: str) -> None:
    said = file_refusal(with_secrets(tmp_path, content, mode))
    assert said.startswith(f'broker.password_file = "{tmp_path / "secret"}": ')
    assert remedy in said
    assert "hunter" not in said


def test_a_secret_that_is_not_there(tmp_path: Path) -> None:
    path = with_secrets(tmp_path, b"hunter2")
    (tmp_path / "secret").unlink()
    assert "cannot be read (No such file or directory)" in file_refusal(path)


def test_an_authority_s_file_is_looked_for_at_once(tmp_path: Path) -> None:
    path = tmp_path / "plugd.toml"
    path.write_text(PLUG + '[broker]\ntls = true\nca_file = "ca.pem"\n')
    assert file_refusal(path).startswith(f'broker.ca_file = "{tmp_path / "ca.pem"}": cannot be read')


# -- anything at all ------------------------------------------------------------------------------

SCALARS = st.one_of(
    st.booleans().map(lambda b: str(b).lower()),
    st.integers().map(str),
    st.floats().map(str),
    st.sampled_from(["nan", "-inf", "1e999", "2026-01-01", "18:00:00", "2026-01-01T00:00:00Z", "[]", "{}", '""']),
    st.text(max_size=30).map(lambda t: '"' + "".join(f"\\U{ord(c):08x}" for c in t) + '"'),
    st.sampled_from(['"18:00"', '"sat"', '"tasmota"', '"Europe/London"', "{away = true}", "50", "0.9"]),
)
KEYS = st.one_of(
    st.sampled_from(known_keys()),
    st.text("abcdefghijklmnop_.-", min_size=1, max_size=12),
    st.text(max_size=8).map(lambda t: '"' + "".join(f"\\U{ord(c):08x}" for c in t) + '"'),
)
ASSIGNMENTS = st.lists(st.tuples(KEYS, SCALARS).map(" = ".join), max_size=6).map("\n".join)


def outcome(text: str) -> Config | str:
    try:
        return parse(text)
    except ConfigError as error:
        return str(error)


@settings(max_examples=300)
@given(st.one_of(st.text(max_size=200), ASSIGNMENTS, ASSIGNMENTS.map(lambda a: f'plug.topic = "x"\n{a}')))
@example('"\\u2028\\n" = 1')
@example('broker.password = "\\u0085"')
@example('"\\n." = false')
def test_whatever_is_written_it_is_a_configuration_or_one_line(text: str) -> None:
    result = outcome(text)
    if isinstance(result, str):
        assert len(result.splitlines()) == 1
        assert result.isprintable()
        assert ": " in result
    else:
        assert result.plug.topic or result.plug.kind == "can_elcon"
        assert result.car.soc_min_pct < result.car.soc_max_pct
        assert result.nights.morning_minimum_pct <= result.car.soc_max_pct


@settings(max_examples=100)
@given(key=st.sampled_from(known_keys()), value=SCALARS)
def test_one_key_at_a_time(key: str, value: str) -> None:
    text = f"{key} = {value}" if key.startswith("plug") else f'plug.topic = "x"\n{key} = {value}'
    result = outcome(text)
    if isinstance(result, str):
        assert result.isprintable()
