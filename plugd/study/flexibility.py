"""How the stay at the plug and the daily use shape what can be saved (the paper's Figure 4), and the market in it.

Stays are 20 to 4 hours long, around one o'clock at night or in the afternoon; the car is there every day, exactly so,
and its use is known.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, time, timedelta
from itertools import product
from typing import Any

from plugd.study.engine import Account, World
from plugd.study.forecasts import Noise
from plugd.study.measured import Measured
from plugd.study.runs import PAPER, Failure, Run
from plugd.study.world import Driver

AROUND_H = {"overnight": 1.0, "daytime": 13.0}
"""The middle of the stay, hour of the day."""
LENGTHS_H = range(20, 2, -2)
USES_KWH = (5.0, 10.0, 20.0, 30.0)
HORIZON = 4


@dataclass(frozen=True, slots=True)
class Profile:
    """One driver."""

    stay: str
    length_h: int
    use_kwh: float

    @property
    def window(self) -> tuple[time, time]:
        """Plug-in and plug-out."""
        middle = datetime(2000, 1, 1) + timedelta(hours=AROUND_H[self.stay])  # noqa: DTZ001 - a clock time
        half = timedelta(hours=self.length_h / 2)
        return (middle - half).time(), (middle + half).time()


PROFILES = tuple(Profile(*chosen) for chosen in product(AROUND_H, LENGTHS_H, USES_KWH))


def run(profile: Profile, found: Measured, start: datetime, end: datetime, noise: Noise, *, end_value: bool) -> Run:
    """One driver's time under multi-session control."""
    plug_in, plug_out = profile.window
    nights = replace(
        PAPER.nights, horizon=HORIZON, plug_in=plug_in, plug_out=plug_out, plug_in_sd_min=0.0, plug_out_sd_min=0.0
    )
    car = replace(PAPER.car, daily_use_kwh=profile.use_kwh, daily_use_sd_kwh=0.0)
    driver = Driver("UTC", plug_in, plug_out, sd_h=0.0, use_kwh=profile.use_kwh, use_sd_kwh=0.0)
    house = replace(PAPER, nights=nights, car=car, end_value=end_value)
    return Run("mpc", World(house, driver, start, end), found, noise)


def rows(outcomes: Iterable[tuple[Profile, Account | Failure]]) -> list[dict[str, Any]]:
    """A row a driver; runs that failed are left out."""
    return [
        {
            "stay": profile.stay,
            "length_h": profile.length_h,
            "plug_in": f"{profile.window[0]:%H:%M}",
            "plug_out": f"{profile.window[1]:%H:%M}",
            "use_kwh": profile.use_kwh,
            "carbon_g_per_kwh": None if account.carbon_g_per_kwh is None else round(account.carbon_g_per_kwh, 3),
            "energy_kwh": round(account.energy_kwh, 3),
            "missed_mornings": account.missed,
        }
        for profile, account in outcomes
        if isinstance(account, Account)
    ]


def credited(found: Sequence[dict[str, Any]], threshold_g_per_kwh: float) -> list[dict[str, Any]]:
    """What each driver would sell (above 0) or have to buy: the grams its energy stays under the threshold."""
    return [
        {
            **{key: row[key] for key in ("stay", "length_h", "use_kwh", "carbon_g_per_kwh", "energy_kwh")},
            "credit_g_per_kwh": round(threshold_g_per_kwh - row["carbon_g_per_kwh"], 3),
            "credit_g": round((threshold_g_per_kwh - row["carbon_g_per_kwh"]) * row["energy_kwh"], 1),
        }
        for row in found
        if row["carbon_g_per_kwh"] is not None
    ]


def even_g_per_kwh(found: Sequence[dict[str, Any]]) -> float:
    """The threshold at which what some sell is what the others buy: the mean of all that is charged."""
    charged = [(row["energy_kwh"], row["carbon_g_per_kwh"]) for row in found if row["carbon_g_per_kwh"] is not None]
    energy_kwh = sum(kwh for kwh, _ in charged)
    return sum(kwh * g for kwh, g in charged) / energy_kwh if energy_kwh else 0.0


def pool(found: Sequence[dict[str, Any]]) -> dict[str, float]:
    """What all drivers together net: credits sold and bought, and the threshold at which they would be even."""
    grams = [row["credit_g"] for row in found]
    energy_kwh = sum(row["energy_kwh"] for row in found)
    return {
        "drivers": len(found),
        "energy_kwh": round(energy_kwh, 1),
        "over_g": round(-sum(g for g in grams if g < 0.0), 1),
        "under_g": round(sum(g for g in grams if g > 0.0), 1),
        "net_g": round(sum(grams), 1) + 0.0,  # no -0.0
        "even_at_g_per_kwh": round(even_g_per_kwh(found), 3),
    }
