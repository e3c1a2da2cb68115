"""The timeline of a run: SOC, relay and power, intensity, and which faults were there and which were shown."""

from datetime import timedelta
from itertools import pairwise
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

from matplotlib import pyplot as plt  # after the choice of no window
from matplotlib.axes import Axes

from plugd.units import hours, to_pct
from plugd_hil.promises import Seen, codes
from plugd_hil.scenario import Scenario

SIZE_IN = (11.0, 7.5)


def draw(scenario: Scenario, seen: Seen, to: Path) -> None:
    """Write the figure. Time goes in hours from the start, and is labelled as the clock showed it."""
    figure, (soc, power, grid, faults) = plt.subplots(
        4, 1, sharex=True, figsize=SIZE_IN, layout="constrained", height_ratios=(3, 2, 2, 1.5)
    )
    figure.suptitle(f"{scenario.name}: {scenario.written.title}")
    start, length_h = scenario.start, hours(scenario.end - scenario.start)
    told_h = [hours(at - start) for at, _ in seen.states]
    true_h = [hours(line.at - start) for line in seen.ledger]
    soc.plot(true_h, [to_pct(line.soc) for line in seen.ledger], label="truly")
    soc.plot(told_h, [state["soc_pct"] for _, state in seen.states], "--", label="told by plugd")
    soc.set_ylabel("SOC, %")
    soc.legend(loc="upper left")
    _power(power, seen, true_h)
    grid.step(told_h, [state["intensity_g_per_kwh"] for _, state in seen.states], where="post", color="tab:gray")
    grid.set_ylabel("g/kWh")
    _faults(faults, seen, [*told_h, length_h])
    for event in scenario.events:
        at_h = hours(event.at - start)
        for axes in (soc, power, grid, faults):
            axes.axvline(at_h, color="tab:red", linewidth=0.8, linestyle=":")
        words, place = f"{event.who} {event.order}"[:28], (at_h, 1.0)
        soc.annotate(words, place, xycoords=("data", "axes fraction"), rotation=30, fontsize=6, color="tab:red")
    faults.xaxis.set_major_formatter(
        lambda at_h, _: seen.clock(start + timedelta(hours=at_h))[: 5 if length_h > 1 else 8]
    )
    faults.set_xlim(0.0, length_h)
    figure.savefig(to, dpi=100)
    plt.close(figure)


def _power(axes: Axes, seen: Seen, true_h: list[float]) -> None:
    """Mean power between the ledger's lines, and the relay behind it."""
    for (before, start_h), (after, end_h) in pairwise(zip(seen.ledger, true_h, strict=True)):
        if before.on:
            axes.axvspan(start_h, end_h, color="tab:green", alpha=0.15, linewidth=0)
        if end_h > start_h:
            mean_kw = (after.energy_kwh - before.energy_kwh) / (end_h - start_h)
            axes.plot([start_h, end_h], [mean_kw, mean_kw], color="tab:green")
    axes.set_ylabel("relay; kW")


def _faults(axes: Axes, seen: Seen, moments_h: list[float]) -> None:
    """A bar as long as plugd's state shows a fault."""
    names = sorted({code for _, state in seen.states for code in codes(state)})
    for row, name in enumerate(names):
        for (_, state), (start_h, end_h) in zip(seen.states, pairwise(moments_h), strict=True):
            if name in codes(state):
                axes.plot([start_h, end_h], [row, row], color="tab:red", linewidth=6, solid_capstyle="butt")
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(-0.5, max(len(names), 1) - 0.5)
    axes.set_ylabel("shown")
