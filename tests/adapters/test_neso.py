"""The NESO source: every oddity its API is known for, on bodies in its shape and over real connections."""

import json
import socket
import ssl
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from hypothesis import event, example, given, settings
from hypothesis import strategies as st

from plugd import __version__
from plugd.adapters.neso import Neso, outward
from plugd.adapters.neso_body import error_message, parse, quotable
from plugd.domain import Forecast, Intensity, PastRow
from plugd.errors import ConfigError, ForecastError, ForecastLate, ForecastMalformed, ForecastUnavailable
from plugd.ports import ForecastSource
from plugd.units import HALF_HOUR, slot_start
from plugd_hil.neso import Handler, StubNeso, serve
from plugd_hil.neso_source import SeriesSource
from plugd_hil.synthetic import synthetic_year

NOW = datetime(2026, 9, 6, 8, 13, 20, tzinfo=UTC)
UNDER_WAY = slot_start(NOW)

Row = dict[str, Any]


def row(k: int, forecast: Any = 100, actual: Any = None, index: str = "low") -> Row:
    """The API's national row of the k-th half hour from the one under way on."""
    start = UNDER_WAY + k * HALF_HOUR
    return {
        "from": f"{start:%Y-%m-%dT%H:%MZ}",
        "to": f"{start + HALF_HOUR:%Y-%m-%dT%H:%MZ}",
        "intensity": {"forecast": forecast, "actual": actual, "index": index},
    }


def rows(count: int = 96, first: int = 0) -> list[Row]:
    return [row(k, 100 + k) for k in range(first, first + count)]


def national(given_rows: list[Any]) -> bytes:
    return json.dumps({"data": given_rows}).encode()


def region(given_rows: list[Any], regionid: Any = 13, as_list: bool = False, **more: Any) -> bytes:
    """The API's regional answer: no actual, a generation mix beside the intensity."""
    inner = [
        {
            **r,
            "intensity": {key: r["intensity"][key] for key in ("forecast", "index")},
            "generationmix": [{"fuel": "wind", "perc": 100}],
        }
        for r in given_rows
    ]
    one = {"regionid": regionid, "dnoregion": "UKPN London", "shortname": "London", **more, "data": inner}
    return json.dumps({"data": [one] if as_list else one}).encode()


def told(body: bytes, where: str = "national") -> Forecast:
    return parse(body, NOW, where)


# -- the shapes -----------------------------------------------------------------------------------


def test_rows_are_keyed_by_their_own_time_and_begin_with_the_half_hour_under_way() -> None:
    forecast = told(national(rows(96)))
    assert forecast.issued_at == NOW
    assert forecast.region == "national"
    assert len(forecast.expected) == 96
    assert forecast.expected[0] == Intensity(UNDER_WAY, 100.0)
    assert forecast.expected[-1] == Intensity(UNDER_WAY + 95 * HALF_HOUR, 195.0)
    assert forecast.actual == ()
    assert forecast.dropped == ()


@pytest.mark.parametrize("as_list", [False, True])
def test_a_regions_answer_is_an_object_or_a_list_of_one(as_list: bool) -> None:
    forecast = told(region(rows(31), as_list=as_list), "13")
    assert forecast.region == "13"
    assert len(forecast.expected) == 31


@pytest.mark.parametrize("count", [1, 29, 31, 96, 97])
def test_short_and_long_lists_are_taken_as_they_are(count: int) -> None:
    assert len(told(national(rows(count))).expected) == count


def test_asked_on_the_half_hour_the_row_before_is_dropped_and_its_actual_kept() -> None:
    before = row(-1, 90, actual=88)
    forecast = parse(national([before, *rows(96)]), UNDER_WAY, "national")
    assert forecast.expected[0].start == UNDER_WAY
    assert len(forecast.expected) == 96
    assert forecast.actual == (Intensity(UNDER_WAY - HALF_HOUR, 88.0),)
    assert forecast.dropped == ("1 row already over",)


def test_an_actual_of_a_half_hour_not_yet_over_is_not_believed() -> None:
    assert told(national([row(0, 100, actual=101), row(1, 100, actual=3)])).actual == ()


def test_an_actual_that_is_no_number_is_counted() -> None:
    forecast = told(national([row(-3, 90, actual="88"), row(-2, 90, actual=0), *rows(8)]))
    assert forecast.actual == (Intensity(UNDER_WAY - 2 * HALF_HOUR, 0.0),)
    assert forecast.dropped == (
        "2 rows already over",
        "1 row with an actual that is not a number from 0 to 1000",
    )


def test_a_real_zero_is_kept() -> None:
    forecast = told(region([row(0, 0), row(1, 0.0), row(2, -0.0)], 1), "1")
    assert [value.g_per_kwh for value in forecast.expected] == [0.0, 0.0, 0.0]
    assert "-" not in str(forecast.expected[2].g_per_kwh)


def test_unsorted_rows_are_sorted() -> None:
    assert told(national(rows(50)[::-1])) == told(national(rows(50)))


def test_of_a_half_hour_given_twice_the_last_counts_and_the_doubling_is_told() -> None:
    forecast = told(national([*rows(10), row(4, 321), row(4, 322)]))
    assert forecast.expected[4].g_per_kwh == 322.0
    assert len(forecast.expected) == 10
    assert forecast.dropped == ("2 rows given twice, the last one used",)


# -- rows that cannot be used ---------------------------------------------------------------------

BAD_VALUES = ["120", "", True, False, -1, 1000.5, 1e9, 10**400, float("nan"), float("inf"), [], {}, "1e999"]


@pytest.mark.parametrize("value", BAD_VALUES, ids=lambda value: repr(value)[:20])
def test_a_forecast_that_is_no_number_is_left_out_never_zero(value: Any) -> None:
    forecast = told(national([row(0), row(1, value), *rows(8, first=2)]))
    assert UNDER_WAY + HALF_HOUR not in {kept.start for kept in forecast.expected}
    assert len(forecast.expected) == 9
    assert forecast.dropped == ("1 row with a forecast that is not a number from 0 to 1000",)


def test_infinity_written_as_a_number_is_left_out() -> None:
    body = national(rows(9)).replace(b'"forecast": 104', b'"forecast": 1e999')
    assert len(told(body).expected) == 8


def test_null_forecasts_are_left_out_and_counted() -> None:
    forecast = told(national([row(k, None if k in {1, 5, 9} else 100) for k in range(12)]))
    assert len(forecast.expected) == 9
    assert forecast.dropped == ("3 rows with a null forecast",)


def changed(k: int, **more: Any) -> Row:
    return {**row(k), **more}


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        (None, "1 row without a time and an intensity"),
        ([], "1 row without a time and an intensity"),
        ({"from": "2026-09-06T09:00Z", "to": "2026-09-06T09:30Z"}, "1 row without a time and an intensity"),
        (
            changed(1, **{"from": "2026-09-06T08:30", "to": "2026-09-06T09:00"}),
            "1 row with a time that is not",
        ),
        (changed(1, **{"from": "2026-09-06T08:30+01:00"}), "1 row with a time that is not"),
        (changed(1, **{"from": "2026-09-31T08:30Z"}), "1 row with a time that is not"),
        (changed(1, **{"from": 1788683400}), "1 row with a time that is not"),
        (changed(1, to=None), "1 row with a time that is not"),
        (changed(1, to="2026-09-06T09:30Z"), "1 row off the half-hour grid or not half an hour long"),
        (
            changed(1, **{"from": "2026-09-06T08:45Z", "to": "2026-09-06T09:15Z"}),
            "1 row off the half-hour grid",
        ),
        (
            changed(1, **{"from": "9999-12-31T23:00Z", "to": "9999-12-31T23:30Z"}),
            "1 row more than 8 days away",
        ),
        (
            changed(1, **{"from": "0001-01-01T00:00Z", "to": "0001-01-01T00:30Z"}),
            "1 row more than 8 days away",
        ),
    ],
)
def test_a_row_that_is_none_is_left_out_and_counted(bad: Any, says: str) -> None:
    forecast = told(national([row(0), bad, *rows(8, first=2)]))
    assert len(forecast.expected) == 9
    assert len(forecast.dropped) == 1
    assert forecast.dropped[0].startswith(says)


def test_a_quarter_of_bad_rows_is_borne_more_is_not() -> None:
    assert len(told(national([*rows(9), row(9, None), row(10, "x"), row(11, -5)])).expected) == 9
    with pytest.raises(ForecastMalformed, match=r"4 of 12 rows are unusable \(3 rows with a null forecast, 1 row"):
        told(national([*rows(8), row(8, None), row(9, None), row(10, None), row(11, -5)]))


def test_ten_times_too_much_is_no_forecast() -> None:
    with pytest.raises(ForecastMalformed, match="unusable"):
        told(national([row(k, 10 * 150) for k in range(96)]))


# -- answers that cannot be used ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("body", "says"),
    [
        (b"", "an empty body"),
        (b" \n", "an empty body"),
        (b"{}", "holds no half hours"),
        (b'{"data":[]}', "holds no half hours"),
        (b'{"data":null}', "holds no half hours"),
        (b"[]", "holds no half hours"),
        (b"null", "holds no half hours"),
        (b"3", "holds no half hours"),
        (b'{"data":"none"}', "answered for a region|unusable"),
        (b"<!DOCTYPE html><html><body>Log in</body></html>", "not JSON but begins with '<!DOCTYPE html>"),
        (b"\xff\xfe\x00", "not JSON"),
        (b"[" * 100_000, "not JSON"),
        (b'{"data":' + b"9" * 5000 + b"}", "not JSON"),
        (b'{"data":[', "not JSON"),
        (
            b'{"error":{"code":"500 Internal Server Error","message":"Requested resource not found."}}',
            r"an error \(Requested resource not found\.\)",
        ),
    ],
)
def test_an_answer_that_is_no_forecast_is_malformed_in_one_line(body: bytes, says: str) -> None:
    with pytest.raises(ForecastMalformed, match=says) as caught:
        told(body)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("body", [b"{}", b'{"data":{}}', b'{"data":[]}', b'{"data":{"regionid":13,"data":[]}}'])
def test_an_empty_region_is_malformed(body: bytes) -> None:
    with pytest.raises(ForecastMalformed, match="no half hours"):
        told(body, "13")


def test_an_answer_about_another_place_is_malformed_and_names_both() -> None:
    with pytest.raises(ForecastMalformed, match="for region 14, but region 13"):
        told(region(rows(96), 14), "13")
    with pytest.raises(ForecastMalformed, match="not for a region, but region 13"):
        told(national(rows(96)), "13")
    with pytest.raises(ForecastMalformed, match="answered for a region, but the national"):
        told(region(rows(96)), "national")
    with pytest.raises(ForecastMalformed, match="answered for a region, but the national"):
        told(region(rows(96), as_list=True), "national")


def test_a_region_may_be_named_as_text_or_not_at_all() -> None:
    assert len(told(region(rows(9), "13"), "13").expected) == 9
    assert len(told(region(rows(9), None), "13").expected) == 9


def test_a_postcode_may_lie_in_any_region() -> None:
    assert told(region(rows(9), 14, postcode="BN3"), "BN3").region == "BN3"


@pytest.mark.parametrize("hours", [-48, -1, 0.5])
def test_rows_shifted_in_time_are_used_by_their_own_times(hours: float) -> None:
    shift = int(hours * 2)
    forecast = told(national(rows(120, first=shift)))
    assert forecast.expected[0].start == UNDER_WAY + max(0, shift) * HALF_HOUR
    assert forecast.expected[0].g_per_kwh == 100.0 + max(0, shift)


def test_a_forecast_that_begins_later_than_the_next_half_hour_is_malformed() -> None:
    with pytest.raises(ForecastMalformed, match="begins at 2026-09-06T09:00:00Z, but now is 2026-09-06T08:13:20Z"):
        told(national(rows(96, first=2)))


def test_last_weeks_answer_is_malformed() -> None:
    with pytest.raises(ForecastMalformed, match="nothing after now"):
        told(national(rows(96, first=-336)))


def test_quotes_are_short_printable_and_on_one_line() -> None:
    assert quotable("a\x1b[31m\nb\u202e\x00c \ud800") == "a [31m b c"
    assert len(quotable("x" * 10_000)) == 120
    assert error_message(b'{"error":{"message":"No\\npostcode"}}') == "No postcode"
    assert error_message(b'{"error":"plain"}') == "plain"
    assert error_message(b"{}") == error_message(b"<") == error_message(b"[" * 100_000) == ""


# -- any bytes at all -----------------------------------------------------------------------------

json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=8,
)
odd_rows = st.builds(
    lambda k, forecast, actual, more: {**row(k, forecast, actual), **more},
    st.integers(-6, 110),
    st.integers(0, 400) | st.floats(0, 1000) | json_values,
    st.none() | st.integers(0, 400) | json_values,
    st.just({}) | st.just({}) | st.dictionaries(st.sampled_from(["from", "to", "intensity"]), json_values, max_size=1),
)
answers = st.one_of(
    st.binary(max_size=200),
    json_values.map(lambda value: json.dumps(value).encode()),
    st.lists(odd_rows, min_size=1, max_size=12).map(national),
    st.builds(
        lambda good, odd: national([*rows(12), *good, *odd]),
        st.lists(odd_rows, max_size=4),
        st.lists(json_values, max_size=3),
    ),
    st.builds(
        lambda found, name: json.dumps({"data": {"regionid": name, "data": found}}).encode(),
        st.lists(odd_rows, max_size=12) | json_values,
        st.just(13) | json_values,
    ),
)


@settings(max_examples=400)
@given(body=answers, where=st.sampled_from(["national", "13", "SW1"]))
@example(body=b'{"data":[{"regionid":' + b"[" * 900 + b"]" * 900 + b',"data":[1]}]}', where="13")
def test_any_answer_is_a_sound_forecast_or_malformed(body: bytes, where: str) -> None:
    try:
        forecast = parse(body, NOW, where)
    except ForecastMalformed as error:
        forecast, said = None, str(error)
    event("malformed" if forecast is None else "forecast")
    if forecast is None:
        assert "\n" not in said
        assert len(said) < 400
        return
    for values in (forecast.expected, forecast.actual):
        starts = [value.start for value in values]
        assert starts == sorted(set(starts))
        assert all(slot_start(start) == start for start in starts)
        assert all(0.0 <= value.g_per_kwh <= 1000.0 for value in values)
        assert all(type(value.g_per_kwh) is float for value in values)
    assert forecast.expected
    assert all(value.start + HALF_HOUR > NOW for value in forecast.expected)
    assert all(value.start + HALF_HOUR <= NOW for value in forecast.actual)
    assert forecast.region == where


# -- over the wire --------------------------------------------------------------------------------

START = datetime(2023, 3, 14, 17, 5, tzinfo=UTC)
SOURCE = SeriesSource({None: synthetic_year(days=120)})


@pytest.fixture
def stub() -> Iterator[StubNeso]:
    server = serve(SOURCE, lambda: START)
    yield server
    server.close()


def asking(server: StubNeso, timeout_s: float = 5.0, region_id: int | None = None, postcode: str | None = None) -> Neso:
    return Neso(server.url, region_id, postcode, timeout_s)


@pytest.mark.parametrize(
    ("region_id", "postcode", "path", "name"),
    [
        (None, None, "/intensity/2023-03-14T17:00Z/fw48h", "national"),
        (13, None, "/regional/intensity/2023-03-14T17:00Z/fw48h/regionid/13", "13"),
        (None, "sw1a 1aa", "/regional/intensity/2023-03-14T17:00Z/fw48h/postcode/SW1A", "SW1A"),
        (1, "SW1", "/regional/intensity/2023-03-14T17:00Z/fw48h/regionid/1", "1"),
    ],
)
def test_the_question_is_the_apis_own(
    stub: StubNeso, region_id: int | None, postcode: str | None, path: str, name: str
) -> None:
    source: ForecastSource = asking(stub, region_id=region_id, postcode=postcode)
    forecast = source.fetch(START)
    assert stub.asked[0] == path
    assert forecast.region == name
    assert len(forecast.expected) == 96
    assert forecast.issued_at == START


def test_on_the_half_hour_the_answer_begins_one_earlier(stub: StubNeso) -> None:
    stub.fault, at = "boundary", slot_start(START)
    stub.now = lambda: at
    forecast = asking(stub).fetch(at)
    assert forecast.dropped == ("1 row already over",)
    assert forecast.expected[0].start == at


FAULTS: list[tuple[str, type[ForecastError], str]] = [
    ("empty", ForecastMalformed, "holds no half hours"),
    ("nodata", ForecastMalformed, "holds no half hours"),
    ("html", ForecastMalformed, "not JSON but begins with"),
    ("500", ForecastUnavailable, r"answered 500: Requested resource not found\.; plugd asks again later"),
    ("huge", ForecastMalformed, "more than 1 MB"),
    ("gzip", ForecastMalformed, r"compressed its answer \(gzip\) unasked"),
    ("broken", ForecastUnavailable, "broke off its answer"),
    (
        "redirect",
        ForecastUnavailable,
        r"redirects to 'http://portal\.example/login', which plugd does not follow",
    ),
    ("redirect_loop", ForecastUnavailable, "redirects without end"),
    ("lastweek", ForecastMalformed, "nothing after now"),
    ("x10", ForecastMalformed, "unusable"),
]


@pytest.mark.parametrize(("fault", "kind", "says"), FAULTS, ids=[fault for fault, _, _ in FAULTS])
def test_a_bad_answer_is_an_error_of_its_kind_in_one_line(
    stub: StubNeso, fault: str, kind: type[ForecastError], says: str
) -> None:
    stub.fault = fault
    with pytest.raises(kind, match=says) as caught:
        asking(stub).fetch(START)
    assert "\n" not in str(caught.value)
    assert len(stub.asked) <= 3


def test_a_redirect_on_the_same_host_is_followed(stub: StubNeso) -> None:
    stub.fault = "redirect_home"
    assert len(asking(stub, region_id=13).fetch(START).expected) == 96
    assert len(stub.asked) == 2


def test_a_thinned_answer_is_used_and_what_is_missing_is_told(stub: StubNeso) -> None:
    stub.fault = "null"
    forecast = asking(stub).fetch(START)
    assert forecast.dropped == ("16 rows with a null forecast",)
    assert len(forecast.expected) == 80
    stub.fault = "short29"
    assert len(asking(stub).fetch(START).expected) == 29


def test_a_refused_question_quotes_the_apis_message(stub: StubNeso) -> None:
    stub.source = SeriesSource({3: synthetic_year(days=120)})
    with pytest.raises(ForecastUnavailable, match=r"400: Please enter a valid region ID\.; check home\.region_id"):
        asking(stub, region_id=13).fetch(START)


@pytest.mark.parametrize("fault", ["silent", "drip", "drip_head"])
def test_the_time_is_over_for_the_whole_question_however_the_answer_trickles(stub: StubNeso, fault: str) -> None:
    stub.fault = fault
    source = asking(stub, timeout_s=0.5)
    begun = time.perf_counter()
    with pytest.raises(ForecastUnavailable, match=r"no answer within|does not answer in time|too slowly"):
        source.fetch(START)
    assert time.perf_counter() - begun < 2.0


def test_beside_a_question_that_hangs_no_second_one_is_begun(stub: StubNeso) -> None:
    stub.fault = "drip_head"
    source = asking(stub, timeout_s=0.3)
    with pytest.raises(ForecastUnavailable, match="no answer within"):
        source.fetch(START)
    with pytest.raises(ForecastUnavailable, match="still hangs"):
        source.fetch(START)
    assert len(stub.asked) == 1


def test_after_a_failure_the_next_question_is_answered(stub: StubNeso) -> None:
    source = asking(stub)
    stub.fault = "broken"
    with pytest.raises(ForecastUnavailable):
        source.fetch(START)
    stub.fault = None
    assert len(source.fetch(START).expected) == 96


@contextmanager
def listening() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server


def test_a_server_that_accepts_nothing_is_told(stub: StubNeso) -> None:
    with listening() as server:
        port = server.getsockname()[1]
    with pytest.raises(ForecastUnavailable, match=r"refuses the connection; check forecast\.base_url"):
        Neso(f"http://127.0.0.1:{port}", None, None, 2.0).fetch(START)


def test_a_name_that_does_not_exist_is_told() -> None:
    with pytest.raises(ForecastUnavailable, match=r"cannot be resolved|no answer within|does not answer"):
        Neso("https://neso.invalid", None, None, 2.0).fetch(START)


class Headers(Handler):
    """Keeps what it was asked with."""

    seen: list[dict[str, str]] = []  # noqa: RUF012 - shared on purpose

    def do_GET(self) -> None:  # noqa: N802 - the parent's name
        self.seen.append(dict(self.headers.items()))
        super().do_GET()


def test_it_says_who_asks_and_wants_nothing_compressed(stub: StubNeso) -> None:
    stub.RequestHandlerClass = Headers
    asking(stub).fetch(START)
    assert Headers.seen[-1]["User-Agent"] == f"plugd/{__version__}"
    assert Headers.seen[-1]["Accept-Encoding"] == "identity"


def test_a_certificate_nobody_vouches_for_is_told_with_a_look_at_the_clock(tmp_path: Path) -> None:
    key, certificate = tmp_path / "key.pem", tmp_path / "certificate.pem"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", "/CN=localhost",
         "-addext", "subjectAltName=DNS:localhost", "-keyout", str(key), "-out", str(certificate)],
        check=True, capture_output=True,
    )  # fmt: skip
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)
    server = serve(SOURCE, lambda: START)
    server.socket = context.wrap_socket(server.socket, server_side=True)
    try:
        with pytest.raises(
            ForecastUnavailable, match=r"certificate of localhost .* the clock here says 2023-03-14T17:05"
        ):
            Neso(f"https://localhost:{server.port}", None, None, 5.0).fetch(START)
    finally:
        server.close()


# -- configuration --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "base_url",
    ["http://api.carbonintensity.org.uk", "ftp://127.0.0.1", "api.carbonintensity.org.uk", "", "https://",
     "https://a:b@c.example", "https://c.example?x=1", "https://[::1", "https://c.example:port"],
)  # fmt: skip
def test_only_https_addresses_are_asked(base_url: str) -> None:
    with pytest.raises(ConfigError, match=r"forecast\.base_url"):
        Neso(base_url, None, None)


@pytest.mark.parametrize(
    "base_url", ["https://api.example/", "http://localhost:81", "http://127.0.0.9:1", "http://[::1]:1"]
)
def test_https_and_this_machine_are_fine(base_url: str) -> None:
    Neso(base_url, None, None)


@pytest.mark.parametrize("region_id", [0, 18, -1])
def test_a_region_that_does_not_exist_is_refused(region_id: int) -> None:
    with pytest.raises(ConfigError, match=r"home\.region_id"):
        Neso("https://api.example", region_id, None)


@pytest.mark.parametrize(
    ("postcode", "outer"),
    [
        ("SW1", "SW1"),
        (" sw1a 1aa ", "SW1A"),
        ("RG10", "RG10"),
        ("RG108AB", "RG10"),
        ("m1 1ae", "M1"),
        ("W1A1AA", "W1A"),
    ],
)
def test_a_postcode_is_cut_to_its_outward_part(postcode: str, outer: str) -> None:
    assert outward(postcode) == outer


@pytest.mark.parametrize("postcode", ["", "SW", "1AA", "SW1/../x", "SW1A 1AAA", "São1"])
def test_what_is_no_postcode_is_refused(postcode: str) -> None:
    with pytest.raises(ConfigError, match=r"home\.postcode"):
        Neso("https://api.example", None, postcode)


def test_a_step_of_the_clock_does_not_lengthen_the_wait(stub: StubNeso) -> None:
    """The wait is measured on the monotonic clock: `now` may be anything."""
    stub.fault = "silent"
    with pytest.raises(ForecastUnavailable):
        asking(stub, timeout_s=0.2).fetch(START + timedelta(days=3650))


# -- what was measured ----------------------------------------------------------------------------


def test_beside_the_forecast_comes_what_was_measured_of_the_last_day_of_the_nation_only(stub: StubNeso) -> None:
    forecast = asking(stub).fetch(START)
    assert stub.asked == ["/intensity/2023-03-14T17:00Z/fw48h", "/intensity/2023-03-13T15:00Z/2023-03-14T17:00Z"]
    first, last = forecast.actual[0].start, forecast.actual[-1].start
    assert (first, last) == (slot_start(START) - timedelta(hours=26), slot_start(START) - timedelta(hours=1.5))
    assert asking(stub, region_id=13).fetch(START).actual == ()
    assert len(stub.asked) == 3


class FirstOnly(Handler):
    """Knows no more after the forecast."""

    def do_GET(self) -> None:  # noqa: N802 - the parent's name
        self.server.fault = None if "fw48h" in self.path else "500"
        super().do_GET()


def test_a_forecast_without_what_was_measured_is_a_forecast_and_says_so(stub: StubNeso) -> None:
    stub.RequestHandlerClass = FirstOnly
    forecast = asking(stub).fetch(START)
    assert (len(forecast.expected), forecast.actual) == (96, ())
    assert forecast.dropped == (
        "what was measured: NESO answered 500: Requested resource not found.; plugd asks again later",
    )


class Slow(Handler):
    """Answers when it is let."""

    gate = threading.Event()

    def do_GET(self) -> None:  # noqa: N802 - the parent's name
        self.gate.wait(5.0)
        super().do_GET()


def test_who_cannot_wait_comes_back_for_the_answer_and_asks_only_once(stub: StubNeso) -> None:
    stub.RequestHandlerClass = Slow
    Slow.gate.clear()
    source = Neso(stub.url, None, None, wait=lambda answer: answer.wait(0.05))
    begun = time.perf_counter()
    for _ in range(3):
        with pytest.raises(ForecastLate):
            source.fetch(START)
    with pytest.raises(ForecastLate):  # beside it, and it waits for nobody either
        source.past(START - timedelta(days=1), START)
    assert time.perf_counter() - begun < 1.0
    Slow.gate.set()
    while True:
        try:
            forecast = source.fetch(START + timedelta(seconds=5))
        except ForecastLate:
            continue
        break
    assert forecast.issued_at == START  # it is of when it was asked
    assert sum("fw48h" in path for path in stub.asked) == 1


def test_a_page_that_comes_late_is_not_taken_for_another(stub: StubNeso) -> None:
    stub.RequestHandlerClass = Slow
    Slow.gate.clear()
    source = Neso(stub.url, None, None, wait=lambda answer: answer.wait(0.05))
    day = timedelta(days=1)
    with pytest.raises(ForecastLate):
        source.past(START - 3 * day, START - 2 * day)
    Slow.gate.set()
    found: tuple[PastRow, ...] = ()
    while not found:
        with suppress(ForecastLate):
            found = source.past(slot_start(START - day), slot_start(START))
    assert (found[0].start, len(found)) == (slot_start(START - day), 48)
