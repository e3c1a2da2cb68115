"""The synthetic forecast is the paper's, and the growth of its error comes from issued forecasts."""

import gzip
from datetime import UTC, datetime, timedelta
from pathlib import Path
from statistics import fmean

import pytest

from plugd.errors import UsageError
from plugd.series import IntensitySeries
from plugd.study.forecasts import Noise, Synthetic
from plugd.study.growth import growth_per_half_hour
from plugd.study.measured import Measured, measured, span
from plugd.units import HALF_HOUR

START = datetime(2023, 3, 1, tzinfo=UTC)
FOUND = Measured("x", START, tuple(100.0 + k for k in range(480)), tuple(0.001 * (k % 7) - 0.002 for k in range(480)))


def at(k: int) -> datetime:
    return START + k * HALF_HOUR


def relative(noise: Noise, issued: int, targets: range, seed: int = 0, growth: float = 0.01) -> list[float]:
    """Relative errors of an issue."""
    given = Synthetic(FOUND, noise, seed, START, growth).expected(at(issued), [at(k) for k in targets])
    return [g / FOUND.actual[k] - 1.0 for g, k in zip(given, targets, strict=True)]


def test_the_error_of_each_target_grows_with_the_lead() -> None:
    found = relative(Noise.TARGET, 10, range(10, 106))
    assert [abs(e) for e in found] == pytest.approx(
        [abs(FOUND.error[k]) * (1 + 0.01 * (k - 10)) for k in range(10, 106)]
    )


def test_the_error_of_the_datum_is_that_of_the_whole_issue() -> None:
    found = relative(Noise.DATUM, 10, range(10, 106))
    assert [abs(e) for e in found] == pytest.approx(
        [abs(FOUND.error[10]) * (1 + 0.01 * (k - 10)) for k in range(10, 106)]
    )


def test_without_noise_it_is_what_will_be() -> None:
    assert relative(Noise.NONE, 10, range(10, 106)) == [0.0] * 96


def test_signs_are_fair_and_new_with_every_issue_and_seed() -> None:
    def signs(issued: int, seed: int) -> list[bool]:
        return [e > 0 for e in relative(Noise.DATUM, issued, range(issued, issued + 300), seed)]

    drawn = [signs(10, seed) for seed in range(20)]
    assert fmean(sign for row in drawn for sign in row) == pytest.approx(0.5, abs=0.03)
    assert len({tuple(row) for row in drawn}) == 20
    assert signs(10, 0) != signs(11, 0)


def test_an_issue_is_the_same_whoever_asks_for_how_much_of_it() -> None:
    whole, part = relative(Noise.TARGET, 10, range(10, 300)), relative(Noise.TARGET, 10, range(50, 60))
    assert whole[40:50] == part


def test_history_is_the_stored_forecast_of_what_is_over() -> None:
    history = Synthetic(FOUND, Noise.TARGET, 0, at(4)).history(at(20))
    assert [value.start for value in history] == [at(k) for k in range(4, 20)]
    assert history[0].g_per_kwh == pytest.approx(FOUND.actual[4] * (1 + FOUND.error[4]))


def test_errors_come_from_another_years_same_half_hour() -> None:
    theirs = IntensitySeries(datetime(2023, 2, 28, tzinfo=UTC), (200.0,) * 96, (220.0,) * 48 + (150.0,) * 48)
    own = IntensitySeries(datetime(2024, 2, 28, tzinfo=UTC), (100.0,) * 144, (None,) * 144)
    found = measured("y", own, theirs)
    assert found.error == pytest.approx((0.1,) * 96 + (-0.25,) * 48)  # the 29th is another 28th


def test_an_actual_of_zero_and_a_missing_one_make_no_nonsense() -> None:
    found = measured("z", IntensitySeries(START, (0.0, None, 50.0), (20.0, 30.0, None)))
    assert found.actual == (0.0, 0.0, 50.0)
    assert found.error == (20.0, 0.0, 0.0)
    assert span(found, None) == (START + timedelta(hours=12), START + 3 * HALF_HOUR)


def test_a_year_that_the_file_has_not_is_refused() -> None:
    with pytest.raises(UsageError, match=r"--year 2019: x goes from 2023-03-01 to 2023-03-11"):
        span(FOUND, 2019)


def issued(path: Path, share_a_day: float) -> Path:
    """Forecasts whose relative error grows by `share_a_day` of the first day's 10 % a day."""
    lines = ["issued,lead_h,forecast,actual"]
    for lead_h in range(96):
        off = 0.1 * (1 + share_a_day * (lead_h // 24))
        lines += [
            f"2021-07-01T00:00Z,{lead_h},{200 * (1 + off)},200",
            f"2021-07-02T00:00Z,{lead_h},{200 * (1 - off)},200",
        ]
    with gzip.open(path, "wt") as file:
        file.write("\n".join(lines))
    return path


def test_growth_is_the_mean_of_the_zones_growth(tmp_path: Path) -> None:
    files = [issued(tmp_path / "a.csv.gz", 0.4), issued(tmp_path / "b.csv.gz", 0.2)]
    assert growth_per_half_hour(files) == pytest.approx((1.2 / 144 + 0.6 / 144) / 2)


def test_growth_of_the_six_zones_is_near_the_papers(neso_data: Path) -> None:
    zones = sorted((neso_data / "carboncast").glob("*_96h_2021H2.csv.gz"))
    assert len(zones) == 6
    assert growth_per_half_hour(zones) == pytest.approx(9.7e-3, abs=0.05e-3)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("issued,lead_h,forecast\n", "line 1: has no column actual"),
        ("issued,lead_h,forecast,actual\n2021,0,x,3\n", "line 2"),
        ("issued,lead_h,forecast,actual\n2021,0,nan,3\n", "line 2: no number"),
        ("issued,lead_h,forecast,actual\n2021,0,4,3\n", "no forecast errors at leads of 72 to 95 hours"),
    ],
)
def test_a_file_without_issued_forecasts_is_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "zone.csv"
    path.write_text(text)
    with pytest.raises(UsageError, match=said):
        growth_per_half_hour([path])
