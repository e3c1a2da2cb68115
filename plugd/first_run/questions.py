"""What is asked, in this order, and what is written beside each answer for who reads the file later."""

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil

from plugd.config.reading import MODULATING
from plugd.first_run.answers import (
    DEFAULTS,
    KINDS,
    NONE,
    Answers,
    Reader,
    clock,
    daily_use,
    default,
    file,
    kind,
    number,
    place,
    unless_none,
    word,
    written,
    yes_no,
)
from plugd.first_run.places import listed
from plugd.units import amps_of

FromAnswers = Callable[[Answers], str]


@dataclass(frozen=True, slots=True)
class Question:
    """One question, about one key or several that go together."""

    keys: tuple[str, ...]
    text: str
    read: Reader
    default: FromAnswers
    """What an empty line stands for, as it would be typed; "" is none."""
    when: Callable[[Answers], bool] = lambda _: True
    before: FromAnswers = lambda _: ""
    """What is said first."""
    blank: str = ""
    """What an empty line means where it has no default; "" is that an answer is needed."""


def told(key: str) -> FromAnswers:
    """The answer given before, if there is one."""
    return lambda answers: written(answers.get(key))


def offered(key: str) -> FromAnswers:
    """The answer given before, else the configuration's own default."""
    return lambda answers: told(key)(answers) or default(key)


KIND_WORDS = {
    "tasmota": "a plug with Tasmota firmware",
    "shelly2": "a Shelly Plus, Pro, Gen3 or later",
    "openevse": "an OpenEVSE charger",
    "mqtt": "any other plug on MQTT: its words go under [plug.mqtt], see docs/hardware.md",
    "can_elcon": "an Elcon or TC charger on a CAN bus",
    "shelly1": "a Shelly of the first generation",
    "zigbee2mqtt": "a Zigbee plug behind Zigbee2MQTT",
    "esphome": "a plug with ESPHome firmware",
}
TOPIC_WORDS = {
    "tasmota": "on the plug's own page under Configuration, MQTT, Topic.",
    "shelly2": "on the plug's own page under Settings, MQTT: the MQTT prefix.",
    "openevse": "on the charger's own page under MQTT: the base topic.",
    "shelly1": "the device's id, what stands after shellies/.",
    "zigbee2mqtt": "with the base, like zigbee2mqtt/garage.",
    "esphome": "the topic prefix, as a rule the node's name.",
    "mqtt": "what stands for {topic} in the words of [plug.mqtt].",
}
TLS_PORT = "8883"
POWER = {"openevse": "7.36", "can_elcon": "3.3"}
"""What chargers give as a rule: 32 A, and the small Elcon."""


def _port(answers: Answers) -> str:
    """The port told before, unless it was only the usual one and encryption has changed; else the usual one."""
    usual = {True: TLS_PORT, False: default("broker.port")}
    encrypted = bool(answers["broker.tls"])
    before = told("broker.port")(answers)
    return usual[encrypted] if before in ("", usual[not encrypted]) else before


def _none_of(key: str) -> FromAnswers:
    """How an answer given before is taken back, where Enter would repeat it."""
    return lambda answers: f"Write {NONE} for none." if key in answers else ""


def of_kind(answers: Answers) -> str:
    """Which kind of plug was told."""
    return str(answers.get("plug.kind", DEFAULTS.plug.kind))


def _on_can(answers: Answers) -> bool:
    return of_kind(answers) == "can_elcon"


def drawn_a(answers: Answers) -> float:
    """What the told power is in amperes."""
    return amps_of(float(answers.get("plug.power_kw", 0.0)), DEFAULTS.plug.mains_voltage_v)


def _needs_current(answers: Answers) -> bool:
    return of_kind(answers) in MODULATING or drawn_a(answers) > DEFAULTS.plug.max_current_a


def _too_much(answers: Answers) -> str:
    if of_kind(answers) in MODULATING:
        return ""
    return (
        f"{answers['plug.power_kw']} kW is {drawn_a(answers):.1f} A. A 13 A plug bears no more than "
        f"{DEFAULTS.plug.max_current_a:g} A all night; plugd switches off what draws more than you say here."
    )


def _current(answers: Answers) -> str:
    return str(ceil(drawn_a(answers))) if of_kind(answers) in MODULATING else ""


def _minimum(answers: Answers) -> str:
    return written(min(DEFAULTS.nights.morning_minimum_pct, float(answers.get("car.soc_max_pct", 100.0))))


PLACE = (
    Question(
        ("home.region_id", "home.postcode"),
        "Region, or first half of a postcode",
        place,
        lambda _: "",
        before=lambda _: f"Where is the car? The forecast knows these regions, by number or name:\n{listed()}",
        blank="all of Great Britain",
    ),
)
BROKER = (
    Question(("broker.host",), "MQTT broker, host", word("broker.host"), offered("broker.host")),
    Question(("broker.tls",), "Encrypted (TLS), y or n", yes_no("broker.tls"), offered("broker.tls")),
    Question(
        ("broker.ca_file",),
        "File of the authority that signed its certificate",
        unless_none(file("broker.ca_file")),
        told("broker.ca_file"),
        when=lambda answers: bool(answers["broker.tls"]),
        before=_none_of("broker.ca_file"),
        blank="a public one",
    ),
    Question(
        ("broker.port",),
        "Port",
        number("broker.port"),
        _port,
    ),
    Question(
        ("broker.username",),
        "User",
        unless_none(word("broker.username")),
        told("broker.username"),
        before=_none_of("broker.username"),
        blank="it asks for none",
    ),
)
PLUG = (
    Question(
        ("plug.kind",),
        "Kind of plug, by number or name",
        kind,
        offered("plug.kind"),
        before=lambda _: "\n".join(
            f"  {place} {name:<12} {KIND_WORDS[name]}" for place, name in enumerate(KINDS, start=1)
        ),
    ),
    Question(
        ("plug.topic",),
        "Its topic",
        word("plug.topic"),
        lambda _: "",
        when=lambda answers: not _on_can(answers),
        before=lambda answers: f"Its topic is {TOPIC_WORDS[of_kind(answers)]}",
    ),
)
CHARGING = (
    Question(
        ("plug.power_kw",),
        "What the car draws there, in kW",
        number("plug.power_kw", "kW"),
        lambda answers: told("plug.power_kw")(answers) or POWER.get(of_kind(answers), default("plug.power_kw")),
    ),
    Question(
        ("plug.max_current_a",),
        "At most, in A",
        number("plug.max_current_a", "A"),
        _current,
        when=_needs_current,
        before=_too_much,
    ),
    *(
        Question((key,), text, read(key), offered(key), when=_on_can)
        for key, text, read in (
            ("can.interface", "CAN interface (socketcan, slcan)", word),
            ("can.channel", "CAN channel", word),
            ("can.bitrate", "CAN bits per second", number),
            ("can.max_voltage_v", "The battery's highest voltage, from its papers, in V", number),
            ("can.max_current_a", "Its highest charging current, from its papers, in A", number),
        )
    ),
)
CAR = (
    Question(("car.capacity_kwh",), "Battery, in kWh", number("car.capacity_kwh", "kWh"), offered("car.capacity_kwh")),
    Question(
        ("car.daily_use_kwh", "car.daily_use_sd_kwh"),
        'Driven on a usual day, in kWh, or a year, like "8000 miles"',
        daily_use,
        offered("car.daily_use_kwh"),
    ),
    Question(
        ("car.soc_max_pct",), "Charge to at most, in %", number("car.soc_max_pct", "%"), offered("car.soc_max_pct")
    ),
    Question(
        ("nights.morning_minimum_pct",),
        "Have every morning at least, in %",
        number("nights.morning_minimum_pct", "%"),
        _minimum,
    ),
    Question(("nights.plug_in",), "Usually plugged in at", clock("nights.plug_in"), offered("nights.plug_in")),
    Question(("nights.plug_out",), "Usually unplugged at", clock("nights.plug_out"), offered("nights.plug_out")),
    Question(
        ("nights.ready_by",),
        "Ready by",
        clock("nights.ready_by"),
        lambda _: "",
        blank="some two hours before that, for the mornings that begin early",
    ),
)


def state(folder: str) -> Question:
    """Where the memory is kept, which is offered as `folder`."""
    return Question(("state.dir",), "Folder for what plugd learns", file("state.dir"), lambda _: folder)


COMMENTS = {
    "home.region_id": "Whose carbon forecast: a region of Great Britain, 1 to 17.",
    "home.postcode": "Whose carbon forecast, by the first half of a postcode. region_id is the safer way.",
    "broker.host": "The MQTT broker of plug and hub.",
    "broker.tls": "Whether the connection to it is encrypted.",
    "broker.ca_file": "The authority that signed the broker's certificate.",
    "broker.password_file": "The password, alone in a file that only plugd's user may read.",
    "plug.kind": f"How the plug talks: {', '.join(KINDS)}.",
    "plug.topic": "The plug's own topic on the broker.",
    "plug.power_kw": "What the car draws at this plug, in kW.",
    "plug.max_current_a": "Never more, in amperes. A plain plug through which more flows for a minute is switched off.",
    "can.interface": "The CAN bus, in python-can's words.",
    "can.max_voltage_v": "What the battery bears, in volts and amperes, from its own papers.",
    "car.capacity_kwh": "What the battery really holds, in kWh.",
    "car.daily_use_kwh": "What is driven between two nights, in battery kWh; its standard deviation.",
    "car.soc_max_pct": "Full enough, in percent: plugd never charges above it.",
    "nights.plug_in": "When the car is usually plugged in and out, local time.",
    "nights.ready_by": "When the car must be ready.",
    "nights.morning_minimum_pct": "The morning minimum, in percent: what the battery must hold when the car leaves.",
    "state.dir": "Where estimate, plan and history outlive a restart.",
}
"""What stands in the file above a key. Keys without one belong to the one before."""
