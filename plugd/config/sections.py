"""The tables of the configuration file, with their defaults: closed, frozen pydantic models of one table each."""

from datetime import time
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from plugd.config import values
from plugd.config.values import (
    Clock,
    File,
    Percent,
    PlugKind,
    PlugTopic,
    SecretFile,
    Text,
    Topic,
    Weekday,
    Window,
    Word,
)


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

    host: Annotated[Text, AfterValidator(values.host)] = "localhost"
    port: Annotated[int, Field(ge=1, le=65535)] = 1883
    username: Text | None = None
    password_file: SecretFile | None = None
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


class PlannerSection(Section):
    """Where OSQP plans."""

    child: bool = True


class StateSection(Section):
    """What outlives a restart."""

    dir: File = Path("/var/lib/plugd")


class WebSection(Section):
    """The status page."""

    enabled: bool = True
    bind: Annotated[Text, AfterValidator(values.bind)] = "127.0.0.1:8480"
    token_file: SecretFile | None = None
    hosts: list[Text] = []
