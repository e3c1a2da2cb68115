"""The figures: one function each, numbers in, PNG and SVG out. As wide as a column of the paper, the same bytes always.

Colours are Okabe and Ito's, told apart by the colour-blind, and every curve has a dash or a mark of its own besides.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plugd.errors import PlugdError, UsageError
from plugd.study.table import Choice
from plugd.study.week import Week

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMN_IN = 3.5
BLACK, ORANGE, SKY, GREEN, BLUE, VERMILION, PURPLE = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00", "#CC79A7",
)  # fmt: skip
NIGHT = "#E6E6E6"
INTENSITY = "Carbon intensity (gCO$_2$/kWh)"
STYLE: Any = {
    "axes.linewidth": 0.6,
    "axes.labelsize": 7.5,
    "axes.spines.top": False,
    "font.family": "DejaVu Sans",
    "font.size": 7,
    "legend.fontsize": 6.5,
    "legend.title_fontsize": 6.5,
    "legend.frameon": False,
    "legend.handlelength": 2.2,
    "lines.linewidth": 1.1,
    "savefig.dpi": 200,
    "svg.hashsalt": "plugd",
    "xtick.labelsize": 6.5,
    "xtick.major.width": 0.6,
    "ytick.labelsize": 6.5,
    "ytick.major.width": 0.6,
}
STRATEGIES: dict[Choice, tuple[str, str, str]] = {
    Choice("uncontrolled"): (VERMILION, "-", "s"),
    Choice("mpc", 1): (ORANGE, "--", "^"),
    Choice("mpc", 2): (GREEN, "-.", "D"),
    Choice("mpc", 4): (BLUE, "-", "o"),
    Choice("mpc", 7): (PURPLE, ":", "v"),
}
"""Colour, dash and mark."""
OTHER = (BLACK, ":", "x")
REGIONS = (
    "North Scotland", "South Scotland", "North West England", "North East England", "Yorkshire", "North Wales",
    "South Wales", "West Midlands", "East Midlands", "East England", "South West England", "South England", "London",
    "South East England",
)  # fmt: skip
"""The distribution areas by NESO's number, from 1 on."""


@contextmanager
def figure(folder: Path, name: str, height_in: float) -> Iterator["Figure"]:
    """An empty figure, written as `name`.png and `name`.svg. Raises UsageError without Matplotlib, PlugdError."""
    try:
        import matplotlib as mpl  # noqa: PLC0415 - an extra, and half a second
        from matplotlib.figure import Figure  # noqa: PLC0415
    except ImportError as error:
        raise UsageError("--out: figures need Matplotlib; pip install 'plugd[study]'") from error
    with mpl.rc_context():
        mpl.rcParams.update(mpl.rcParamsDefault)  # whatever the machine's own style is
        mpl.rcParams.update(STYLE)
        drawn = Figure(figsize=(COLUMN_IN, height_in), layout="constrained")
        yield drawn
        try:
            folder.mkdir(parents=True, exist_ok=True)
            drawn.savefig(folder / f"{name}.png", metadata={"Software": None})
            drawn.savefig(folder / f"{name}.svg", metadata={"Date": None})
        except OSError as error:
            raise PlugdError(f"--out {folder}: cannot be written ({error.strerror}); name another folder") from error


def _name(choice: Choice) -> str:
    return f"N = {choice.horizon}" if choice.horizon else choice.name.replace("-", " ").capitalize()


def _days(axes: "Axes", at: Sequence[datetime], stays: Sequence[tuple[datetime, datetime]]) -> None:
    """Midnights on the time axis, and the nights at the plug in grey."""
    midnights = [moment for moment in at if (moment.hour, moment.minute) == (0, 0)]
    axes.set_xlim(_x(at[0]), _x(at[-1]))
    axes.set_xticks([_x(moment) for moment in midnights], [f"{moment.day} {moment:%b}" for moment in midnights])
    for arrival, departure in stays:
        axes.axvspan(_x(max(arrival, at[0])), _x(min(departure, at[-1])), color=NIGHT, linewidth=0, zorder=0)


def _x(moment: datetime) -> float:
    """Days: Matplotlib's own dates would bring its time zones and formats."""
    return moment.timestamp() / 86400.0


def forecast(folder: Path, at: Sequence[datetime], curves: Sequence[tuple[str, Sequence[float | None]]]) -> None:
    """Figure 1. `curves`: measured, one step ahead, as far ahead as the figure goes."""
    with figure(folder, "forecast", 2.3) as drawn:
        axes = drawn.subplots()
        looks = ((BLUE, "-", 0.8), (VERMILION, ":", 1.0), (BLACK, "-", 1.2))
        for (name, values), (colour, dash, width) in reversed(list(zip(curves, reversed(looks), strict=True))):
            known = [(_x(moment), g) for moment, g in zip(at, values, strict=True) if g is not None]
            axes.plot(*zip(*known, strict=True), dash, color=colour, linewidth=width, label=name)
        _days(axes, at, ())
        axes.set_ylabel(INTENSITY)
        axes.spines.right.set_visible(False)
        handles, names = axes.get_legend_handles_labels()
        drawn.legend(handles[::-1], names[::-1], loc="outside upper center", ncols=3, columnspacing=1.0)


def week(folder: Path, found: Week) -> None:
    """Figures 2 and 3."""
    x = [_x(moment) for moment in found.at]
    for name, label, curves, scale in (
        ("week_soc", "State of charge (%)", found.soc, 100.0),
        ("week_co2", "Cumulative CO$_2$ (kg)", found.carbon_g, 0.001),
    ):
        with figure(folder, name, 2.3) as drawn:
            axes = drawn.subplots()
            behind = axes.twinx()
            _days(behind, found.at, found.stays)
            (line,) = behind.plot(x, found.intensity, color="#777777", linewidth=0.7, label="Carbon intensity")
            behind.set_ylabel(INTENSITY)
            behind.set_ylim(0, 1.05 * max(found.intensity))
            axes.set_zorder(behind.get_zorder() + 1)
            axes.patch.set_visible(False)
            for choice, curve in curves.items():
                colour, dash, _ = STRATEGIES.get(choice, OTHER)
                axes.plot(x, [scale * y for y in curve], dash, color=colour, label=_name(choice))
            axes.set_ylabel(label)
            axes.set_ylim(*((15, 85) if scale == 100.0 else (0, None)))
            handles, names = axes.get_legend_handles_labels()
            drawn.legend(
                [*handles, line], [*names, "Carbon intensity"], loc="outside upper center", ncols=4, columnspacing=0.9
            )


def flexibility(folder: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Figure 4: carbon by length of stay and daily use; below it when the car is at the plug."""
    looks = ((BLUE, "-", "o"), (GREEN, "-.", "D"), (ORANGE, "--", "^"), (VERMILION, ":", "s"))
    lengths = sorted({row["length_h"] for row in rows}, reverse=True)
    uses = sorted({row["use_kwh"] for row in rows})
    with figure(folder, "flexibility", 3.2) as drawn:
        grid = drawn.subplots(2, 2, sharex=True, sharey="row", height_ratios=(2.4, 1))
        for column, stay in enumerate(("overnight", "daytime")):
            above, below = grid[0][column], grid[1][column]
            here = [row for row in rows if row["stay"] == stay]
            for use_kwh, (colour, dash, mark) in zip(uses, looks, strict=False):
                of = {row["length_h"]: row["carbon_g_per_kwh"] for row in here if row["use_kwh"] == use_kwh}
                above.plot(
                    range(len(lengths)),
                    [of.get(length_h) for length_h in lengths],
                    dash,
                    marker=mark,
                    markersize=2.6,
                    color=colour,
                    label=f"{use_kwh:g}",
                )
            above.set_title(f"{stay.capitalize()} charging", fontsize=7.5)
            middle = 1.0 if stay == "overnight" else 13.0
            for place, length_h in enumerate(lengths):
                below.bar(place, length_h, bottom=middle - length_h / 2, width=0.7, color="#999999")
            below.set_xticks(range(len(lengths)), [str(length_h) for length_h in lengths])
            below.set_xlabel("Time at the plug (h a day)")
            for axes in (above, below):
                axes.spines.right.set_visible(False)
        grid[0][0].set_ylabel("Charged at (gCO$_2$/kWh)")
        grid[1][0].set_ylabel("Plugged in\n(hour of day)")
        grid[1][0].set_yticks(range(-6, 25, 6), ["18", "0", "6", "12", "18", "0"])
        handles, names = grid[0][0].get_legend_handles_labels()
        drawn.legend(handles, names, title="Daily use (kWh)", loc="outside upper center", ncols=4)


def regions(folder: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Figure 5: one line a region, dirtiest uncontrolled charging first, one mark a strategy."""
    choices = [Choice(row["strategy"], row["horizon"]) for row in rows]
    value = {(row["regionid"], choice): row["carbon_g_per_kwh"] for row, choice in zip(rows, choices, strict=True)}
    ids = list(dict.fromkeys(row["regionid"] for row in rows))
    shown = list(dict.fromkeys(choices))
    ids.sort(key=lambda region: (value.get((region, shown[0])) or 0.0, region))
    with figure(folder, "regions", 1.1 + 0.17 * len(ids)) as drawn:
        axes = drawn.subplots()
        for place, region in enumerate(ids):
            found = [g for choice in shown if (g := value.get((region, choice))) is not None]
            if found:
                axes.plot((min(found), max(found)), (place, place), color="#BBBBBB", linewidth=1.6, zorder=1)
        for choice in shown:
            colour, _, mark = STRATEGIES.get(choice, OTHER)
            points = [(g, k) for k, region in enumerate(ids) if (g := value.get((region, choice))) is not None]
            if points:
                x, y = zip(*points, strict=True)
                axes.scatter(x, y, marker=mark, s=13, color=colour, linewidth=0, label=_name(choice), zorder=2)
        axes.set_yticks(range(len(ids)), [_region(region) for region in ids])
        axes.set_xlabel("Charged at (gCO$_2$/kWh)")
        axes.set_xlim(left=0)
        axes.spines.right.set_visible(False)
        axes.grid(axis="x", color=NIGHT, linewidth=0.6)
        axes.set_axisbelow(True)
        drawn.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=4, columnspacing=0.8)


def _region(number: int) -> str:
    return REGIONS[number - 1] if 1 <= number <= len(REGIONS) else f"Region {number}"


def reductions(folder: Path, rows: Sequence[dict[str, Any]], perfect: Sequence[dict[str, Any]]) -> None:
    """The table as a figure: reductions by horizon with their confidence, beside perfect foresight."""
    planned = [row for row in rows if row["strategy"] == "mpc"]
    if not planned:
        return
    with figure(folder, "table", 2.1) as drawn:
        axes = drawn.subplots()
        places = {row["horizon"]: place for place, row in enumerate(planned)}
        axes.bar(
            list(places.values()),
            [row["reduction_pct"] or 0.0 for row in planned],
            yerr=[row.get("reduction_ci95_pct") or 0.0 for row in planned],
            width=0.6,
            color=SKY,
            error_kw={"linewidth": 0.9, "capsize": 2.5},
            label="On forecasts (95 % interval)",
        )
        axes.scatter(
            [places[row["horizon"]] for row in perfect if row["horizon"] in places],
            [row["reduction_pct"] or 0.0 for row in perfect if row["horizon"] in places],
            marker="_", s=220, color=BLACK, label="Perfect foresight",
        )  # fmt: skip
        axes.set_xticks(list(places.values()), [str(horizon) for horizon in places])
        axes.set_xlabel("Nights planned together, N")
        axes.set_ylabel("Less than uncontrolled (%)")
        axes.spines.right.set_visible(False)
        handles, names = axes.get_legend_handles_labels()
        drawn.legend(handles, names, loc="outside upper center", ncols=2)


def credits_by_driver(folder: Path, rows: Sequence[dict[str, Any]], threshold_g_per_kwh: float) -> None:
    """Who would sell and who buy, as a map of stays and uses."""
    from matplotlib.colors import TwoSlopeNorm  # noqa: PLC0415 - an extra

    lengths = sorted({row["length_h"] for row in rows}, reverse=True)
    uses = sorted({row["use_kwh"] for row in rows})
    credit = {(row["stay"], row["length_h"], row["use_kwh"]): row["credit_g_per_kwh"] for row in rows}
    most = max([1.0, *(abs(g) for g in credit.values())])
    with figure(folder, "credits", 3.0) as drawn:
        grid = drawn.subplots(1, 2, sharey=True)
        for axes, stay in zip(grid, ("overnight", "daytime"), strict=True):
            cells = [[credit.get((stay, length_h, use), 0.0) for use in uses] for length_h in lengths]
            axes.imshow(cells, cmap="PuOr", norm=TwoSlopeNorm(0.0, -most, most), aspect="auto")
            for row, line in enumerate(cells):
                for column, g in enumerate(line):
                    colour = "white" if abs(g) > 0.52 * most else "black"
                    axes.text(column, row, f"{g:+.0f}", ha="center", va="center", fontsize=6, color=colour)
            axes.set_title(f"{stay.capitalize()} charging", fontsize=7.5)
            axes.set_xticks(range(len(uses)), [f"{use:g}" for use in uses])
            axes.set_yticks(range(len(lengths)), [str(length_h) for length_h in lengths])
            axes.set_xlabel("Daily use (kWh)")
            axes.tick_params(length=0)
            axes.spines[:].set_visible(False)
        grid[0].set_ylabel("Time at the plug (h a day)")
        drawn.suptitle(f"Credit (gCO$_2$/kWh) at a threshold of {threshold_g_per_kwh:.0f} gCO$_2$/kWh", fontsize=7.5)


def crowd(folder: Path, rows: Sequence[dict[str, Any]]) -> None:
    """The saving by how many plan, a curve a delay."""
    looks = ((BLACK, "-", "o"), (BLUE, "--", "D"), (GREEN, "-.", "^"), (VERMILION, ":", "s"), (PURPLE, "-", "v"))
    with figure(folder, "crowd", 2.3) as drawn:
        axes = drawn.subplots()
        for delay_h, (colour, dash, mark) in zip(dict.fromkeys(row["delay_h"] for row in rows), looks, strict=False):
            of = [row for row in rows if row["delay_h"] == delay_h]
            axes.plot(
                [row["cars"] / 1e6 for row in of], [row["reduction_pct"] for row in of],
                dash, marker=mark, markersize=2.8, color=colour,
                label=f"up to {delay_h:g} h" if delay_h else "none",
            )  # fmt: skip
        axes.axhline(0.0, color=BLACK, linewidth=0.6)
        axes.set_xlabel("Cars that plan with the same forecast (millions)")
        axes.set_ylabel("Less than uncontrolled (%)")
        axes.spines.right.set_visible(False)
        axes.legend(title="Random delay", loc="best")
