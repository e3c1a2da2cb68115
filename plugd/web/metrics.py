"""The page's figures for Prometheus."""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from plugd.domain import Mode
from plugd.web.desk import Snapshot

GAUGES: tuple[tuple[str, str, str, float], ...] = (
    ("soc_ratio", "State of charge, estimated, 0 to 1.", "soc_pct", 0.01),
    ("soc_low_ratio", "State of charge that promises are made on.", "soc_low_pct", 0.01),
    ("soc_age_seconds", "Since somebody told how full the battery is.", "soc_age_s", 1.0),
    ("power_watts", "Power at the plug.", "power_w", 1.0),
    ("intensity_grams_per_kwh", "Carbon intensity of the half hour under way.", "intensity_g_per_kwh", 1.0),
    ("morning_soc_ratio", "State of charge expected at the session end.", "morning_soc_pct", 0.01),
    ("minimum_ratio", "Morning minimum of the coming session end.", "minimum_pct", 0.01),
    ("shortfall_kwh", "Battery kWh by which the minimum will be missed.", "shortfall_kwh", 1.0),
    ("saved_grams", "Saved since the ledger began, against charging on arrival.", "saved_g_total", 1.0),
    ("saved_today_grams", "Saved in the night under way or just over.", "saved_g_today", 1.0),
    ("switch_ons_today", "Switch-ons by the plan today.", "switch_ons_today", 1.0),
    ("forecast_age_minutes", "Age of the forecast.", "forecast_age_min", 1.0),
)
"""(name, help, key of the state document, factor). What is not known is left out."""


@dataclass(frozen=True, slots=True, eq=False)
class Figures:
    """A collector of prometheus_client."""

    look: Callable[[], tuple[Snapshot, dict[str, Any]] | None]
    refused: Counter[str]

    def collect(self) -> Iterator[Metric]:
        """What there is now."""
        refused = CounterMetricFamily("plugd_page_refused", "Requests refused, by reason.", labels=["reason"])
        for reason, count in self.refused.items():
            refused.add_metric([reason], count)
        yield refused
        seen = self.look()
        if seen is None:
            return
        snapshot, state = seen
        for name, words, key, factor in GAUGES:
            if state[key] is not None:
                yield GaugeMetricFamily(f"plugd_{name}", words, value=state[key] * factor)
        if state["energy_kwh"] is not None:
            yield CounterMetricFamily("plugd_energy_kwh", "The meter's total.", value=state["energy_kwh"])
        yield CounterMetricFamily("plugd_guard", "How often the guard fired.", value=state["guard_count"])
        yield GaugeMetricFamily(
            "plugd_relay_on", "Whether power may flow.", value=float(bool(snapshot.decision.memory.relay_on))
        )
        modes = GaugeMetricFamily("plugd_mode", "1 for the mode it is in.", labels=["mode"])
        for mode in Mode:
            modes.add_metric([mode.value], float(mode.value == state["mode"]))
        yield modes
        faults = GaugeMetricFamily("plugd_fault", "1 for each thing that needs somebody.", labels=["code"])
        for fault in snapshot.decision.faults:
            faults.add_metric([fault.code], 1.0)
        yield faults


def text(figures: Figures) -> bytes:
    """The exposition format."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(figures)
    return bytes(generate_latest(registry))
