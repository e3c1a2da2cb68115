"""The charger on CAN against its stub in one process: what it is told, what is made of what it tells, and when."""

import errno
import struct
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

import can
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from plugd.adapters.can_elcon import CanElcon
from plugd.adapters.can_link import MOST_FRAMES
from plugd.adapters.can_soc import soc_signal
from plugd.adapters.elcon_words import COMMAND_ID, STATUS_ID
from plugd.domain import Reading, Relay, Setpoint
from plugd.errors import PlugFault, PlugRefused, PlugTimeout
from plugd.ports import Tended
from plugd.study.world import Battery
from plugd_hil.car import CarAtHome
from plugd_hil.elcon import Rating
from tests import fuzz_can
from tests.can_world import CHARGER, LIMITS, CanWorld

NOON = datetime(2023, 1, 2, 12, tzinfo=UTC)
RATING = Rating(3.3, empty_v=320.0, full_v=400.0)


@pytest.fixture
def world() -> Iterator[CanWorld]:
    """A car half full, plugged in."""
    made = CanWorld(NOON, CarAtHome(Battery(), True, None, NOON), RATING)
    yield made
    made.bus.shutdown()


def told(world: CanWorld, power_kw: float, length_s: float = 7200.0) -> Setpoint:
    return Setpoint(power_kw, world.at + timedelta(seconds=length_s))


def fields(frame: can.Message) -> tuple[float, float, int]:
    """Volts, amperes, control of a command."""
    volts, amps, control = struct.unpack(">HHB3x", bytes(frame.data))
    return volts / 10.0, amps / 10.0, control


def codes(plug: CanElcon) -> set[str]:
    return {fault.code for fault in plug.warnings}


# -- what it is told ------------------------------------------------------------------------------


def test_it_is_told_every_second_and_never_by_anybody_but_the_loop(world: CanWorld) -> None:
    plug = world.plug()
    plug.set(told(world, 2.3))
    before = len(world.commands)
    world.live(plug, 60.0)
    assert len(world.commands) - before == 60
    world.wait(world.at + timedelta(seconds=60.0))  # the loop hangs
    assert len(world.commands) - before <= 61
    assert not world.charger.on, "its own time-out has caught the hung loop"
    world.live(plug, 3.0)
    assert world.charger.on


def test_a_power_at_the_plug_is_a_current_at_the_battery(world: CanWorld) -> None:
    plug = world.plug()
    plug.read()
    plug.set(told(world, 2.3))
    assert fields(world.commands[-1]) == (405.0, 5.7, 0)  # 2.07 kW at 360 V, rounded down
    assert plug.read().power_kw == pytest.approx(2.3, rel=0.02)


def test_before_it_tells_its_voltage_the_highest_there_can_be_is_counted_with(world: CanWorld) -> None:
    world.charger.muted = True
    with pytest.raises(PlugTimeout):
        world.plug().set(told(world, 2.3))
    assert fields(world.commands[-1]) == (405.0, 5.1, 0)


@pytest.mark.parametrize("power_kw", [0.5, 3.4])
def test_a_power_that_it_does_not_give_is_refused(world: CanWorld, power_kw: float) -> None:
    with pytest.raises(PlugRefused, match=r"1\.38 to 3\.3 kW"):
        world.plug().set(told(world, power_kw))
    assert not world.commands


def test_who_only_looks_says_nothing(world: CanWorld) -> None:
    plug = world.plug()
    world.live(plug, 5.0)
    assert not plug.read().on
    assert plug.due() is None
    plug.close()
    assert not world.commands


def test_current_is_lowered_before_it_is_stopped(world: CanWorld) -> None:
    plug = world.plug()
    plug.set(told(world, 3.3))
    world.live(plug, 0.5)
    before = len(world.commands) + len(world.bus.sent)
    plug.set(told(world, 0.0))
    lowered, *_, last = (fields(frame) for frame in (*world.commands, *world.bus.sent)[before:])
    assert lowered == (405.0, 0.0, 0)
    assert last == (405.0, 0.0, 1)
    assert world.charger.asked.opened_under_load == 0


def test_at_rest_it_is_told_to_stop_every_second_in_whole_frames(world: CanWorld) -> None:
    plug = world.plug()
    plug.set(told(world, 0.0))
    world.live(plug, 20.0)
    assert {fields(frame) for frame in world.commands} == {(405.0, 0.0, 1)}
    assert world.charger.asked.invalid == 0


def test_a_setpoint_ends_when_its_time_is_over(world: CanWorld) -> None:
    plug = world.plug()
    plug.set(told(world, 2.3, length_s=60.0))
    world.live(plug, 50.0)
    assert plug.read().on
    world.live(plug, 20.0)
    assert not world.charger.on
    assert not plug.read().on


def test_a_setpoint_renewed_is_no_new_command(world: CanWorld) -> None:
    plug = world.plug()
    plug.set(told(world, 2.3, length_s=60.0))
    at = world.at
    plug.set(told(world, 2.3, length_s=600.0))
    assert world.at == at, "nothing is waited for"
    world.live(plug, 120.0)
    assert world.charger.on


def test_the_end_of_plugd_stops_it(world: CanWorld) -> None:
    plug = world.plug()
    plug.set(told(world, 3.3))
    plug.close()
    world.wait(world.at + timedelta(seconds=2.0))
    assert fields(world.commands[-1]) == (405.0, 0.0, 1)
    assert world.charger.asked.opened_under_load == 0
    assert not world.charger.on
    assert isinstance(plug, Tended)


# -- what it tells --------------------------------------------------------------------------------


def test_energy_is_counted_without_a_meter(world: CanWorld) -> None:
    plug = world.plug()
    plug.set(told(world, 3.3))
    before_kwh, truth_kwh = plug.read().energy_kwh, world.charger.total_kwh
    world.live(plug, 3600.0)
    after_kwh = plug.read().energy_kwh
    assert before_kwh is not None
    assert after_kwh is not None
    assert after_kwh - before_kwh == pytest.approx(world.charger.total_kwh - truth_kwh, rel=0.02)
    assert after_kwh - before_kwh == pytest.approx(3.3, rel=0.03)


def test_for_a_gap_no_energy_is_made_up(world: CanWorld) -> None:
    plug = world.plug()
    plug.set(told(world, 3.3))
    world.charger.muted = True
    world.live(plug, 1800.0)
    with pytest.raises(PlugTimeout, match=r"silent since 2023-01-02T12:00:0"):
        plug.read()
    world.charger.muted = False
    world.live(plug, 2.0)
    reading = plug.read()
    assert reading.came_back
    assert (reading.energy_kwh or 0.0) < 0.01
    assert not plug.read().came_back


@pytest.mark.parametrize(
    ("order", "code", "error"),
    [
        ("fault hardware", "charger_hardware", PlugFault),
        ("fault hot", "charger_hot", PlugFault),
        ("fault mains", "charger_mains", PlugFault),
        ("deaf", None, PlugRefused),
    ],
)
def test_what_stops_it_is_told(world: CanWorld, order: str, code: str | None, error: type[Exception]) -> None:
    plug = world.plug()
    world.charger.told(order)
    with pytest.raises(error):
        plug.set(told(world, 2.3))
    assert not plug.read().on
    assert codes(plug) == ({code} if code else set())


def test_it_goes_on_by_itself_when_a_fault_has_gone(world: CanWorld) -> None:
    plug = world.plug()
    plug.set(told(world, 2.3))
    world.charger.told("fault hot")
    world.live(plug, 10.0)
    assert not plug.read().on
    world.charger.told("fault")
    world.live(plug, 3.0)
    assert plug.read().on
    assert not plug.warnings


def test_without_a_battery_it_is_a_fault_only_while_it_should_charge(world: CanWorld) -> None:
    world.car.leave()
    plug = world.plug()
    plug.set(told(world, 0.0))
    assert not plug.warnings
    plug.set(told(world, 2.3))
    assert codes(plug) == {"charger_battery"}
    assert plug.read().power_kw == 0.0


def test_a_full_battery_that_takes_nothing_has_not_refused(world: CanWorld) -> None:
    world.car.battery.energy_kwh = 50.0
    plug = world.plug()
    plug.set(told(world, 2.3))
    reading = plug.read()
    assert (reading.on, reading.power_kw) == (True, 0.0)


def test_one_that_does_not_stop_is_a_refusal(world: CanWorld) -> None:
    plug = world.plug()
    world.charger.told("lie 360 8")
    with pytest.raises(PlugRefused, match="still gives 8 A"):
        plug.set(told(world, 0.0))
    assert plug.read().on


@pytest.mark.parametrize(("lie", "cut"), [("lie 360 14", True), ("lie 425 5", True), ("lie 6553.5 0", True)])
def test_more_than_the_battery_bears_is_cut_until_somebody_has_looked(world: CanWorld, lie: str, cut: bool) -> None:
    plug = world.plug()
    plug.set(told(world, 3.3))
    world.charger.told(lie)
    world.live(plug, 3.0)
    assert "charger_over" not in codes(plug), "one word is no proof"
    world.live(plug, 10.0)
    world.charger.told("truth")
    world.live(plug, 10.0)
    assert ("charger_over" in codes(plug)) is cut
    assert not world.charger.on
    with pytest.raises(PlugFault, match="limits"):
        plug.set(told(world, 2.3))


def test_a_short_untruth_is_counted_and_forgotten(world: CanWorld) -> None:
    plug = world.plug()
    plug.set(told(world, 2.3))
    world.charger.told("lie 6553.5 6553.5")
    world.live(plug, 2.0)
    world.charger.told("truth")
    world.live(plug, 10.0)
    assert plug.nonsense == 2
    assert plug.read().power_kw == pytest.approx(2.3, rel=0.02)
    assert not plug.warnings


# -- how full the battery is ----------------------------------------------------------------------


def test_the_battery_tells_how_full_it_is_until_its_word_is_old() -> None:
    world = CanWorld(NOON, CarAtHome(Battery(), True, None, NOON), RATING, tells="arrival")
    plug = world.plug(soc=soc_signal("pylontech", None, None))
    assert plug.read().soc is None
    world.charger.load_changed()
    world.live(plug, 10.0)
    reading = plug.read()
    assert (reading.soc, reading.soc_at) == (0.5, NOON + timedelta(seconds=6.0))
    world.live(plug, 1700.0)
    assert plug.read().soc_at == reading.soc_at
    world.live(plug, 120.0)
    assert (plug.read().soc, plug.read().soc_at) == (None, None)
    world.bus.shutdown()


# -- the bus --------------------------------------------------------------------------------------


def error_frame(kind: int) -> can.Message:
    return can.Message(arbitration_id=kind, is_error_frame=True, is_extended_id=False, data=bytes(8))


def test_bus_off_is_told_and_over_with_the_next_frame(world: CanWorld) -> None:
    plug = world.plug()
    plug.set(told(world, 2.3))
    world.charger.muted = True
    world.bus.arrived.append(error_frame(0x40))
    world.live(plug, 2.0)
    assert "bus off" in next(f.text for f in plug.warnings if f.code == "can_bus")
    world.charger.muted = False
    world.live(plug, 2.0)
    assert not plug.warnings


def test_where_nobody_acknowledges_it_is_tried_once_a_second(world: CanWorld) -> None:
    plug = world.plug()
    plug.set(told(world, 2.3))
    opened, before = world.opened, len(world.commands) + len(world.bus.sent)
    world.charger.muted = True
    world.bus.refuses = can.CanOperationError("Failed to transmit", errno.ENOBUFS)
    world.live(plug, 30.0)
    assert "nobody on the bus acknowledges" in next(f.text for f in plug.warnings if f.code == "can_bus")
    assert (world.opened, len(world.commands)) == (opened, before)
    world.bus.refuses, world.charger.muted = None, False
    world.live(plug, 3.0)
    assert world.charger.on
    assert not plug.warnings


def test_a_bus_that_fails_is_opened_again_later_and_later(world: CanWorld) -> None:
    plug = world.plug()
    plug.set(told(world, 2.3))
    world.charger.muted = True
    world.bus.refuses = OSError(errno.ENETDOWN, "Network is down")
    opened = world.opened
    world.live(plug, 300.0)
    assert 5 <= world.opened - opened <= 10
    assert "ip link set can0 up type can bitrate 250000" in next(f.text for f in plug.warnings)
    world.bus.refuses, world.charger.muted = None, False
    world.live(plug, 65.0)
    assert world.charger.on
    assert not plug.warnings


def test_a_babbling_bus_is_read_in_gulps(world: CanWorld) -> None:
    plug = world.plug()
    plug.set(told(world, 2.3))
    world.bus.arrived.extend(can.Message(arbitration_id=1, is_extended_id=False) for _ in range(3 * MOST_FRAMES))
    plug.tend(world.at)
    assert len(world.bus.arrived) == 2 * MOST_FRAMES
    assert codes(plug) == {"can_babble"}
    world.live(plug, 5.0)
    assert not plug.warnings


def test_bytes_that_are_no_frame_are_skipped(world: CanWorld) -> None:
    plug = world.plug()
    plug.set(told(world, 2.3))
    world.bus.arrived.extend((ValueError("int"), IndexError("short"), can.CanOperationError("could not unpack")))
    world.live(plug, 3.0)
    assert plug.line.garbled == 3
    assert plug.read().on
    assert world.opened == 1


def test_our_own_frames_come_back_without_harm_and_another_masters_are_told(world: CanWorld) -> None:
    plug = world.plug()
    world.happens = lambda _: world.bus.arrived.extend(world.commands[-1:])
    plug.set(told(world, 2.3))
    world.live(plug, 30.0)
    assert not plug.warnings
    world.bus.arrived.append(can.Message(arbitration_id=COMMAND_ID, is_extended_id=True, data=bytes(8)))
    world.live(plug, 1.0)
    assert codes(plug) == {"charger_two_masters"}
    world.live(plug, 61.0)
    assert not plug.warnings


# -- whatever arrives -----------------------------------------------------------------------------

FRAMES = st.builds(
    lambda identifier, extended, data, remote, error: can.Message(
        arbitration_id=identifier if extended else identifier & 0x7FF,
        is_extended_id=extended,
        data=None if remote else data,
        is_remote_frame=remote,
        is_error_frame=error and not remote,
    ),
    st.sampled_from((STATUS_ID, COMMAND_ID, 0x355, 0x6B0)) | st.integers(0, 0x1FFFFFFF),
    st.booleans(),
    st.binary(max_size=8) | st.binary(min_size=8, max_size=8),
    st.booleans(),
    st.booleans(),
)


@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(batches=st.lists(st.lists(FRAMES, max_size=12), min_size=1, max_size=8), power_kw=st.floats(1.38, 3.3))
def test_no_command_above_the_batterys_limits_whatever_arrives(
    batches: list[list[can.Message]], power_kw: float
) -> None:
    world = CanWorld(NOON, CarAtHome(Battery(), True, None, NOON), RATING)
    plug = world.plug(soc=soc_signal("pylontech", None, None))
    for batch in batches:
        world.bus.arrived.extend(batch)
        try:
            plug.set(told(world, power_kw))
            reading: Reading | None = plug.read()
        except (PlugFault, PlugRefused, PlugTimeout):
            reading = None
        assert reading is None or reading.soc is None or 0.0 <= reading.soc <= 1.0
        world.live(plug, 2.0)
    assert len(world.commands) >= 2 * len(batches)
    for frame in world.commands:
        volts, amps, control = fields(frame)
        assert volts <= LIMITS.voltage_v
        assert amps <= LIMITS.current_a
        assert control in (0, 1)
        assert control == 0 or amps == 0.0
    world.bus.shutdown()


def test_a_few_thousand_of_the_million_frames_at_random() -> None:
    outcome = fuzz_can.run(5_000, seed=1)
    assert outcome.over == []
    assert outcome.charging > 0
    assert outcome.dropped > 0


def test_a_relays_words_are_understood(world: CanWorld) -> None:
    plug = world.plug()
    plug.set(Relay(True))
    assert plug.read().power_kw == pytest.approx(CHARGER.power_max_kw, rel=0.02)
    plug.set(Relay(False))
    assert not plug.read().on
