"""What the meter, people and the passing of days make of the state of charge."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugd import soc
from plugd.domain import Car, Reading, SocEstimate

NOW = datetime(2023, 1, 2, 22, tzinfo=UTC)
CAR = Car()
POWER_KW = 2.3


def reading(minutes: float, kwh: float | None, kw: float | None = POWER_KW, on: bool = True) -> Reading:
    at = NOW + timedelta(minutes=minutes)
    return Reading(at, on, kw, kwh, at)


def known(mean: float = 0.5) -> SocEstimate:
    return soc.metered(soc.told(soc.unknown(NOW), mean, NOW, "car"), reading(0, 100.0), CAR, POWER_KW)


def test_nobody_said_anything_so_promises_count_on_nearly_nothing() -> None:
    assert soc.cautious(soc.unknown(NOW)) == pytest.approx(0.09)


def test_metered_energy_counts_with_the_efficiency() -> None:
    estimate = soc.metered(known(), reading(60, 102.3), CAR, POWER_KW)
    assert estimate.mean == pytest.approx(0.5 + 2.3 * 0.9 / 50)


def test_the_same_reading_twice_counts_once() -> None:
    once = soc.metered(known(), reading(60, 102.3), CAR, POWER_KW)
    assert soc.metered(once, reading(60, 102.3), CAR, POWER_KW) == once


@pytest.mark.parametrize(
    ("shows_kwh", "gain_kwh"),
    [(0.4, 0.4), (50.0, 0.0), (1e6, 0.0), (None, 0.0)],
    ids=["reset", "backwards", "absurd", "silent"],
)
def test_a_meter_that_resets_jumps_or_is_silent_never_invents_energy(shows_kwh: float | None, gain_kwh: float) -> None:
    estimate = soc.metered(known(), reading(60, shows_kwh), CAR, POWER_KW)
    assert estimate.mean == pytest.approx(0.5 + gain_kwh * 0.9 / 50)


def test_driving_lowers_the_mean_and_widens_the_doubt() -> None:
    after = soc.driven(known(0.8), ((NOW, 1), (NOW + timedelta(days=1), 2)), CAR)
    assert after.mean == pytest.approx(0.8 - 3 * 5.8 / 50)
    assert after.sd == pytest.approx((soc.TOLD_SD**2 + 3 * (2.67 / 50) ** 2) ** 0.5)
    assert after.driven_to == NOW + timedelta(days=1)


def test_power_that_tapers_and_stops_means_full_and_one_that_is_cut_does_not() -> None:
    def after(*powers_kw: float) -> SocEstimate:
        estimate = soc.driven(known(0.5), ((NOW, 9),), CAR)
        for minute, kw in enumerate(powers_kw, start=1):
            estimate = soc.metered(estimate, reading(minute, 100.0, kw), CAR, POWER_KW)
        return estimate

    tapered, cut = after(2.3, 1.8, 1.0, 0.0), after(2.3, 2.3, 0.0)
    assert (tapered.source, tapered.mean) == ("full", CAR.soc_max)
    assert soc.cautious(tapered) > 0.75
    assert cut.source == "car"
    assert soc.cautious(cut) < 0.2


def test_a_relay_that_goes_off_is_no_sign_of_a_full_car() -> None:
    estimate = known()
    for minute, (kw, on) in enumerate([(2.3, True), (1.0, True), (0.0, False), (0.0, True)], start=1):
        estimate = soc.metered(estimate, reading(minute, 100.0, kw, on), CAR, POWER_KW)
    assert estimate.source == "car"


@given(
    st.lists(
        st.tuples(st.floats(0, 120), st.floats(-1, 1e7) | st.none(), st.floats(0, 10) | st.none(), st.booleans()),
        max_size=30,
    )
)
def test_whatever_the_meter_says_the_estimate_stays_a_state_of_charge(
    said: list[tuple[float, float | None, float | None, bool]],
) -> None:
    estimate, minute = known(), 0.0
    for step, kwh, kw, on in said:
        minute += step
        before = estimate
        estimate = soc.metered(estimate, reading(minute, kwh, kw, on), CAR, POWER_KW)
        assert 0.0 <= soc.cautious(estimate) <= estimate.mean <= 1.0
        if estimate.source == before.source:
            most_kwh = 1.5 * POWER_KW * step / 60 + 0.1 + 1e-9
            assert 0.0 <= (estimate.mean - before.mean) * 50 / 0.9 <= max(most_kwh, soc.RESET_KWH)


def test_a_told_soc_ends_the_doubt() -> None:
    estimate = soc.told(soc.driven(known(), ((NOW, 30),), CAR), 0.62, NOW, "hub")
    assert replace(estimate, meter_kwh=None, metered_at=None) == SocEstimate(0.62, soc.TOLD_SD, "hub", NOW, NOW)


# -- what the car itself says ---------------------------------------------------------------------


def words(estimate: SocEstimate, *said: tuple[float, float]) -> SocEstimate:
    """After words of the car: (seconds from NOW, SOC)."""
    for seconds, value in said:
        estimate = soc.heard(estimate, value, NOW + timedelta(seconds=seconds))
    return estimate


@pytest.mark.parametrize("glitch", [0.0, 0.01, 0.3, 0.7, 1.0])
def test_a_word_that_jumps_is_not_believed_at_once(glitch: float) -> None:
    before = words(soc.unknown(NOW), (0, 0.5))
    after = words(before, (30, glitch))
    assert after == replace(before, doubted=glitch, doubted_at=NOW + timedelta(seconds=30))
    assert soc.cautious(after) == soc.cautious(before)
    assert words(after, (60, 0.51)) == words(before, (60, 0.51)), "a glitch leaves no trace"


@pytest.mark.parametrize("jump", [0.0, 0.2, 0.9])
def test_a_jump_that_is_said_again_after_a_minute_is_believed(jump: float) -> None:
    before = words(soc.unknown(NOW), (0, 0.5))
    assert words(before, (10, jump), (60, jump)).mean == 0.5
    after = words(before, (10, jump), (60, jump), (71, jump + 0.01))
    assert after.mean == pytest.approx(jump + 0.01)
    assert after.doubted is None


def test_two_glitches_that_differ_do_not_confirm_each_other() -> None:
    before = words(soc.unknown(NOW), (0, 0.5))
    after = words(before, (10, 0.0), (80, 0.95))
    assert (after.mean, after.doubted) == (0.5, 0.95)


@pytest.mark.parametrize(("minutes", "believed"), [(1, False), (5, False), (10, True), (600, True)])
def test_how_far_a_word_may_be_off_grows_with_the_time_since_the_last(minutes: float, believed: bool) -> None:
    after = words(soc.unknown(NOW), (0, 0.9), (60 * minutes, 0.5))
    assert (after.mean == 0.5) is believed


@pytest.mark.parametrize("minutes", [1, 10, 600])
def test_no_time_explains_a_jump_upwards_and_one_wrong_word_costs_no_morning(minutes: float) -> None:
    said = words(soc.unknown(NOW), (0, 0.5), (60 * minutes, 0.95))
    assert said.mean == 0.5
    assert words(said, (60 * minutes + 61, 0.95)).mean == 0.95


def test_after_days_of_driving_a_word_may_be_as_far_above_as_is_not_known() -> None:
    driven = soc.driven(words(soc.unknown(NOW), (0, 0.8)), ((NOW, 4),), CAR)
    assert words(driven, (400_000, 0.6)).mean == 0.6
    assert words(driven, (400_000, 0.9)).mean == driven.mean


# -- a total that is not believed -----------------------------------------------------------------


def counted(*totals_kwh: float | None, kw: float | None = 2.0) -> SocEstimate:
    """After readings every five minutes."""
    estimate = known(0.5)
    for k, kwh in enumerate(totals_kwh, start=1):
        estimate = soc.metered(estimate, reading(5 * k, kwh, kw), CAR, POWER_KW)
    return estimate


@pytest.mark.parametrize("total_kwh", [100.0, 9e6, None], ids=["frozen", "absurd", "missing"])
def test_a_total_that_does_not_count_is_replaced_by_power_and_time(total_kwh: float | None) -> None:
    estimate = counted(*[total_kwh] * 36)
    assert estimate.lent_kwh > 5.0
    assert estimate.mean == pytest.approx(0.5 + 6.0 * 0.9 / 50, abs=0.01)
    assert estimate.mean < 0.5 + 6.0 * 0.9 / 50
    assert estimate.sd > known(0.5).sd + soc.LENT_SHARE * 5.0 * 0.9 / 50


def test_a_total_that_counts_again_is_believed_again_and_nothing_twice() -> None:
    still = counted(*[9e6] * 24)
    again = soc.metered(still, reading(125, 9e6 + 2.0 / 12), CAR, POWER_KW)
    assert (again.lent_kwh, again.unseen_kwh) == (0.0, 0.0)
    assert again.mean == pytest.approx(still.mean + 2.0 / 12 * 0.9 / 50)


@pytest.mark.parametrize("kw", [0.0, None, 1000.0, -1.0])
def test_without_a_power_that_can_be_nothing_is_lent(kw: float | None) -> None:
    assert counted(*[100.0] * 36, kw=kw).mean == 0.5


def test_the_first_word_of_all_is_believed() -> None:
    assert words(soc.unknown(NOW), (1, 0.05)).mean == 0.05


def test_a_clock_set_back_does_not_make_the_car_unheard_for_ever() -> None:
    before = words(soc.unknown(NOW), (7200, 0.5), (7210, 0.8))
    assert words(before, (0, 0.8), (61, 0.8)).mean == 0.8


def test_a_word_that_does_not_move_while_energy_flows_lowers_what_is_promised_and_not_the_mean() -> None:
    estimate = known(0.5)
    for minute in range(5, 125, 5):
        kwh, now = 100.0 + 2.3 * minute / 60, NOW + timedelta(minutes=minute)
        estimate = soc.metered(estimate, reading(minute, kwh), CAR, POWER_KW)
        if soc.is_news(estimate, 0.5, now):
            estimate = soc.heard(estimate, 0.5, now)
    assert estimate.mean == pytest.approx(0.5 + 4.6 * 0.9 / 50)
    assert soc.cautious(estimate) == pytest.approx(0.5, abs=0.021)
    assert estimate.told_at is not None
    assert NOW + timedelta(minutes=50) < estimate.told_at < NOW + timedelta(minutes=65), "then it was an old word"
    moved = soc.heard(estimate, 0.58, NOW + timedelta(minutes=125))
    assert (moved.mean, moved.sd) == (0.58, soc.TOLD_SD)


def test_a_car_is_missed_after_a_drive_or_where_it_repeats_itself_and_nobody_who_never_tells() -> None:
    def stale(estimate: SocEstimate, minutes: float) -> bool:
        return soc.is_stale(estimate, NOW + timedelta(minutes=minutes), CAR)

    told = known(0.5)
    assert not stale(told, 3000.0), "it has not driven: it is as full as it said"
    charged = soc.metered(told, reading(180, 106.9), CAR, POWER_KW)
    assert not stale(charged, 180.0), "a car that tells when it comes home need not tell again"
    repeated = soc.heard(charged, 0.5, NOW + timedelta(minutes=180))
    assert stale(repeated, 180.0)
    assert not stale(soc.heard(repeated, 0.6, NOW + timedelta(minutes=200)), 200.0)
    driven = soc.driven(told, ((NOW + timedelta(minutes=600), 1),), CAR)
    assert [stale(driven, minutes) for minutes in (620.0, 640.0)] == [False, True]
    for other in (soc.unknown(NOW), soc.told(told, 0.5, NOW, "hub")):
        assert not stale(soc.driven(other, ((NOW + timedelta(minutes=600), 1),), CAR), 3000.0)


@pytest.mark.parametrize(("said", "odd"), [(0.0, False), (0.0062, True), (0.01, True), (0.011, False), (0.62, False)])
def test_a_fraction_that_was_taken_for_a_percentage_is_seen(said: float, odd: bool) -> None:
    assert soc.is_no_percentage(soc.told(known(), said, NOW, "car")) is odd
    assert not soc.is_no_percentage(soc.told(known(), said, NOW, "hub"))


def test_a_car_that_counts_in_whole_points_does_not_take_back_what_has_flowed() -> None:
    carried = soc.metered(known(0.5), reading(30, 101.15), CAR, POWER_KW)
    later = NOW + timedelta(minutes=30)
    assert soc.heard(carried, 0.5, later) == replace(carried, told_at=later)
    assert soc.heard(carried, 0.52, later).mean == 0.52


def test_the_same_word_after_a_day_that_was_not_driven_is_believed() -> None:
    driven = soc.driven(known(0.5), ((NOW, 1),), CAR)
    later = NOW + timedelta(minutes=30)
    assert soc.is_news(driven, 0.5, later)
    assert soc.heard(driven, 0.5, later).mean == 0.5


def test_a_car_that_speaks_every_second_does_not_make_a_decision_of_every_word() -> None:
    estimate, decisions = words(soc.unknown(NOW), (0, 0.5)), 0
    for second in range(1, 3600):
        word, now = 0.5 + 0.1 * second / 3600, NOW + timedelta(seconds=second)
        if soc.is_news(estimate, word, now):
            estimate, decisions = soc.heard(estimate, word, now), decisions + 1
    assert decisions == 11, "one in five minutes"
    assert estimate.mean == pytest.approx(0.6, abs=soc.SAME)


def test_a_doubted_word_that_is_repeated_every_second_is_news_twice() -> None:
    estimate = words(soc.unknown(NOW), (0, 0.5))
    news: list[int] = []
    for second in range(1, 100):
        now = NOW + timedelta(seconds=second)
        if soc.is_news(estimate, 0.9, now):
            estimate, news = soc.heard(estimate, 0.9, now), [*news, second]
    assert news == [1, 61]
    assert estimate.mean == 0.9


@pytest.mark.parametrize(("minutes", "source"), [(29, "car"), (30, "car"), (31, "meter")])
def test_an_old_word_is_no_longer_called_the_cars(minutes: float, source: str) -> None:
    told = words(soc.unknown(NOW), (0, 0.5))
    aged = soc.aged(told, NOW + timedelta(minutes=minutes), CAR)
    assert aged == replace(told, source=source)


def test_a_persons_word_does_not_age_into_the_meters() -> None:
    told = soc.told(soc.unknown(NOW), 0.5, NOW, "hub")
    assert soc.aged(told, NOW + timedelta(days=3), CAR) == told


@given(
    said=st.lists(st.tuples(st.integers(0, 7200), st.floats(0, 1)), max_size=20),
    first=st.floats(0, 1),
)
def test_whatever_the_car_says_the_estimate_stays_a_fraction_and_somebody_said_it(
    said: list[tuple[int, float]], first: float
) -> None:
    estimate = words(soc.unknown(NOW), (0, first), *[(float(at), value) for at, value in sorted(said)])
    assert estimate.mean in [first, *[value for _, value in said]]
    assert estimate.doubted is None or estimate.doubted != estimate.mean
