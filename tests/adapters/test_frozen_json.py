"""What the daemon keeps, as JSON: it comes back as it was, from another plugd too, and nothing else is taken for it."""

import json
import math
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime, time
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter

from plugd.adapters.frozen_json import dump, read
from plugd.domain import DayRule, Memory, Mode, Overrides, Record, Setpoint, Status, Switch, Switching, Trip
from tests.adapters.test_store import FULL, T0

EVERYTHING = replace(
    FULL,
    overrides=Overrides(
        mode=Mode.OFF,
        ready_by=time(7, 30),
        trips=(Trip(date(2023, 3, 26), away=True),),
        week=((6, DayRule(minimum=0.8)),),
    ),
    orders=Switching((Switch(T0, True),), T0),
    switch_ons=(T0,),
)


@dataclass(frozen=True, slots=True)
class Sample:
    """One of each."""

    number: float
    count: int = 0
    flag: bool | None = None
    words: tuple[str, ...] = ()
    pair: tuple[int, Status] = (0, Status.OFF)
    orders: Switching | Setpoint | None = None


@pytest.mark.parametrize("memory", [FULL, EVERYTHING, replace(EVERYTHING, orders=Setpoint(2.3, T0))])
def test_what_is_written_is_read_and_what_pydantic_wrote_too(memory: Memory) -> None:
    assert read(Memory, dump(memory)) == memory
    older = TypeAdapter(Memory).dump_json(memory)
    assert read(Memory, older) == memory
    assert TypeAdapter(Memory).validate_json(dump(memory)) == memory  # and a plugd that goes back reads ours


def test_a_moment_stays_aware_and_a_log_line_whole() -> None:
    line = Record(T0, 0.4, 2.3, None, True, Status.CHARGING, 'it says "now" – ' + "\x00\n", 100.5)
    assert read(Record, dump(line)) == line
    assert read(Record, dump(line)).at.tzinfo is UTC


def test_a_key_of_a_newer_plugd_is_passed_over_and_one_that_is_missing_takes_its_default() -> None:
    assert read(Sample, b'{"number": 1, "of a newer one": [{}]}') == Sample(1.0)
    assert type(read(Sample, b'{"number": 1}').number) is float


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_a_number_without_a_word_is_refused(number: float) -> None:
    with pytest.raises(ValueError, match="JSON"):
        dump(Sample(number))


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        [],
        None,
        {"number": "1"},
        {"number": True},
        {"number": 10**400},
        {"number": 1, "count": 1.5},
        {"number": 1, "flag": 1},
        {"number": 1, "words": "several"},
        {"number": 1, "words": [1]},
        {"number": 1, "pair": [1]},
        {"number": 1, "pair": [1, "no status"]},
        {"number": 1, "pair": {"1": 1}},
        {"number": 1, "orders": {"power_kw": -1, "until": "2023-03-14T17:00:00Z"}},
        {"number": 1, "orders": {"switches": [], "until": "soon"}},
        {"number": 1, "orders": {"switches": [], "until": 7}},
    ],
)
def test_nothing_else_is_taken_for_it(wrong: Any) -> None:
    with pytest.raises(ValueError, match=r"."):
        read(Sample, json.dumps(wrong))


@pytest.mark.parametrize("torn", [b"", b"{", b"\xff", b"[" * 100_000])
def test_what_is_no_json_is_a_value_error(torn: bytes) -> None:
    with pytest.raises(ValueError, match=r"."):
        read(Memory, torn)


json_values: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.just(T0.isoformat()),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["at", "soc", "until"]), inner),
    max_leaves=8,
)


@given(name=st.sampled_from(sorted(Memory.__dataclass_fields__)), value=json_values)
def test_whatever_stands_in_a_field_is_a_memory_or_a_value_error(name: str, value: Any) -> None:
    document = json.loads(dump(EVERYTHING)) | {name: value}
    try:
        found = read(Memory, json.dumps(document))
    except ValueError:
        return
    assert isinstance(found, Memory)
    assert isinstance(found.soc.driven_to, datetime)
