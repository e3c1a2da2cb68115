"""The whole file: its tables together, and what only shows when two values are seen beside each other."""

from collections.abc import Callable
from math import floor
from typing import Annotated, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from plugd.config.reading import MODULATING, at
from plugd.config.sections import (
    BrokerSection,
    CanSection,
    CarSection,
    ForecastSection,
    HomeSection,
    NightsSection,
    PlannerSection,
    PlugSection,
    RelaySection,
    Section,
    StateSection,
    WebSection,
)
from plugd.units import amps_of, kw_of


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
    planner: PlannerSection = PlannerSection()
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


WORDED = ("mqtt", "shelly1", "zigbee2mqtt", "esphome")
"""Kinds whose words [plug.mqtt] may change."""
NEEDED = ("command_topic", "command_on", "command_off", "state_topic", "state_on", "state_off")

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


def doubts(config: Config) -> tuple[str, ...]:
    """What is possible, and will not work: each with key, value and remedy."""
    plug = config.plug
    flowing_a = amps_of(plug.power_kw, plug.mains_voltage_v)
    if plug.kind in MODULATING or flowing_a <= plug.max_current_a:
        return ()
    most_kw = floor(100 * kw_of(plug.max_current_a, plug.mains_voltage_v)) / 100
    return (
        f"plug.power_kw = {plug.power_kw:g}: is {flowing_a:.1f} A at {plug.mains_voltage_v:g} V, and the plug is cut "
        f"off above plug.max_current_a = {plug.max_current_a:g}; let the car draw less and write {most_kw:g}, or raise "
        "plug.max_current_a where plug, socket and cable bear it",
    )
