"""The charger on CAN as the configuration has it. Imported only where one is configured: its libraries are an extra."""

from typing import TYPE_CHECKING

from plugd.adapters.can_elcon import CanElcon, identifiers
from plugd.adapters.can_link import CanLink, Place
from plugd.adapters.can_soc import soc_signal
from plugd.adapters.elcon_words import Limits
from plugd.domain import Capability
from plugd.errors import ConfigError
from plugd.ports import Clock

if TYPE_CHECKING:
    from plugd.config import Config


def charger(config: "Config", capability: Capability, clock: Clock) -> CanElcon:
    """The charger of `[can]`. Raises ConfigError without the battery's limits, and for a DBC that cannot be used."""
    can = config.can
    for key, limit, what in (
        ("max_voltage_v", can.max_voltage_v, "the highest voltage"),
        ("max_current_a", can.max_current_a, "the highest charging current"),
    ):
        if limit is None:
            raise ConfigError(f"can.{key}: write {what} that the battery bears, from its own papers; no other is safe")
    soc = soc_signal(can.soc, can.soc_dbc, can.soc_signal)
    return CanElcon(
        CanLink(Place(can.interface, can.channel, can.bitrate), clock, identifiers(soc)),
        clock,
        capability,
        Limits(can.max_voltage_v or 0.0, can.max_current_a or 0.0),
        config.car.efficiency,
        soc,
        60.0 * config.car.soc_max_age_min,
        can.period_s,
    )
