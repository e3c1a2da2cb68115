"""The report as one HTML file that needs nothing else: style and drawings are in it."""

from collections.abc import Callable, Iterable
from datetime import datetime
from html import escape
from importlib.resources import files

from plugd import __version__, scoring
from plugd.charts import Frame, box, ceiling, days, line, rule, scale, svg, text
from plugd.ledger import LITTLE_KWH, Night, Sum
from plugd.report import Report, headline
from plugd.units import HALF_HOUR, grams, to_pct

WIDE, NARROW = 900.0, 400.0
POLICY = "default-src 'none'; style-src 'unsafe-inline'"
LABELLED_PX = 34.0
"""A night's name needs this much room."""

Drawing = Callable[[Report, float, str], str]
"""(report, width, its class) to SVG."""

_STYLE = files("plugd.web").joinpath("static/style.css")


def page(report: Report) -> str:
    """The whole file."""
    name = escape(report.name)
    first, last = report.nights[0].day, report.nights[-1].day
    body = "".join(
        (
            f"<header><h1>plugd {name}</h1><p class='soft'>Nights of {first:%-d %B} to {last:%-d %B %Y}</p></header>",
            "<main>",
            _card("", f"<p class='reason'>{escape(headline(report))}</p>{_tiles(report.total)}"),
            _card("Carbon per night", _both(report, _savings) + _savings_legend()),
            _card("Battery over the nights", _both(report, _battery) + _battery_legend()),
            _card("Other horizons", _horizons(report)) if report.replays else "",
            _card("Nights", _nights(report)),
            _card("Months", _months(report)),
            _card("How good the forecasts were", _forecast(report)) if report.scores else "",
            _card("What is compared with what", _explained(report)),
            "</main>",
            f"<footer><p>plugd {__version__}. Intensity: NESO Carbon Intensity API, CC BY 4.0.</p></footer>",
        )
    )
    return (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        "<meta name='viewport' content='width=device-width, initial-scale=1'>"
        f"<title>plugd {name}: report</title><style>{_STYLE.read_text(encoding='utf-8')}</style></head>"
        f"<body>{body}</body></html>\n"
    )


def _card(title: str, inner: str) -> str:
    heading = f"<h2>{escape(title)}</h2>" if title else ""
    return f"<section class='card'>{heading}{inner}</section>"


def _tiles(whole: Sum) -> str:
    ours, theirs, best = (whole.per_kwh(g) for g in (whole.carbon_g, whole.on_arrival_g, whole.best_g))
    tiles = [
        ("charged", f"{whole.kwh:.1f} kWh", f"in {whole.nights} nights"),
        ("saved", grams(whole.saved_g), "" if whole.saved_pct is None else f"{whole.saved_pct:.0f} %"),
        ("plugd", _clean(ours), "per kWh"),
        ("on arrival", _clean(theirs), "per kWh"),
        ("best in hindsight", _clean(best), "per kWh"),
        ("switched on", f"{whole.switch_ons} times", f"{whole.missed} mornings missed"),
    ]
    inner = "".join(
        f"<div><dt>{escape(name)}</dt><dd>{escape(value)}<small>{escape(more)}</small></dd></div>"
        for name, value, more in tiles
    )
    return f"<dl class='tiles'>{inner}</dl>"


def _clean(g_per_kwh: float | None) -> str:
    return "-" if g_per_kwh is None else f"{g_per_kwh:.0f} g"


# -- drawings -------------------------------------------------------------------------------------


def _both(report: Report, draw: Drawing) -> str:
    return draw(report, WIDE, "wide") + draw(report, NARROW, "narrow")


def _savings(report: Report, width: float, css: str) -> str:
    """Bars: charging on arrival behind, plugd before it, the best possible as a line across."""
    nights = report.nights
    top, step = ceiling(max(max(n.on_arrival_g, n.carbon_g) for n in nights))
    start, end = nights[0].arrival, nights[-1].arrival
    frame = Frame(52.0, 24.0, width - 64.0, 190.0, start, max(end, start + HALF_HOUR), 0.0, max(top, 1.0))
    parts = [scale(frame, step, "g CO2")]
    room = frame.width / len(nights)
    every = max(1, round(LABELLED_PX / room + 0.49))
    for index, night in enumerate(nights):
        left = frame.left + room * index
        parts.append(_bar(frame, left + 0.14 * room, 0.72 * room, night.on_arrival_g, "arrival", night))
        parts.append(_bar(frame, left + 0.26 * room, 0.48 * room, night.carbon_g, "ours", night))
        if night.kwh > LITTLE_KWH:
            y = frame.y(night.best_g)
            parts.append(rule(left + 0.1 * room, y, left + 0.9 * room, y, "best"))
        if index % every == 0:
            parts.append(text(left + room / 2, frame.bottom + 16, f"{night.day:%a}", "tick", "middle"))
            parts.append(text(left + room / 2, frame.bottom + 31, f"{night.day:%-d}", "tick", "middle"))
    return svg(width, 255.0, f"savings-{css}", "Carbon per night", headline(report), parts, css)


def _bar(frame: Frame, x: float, width: float, grams_of_it: float, css: str, night: Night) -> str:
    y = frame.y(grams_of_it)
    said = f"{night.day:%a %-d %b}: {night.kwh:.1f} kWh, {night.carbon_g:.0f} g; on arrival {night.on_arrival_g:.0f} g"
    shape = f'x="{x:.1f}" y="{y:g}" width="{width:.1f}" height="{frame.bottom - y:.1f}"'
    return f'<rect {shape} class="{css}"><title>{escape(said)}</title></rect>'


def _battery(report: Report, width: float, css: str) -> str:
    """The estimate as a line, stays shaded, each morning's minimum as a bar and its SOC as a dot."""
    rows = report.rows
    frame = Frame(44.0, 24.0, width - 56.0, 190.0, rows[0].start, rows[-1].start + HALF_HOUR, 0.0, 100.0)
    parts = [
        box(frame, (night.arrival, night.session_end), 0.0, 100.0, "session")
        for night in report.nights
        if night.session_end is not None
    ]
    parts += [scale(frame, 20.0, "%"), days(frame, report.zone, noons=False)]
    points: list[tuple[datetime, float]] = [(row.start, 100.0 * row.soc) for row in rows]
    parts.append(line(frame, points, "soc"))
    mornings = [n for n in report.nights if n.session_end and n.morning_soc is not None and n.minimum is not None]
    for night in mornings:
        if night.session_end is None or night.morning_soc is None or night.minimum is None:
            continue
        x, y = frame.x(night.session_end), frame.y(100.0 * night.minimum)
        parts.append(rule(x - 7, y, x + 7, y, "minimum"))
        said = f"{night.session_end:%a %-d %b}: {100 * night.morning_soc:.0f} %, minimum {100 * night.minimum:.0f} %"
        dot = f'<circle cx="{x:g}" cy="{frame.y(100 * night.morning_soc):g}" r="4" class="dot">'
        parts.append(f"{dot}<title>{escape(said)}</title></circle>")
    says = f"{len(mornings)} mornings; {report.total.missed} of them under a minimum that was in reach."
    return svg(width, 255.0, f"battery-{css}", "State of charge over the nights", says, parts, css)


def _legend(items: Iterable[tuple[str, str]]) -> str:
    inner = "".join(
        f"<li><svg viewBox='0 0 26 12' aria-hidden='true'>{shape}</svg>{escape(words)}</li>" for shape, words in items
    )
    return f"<ul class='legend'>{inner}</ul>"


def _savings_legend() -> str:
    return _legend(
        (
            ("<rect x='6' y='1' width='14' height='11' class='ours'/>", "plugd"),
            ("<rect x='4' y='1' width='18' height='11' class='arrival'/>", "the same energy on arrival"),
            ("<line x1='2' y1='6' x2='24' y2='6' class='best'/>", "best in hindsight"),
        )
    )


def _battery_legend() -> str:
    return _legend(
        (
            ("<line x1='0' y1='6' x2='26' y2='6' class='soc'/>", "state of charge (estimate)"),
            ("<circle cx='13' cy='6' r='4' class='dot'/>", "at the session end"),
            ("<line x1='4' y1='6' x2='22' y2='6' class='minimum'/>", "morning minimum"),
            ("<rect x='0' y='0' width='26' height='12' class='session'/>", "at the plug"),
        )
    )


# -- tables ---------------------------------------------------------------------------------------


def _table(caption: str, head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    top = "".join(f"<th scope='col'>{escape(cell)}</th>" for cell in head)
    body = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in rows)
    return (
        f"<div class='scroll' tabindex='0'><table><caption>{escape(caption)}</caption><thead><tr>{top}</tr></thead>"
        f"<tbody>{body}</tbody></table></div>"
    )


def _per(night: Night, grams_of_it: float) -> str:
    return f"{grams_of_it / night.kwh:.0f}" if night.kwh > LITTLE_KWH else "-"


def _nights(report: Report) -> str:
    head = ("night", "arrived", "kWh", "g/kWh", "on arrival", "best", "saved", "on", "morning", "minimum")
    rows = []
    for night in report.nights:
        morning = "-" if night.morning_soc is None else f"{to_pct(night.morning_soc, 0):.0f} %"
        rows.append(
            (
                f"{night.day:%a %-d %b}{'' if night.final else ' *'}",
                f"{to_pct(night.arrival_soc, 0):.0f} %",
                f"{night.kwh:.1f}",
                *(_per(night, value) for value in (night.carbon_g, night.on_arrival_g, night.best_g)),
                grams(night.saved_g),
                str(night.switch_ons),
                f"<span class='bad'>{morning} missed</span>" if night.missed else morning,
                "-" if night.minimum is None else f"{to_pct(night.minimum, 0):.0f} %",
            )
        )
    return _table("* waits for a measured intensity and may change once.", head, rows)


def _months(report: Report) -> str:
    head = ("month", "nights", "kWh", "g/kWh", "on arrival", "best", "saved", "switched on", "missed")
    rows = [
        (
            month,
            str(part.nights),
            f"{part.kwh:.1f}",
            *(_clean(part.per_kwh(value)) for value in (part.carbon_g, part.on_arrival_g, part.best_g)),
            grams(part.saved_g),
            str(part.switch_ons),
            str(part.missed),
        )
        for month, part in report.months
    ]
    return _table("Months of the evening; the first and last may be in part.", head, rows)


def _horizons(report: Report) -> str:
    rows = [(str(r.horizon), _clean(r.g_per_kwh), f"{r.kwh:.1f}", str(r.missed)) for r in report.replays]
    return _table(
        "These nights once more in a simulation of the same plug and car, with the forecasts as they were issued.",
        ("nights planned", "g/kWh", "kWh", "mornings missed"),
        rows,
    )


def _forecast(report: Report) -> str:
    rows = [
        (
            f"{s.from_h} to {s.to_h} h",
            f"{s.mean_abs_g_per_kwh:.0f}",
            f"{s.mean_abs_pct:.0f} %",
            f"{s.bias_g_per_kwh:+.0f}",
            str(s.count),
        )
        for s in report.scores
    ]
    issued = _table(
        "Every forecast as issued against what was measured.",
        ("looking ahead", "off by, g/kWh", "in percent", "too high by", "half hours"),
        rows,
    )
    compared = list(scoring.table(report.compared))
    if not compared:
        return issued
    head = ("looking ahead", "plugd's outlook, g/kWh", "NESO's forecast", "the day before")
    return issued + _table(f"Off by, of the same half hours of the last {scoring.SCORED.days} days.", head, compared)


def _explained(report: Report) -> str:
    said = (
        "Every figure comes from the ledger of half hours: energy by the plug's meter, times the carbon intensity of "
        "the grid. The intensity is noted when the half hour is over, and replaced once, a day later, by the measured "
        "one; after that it never changes.",
        "On arrival: the same energy, at the same power, from the moment the car came home (as told, else the usual "
        f"time, {report.household.nights.plug_in:%H:%M}) until it is all in.",
        "Best in hindsight: the same energy in the cleanest half hours between arrival and session end, which nobody "
        "could have known.",
        "Other horizons: what was driven is taken from the estimate, and the battery is known on each arrival. The "
        "batteries end at different levels, so compare g/kWh.",
    )
    return "".join(f"<p class='soft'>{escape(words)}</p>" for words in said)
