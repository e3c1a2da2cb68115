"""`plugd report`: what was charged, how clean it was, and what it is compared with, out of the ledger."""

import csv
import io
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from zoneinfo import ZoneInfo

from plugd import daemon, ledger, scoring
from plugd.adapters.store import SqliteStore
from plugd.config import Config, household
from plugd.domain import Forecast, Household, Intensity
from plugd.errors import PlugdError
from plugd.ledger import HalfHour, Night, Sum
from plugd.planner.exact import Exact
from plugd.score import LeadScore, scores
from plugd.sessions import to_utc
from plugd.study.house import FunctionSource, House
from plugd.study.world import Battery, Stay
from plugd.units import HALF_HOUR, grams, iso, rounded, slot_start, to_pct

HORIZONS = (1, 2, 4, 7)
HISTORY = timedelta(days=56)
LONGEST_FORECAST_SLOTS = 2 * 24 * 4


@dataclass(frozen=True, slots=True)
class Replay:
    """What the same controller would have charged with another horizon, told the forecasts as they were issued."""

    horizon: int
    kwh: float
    carbon_g: float
    missed: int

    @property
    def g_per_kwh(self) -> float | None:
        """None where nothing flowed."""
        return self.carbon_g / self.kwh if self.kwh > 0.0 else None


@dataclass(frozen=True, slots=True)
class Report:
    """Everything that the report says, whatever its form."""

    name: str
    household: Household
    rows: tuple[HalfHour, ...]
    nights: tuple[Night, ...]
    months: tuple[tuple[str, Sum], ...]
    total: Sum
    replays: tuple[Replay, ...]
    scores: tuple[LeadScore, ...]
    """Of every forecast as issued in these nights."""
    compared: Mapping[str, tuple[LeadScore, ...]]
    """Of plugd's own outlook, the source's forecast and persistence, in the last 30 days that are scored."""

    @property
    def zone(self) -> ZoneInfo:
        """Where it is read."""
        return ZoneInfo(self.household.timezone)


def gathered(
    config: Config, days: int, horizons: Sequence[int] = (), progress: Callable[[str], None] = lambda _: None
) -> Report:
    """The report on the last `days` nights of the ledger, replayed with `horizons`. Raises PlugdError without any."""
    home = household(config, daemon.capability_of(config))
    folder = daemon.state_folder(config)
    if not folder.is_dir():
        raise PlugdError(f"{folder}: is not there, so nothing was charged yet; is state.dir right?")
    with SqliteStore(folder, hold=False) as store:
        kept = store.half_hours()
        if not kept:
            raise PlugdError(f"{folder}: the ledger is empty; it fills while plugd runs")
        first = sorted({row.night for row in kept})[-days:][0]
        rows = tuple(row for row in kept if row.night >= first)
        since = rows[0].start
        forecasts, measured = tuple(store.issued(since)), store.measured(since)
        history = store.history(since - HISTORY)
        compared = scoring.summed(store.tallies((rows[-1].start - scoring.SCORED).date()))
    car = home.car
    found = ledger.nights(rows, car.efficiency, car.capacity_kwh)
    nights = tuple(n for n in found if n.session_end is not None or n.kwh > ledger.LITTLE_KWH)
    if not nights:
        raise PlugdError(f"{folder}: no night is over yet; the ledger fills while plugd runs")
    past = tuple(value for value in history if value.start < since)

    def replays() -> Iterator[Replay]:
        for horizon in horizons:
            progress(f"replaying {len(nights)} nights, {horizon} planned together")
            yield _replay(horizon, home, rows, nights, forecasts, past)

    return Report(
        name=config.name,
        household=home,
        rows=rows,
        nights=nights,
        months=tuple((f"{month:%Y-%m}", part) for month, part in ledger.months(nights)),
        total=ledger.total(nights),
        replays=tuple(replays()) if forecasts else (),
        scores=scores(forecasts, measured),
        compared=compared,
    )


def _replay(
    horizon: int,
    home: Household,
    rows: tuple[HalfHour, ...],
    nights: tuple[Night, ...],
    forecasts: tuple[Forecast, ...],
    past: tuple[Intensity, ...],
) -> Replay:
    """The ledger's nights once more, through the daemon's own cycle in a simulated house."""
    other = replace(home, nights=replace(home.nights, horizon=horizon))
    stays = _stays(rows, nights, home)
    start, end = rows[0].start, rows[-1].start + HALF_HOUR
    battery = Battery(home.car.capacity_kwh, nights[0].arrival_soc * home.car.capacity_kwh, home.car.efficiency)
    house = House(
        other, Exact(), FunctionSource(_as_issued(forecasts), LONGEST_FORECAST_SLOTS), iter(stays), start, battery
    )
    house.store.seen.update((value.start, value) for value in past)
    house.run(end)
    known = {row.start: row.carbon_g_per_kwh for row in rows}
    flows = house.plug.flows
    carbon_g = sum(kwh * known[slot] for slot, kwh in flows.items())
    return Replay(horizon, sum(flows.values()), carbon_g, sum(morning.missed for morning in house.mornings))


def _as_issued(forecasts: tuple[Forecast, ...]) -> Callable[[datetime, datetime], float | None]:
    """What the newest forecast of a moment said of a half hour."""
    ordered = sorted(forecasts, key=lambda f: f.issued_at)
    moments = [slot_start(f.issued_at) for f in ordered]
    said: dict[int, dict[datetime, float]] = {}

    def value(now: datetime, slot: datetime) -> float | None:
        index = bisect_right(moments, now) - 1
        if index < 0:
            return None
        if index not in said:
            said.clear()
            said[index] = {row.start: row.g_per_kwh for row in ordered[index].expected}
        return said[index].get(slot)

    return value


def _stays(rows: tuple[HalfHour, ...], nights: Sequence[Night], home: Household) -> list[Stay]:
    """The stays of the ledger's nights: what was driven between is what the estimate lost."""
    capacity_kwh, efficiency = home.car.capacity_kwh, home.car.efficiency
    zone = ZoneInfo(home.timezone)
    flowing = {row.night: row.start + HALF_HOUR for row in rows if row.kwh > ledger.LITTLE_KWH}
    found = []
    for index, night in enumerate(nights):
        if night.session_end is None:
            continue
        left = to_utc(night.session_end.astimezone(zone).date(), home.nights.plug_out, zone)
        departure = max(left, night.session_end, flowing.get(night.day, night.session_end))
        following = nights[index + 1].arrival_soc if index + 1 < len(nights) else night.arrival_soc
        filled = night.arrival_soc + night.kwh * efficiency / capacity_kwh
        found.append(Stay(max(night.arrival, rows[0].start), departure, max(0.0, (filled - following) * capacity_kwh)))
    return found


# -- in words and numbers -------------------------------------------------------------------------


def night_row(night: Night) -> dict[str, object]:
    """One night, for programs."""
    return {
        "night": night.day.isoformat(),
        "arrival": iso(night.arrival),
        "arrival_told": night.arrival_told,
        "arrival_soc_pct": to_pct(night.arrival_soc),
        "session_end": iso(night.session_end) if night.session_end else None,
        "morning_soc_pct": None if night.morning_soc is None else to_pct(night.morning_soc),
        "minimum_pct": None if night.minimum is None else to_pct(night.minimum),
        "missed": night.missed,
        "kwh": round(night.kwh, 3),
        "carbon_g": round(night.carbon_g, 1),
        "on_arrival_g": round(night.on_arrival_g, 1),
        "best_g": round(night.best_g, 1),
        "saved_g": round(night.saved_g, 1),
        "switch_ons": night.switch_ons,
        "final": night.final,
    }


def _sum_row(part: Sum) -> dict[str, object]:
    return {
        "nights": part.nights,
        "kwh": round(part.kwh, 3),
        "carbon_g": round(part.carbon_g, 1),
        "on_arrival_g": round(part.on_arrival_g, 1),
        "best_g": round(part.best_g, 1),
        "saved_g": round(part.saved_g, 1),
        "saved_pct": rounded(part.saved_pct, 1),
        "g_per_kwh": rounded(part.per_kwh(part.carbon_g), 2),
        "on_arrival_g_per_kwh": rounded(part.per_kwh(part.on_arrival_g), 2),
        "best_g_per_kwh": rounded(part.per_kwh(part.best_g), 2),
        "switch_ons": part.switch_ons,
        "missed_mornings": part.missed,
    }


def document(report: Report) -> dict[str, object]:
    """The JSON answer."""
    return {
        "name": report.name,
        "from": iso(report.rows[0].start),
        "to": iso(report.rows[-1].start + HALF_HOUR),
        "nights": [night_row(night) for night in report.nights],
        "months": [{"month": month, **_sum_row(part)} for month, part in report.months],
        "total": _sum_row(report.total),
        "horizons": [
            {
                "horizon": replay.horizon,
                "kwh": round(replay.kwh, 3),
                "g_per_kwh": rounded(replay.g_per_kwh, 2),
                "missed_mornings": replay.missed,
            }
            for replay in report.replays
        ],
        "forecast": [scoring.row(score) for score in report.scores],
        "score": {who: [scoring.row(score) for score in rows] for who, rows in report.compared.items()},
    }


def table(report: Report) -> str:
    """CSV: one line a night; yes is 1 and no is 0, which spreadsheets of every language take as numbers."""
    rows = [night_row(night) for night in report.nights]
    out = io.StringIO()
    writer = csv.DictWriter(out, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows({key: int(x) if isinstance(x, bool) else x for key, x in row.items()} for row in rows)
    return out.getvalue()


def headline(report: Report) -> str:
    """The sum of it, in one sentence."""
    whole = report.total
    ours, theirs, best = (whole.per_kwh(g) for g in (whole.carbon_g, whole.on_arrival_g, whole.best_g))
    if ours is None or theirs is None or best is None or whole.saved_pct is None:
        return f"Nothing was charged in {whole.nights} nights."
    word = "less" if whole.saved_g >= 0.0 else "more"
    return (
        f"{whole.kwh:.1f} kWh in {whole.nights} nights at {ours:.0f} g/kWh: {grams(abs(whole.saved_g))} of CO2, "
        f"or {abs(whole.saved_pct):.0f} %, {word} than charging on arrival at {theirs:.0f} g/kWh."
    )


def lines(report: Report) -> list[str]:
    """The terminal's summary."""
    said = [headline(report)]
    whole = report.total
    best = whole.per_kwh(whole.best_g)
    if best is not None:
        said.append(f"The cleanest half hours of the same nights, known afterwards, were at {best:.0f} g/kWh.")
    said.append(f"Switched on {whole.switch_ons} times; mornings under a minimum in reach: {whole.missed}.")
    waiting = sum(not night.final for night in report.nights)
    if waiting:
        said.append(f"{waiting} of {whole.nights} nights still wait for a measured intensity, and may move once.")
    said += ["", f"{'night':<12}{'kWh':>6}{'g/kWh':>7}{'on arrival':>12}{'best':>6}{'saved':>9}  morning"]
    said += [_line(night) for night in report.nights]
    if report.replays:
        said += ["", "The same nights with other horizons, replayed with the forecasts as issued:"]
        said += [_replayed(replay) for replay in report.replays]
    if report.scores:
        said += ["", "Forecasts were off by, on average:"]
        said += [
            f"  {s.from_h:>2} to {s.to_h:>2} h ahead: {s.mean_abs_g_per_kwh:.0f} g/kWh ({s.mean_abs_pct:.0f} %)"
            for s in report.scores
        ]
    return said + scoring.lines(report.compared)


def _line(night: Night) -> str:
    if night.kwh > ledger.LITTLE_KWH:
        clean = [f"{g / night.kwh:.0f}" for g in (night.carbon_g, night.on_arrival_g, night.best_g)]
        saved = grams(night.saved_g)
    else:
        clean, saved = ["-"] * 3, "-"
    morning = "" if night.morning_soc is None else f"{100 * night.morning_soc:.0f} %"
    missed = " missed" if night.missed else ""
    day = f"{night.day:%a %d %b}"
    return f"{day:<12}{night.kwh:>6.1f}{clean[0]:>7}{clean[1]:>12}{clean[2]:>6}{saved:>9}  {morning}{missed}"


def _replayed(replay: Replay) -> str:
    clean = "-" if replay.g_per_kwh is None else f"{replay.g_per_kwh:.0f} g/kWh"
    missed = f", {replay.missed} mornings missed" if replay.missed else ""
    return f"  {replay.horizon} night{'s' if replay.horizon > 1 else ' '}: {clean}, {replay.kwh:.1f} kWh{missed}"
