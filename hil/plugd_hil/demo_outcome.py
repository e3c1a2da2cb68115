"""What a run of the demo came to: reckoned from the truth and the daemon's records, as a document and as a table."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import takewhile
from pathlib import Path
from zoneinfo import ZoneInfo

from rich.table import Table

from plugd.adapters.store import SqliteStore
from plugd.domain import Household
from plugd.errors import UsageError
from plugd.series import IntensitySeries
from plugd.study.world import Battery, Driver
from plugd.units import to_pct
from plugd_hil.account import Night, foresight, nights, per_kwh, read_ledger, uncontrolled
from plugd_hil.demo_run import SOC_START, Options


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run came to."""

    source: str
    nights: tuple[Night, ...]
    ours: tuple[float, float]
    uncontrolled: tuple[float, float]
    perfect: tuple[float, float]
    guarded: int
    wall_s: float = 0.0

    @property
    def reduction_pct(self) -> float | None:
        """Less carbon per kWh than charging on arrival."""
        ours, theirs = per_kwh(*self.ours), per_kwh(*self.uncontrolled)
        return round(100.0 * (1.0 - ours / theirs), 2) if ours is not None and theirs else None

    def document(self, zone: ZoneInfo) -> dict[str, object]:
        """The JSON answer (interface: the demo)."""
        return {
            "source": self.source,
            "nights": [_night(night, zone) for night in self.nights],
            "carbon_g_per_kwh": per_kwh(*self.ours),
            "uncontrolled_g_per_kwh": per_kwh(*self.uncontrolled),
            "perfect_g_per_kwh": per_kwh(*self.perfect),
            "reduction_pct": self.reduction_pct,
            "missed_mornings": sum(night.missed for night in self.nights),
            "energy_kwh": round(self.ours[0], 3),
            "guard_interventions": self.guarded,
            "wall_s": round(self.wall_s, 1),
        }


def _night(night: Night, zone: ZoneInfo) -> dict[str, object]:
    return {
        "date": night.stay.arrival.astimezone(zone).date().isoformat(),
        "arrival_soc_pct": to_pct(night.arrival_soc),
        "charged_kwh": round(night.charged_kwh, 3),
        "carbon_g_per_kwh": per_kwh(night.charged_kwh, night.carbon_g),
        "switch_ons": night.switch_ons,
        "morning_soc_pct": to_pct(night.morning_soc),
        "minimum_pct": to_pct(night.minimum),
        "reason": night.reason,
    }


def reckoned(
    options: Options,
    household: Household,
    series: IntensitySeries,
    span: tuple[datetime, datetime],
    places: tuple[Path, Path],
) -> Outcome:
    """From the stub's ledger and the daemon's state (`places`). Raises UsageError where the series is too short."""
    start, end = span
    ledger, state = places
    truth = read_ledger(ledger)
    with SqliteStore(state) as store:
        records = store.records(start)
        memory = store.load()
    held = series.held()

    def actual(slot: datetime) -> float:
        value = held.actual_at(slot)
        if value is None:
            raise UsageError(f"{options.source}: ends before {slot:%Y-%m-%d %H:%M}")
        return value

    stays = takewhile(lambda s: s.arrival < end, Driver(seed=options.seed).stays(start))
    found = nights(truth, tuple(s for s in stays if s.arrival >= start), records, household, actual)
    over = tuple(night.stay for night in found)
    last = over[-1].departure if over else end
    return Outcome(
        source=options.source,
        nights=found,
        ours=(sum(n.charged_kwh for n in found), sum(n.carbon_g for n in found)),
        uncontrolled=uncontrolled(over, household, actual, _battery(household)),
        perfect=foresight(over, household, _endless(actual, held), _battery(household), (start, last)),
        guarded=memory.guard_count if memory else 0,
    )


def _endless(actual: Callable[[datetime], float], series: IntensitySeries) -> Callable[[datetime], float]:
    """The last value for whatever lies beyond the series: the plans of its last nights reach there."""
    last = series.end - timedelta(minutes=30)
    return lambda slot: actual(min(slot, last))


def _battery(household: Household) -> Battery:
    capacity_kwh = household.car.capacity_kwh
    return Battery(capacity_kwh, SOC_START * capacity_kwh, household.car.efficiency)


def table(outcome: Outcome, household: Household) -> Table:
    """A line per night."""
    zone = ZoneInfo(household.timezone)
    shown = Table(title=f"{outcome.source}: {len(outcome.nights)} nights", title_justify="left")
    for name in ("night", "arrived", "charged", "g/kWh", "on", "morning", "why"):
        shown.add_column(name, justify="left" if name in ("night", "why") else "right", no_wrap=name != "why")
    for night in outcome.nights:
        row = _night(night, zone)
        clean = row["carbon_g_per_kwh"]
        mark = " missed" if night.missed else ""
        shown.add_row(
            f"{night.stay.arrival.astimezone(zone):%a %d %b}",
            f"{100 * night.arrival_soc:.0f} %",
            f"{night.charged_kwh:.1f} kWh",
            "-" if clean is None else f"{clean:.0f}",
            str(night.switch_ons),
            f"{100 * night.morning_soc:.0f} %{mark}",
            night.reason,
        )
    return shown


def summary(outcome: Outcome) -> str:
    """The last line: against charging on arrival, and against perfect foresight."""
    ours, theirs, best = (per_kwh(*pair) for pair in (outcome.ours, outcome.uncontrolled, outcome.perfect))
    missed = sum(night.missed for night in outcome.nights)
    if ours is None or theirs is None or best is None:
        return f"Nothing was charged in {len(outcome.nights)} nights; missed mornings: {missed}."
    return (
        f"{ours:.0f} g/kWh against {theirs:.0f} when charging on arrival: {outcome.reduction_pct:.0f} % less "
        f"(with perfect foresight {best:.0f} g/kWh). Missed mornings: {missed}."
    )
