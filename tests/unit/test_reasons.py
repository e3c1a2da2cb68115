"""The status and the sentence that go with a decision."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from plugd import beat, soc
from plugd.adapters.hub import state
from plugd.domain import (
    Fault,
    Household,
    Memory,
    Mode,
    Outlook,
    OutlookSlot,
    Overrides,
    Plan,
    Presence,
    Press,
    SessionPlan,
    SetSoc,
    SlotSource,
    Status,
    Switching,
)
from plugd.reasons import explain
from tests.unit.deciding import (
    CHARGER,
    EVENING,
    HOME,
    NIGHT,
    READY_BY,
    Room,
    at,
    knows,
    minutes,
    plan,
    planned,
    session,
    switching,
)

TONIGHT, TUESDAY = session(), session(at(20, 3, day=3), at(6, 57, day=4))
IDLE = planned(TONIGHT)


def from_three(start: datetime) -> float:
    return 2.3 if start.hour == 3 else 0.0


CHARGES = planned(TONIGHT, from_three)
ORDERS = switching((at(3, day=3), True), (at(4, day=3), False))
SLOT = OutlookSlot(NIGHT, 100.0, 10.0, SlotSource.NESO)
KNOWN, UNKNOWN = Outlook((SLOT,), NIGHT + timedelta(days=2)), Outlook((SLOT,), None)


def remembering(soc: float = 0.6, made: Plan | None = None, orders: Switching | None = ORDERS) -> Memory:
    return replace(knows(soc), plan=made or plan(CHARGES), orders=orders)


def meaning(mode: Mode = Mode.SMART, press: Press | None = None, here: bool | None = None, soc: float = 0.6) -> Memory:
    presence = Presence(here, None if here is None else EVENING)
    return replace(remembering(soc), overrides=Overrides(mode=mode), press=press, presence=presence)


def say(
    memory: Memory, now: datetime = NIGHT, outlook: Outlook = KNOWN, household: Household = HOME,
    faults: tuple[Fault, ...] = (),
) -> tuple[Status, str]:  # fmt: skip
    return explain(now, beat.decide(now, memory, household), memory, outlook, household, faults)


HOLDING = remembering(made=plan(IDLE, planned(TUESDAY, lambda start: 2.3)), orders=switching())
READY = remembering(0.7, plan(IDLE, planned(TUESDAY)), switching())
SHORT = plan(planned(TONIGHT, lambda start: 2.3, soc_end=0.46, short_kwh=2.0))
LOST = Fault("plug_silent", "plug ev-plug silent since 22:00")


@pytest.mark.parametrize(
    ("memory", "now", "status", "sentence"),
    [
        (meaning(Mode.OFF), NIGHT, Status.OFF,
            "Off because you switched it off: set the mode to smart to charge again."),
        (
            meaning(press=Press(False, None)), NIGHT, Status.OFF,
            "Off because you switched it off at the plug, until the next plug-in.",
        ),
        (meaning(soc=0.4), at(4, 30, day=3), Status.CHARGING,
            "Charging now: this is the last safe start for 50 % by 06:57."),
        (meaning(soc=0.45), at(7, day=3), Status.CHARGING,
            "Late: it is past 06:57 and the car has not reached 50 % yet; charging until it has."),
        (meaning(soc=0.18), at(20, 4), Status.CHARGING, "Charging now: the battery may be below the reserve of 20 %."),
        (meaning(Mode.NOW), NIGHT, Status.BOOSTING,
            "Charging now because you asked, up to 80 % or until you say otherwise."),
        (meaning(press=Press(True, at(11, 3, day=3))), NIGHT, Status.BOOSTING,
            "Charging now because you switched it on at the plug, up to 80 %, until 11:03 or until you say otherwise."),
        (meaning(press=Press(True, None)), NIGHT, Status.BOOSTING,
            "Charging now because you switched it on at the plug, up to 80 % or until you say otherwise."),
        (meaning(here=False), NIGHT, Status.DISCONNECTED, "The car is not plugged in."),
        (remembering(), at(3, 10, day=3), Status.CHARGING,
            "Charging until 04:00 at 100 g/kWh, among the cleanest hours of tonight."),
        (remembering(), NIGHT, Status.WAITING,
            "Waiting until 03:00: 100 g/kWh then, among the cleanest hours of tonight."),
        (remembering(made=plan(CHARGES, planned(TUESDAY))), NIGHT, Status.WAITING,
            "Waiting until 03:00: 100 g/kWh then, among the cleanest hours of the next 2 nights."),
        (HOLDING, NIGHT, Status.HOLDING,
            "Holding for Tuesday night: 100 g/kWh then, and 60 % is enough for 50 % in the morning."),
        (READY, NIGHT, Status.READY, "Ready: at 70 % nothing needs charging for the next 2 nights."),
        (replace(knows(0.6), plan=None), NIGHT, Status.READY, "Nothing to do: no night at home is expected."),
    ],
    ids=lambda value: value.value if isinstance(value, Status) else "",
)  # fmt: skip
def test_a_sentence_for_every_status(memory: Memory, now: datetime, status: Status, sentence: str) -> None:
    assert say(memory, now) == (status, sentence)


def test_without_a_forecast_it_says_so() -> None:
    usual = " There is no forecast at the moment: this plan uses the usual day."
    status, sentence = say(HOLDING, outlook=UNKNOWN)
    assert status is Status.WAITING_FOR_FORECAST
    assert sentence.endswith(usual)
    status, sentence = say(remembering(), outlook=UNKNOWN)
    assert status is Status.WAITING
    assert sentence.endswith(usual)
    assert usual not in say(meaning(Mode.NOW), outlook=UNKNOWN)[1]


def test_a_plug_out_of_control_is_said_first() -> None:
    status, sentence = say(remembering(), faults=(Fault("store", "full"), LOST))
    assert status is Status.FAULT
    assert sentence.startswith("The plug is not under control: plug ev-plug silent since 22:00. Wanted: Waiting until")


@pytest.mark.parametrize("code", ["forecast", "store", "plug_retained_command"])
def test_other_faults_leave_the_status(code: str) -> None:
    assert say(remembering(), faults=(Fault(code, "x"),)) == say(remembering())


def test_every_status_can_be_reached() -> None:
    cases = [
        say(meaning(Mode.OFF)),
        say(meaning(Mode.NOW)),
        say(meaning(here=False)),
        say(remembering(), at(3, 10, day=3)),
        say(remembering()),
        say(HOLDING),
        say(HOLDING, outlook=UNKNOWN),
        say(READY),
        say(remembering(), faults=(LOST,)),
    ]
    assert {status for status, _ in cases} == set(Status)


# -- what is missing in the morning ---------------------------------------------------------------

MISSING = " Only 46 % can be counted on by 06:57, 4 % short of 50 %."


@pytest.mark.parametrize(
    ("memory", "now"),
    [
        (replace(meaning(soc=0.3), plan=SHORT), at(3, day=3)),
        (replace(meaning(Mode.NOW, soc=0.3), plan=SHORT), NIGHT),
        (remembering(0.6, SHORT), NIGHT),
        (remembering(0.6, SHORT), at(3, 10, day=3)),
    ],
    ids=["the guard", "a person", "waiting", "charging"],
)
def test_a_shortfall_is_said_whoever_charges(memory: Memory, now: datetime) -> None:
    assert say(memory, now)[1].endswith(MISSING)


@pytest.mark.parametrize(
    "memory",
    [
        replace(meaning(Mode.OFF), plan=SHORT),
        replace(meaning(here=False), plan=SHORT),
        remembering(0.6, plan(planned(TONIGHT, from_three, 0.497, 0.15))),
    ],
    ids=["off", "away", "less than half a point"],
)
def test_no_shortfall_where_it_would_say_nothing(memory: Memory) -> None:
    assert "short" not in say(memory)[1]


# -- times ----------------------------------------------------------------------------------------


def test_late_speaks_of_this_morning_not_of_the_plan_for_the_next() -> None:
    """The plan has rolled on; the session that is missed has another end and another minimum."""
    coming = replace(TUESDAY, end=at(8, 30, day=4), minimum=0.7)
    memory = replace(meaning(soc=0.45), plan=plan(planned(coming), made_at=at(7, day=3)))
    sentence = say(memory, at(7, 10, day=3))[1]
    assert "past 06:57" in sentence
    assert "50 %" in sentence


def test_a_session_that_is_over_is_not_tonight() -> None:
    memory = replace(remembering(made=plan(CHARGES, planned(TUESDAY, lambda start: 2.3))), orders=switching())
    status, sentence = say(memory, READY_BY + minutes(1))
    assert status is Status.READY
    assert sentence.endswith("for tonight.")


@pytest.mark.parametrize(
    ("moment", "says"),
    [
        (datetime(2023, 3, 26, 0, 30, tzinfo=UTC), "until 00:30:"),
        (datetime(2023, 3, 26, 1, 30, tzinfo=UTC), "until 02:30:"),
        (datetime(2023, 10, 29, 0, 30, tzinfo=UTC), "until 01:30:"),
        (datetime(2023, 10, 29, 1, 30, tzinfo=UTC), "until 01:30:"),
        (datetime(2023, 7, 1, 1, 0, tzinfo=UTC), "until 02:00:"),
    ],
)
def test_times_are_the_households_own_on_days_when_clocks_change(moment: datetime, says: str) -> None:
    now = moment - timedelta(hours=2)
    night = session(moment - timedelta(hours=4), moment + timedelta(hours=5))
    made = plan(planned(night, lambda start: 2.3 if start == moment else 0.0), made_at=now)
    memory = replace(knows(0.6, now), plan=made, orders=switching((moment, True), until=night.end))
    assert says in say(memory, now)[1]


def test_elsewhere_is_another_clock_and_weekday() -> None:
    away = replace(HOME, timezone="Pacific/Auckland")
    made = plan(IDLE, planned(replace(TUESDAY, start=at(14, day=3)), lambda start: 2.3))
    assert "Holding for Wednesday night" in say(remembering(made=made, orders=switching()), household=away)[1]


def test_a_chargers_start_comes_from_the_plan() -> None:
    memory = replace(remembering(), orders=None)
    assert say(memory, household=CHARGER) == say(remembering())


def test_a_soc_that_nobody_ever_told_is_said_where_it_makes_the_car_charge() -> None:
    never = replace(meaning(soc=0.18), soc=soc.unknown(NIGHT))
    assert say(never)[1].endswith("Nobody has said yet how full the battery is, so little is counted on.")
    assert "Nobody" not in say(meaning(soc=0.18))[1]
    assert "Nobody" not in say(replace(never, soc=soc.told(never.soc, 0.15, NIGHT, "hub")))[1]


@pytest.mark.parametrize("now", [NIGHT, at(3, 10, day=3)], ids=["waiting", "charging"])
def test_a_soc_that_nobody_ever_told_is_said_where_the_plan_falls_short_for_it(now: datetime) -> None:
    never = replace(remembering(0.6, SHORT), soc=replace(soc.unknown(NIGHT), mean=0.6, sd=0.01))
    assert f"{MISSING} Nobody has said yet how full the battery is" in say(never, now)[1]
    assert "Nobody" not in say(replace(never, plan=plan(CHARGES)))[1]


def test_what_is_enough_is_the_figure_that_people_are_shown() -> None:
    doubtful = replace(HOLDING, soc=replace(HOLDING.soc, mean=0.62, sd=0.03))
    assert " and 62 % is enough for 50 % in the morning." in say(doubtful)[1]


def test_where_the_forecast_leaves_off_before_the_morning_it_says_from_when_on_it_is_the_usual_day() -> None:
    def until(moment: datetime) -> str:
        return say(remembering(), outlook=Outlook((SLOT,), moment))[1]

    assert until(at(2, day=3)).endswith(" The forecast ends at 02:00: the usual day counts from then on.")
    assert "forecast" not in until(TONIGHT.end)
    assert "forecast" not in say(meaning(Mode.NOW), outlook=Outlook((SLOT,), at(2, day=3)))[1]


@pytest.mark.parametrize(("seen_kw", "slow"), [(1.6, True), (2.1, False), (None, False)])
def test_a_car_that_takes_less_than_the_plug_could_give_is_said_while_it_charges(
    seen_kw: float | None, slow: bool
) -> None:
    memory = replace(remembering(), observed_kw=seen_kw)
    text = " It takes 1.6 kW, not 2.3, so more time is planned."
    assert (text in say(memory, at(3, 10, day=3))[1]) is slow
    assert text not in say(memory)[1], "nothing flows yet"
    assert text not in say(memory, at(3, 10, day=3), household=CHARGER)[1], "it was told how much"


@pytest.mark.parametrize("coming", [IDLE, CHARGES], ids=["nothing planned", "planned for later"])
def test_a_relay_that_only_serves_its_time_says_so(coming: SessionPlan) -> None:
    """And not that it charges among the cleanest hours: what is planned is for other hours."""
    serving = switching((NIGHT - minutes(5), True), (NIGHT + minutes(10), False))
    waiting = remembering(0.7, plan(coming, planned(TUESDAY)), serving)
    status, sentence = say(waiting)
    assert (status, sentence) == (
        Status.CHARGING,
        "On until 23:10: a relay stays on for a while once it is on.",
    )


def test_after_the_guard_the_relay_serves_its_time_and_its_end_is_the_next_stop() -> None:
    """Late on an unknown SOC; three minutes later the car is told to be full enough."""
    room = Room(at(8, 6, day=3), replace(knows(0.45, at(21)), presence=Presence(True, at(21))))
    room.step()
    late = room.hub.decision
    assert late is not None
    assert late.reason.startswith("Late")
    room.hub.said.append(SetSoc(0.65))
    room.step(at(8, 9, day=3))
    ended = room.hub.decision
    assert ended is not None
    stop = at(8, 6, day=3) + timedelta(seconds=HOME.relay.min_on_s)
    assert ended.reason == f"On until {stop:%H:%M}: a relay stays on for a while once it is on."
    assert ended.memory.plan
    assert ended.memory.plan.sessions[0].energy_kwh > 1.0, "there is something to be mistaken for what flows now"
    assert state(ended, None, HOME)["next_stop"] == f"{stop:%Y-%m-%dT%H:%M:%SZ}"
