"""What can be wrong with an answer of the NESO API: each fault one function, by name.

Faults of the content change the answer; faults of the line send something else, or nothing.
"""

import gzip
from collections.abc import Callable
from datetime import datetime
from http.server import BaseHTTPRequestHandler
from threading import Event
from typing import Any

from plugd.units import HALF_HOUR

Answer = dict[str, Any]
"""An API answer on its way into JSON."""
DRIP_S = 0.2
HUGE_BYTES = 2_000_000

HTML = b"<!DOCTYPE html><html><title>Welcome</title><body>Please log in to the Wi-Fi</body></html>"
OUTAGE: Answer = {"error": {"code": "500 Internal Server Error", "message": "Requested resource not found."}}


def rows_in(answer: Answer) -> list[Answer]:
    """The half hours in an answer of either shape."""
    inner = answer.get("data", [])
    rows: list[Answer] = inner["data"] if isinstance(inner, dict) else inner
    return rows


def _with_rows(answer: Answer, rows: list[Answer]) -> Answer:
    inner = answer.get("data", [])
    return {"data": {**inner, "data": rows} if isinstance(inner, dict) else rows}


def _forecast(row: Answer, value: object) -> Answer:
    return {**row, "intensity": {**row["intensity"], "forecast": value}}


def _null(answer: Answer) -> Answer:
    rows = [_forecast(row, None) if k % 6 == 2 else row for k, row in enumerate(rows_in(answer))]
    return _with_rows(answer, rows)


def _times10(answer: Answer) -> Answer:
    rows = [_forecast(row, 10 * row["intensity"]["forecast"]) for row in rows_in(answer)]
    return _with_rows(answer, rows)


def _week_ago(stamp: str) -> str:
    moment = datetime.fromisoformat(stamp) - 336 * HALF_HOUR
    return moment.strftime("%Y-%m-%dT%H:%MZ")


def _lastweek(answer: Answer) -> Answer:
    rows = [{**row, "from": _week_ago(row["from"]), "to": _week_ago(row["to"])} for row in rows_in(answer)]
    return _with_rows(answer, rows)


CONTENT: dict[str, Callable[[Answer], Answer]] = {
    "empty": lambda _: {},
    "nodata": lambda _: {"data": []},
    "null": _null,
    "short29": lambda answer: _with_rows(answer, rows_in(answer)[:29]),
    "lastweek": _lastweek,
    "x10": _times10,
}


def send(to: BaseHTTPRequestHandler, body: bytes, status: int = 200, **headers: str) -> None:
    """A whole answer. Header names with _ for -."""
    to.send_response(status)
    said = {"Content_Type": "application/json", "Content_Length": str(len(body)), **headers}
    for name, value in said.items():
        to.send_header(name.replace("_", "-"), value)
    to.end_headers()
    to.wfile.write(body)


def _drip(to: BaseHTTPRequestHandler, body: bytes, ended: Event) -> None:
    to.send_response(200)
    to.send_header("Content-Length", str(len(body)))
    to.end_headers()
    _byte_by_byte(to, body, ended)


def _drip_head(to: BaseHTTPRequestHandler, body: bytes, ended: Event) -> None:
    _byte_by_byte(to, b"HTTP/1.1 200 OK\r\nX-Slow: " + b"a" * 1000, ended)


def _byte_by_byte(to: BaseHTTPRequestHandler, content: bytes, ended: Event) -> None:
    for k in range(len(content)):
        to.wfile.write(content[k : k + 1])
        to.wfile.flush()
        if ended.wait(DRIP_S):
            return


def _silent(to: BaseHTTPRequestHandler, body: bytes, ended: Event) -> None:
    ended.wait()


def _broken(to: BaseHTTPRequestHandler, body: bytes, ended: Event) -> None:
    to.send_response(200)
    to.send_header("Content-Length", str(len(body)))
    to.end_headers()
    to.wfile.write(body[: len(body) // 2])
    to.close_connection = True


def _redirect_home(to: BaseHTTPRequestHandler, body: bytes, ended: Event) -> None:
    if "?" in to.path:
        send(to, body)
    else:
        send(to, b"", 302, Location=f"{to.path}?moved")


LINE: dict[str, Callable[[BaseHTTPRequestHandler, bytes, Event], None]] = {
    "html": lambda to, *_: send(to, HTML, Content_Type="text/html"),
    "drip": _drip,
    "drip_head": _drip_head,
    "silent": _silent,
    "huge": lambda to, body, ended: send(to, body + b" " * HUGE_BYTES),
    "gzip": lambda to, body, ended: send(to, gzip.compress(body), Content_Encoding="gzip"),
    "broken": _broken,
    "redirect": lambda to, *_: send(to, b"", 302, Location="http://portal.example/login"),
    "redirect_home": _redirect_home,
    "redirect_loop": lambda to, *_: send(to, b"", 302, Location=to.path),
}

NAMES = (*CONTENT, *LINE, "500", "boundary")
"""`500`: the outage's own error body. `boundary`: asked from a full half hour, the one before comes too."""
