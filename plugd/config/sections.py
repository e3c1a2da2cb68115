"""The tables of the configuration file, with their defaults: closed, frozen pydantic models."""

from collections.abc import Callable
from datetime import time
from functools import reduce
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from plugd.config import values
from plugd.config.values import Clock, File, Percent, PlugKind, PlugTopic, Text, Topic, Weekday, Window, Word
from plugd.units import kw_of


class Section(BaseModel):
    """A table of the file: closed, frozen, and no value turned silently into another type."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class HomeSection(Section):
    """Where the house stands. Neither region nor postcode: the national forecast."""

    timezone: Annotated[Text, AfterValidator(values.timezone)] = "Europe/London"
    region_id: Annotated[int, Field(ge=1, le=17)] | None = None
    postcode: Annotated[Text, AfterValidator(values.postcode)] | None = None


class BrokerSection(Section):
    """The MQTT broker that plug and hub speak through."""

    host: Text = "localhost"
    port: Annotated[int, Field(ge=1, le=65535)] = 1883
    username: Text | None = None
    password_file: File | None = None
    tls: bool = False
    ca_file: File | None = None
    topic: Topic = "plugd"
    discovery_prefix: Topic | Literal[""] = "homeassistant"


class MqttPlugSection(Section):
    """The words of a plug over MQTT, where they differ from its preset's. `{topic}` is the plug's own topic."""

    command_topic: PlugTopic | None = None
    command_on: Word | None = None
    command_off: Word | None = None
    state_topic: PlugTopic | None = None
    state_key: Word | None = None
    state_on: Word | None = None
    state_off: Word | None = None
    power_topic: PlugTopic | None = None
    power_key: Word | None = None
    power_unit: Literal["W", "kW"] | None = None
    energy_topic: PlugTopic | None = None
    energy_key: Word | None = None
    energy_unit: Literal["kWh", "Wh", "Wmin"] | None = None
    availability_topic: PlugTopic | None = None
    online: Word | None = None
    offline: Word | None = None
    ask_topic: PlugTopic | None = None
    ask_payload: Word | None = None
    on_change: bool | None = None


class PlugSection(Section):
    """What feeds the car."""

    kind: PlugKind = "tasmota"
    topic: Topic | None = None
    power_kw: Annotated[float, Field(ge=0.1, le=50)] = 2.3
    max_current_a: Annotated[float, Field(ge=1, le=80)] = 10.5
    min_current_a: Annotated[float, Field(ge=6, le=80)] = 6.0
    """The least a charger gives, or nothing (IEC 61851: 6 A). Not for plugs that are on or off."""
    mains_voltage_v: Annotated[float, Field(ge=100, le=260)] = 230.0
    dead_man_s: Annotated[int, Field(ge=10, le=64800)] = 3600
    """After how long without word from plugd the plug comes on by itself. Under 60 s only on a test bench."""
    mqtt: MqttPlugSection = MqttPlugSection()


class CanSection(Section):
    """The CAN bus of a charger with `kind = "can_elcon"`, in python-can's words, and what its battery bears."""

    interface: Literal["socketcan", "slcan", "udp_multicast"] = "socketcan"
    channel: Text = "can0"
    bitrate: Annotated[int, Field(ge=10_000, le=1_000_000)] = 250_000
    period_s: Annotated[float, Field(ge=0.1, le=2)] = 1.0
    """Between two commands; without one for 5 s the charger stops."""
    max_voltage_v: Annotated[float, Field(ge=10, le=1000)] | None = None
    max_current_a: Annotated[float, Field(ge=0.5, le=500)] | None = None
    soc: Literal["pylontech", "orion"] | None = None
    soc_dbc: File | None = None
    soc_signal: Text | None = None


class CarSection(Section):
    """The battery, and how it is driven."""

    capacity_kwh: Annotated[float, Field(ge=1, le=500)] = 50.0
    efficiency: Annotated[float, Field(ge=0.3, le=1)] = 0.9
    soc_min_pct: Percent = 20.0
    soc_max_pct: Percent = 80.0
    taper_from_pct: Percent = 100.0
    taper_share_pct: Annotated[float, Field(ge=1, le=100)] = 20.0
    daily_use_kwh: Annotated[float, Field(ge=0, le=500)] = 5.8
    daily_use_sd_kwh: Annotated[float, Field(ge=0, le=500)] = 2.67
    soc_topic: Topic | None = None
    soc_json_key: Text | None = None
    soc_unit: Literal["percent", "fraction"] = "percent"
    soc_max_age_min: Annotated[float, Field(gt=0, le=1440)] = 30.0


class DaySection(Section):
    """What is special about the session that ends on one weekday."""

    ready_by: Clock | None = None
    minimum_pct: Percent | None = None
    away: bool = False

    @property
    def set_beside_away(self) -> bool:
        """Whether something is asked of the morning too."""
        return self.ready_by is not None or self.minimum_pct is not None


class NightsSection(Section):
    """When the car is expected, in local time, and what is asked of a morning."""

    horizon: Annotated[int, Field(ge=1, le=7)] = 4
    plug_in: Clock = time(18, 0)
    plug_in_sd_min: Annotated[float, Field(ge=0, le=600)] = 60.0
    plug_out: Clock = time(9, 0)
    plug_out_sd_min: Annotated[float, Field(ge=0, le=600)] = 60.0
    ready_by: Clock | None = None
    confidence: Annotated[float, Field(ge=0.5, le=0.999)] = 0.98
    morning_minimum_pct: Percent = 50.0
    default_window: Window = (time(23, 0), time(6, 0))
    learn: bool = True
    week: dict[Weekday, DaySection] = {}


class ForecastSection(Section):
    """Where the carbon forecast comes from."""

    base_url: Annotated[Text, AfterValidator(values.url)] = "https://api.carbonintensity.org.uk"


class RelaySection(Section):
    """How often the plug's relay may move."""

    min_on_min: Annotated[float, Field(ge=0, le=240)] = 15.0
    min_off_min: Annotated[float, Field(ge=0, le=240)] = 10.0
    max_switch_on: Annotated[int, Field(ge=1, le=48)] = 6
    random_delay_s: Annotated[float, Field(ge=0, le=1800)] = 600.0


class StateSection(Section):
    """What outlives a restart."""

    dir: File = Path("/var/lib/plugd")


class WebSection(Section):
    """The status page."""

    enabled: bool = True
    bind: Annotated[Text, AfterValidator(values.bind)] = "127.0.0.1:8480"
    token_file: File | None = None
    hosts: list[Text] = []


class Config(Section):
    """The whole file. Only `plug.topic` has no default, for the plugs that are reached over MQTT."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,32}$")] = "ev"
    home: HomeSection = HomeSection()
    broker: BrokerSection = BrokerSection()
    plug: PlugSection = PlugSection()
    can: CanSection = CanSection()
    car: CarSection = CarSection()
    nights: NightsSection = NightsSection()
    forecast: ForecastSection = ForecastSection()
    relay: RelaySection = RelaySection()
    state: StateSection = StateSection()
    web: WebSection = WebSection()

    @model_validator(mode="after")
    def _possible(self) -> Self:
        for key, impossible, remedy in IMPOSSIBLE:
            if impossible(self):
                raise PydanticCustomError(
                    "impossible", "{remedy}", {"key": key, "value": at(self, key), "remedy": remedy}
                )
        return self


def at(config: Config, key: str) -> Any:
    """The value under a dotted key."""
    return reduce(getattr, key.split("."), config)


WORDED = ("mqtt", "shelly1", "zigbee2mqtt", "esphome")
"""Kinds whose words [plug.mqtt] may change."""
NEEDED = ("command_topic", "command_on", "command_off", "state_topic", "state_on", "state_off")
MODULATING = ("can_elcon", "openevse")
"""Kinds that take a power, and not only on and off."""


IMPOSSIBLE: tuple[tuple[str, Callable[[Config], bool], str], ...] = (
    (
        "plug.topic",
        lambda c: c.plug.topic is None and c.plug.kind != "can_elcon",
        'write topic = "..." under [plug]: the name that the plug itself uses on the broker',
    ),
    (
        "plug.min_current_a",
        lambda c: c.plug.kind in MODULATING and c.plug.min_current_a > c.plug.max_current_a,
        "is more than plug.max_current_a; lower it, or raise that",
    ),
    (
        "plug.power_kw",
        lambda c: c.plug.kind in MODULATING and c.plug.power_kw < kw_of(c.plug.min_current_a, c.plug.mains_voltage_v),
        "is less than plug.min_current_a gives at plug.mains_voltage_v; raise it",
    ),
    (
        "can.soc",
        lambda c: c.can.soc is not None and c.can.soc_dbc is not None,
        "stands beside can.soc_dbc; keep one of them",
    ),
    (
        "can.soc_signal",
        lambda c: (c.can.soc_signal is None) is not (c.can.soc_dbc is None),
        "can.soc_dbc and can.soc_signal belong together; write both or none",
    ),
    (
        "plug.mqtt",
        lambda c: c.plug.kind not in WORDED and bool(c.plug.mqtt.model_fields_set),
        f"counts only for plug.kind {', '.join(WORDED)}; remove the table, or change the kind",
    ),
    *(
        (
            f"plug.mqtt.{key}",
            lambda c, key=key: getattr(c.plug.mqtt, key) == "",
            "must not be empty: without it the plug can be neither told nor heard",
        )
        for key in NEEDED
    ),
    (
        "home.postcode",
        lambda c: c.home.postcode is not None and c.home.region_id is not None,
        "stands beside home.region_id; keep one of them, best the region_id",
    ),
    (
        "broker.password_file",
        lambda c: c.broker.password_file is not None and c.broker.username is None,
        "a password needs a user; write broker.username",
    ),
    (
        "broker.ca_file",
        lambda c: c.broker.ca_file is not None and not c.broker.tls,
        "is unused without TLS; write broker.tls = true",
    ),
    (
        "car.soc_max_pct",
        lambda c: c.car.soc_max_pct <= c.car.soc_min_pct,
        "must be more than car.soc_min_pct; raise it, or lower that",
    ),
    (
        "car.daily_use_kwh",
        lambda c: c.car.daily_use_kwh > c.car.capacity_kwh,
        "is more than car.capacity_kwh holds; lower it, or raise that",
    ),
    (
        "car.soc_json_key",
        lambda c: c.car.soc_json_key is not None and c.car.soc_topic is None,
        "is a key of what? write car.soc_topic",
    ),
    (
        "nights.morning_minimum_pct",
        lambda c: c.nights.morning_minimum_pct > c.car.soc_max_pct,
        "is more than car.soc_max_pct; lower it, or raise that",
    ),
    (
        "nights.plug_out",
        lambda c: c.nights.plug_out == c.nights.plug_in,
        "is the same as nights.plug_in; write when the car leaves",
    ),
    (
        "nights.ready_by",
        lambda c: c.nights.ready_by == c.nights.plug_in,
        "is the same as nights.plug_in; write when the car must be ready",
    ),
    (
        "nights.week",
        lambda c: any(day.away and day.set_beside_away for day in c.nights.week.values()),
        "a day with away = true has no ready_by or minimum_pct; remove one or the other",
    ),
    (
        "nights.week",
        lambda c: any((day.minimum_pct or 0) > c.car.soc_max_pct for day in c.nights.week.values()),
        "has a minimum_pct above car.soc_max_pct; lower it, or raise that",
    ),
    (
        "nights.week",
        lambda c: len(c.nights.week) == 7 and all(day.away for day in c.nights.week.values()),
        "the car is away on every day; remove a day, or stop plugd",
    ),
)
"""(key, when it is impossible, what to do): what only shows when two values are seen together."""
