"""One behaviour suite for everything that is a `plugd.ports.Plug`."""

from datetime import timedelta

import pytest

from plugd.domain import Relay, Setpoint
from plugd.errors import PlugRefused, PlugTimeout
from plugd.ports import Tended
from tests.contract.rigs import WITH_BUTTON, WITH_DEAD_MAN, WITHOUT_DEAD_MAN, Rig, eventually, order

FRESH = timedelta(seconds=60)


@pytest.mark.quick
def test_what_was_set_is_read(rig: Rig) -> None:
    for on in (True, False, True):
        rig.plug.set(order(rig, on))
        assert rig.plug.read().on is on


def test_setting_twice_is_setting_once(rig: Rig) -> None:
    for on in (True, True, False, False):
        rig.plug.set(order(rig, on))
        reading = rig.plug.read()
        assert reading.on is on
        assert reading.changed_by_other is None
    assert [warning.code for warning in rig.plug.warnings] == ([] if rig.metered else ["plug_meter"])


def test_a_reading_is_at_most_a_minute_old(rig: Rig) -> None:
    reading = rig.plug.read()
    assert timedelta(0) <= rig.clock.now() - reading.at <= FRESH
    if rig.metered:
        assert reading.metered_at is not None
        assert reading.metered_at.utcoffset() == timedelta(0)
    else:
        assert (reading.metered_at, reading.power_kw, reading.energy_kwh) == (None, None, None)


def test_off_is_off(rig: Rig) -> None:
    rig.plug.set(order(rig, True))
    rig.plug.set(order(rig, False))
    before = rig.plug.read()
    after = eventually(rig, lambda reading: False, 0.5)
    assert not after.on
    assert not after.power_kw
    assert after.energy_kwh == before.energy_kwh


def test_energy_grows_while_a_car_charges(rig: Rig) -> None:
    before = rig.plug.read().energy_kwh
    if not rig.metered:
        assert before is None, "what is not measured is not made up"
        return
    assert before is not None
    rig.plug.set(order(rig, True))
    reading = eventually(rig, lambda reading: (reading.energy_kwh or 0.0) > before + 0.002, 8.0)
    assert reading.energy_kwh is not None
    assert reading.energy_kwh > before + 0.002
    assert reading.power_kw == pytest.approx(rig.plug.capability.power_max_kw)


def test_silence_is_a_timeout(rig: Rig) -> None:
    rig.plug.read()
    rig.mute()
    with pytest.raises(PlugTimeout):
        rig.plug.set(order(rig, True))


def test_a_plug_that_does_otherwise_has_refused(rig: Rig) -> None:
    rig.plug.set(order(rig, False))
    rig.jam()
    with pytest.raises(PlugRefused):
        rig.plug.set(order(rig, True))
    assert not rig.plug.read().on


def test_the_capability_is_honest(rig: Rig) -> None:
    capability = rig.plug.capability
    assert capability.power_max_kw > 0.0
    if capability.modulating:
        some_kw = (capability.power_min_kw + capability.power_max_kw) / 2.0
        rig.plug.set(Setpoint(some_kw, rig.clock.now() + timedelta(hours=1)))
        reading = eventually(rig, lambda reading: reading.power_kw == pytest.approx(some_kw), 4.0)
        assert reading.power_kw == pytest.approx(some_kw)
        with pytest.raises(PlugRefused):
            rig.plug.set(Setpoint(capability.power_max_kw + 0.1, rig.clock.now() + timedelta(hours=1)))
    else:
        with pytest.raises(PlugRefused):
            rig.plug.set(Setpoint(capability.power_max_kw / 2.0, rig.clock.now() + timedelta(hours=1)))


@pytest.mark.about(WITH_DEAD_MAN)
def test_off_ends_by_itself_when_nobody_renews_it(rig: Rig) -> None:
    rig.plug.set(Relay(on=False))
    reading = eventually(rig, lambda reading: reading.on, 2.0 * rig.dead_man_s)
    assert reading.on
    assert reading.changed_by_other is None, "the timer is nobody's press"


@pytest.mark.about(WITH_DEAD_MAN)
def test_off_stays_while_it_is_renewed(rig: Rig) -> None:
    rig.plug.set(Relay(on=False))
    end = rig.clock.now() + timedelta(seconds=2.5 * rig.dead_man_s)
    while (now := rig.clock.now()) < end:
        rig.plug.tend(now)
        due = rig.plug.due()
        assert due is not None
        rig.clock.wait(min(due, end))
        assert not rig.plug.read().on


@pytest.mark.about(WITH_DEAD_MAN)
def test_a_persons_off_has_no_timer(rig: Rig) -> None:
    rig.plug.set(Relay(on=True))
    rig.plug.set(Relay(on=False, held=True))
    reading = eventually(rig, lambda reading: reading.on, 1.6 * rig.dead_man_s)
    assert not reading.on


@pytest.mark.about(WITH_DEAD_MAN)
def test_the_timer_is_back_after_a_persons_off(rig: Rig) -> None:
    rig.plug.set(Relay(on=False, held=True))
    rig.plug.set(Relay(on=False))
    assert eventually(rig, lambda reading: reading.on, 2.0 * rig.dead_man_s).on


@pytest.mark.about(WITH_BUTTON)
@pytest.mark.parametrize("on", [True, False])
def test_a_press_is_seen_once(rig: Rig, on: bool) -> None:
    rig.plug.set(order(rig, not on, held=on))
    rig.plug.read()
    rig.press()
    reading = eventually(rig, lambda reading: reading.on is on, 2.0)
    assert (reading.on, reading.changed_by_other) == (on, on)
    assert rig.plug.read().changed_by_other is None


@pytest.mark.about(WITH_BUTTON)
def test_a_power_cut_is_no_press(rig: Rig) -> None:
    rig.plug.set(order(rig, True))
    rig.plug.read()
    rig.cut()
    reading = eventually(rig, lambda reading: reading.came_back, 6.0)
    assert reading.came_back
    assert reading.changed_by_other is None
    assert not rig.plug.read().came_back


def test_what_has_no_dead_man_and_need_not_be_tended_is_not_renewed(rig: Rig) -> None:
    rig.plug.set(order(rig, False))
    assert (rig.plug.due() is not None) is (rig.plug.capability.dead_man or isinstance(rig.plug, Tended))


@pytest.mark.about(WITHOUT_DEAD_MAN)
def test_without_a_dead_man_off_stays_off_with_nobody_there(rig: Rig) -> None:
    rig.plug.set(order(rig, False))
    reading = eventually(rig, lambda reading: reading.on, 1.5)
    assert not reading.on
