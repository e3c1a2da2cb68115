"""Forecast scores against an example by hand."""

from datetime import UTC, datetime, timedelta

from plugd.domain import Forecast, Intensity
from plugd.score import LeadScore, scores
from plugd.units import HALF_HOUR

ISSUED = datetime(2023, 1, 2, 12, 4, tzinfo=UTC)
FIRST = ISSUED.replace(minute=0)


def test_each_forecast_counts_by_how_far_it_looked_ahead() -> None:
    near, far = FIRST, FIRST + timedelta(hours=13)
    forecast = Forecast(ISSUED, "national", (Intensity(near, 110.0), Intensity(far, 80.0)))
    later = Forecast(ISSUED + timedelta(hours=12), "national", (Intensity(far, 120.0),))
    found = scores((forecast, later), (Intensity(near, 100.0), Intensity(far, 100.0)))
    assert found == (LeadScore(0, 6, 2, 15.0, 15.0, 15.0), LeadScore(12, 24, 1, 20.0, -20.0, 20.0))


def test_what_nobody_measured_is_not_scored() -> None:
    forecast = Forecast(ISSUED, "13", (Intensity(FIRST, 110.0),))
    assert scores((forecast,), (Intensity(FIRST + HALF_HOUR, 100.0),)) == ()
    assert scores((), ()) == ()
