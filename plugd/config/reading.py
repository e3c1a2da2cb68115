"""What is read off a configuration, be it the models or their values: nothing here needs pydantic."""

from functools import reduce
from typing import TYPE_CHECKING, Any

from plugd.domain import Capability, Car, DayRule, Household, Nights, RelayRules
from plugd.units import from_pct

if TYPE_CHECKING:
    from plugd.config.sections import DaySection
    from plugd.config.whole import Config

MODULATING = ("can_elcon", "openevse")
"""Kinds of plug that take a power, and not only on and off."""
WEEKDAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")


def at(config: "Config", key: str) -> Any:
    """The value under a dotted key."""
    return reduce(getattr, key.split("."), config)


def household(config: "Config", capability: Capability) -> Household:
    """What the core works with: SOC as fractions, dwell in seconds. `capability` is the plug's own."""
    car, nights, relay = config.car, config.nights, config.relay
    return Household(
        timezone=config.home.timezone,
        car=Car(
            capacity_kwh=car.capacity_kwh,
            efficiency=car.efficiency,
            soc_min=from_pct(car.soc_min_pct),
            soc_max=from_pct(car.soc_max_pct),
            taper_from=from_pct(car.taper_from_pct),
            taper_share=from_pct(car.taper_share_pct),
            soc_max_age_s=car.soc_max_age_min * 60,
            daily_use_kwh=car.daily_use_kwh,
            daily_use_sd_kwh=car.daily_use_sd_kwh,
        ),
        nights=Nights(
            horizon=nights.horizon,
            plug_in=nights.plug_in,
            plug_in_sd_min=nights.plug_in_sd_min,
            plug_out=nights.plug_out,
            plug_out_sd_min=nights.plug_out_sd_min,
            ready_by=nights.ready_by,
            confidence=nights.confidence,
            minimum=from_pct(nights.morning_minimum_pct),
            default_window=nights.default_window,
            learn=nights.learn,
            week=tuple(sorted((WEEKDAYS.index(name), _rule(day)) for name, day in nights.week.items())),
        ),
        relay=RelayRules(
            min_on_s=relay.min_on_min * 60,
            min_off_s=relay.min_off_min * 60,
            max_switch_on=relay.max_switch_on,
            random_delay_s=relay.random_delay_s,
        ),
        capability=capability,
        max_current_a=config.plug.max_current_a,
        mains_voltage_v=config.plug.mains_voltage_v,
        guard_margin_s=relay.random_delay_s + 1800,
    )


def _rule(day: "DaySection") -> DayRule:
    minimum = None if day.minimum_pct is None else from_pct(day.minimum_pct)
    return DayRule(ready_by=day.ready_by, minimum=minimum, away=day.away)
