"""The nights at a glance: intensity with its spread, charging done and planned, the battery, sessions and now."""

from collections.abc import Iterator
from datetime import datetime, timedelta
from itertools import pairwise
from zoneinfo import ZoneInfo

from plugd import habits, sessions, soc
from plugd.charts import Frame, Point, band, box, ceiling, days, line, rule, scale, steps, svg, text
from plugd.domain import SlotSource
from plugd.units import HALF_HOUR, hours
from plugd.web.desk import Snapshot

LIKELY_SD = 1.28
"""Standard deviations either side: four times in five the value lies within."""
FLOWING_KW = 0.01
WIDTHS = (
    ("wide", 940.0, timedelta(hours=14), timedelta(hours=106)),
    ("narrow", 400.0, timedelta(hours=8), timedelta(hours=46)),
)
"""Class, width, and how far back and ahead it looks."""


def drawings(snapshot: Snapshot, says: str) -> str:
    """The same picture for wide and narrow screens; the style shows one of them."""
    return "".join(_drawing(snapshot, says, *each) for each in WIDTHS)


def _drawing(snapshot: Snapshot, says: str, css: str, width: float, back: timedelta, ahead: timedelta) -> str:
    now = snapshot.decision.at
    planned = snapshot.decision.memory.plan.sessions if snapshot.decision.memory.plan else ()
    end = max([now + timedelta(hours=24), *(p.session.end + timedelta(hours=3) for p in planned)])
    span = (now - back, min(end, now + ahead))
    zone = ZoneInfo(snapshot.household.timezone)
    outlook = snapshot.decision.outlook
    highest = [
        s.g_per_kwh + LIKELY_SD * s.sd_g_per_kwh for s in (outlook.slots if outlook else ()) if s.start < span[1]
    ]
    top, step = ceiling(max([50.0, *highest, *(row.carbon_g_per_kwh for row in snapshot.rows if row.start >= span[0])]))
    upper = Frame(44.0, 42.0, width - 54.0, 170.0, *span, 0.0, top)
    lower = Frame(44.0, 242.0, width - 54.0, 110.0, *span, 0.0, 100.0)
    parts = [*_sessions(snapshot, upper, lower), scale(upper, step, ""), scale(lower, 25.0, "")]
    parts += [text(4.0, 14.0, "Carbon intensity, g/kWh", "name"), text(4.0, 232.0, "Battery, %", "name")]
    parts += [
        *_carbon(snapshot, upper),
        *_battery(snapshot, lower),
        days(lower, zone),
        days(upper, zone, noons=False, names=False),
    ]
    x = upper.x(now)
    parts += [rule(x, upper.top - 8, x, lower.bottom, "now"), text(x, upper.top - 12, "now", "now-word", "middle")]
    return svg(width, 392.0, f"nights-{css}", "The next nights", says, parts, css)


def _sessions(snapshot: Snapshot, *frames: Frame) -> Iterator[str]:
    """Past stays as the ledger has them, those to come as planned."""
    past = [
        (n.arrival, n.session_end) for n in snapshot.nights if n.session_end and n.session_end <= snapshot.decision.at
    ]
    coming = [(s.start, s.end) for s in snapshot.decision.sessions]
    for frame in frames:
        for start, end in (*past, *coming):
            if end > frame.start and start < frame.end:
                yield box(frame, (start, end), frame.low, frame.high, "session")


def _carbon(snapshot: Snapshot, frame: Frame) -> Iterator[str]:
    """What charging costs is the area of its columns: intensity times share of the power."""
    decision = snapshot.decision
    slots = [s for s in (decision.outlook.slots if decision.outlook else ()) if s.start < frame.end]
    rows = [r for r in snapshot.rows if frame.start <= r.start and r.start + HALF_HOUR <= decision.at + HALF_HOUR]
    spread = [(s.start, s.start + HALF_HOUR, *_likely(s.g_per_kwh, s.sd_g_per_kwh)) for s in slots]
    yield band(frame, spread, "band")
    yield from _columns(snapshot, frame)
    yield steps(frame, [(r.start, r.start + HALF_HOUR, r.carbon_g_per_kwh) for r in rows], "carbon")
    known = [(s.start, s.start + HALF_HOUR, s.g_per_kwh) for s in slots if s.source is not SlotSource.TAIL]
    guessed = [(s.start, s.start + HALF_HOUR, s.g_per_kwh) for s in slots if s.source is SlotSource.TAIL]
    yield steps(frame, known, "carbon")
    yield steps(frame, guessed, "carbon tail")


def _likely(g_per_kwh: float, sd_g_per_kwh: float) -> tuple[float, float]:
    return max(0.0, g_per_kwh - LIKELY_SD * sd_g_per_kwh), g_per_kwh + LIKELY_SD * sd_g_per_kwh


def _columns(snapshot: Snapshot, frame: Frame) -> Iterator[str]:
    zone, now = ZoneInfo(snapshot.household.timezone), snapshot.decision.at
    for row in snapshot.rows:
        if row.kwh > 0.01 and row.start + HALF_HOUR > frame.start:
            share = min(1.0, row.kwh / (0.5 * row.limit_kw))
            said = f"{row.start.astimezone(zone):%H:%M}: {row.kwh:.2f} kWh charged at {row.carbon_g_per_kwh:.0f} g/kWh"
            yield box(frame, (row.start, row.start + HALF_HOUR), 0.0, share * row.carbon_g_per_kwh, "done", said)
    plan = snapshot.decision.memory.plan
    for slot in plan.slots() if plan else ():
        if slot.power_kw > FLOWING_KW and slot.end > now and slot.start < frame.end:
            share = slot.power_kw / max(slot.limit_kw, slot.power_kw)
            clean = f"{slot.intensity_g_per_kwh:.0f} g/kWh"
            said = f"{slot.start.astimezone(zone):%H:%M}: {slot.power_kw:.1f} kW planned at {clean}"
            span = (max(slot.start, now), slot.end)
            yield box(frame, span, 0.0, share * slot.intensity_g_per_kwh, "planned", said)


def _battery(snapshot: Snapshot, frame: Frame) -> Iterator[str]:
    now, mean = snapshot.decision.at, snapshot.decision.memory.soc.mean
    past = [(row.start, 100.0 * row.soc) for row in snapshot.rows if frame.start <= row.start <= now]
    yield line(frame, [*past, (now, 100.0 * mean)], "soc")
    ahead = list(expected(snapshot))
    inside = [point for point in ahead if point[0] <= frame.end]
    yield line(frame, [*inside, *_crossing(ahead, frame.end)], "soc ahead")
    for planned in snapshot.decision.memory.plan.sessions if snapshot.decision.memory.plan else ():
        session = planned.session
        if session.end < frame.end:
            x, y = frame.x(session.end), frame.y(100.0 * session.minimum)
            yield rule(x - 8, y, x + 8, y, "minimum")
            morning = next((value for at, value in ahead if at == session.end), None)
            if morning is not None:
                yield f'<circle cx="{x:g}" cy="{frame.y(morning):g}" r="4" class="dot"/>'
                yield text(x, frame.y(morning) - 8, f"{morning:.0f}", "name", "middle")


def expected(snapshot: Snapshot) -> Iterator[Point]:
    """The battery in percent as planned, from now on: it fills as planned and is driven by the usual day."""
    memory, now = snapshot.decision.memory, snapshot.decision.at
    home = habits.informed(snapshot.household, memory.habits)
    car, soc_now = home.car, memory.soc.mean
    yield now, 100.0 * soc_now
    previous: datetime | None = None
    for planned in [p for p in (memory.plan.sessions if memory.plan else ()) if p.session.end > now]:
        session = planned.session
        ceiling_soc = 1.0
        if previous is None:
            begins = max(now, session.start)
            coming = sessions.drives(home, memory.overrides, memory.presence, memory.soc.driven_to, begins)
            soc_now = soc.driven(memory.soc, coming, car).mean
        else:
            # Later plans are made on a SOC that is known better by then: they end at the ceiling.
            nights_away = max(1, round(hours(session.end - previous) / 24.0))
            soc_now = max(0.0, soc_now - nights_away * car.daily_use_kwh / car.capacity_kwh)
            ceiling_soc = max(session.ceiling, soc_now)
        yield max(now, session.start), 100.0 * soc_now
        for slot in [slot for slot in planned.slots if slot.end > now and slot.power_kw > FLOWING_KW]:
            begins = max(slot.start, now)
            yield begins, 100.0 * soc_now
            gain = slot.power_kw * hours(slot.end - begins) * car.efficiency / car.capacity_kwh
            soc_now = min(ceiling_soc, soc_now + gain)
            yield slot.end, 100.0 * soc_now
        yield session.end, 100.0 * soc_now
        previous = session.end


def _crossing(points: list[Point], moment: datetime) -> list[Point]:
    """Where the line leaves the picture."""
    for (before, low), (after, high) in pairwise(points):
        if before <= moment < after:
            return [(moment, low + (high - low) * ((moment - before) / (after - before)))]
    return []
