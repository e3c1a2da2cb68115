"""Drawings as SVG text, for the page and the report: plain shapes with classes, coloured by the page's own style."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from html import escape
from itertools import pairwise
from zoneinfo import ZoneInfo

from plugd.units import require_utc

Point = tuple[datetime, float]
Span = tuple[datetime, datetime]
NICE = (1, 2, 5, 10, 20, 50, 100, 200, 250, 500, 1000, 2000, 2500, 5000, 10000)


@dataclass(frozen=True, slots=True)
class Frame:
    """A rectangle of the drawing in which time runs to the right and a value upward."""

    left: float
    top: float
    width: float
    height: float
    start: datetime
    end: datetime
    low: float
    high: float

    @property
    def right(self) -> float:
        """Its right edge."""
        return self.left + self.width

    @property
    def bottom(self) -> float:
        """Its lower edge."""
        return self.top + self.height

    def x(self, moment: datetime) -> float:
        """Where a moment is, held within the frame."""
        share = (moment - self.start) / (self.end - self.start)
        return round(self.left + self.width * min(max(share, 0.0), 1.0), 1)

    def y(self, value: float) -> float:
        """Where a value is, held within the frame."""
        share = (value - self.low) / (self.high - self.low)
        return round(self.bottom - self.height * min(max(share, 0.0), 1.0), 1)


def ceiling(value: float, most: int = 5) -> tuple[float, float]:
    """(top of an axis from 0 that holds `value`, distance of its at most `most` lines), in round numbers."""
    step = next((float(nice) for nice in NICE if nice * most >= value), max(value, 1.0) / most)
    return step * max(1, -int(-value // step)), step


def text(x: float, y: float, words: str, css: str = "", anchor: str = "start") -> str:
    """A line of text."""
    return f'<text x="{x:g}" y="{y:g}" class="{css}" text-anchor="{anchor}">{escape(words)}</text>'


def _polygon(points: Iterable[tuple[float, float]], css: str, closed: bool) -> str:
    body = " ".join(f"{x:g},{y:g}" for x, y in points)
    return f'<{"polygon" if closed else "polyline"} points="{body}" class="{css}"/>'


def line(frame: Frame, points: Sequence[Point], css: str) -> str:
    """A line through points."""
    return _polygon(((frame.x(at), frame.y(value)) for at, value in points), css, closed=False) if points else ""


def steps(frame: Frame, values: Sequence[tuple[datetime, datetime, float]], css: str) -> str:
    """A staircase of values that each hold for a while."""
    corners = [(frame.x(at), frame.y(value)) for start, end, value in values for at in (start, end)]
    return _polygon(corners, css, closed=False) if corners else ""


def band(frame: Frame, values: Sequence[tuple[datetime, datetime, float, float]], css: str) -> str:
    """The area between two staircases."""
    lower = [(frame.x(at), frame.y(low)) for start, end, low, _ in values for at in (start, end)]
    upper = [(frame.x(at), frame.y(high)) for start, end, _, high in values for at in (start, end)]
    return _polygon([*upper, *reversed(lower)], css, closed=True) if values else ""


def box(frame: Frame, span: Span, low: float, high: float, css: str, title: str = "") -> str:
    """A rectangle over a time and between two values."""
    x, y = frame.x(span[0]), frame.y(high)
    width, height = max(frame.x(span[1]) - x, 0.8), max(frame.y(low) - y, 0.0)
    inner = f"<title>{escape(title)}</title>" if title else ""
    return f'<rect x="{x:g}" y="{y:g}" width="{width:.1f}" height="{height:.1f}" class="{css}">{inner}</rect>'


def rule(x1: float, y1: float, x2: float, y2: float, css: str) -> str:
    """A straight line."""
    return f'<line x1="{x1:g}" y1="{y1:g}" x2="{x2:g}" y2="{y2:g}" class="{css}"/>'


def scale(frame: Frame, step: float, unit: str) -> str:
    """Lines across at round values, named at the left."""
    parts = []
    value = frame.low
    while value <= frame.high + 1e-9:
        y = frame.y(value)
        parts.append(rule(frame.left, y, frame.right, y, "grid"))
        parts.append(text(frame.left - 6, y + 4, f"{value:g}", "tick", "end"))
        value += step
    parts.append(text(frame.left - 6, frame.top - 8, unit, "tick", "end" if len(unit) < 6 else "middle"))
    return "".join(parts)


def midnights(frame: Frame, zone: ZoneInfo) -> list[datetime]:
    """Local midnights within the frame."""
    day = frame.start.astimezone(zone).date() + timedelta(days=1)
    found = []
    while (at := require_utc(datetime(day.year, day.month, day.day, tzinfo=zone))) < frame.end:
        found.append(at)
        day += timedelta(days=1)
    return found


def days(frame: Frame, zone: ZoneInfo, noons: bool = True, names: bool = True) -> str:
    """Local midnights as lines, the weekdays named between them, and 6, 12 and 18 o'clock where there is room."""
    parts = []
    edges = [frame.start, *midnights(frame, zone), frame.end]
    room = frame.width / max(1, len(edges) - 1)
    for first, last in pairwise(edges):
        if first != frame.start:
            parts.append(rule(frame.x(first), frame.top, frame.x(first), frame.bottom, "day"))
        if names and frame.x(last) - frame.x(first) >= min(40.0, 0.6 * room):
            middle = (frame.x(first) + frame.x(last)) / 2
            local = first.astimezone(zone)
            name = f"{local:%a %-d}" if room < 60 else f"{local:%a %-d %b}"
            parts.append(text(middle, frame.bottom + 30, name, "tick", "middle"))
    if noons:
        parts += _hours(frame, zone, 6 if room > 130 else 12)
    return "".join(parts)


def _hours(frame: Frame, zone: ZoneInfo, every_h: int) -> list[str]:
    parts = []
    at = frame.start.replace(minute=0, second=0, microsecond=0)
    while at <= frame.end:
        local = at.astimezone(zone)
        if at >= frame.start and local.hour % every_h == 0:
            x = frame.x(at)
            parts.append(rule(x, frame.bottom, x, frame.bottom + 4, "axis"))
            parts.append(text(x, frame.bottom + 15, f"{local:%H}", "tick", "middle"))
        at += timedelta(hours=1)
    return parts


def svg(width: float, height: float, name: str, title: str, says: str, parts: Iterable[str], css: str = "") -> str:
    """The whole drawing. `title` and `says` are what a screen reader reads; `name` tells drawings apart."""
    words = f'<title id="{name}-t">{escape(title)}</title><desc id="{name}-d">{escape(says)}</desc>'
    head = f'viewBox="0 0 {width:g} {height:g}" role="img" aria-labelledby="{name}-t {name}-d" class="{css}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {head}>{words}{"".join(parts)}</svg>'
