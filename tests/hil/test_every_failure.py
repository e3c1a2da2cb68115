"""Every row of the table of failure modes is lived through with real programs, or says which test does so instead.

A row by its first words; `x.yaml` is a scenario of `make scenarios`, all else a test. What no broker, plug or server
can do to plugd (a clock, a disk, a solver) is tested where it happens.
"""

import ast
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCENARIOS = ROOT / "hil" / "scenarios"
ROWS: dict[str, tuple[str, ...]] = {
    "**Forecast** API down, DNS, timeout": ("natural_api_silent.yaml", "forecast_never.yaml"),
    "HTTP 500 with JSON error body": ("forecast_gone.yaml",),
    '200 with `{}` or `{"data":[]}` or short list': ("forecast_short.yaml", "forecast_hostile.yaml"),
    "null, string, NaN": ("forecast_ten_times.yaml", "forecast_hostile.yaml", "tests/fuzz_parsers.py"),
    "Time-shifted, past, wrong region": ("forecast_last_week.yaml",),
    "Huge or compressed bomb, redirect": ("forecast_hostile.yaml",),
    "TLS failure": (
        "tests/adapters/test_neso.py::test_a_certificate_nobody_vouches_for_is_told_with_a_look_at_the_clock",
    ),
    "**Clock** not synced at boot": (
        "tests/unit/test_wall.py::test_without_a_clock_it_holds_for_ten_minutes_and_then_charges_and_enters_nothing",
    ),
    "Clock steps": (
        "tests/unit/test_wall.py::test_a_step_costs_at_most_one_switch_and_the_homecomings_are_counted_right",
    ),
    "DST": ("dst_spring.yaml", "dst_autumn.yaml"),
    "**MQTT** broker down": (
        "broker_gone.yaml",
        "broker_gone_for_good.yaml",
        "broker_flaps.yaml",
        "natural_broker.yaml",
    ),
    "Auth refused / ACL denied": (
        "tests/adapters/test_mqtt.py::test_a_refused_password_is_told_in_words_and_never_shown",
        "tests/adapters/test_mqtt.py::test_what_the_access_list_forbids_is_told",
    ),
    "Retained command": ("retained_command.yaml", "retained_hub_command.yaml"),
    "Duplicate / out of order": ("plug_late.yaml",),
    "Oversize payload": ("tests/adapters/test_mqtt.py::test_long_messages_are_dropped_and_the_connection_stays",),
    "Hostile JSON": ("plug_babbles.yaml", "hub_nonsense.yaml"),
    "Another client publishes to the plug's own command topic": (
        "two_controllers.yaml",
        "tests/adapters/test_broker_files.py::test_what_a_user_may_say",
    ),
    "Flood of commands": ("tests/adapters/test_mqtt.py::test_a_mailbox_is_bounded",),
    "**Plug** unresponsive": ("plug_silent.yaml", "plug_silent_off.yaml", "plug_deaf.yaml"),
    "Stuck OFF": ("plug_stuck_off.yaml", "car_takes_nothing.yaml"),
    "Stuck ON / welded": ("plug_welded.yaml", "plug_welded_says_off.yaml"),
    "Says ON, is OFF": ("plug_lies_on.yaml",),
    "Nonsense power": (
        "meter_says_1e6_w.yaml",
        "meter_says_negative.yaml",
        "meter_frozen.yaml",
        "meter_total_absurd.yaml",
    ),
    "Meter total reset": ("meter_reset.yaml",),
    "Plug power-cut and returns": (
        "plug_power_cut.yaml",
        "plug_power_cuts.yaml",
        "natural_power_cut.yaml",
        "openevse_restart.yaml",
    ),
    "Button pressed by a person": ("button_off.yaml", "button_on.yaml", "natural_button.yaml"),
    "**Car** SOC missing": ("soc_never_told.yaml", "soc_nonsense.yaml"),
    "Unplugged mid-slot": ("car_unplugged.yaml",),
    "Plugged in late": ("car_late.yaml",),
    "Charges slower than configured": ("car_slow.yaml",),
    "**Solver** non-convergence": ("tests/unit/test_qp.py::test_no_status_but_solved_is_believed",),
    "Solver hangs / crashes": (
        "tests/adapters/test_planner_child.py::test_one_that_hangs_costs_its_time_once_and_the_plan_is_the_exact_one",
        "tests/adapters/test_planner_child.py::test_a_child_that_was_killed_is_started_again",
    ),
    "**Disk** full": (
        "tests/chaos_store.py",
        "tests/adapters/test_store.py::test_a_full_disk_is_told_and_what_was_there_stays",
    ),
    "SD read-only / I/O error": (
        "tests/chaos_store.py",
        "tests/adapters/test_store.py::test_a_store_that_may_not_be_written_is_told",
    ),
    "DB corrupt": (
        "store_damaged.yaml",
        "tests/adapters/test_store.py::test_a_damaged_store_is_set_aside_and_a_new_one_begun",
    ),
    "State JSON torn, empty": (
        "tests/adapters/test_kept_twice.py::test_every_cut_of_the_copy_is_noticed",
        "tests/fuzz_stored.py",
    ),
    "Power cut / lying card": ("tests/chaos_store.py",),
    "**Process** kill -9": ("plugd_killed.yaml", "plugd_dead.yaml", "plugd_dead_zigbee.yaml", "natural_kill.yaml"),
    "Hang / event-loop stall": (
        "tests/adapters/test_systemd.py::test_a_loop_that_is_ill_neither_becomes_ready_nor_feeds_the_watchdog",
    ),
    "Leak over months": ("tests/soak.py",),
    "Crash loop": ("plugd_crash_loop.yaml",),
    "Brown-out": ("tests/adapters/test_supply.py::test_a_dip_is_told_for_an_hour",),
    "**CAN** bus-off": ("can_silent.yaml", "can_no_battery.yaml"),
    "Short / unplugged / no ACK": ("can_silent.yaml", "can_deaf.yaml"),
    "Noise, wrong DLC": ("can_noise.yaml",),
    "Babbling node": ("can_babble.yaml",),
    "Setpoint rejected or echoed differently": ("can_over_limits.yaml", "can_two_masters.yaml"),
    "status bits": ("can_hardware_and_mains.yaml", "can_hot.yaml"),
    "CAN: plugd dies": ("can_plugd_killed.yaml", "natural_can.yaml"),
    "It never cooks a plug": ("plug_overcurrent.yaml", "plug_protects.yaml"),
    "**Two controllers**": ("two_controllers.yaml",),
    "Two daemons": (
        "tests/adapters/test_store.py::test_a_second_daemon_is_turned_away_and_a_reader_is_not",
        "tests/adapters/test_mqtt.py::test_being_pushed_out_by_a_twin_is_told",
    ),
    "**Secrets** on SD": ("tests/test_secrets.py::test_a_secret_is_nowhere_but_in_its_file",),
    "Page: CSRF, DNS rebinding": (
        "tests/web/test_page.py::test_another_origin_is_refused_and_counted",
        "tests/fuzz_page.py",
    ),
    "Page: slowloris, many clients": ("tests/web/test_page.py::test_half_open_connections_are_bounded",),
    "Supply chain": (
        "tests/unit/test_ingredients.py::test_every_package_is_pinned_with_its_hashes_and_bandit_is_there",
    ),
    "Update goes wrong": (
        "tests/adapters/test_store.py::test_a_store_of_the_first_version_gets_its_ledger",
        "tests/adapters/test_store.py::test_a_newer_plugds_store_is_refused_untouched_and_the_folder_let_go",
    ),
}


@cache
def _tests_of(path: str) -> frozenset[str]:
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    return frozenset(node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef))


@pytest.mark.parametrize("row", ROWS)
def test_a_row_is_lived_through(row: str) -> None:
    for place in ROWS[row]:
        path, _, name = place.partition("::")
        if path.endswith(".yaml"):
            assert (SCENARIOS / path).is_file(), place
        else:
            assert (ROOT / path).is_file(), place
            assert not name or name in _tests_of(path), place


def test_no_scenario_stands_for_nothing() -> None:
    told = {place for places in ROWS.values() for place in places if place.endswith(".yaml")}
    assert {path.name for path in SCENARIOS.glob("*.yaml")} == told
