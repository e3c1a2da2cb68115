"""One run of the demo: its options, the programs that take part, and the passing of time."""

import socket
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from datetime import time as clock_time
from pathlib import Path
from zoneinfo import ZoneInfo

from plugd import config as configuration
from plugd.adapters.house_mark import drawn
from plugd.errors import PlugdError, UsageError
from plugd.series import IntensitySeries, load
from plugd.units import require_utc
from plugd_hil.broker import HOST, BrokerProcess, running_broker
from plugd_hil.children import Children
from plugd_hil.conductor import Conductor
from plugd_hil.synthetic import synthetic_year

POWER_KW = 2.3
SOC_START = 0.5
SYNTHETIC = "synthetic"

TELLING = dict.fromkeys(("openevse", "mqtt", "shelly1", "esphome"), ("--tele-period", "60"))
"""Half as often as they are shipped: the week is sooner over, and a reading may be a minute old."""

CONFIG = """
name = "ev"
[broker]
host = "{host}"
port = {broker_port}
[plug]
kind = "{plug}"
topic = "ev-plug"
power_kw = {power_kw}
{more}
[forecast]
base_url = "http://{host}:{neso_port}"
[state]
dir = "{state}"
[web]
enabled = {page}
bind = "127.0.0.1:{page_port}"
token_file = "{token}"
"""


CAN = "can_elcon"
CAN_PERIOD_S = 2.0
"""Half as often as on a real bus, for a demo twice as fast: every second is a turn of everybody's."""
CAN_CONFIG = """
[can]
interface = "slcan"
channel = "{channel}"
max_voltage_v = 405
max_current_a = 12
period_s = {period_s}
{soc}
"""


@dataclass(frozen=True, slots=True)
class Options:
    """What was asked for."""

    days: int = 7
    start: datetime | None = None
    seed: int = 0
    source: str = SYNTHETIC
    plug: str = "tasmota"
    soc: str = "arrival"
    json: bool = False
    keep: Path | None = None
    """Where the daemon's configuration and state stay, for `plugd report`; else nothing stays."""
    page: int | None = None
    """The page's port: it is open meanwhile and afterwards, while time goes on at its natural speed."""
    look_s: float | None = None
    """The daemon's longest wait; else it waits for as long as nothing is due."""
    more: Path | None = None
    """Tables added to the daemon's configuration."""


def series_for(options: Options) -> IntensitySeries:
    """The intensity of the run. Raises UsageError."""
    return synthetic_year(options.seed) if options.source == SYNTHETIC else load(Path(options.source))


def span(options: Options, series: IntensitySeries, zone: ZoneInfo) -> tuple[datetime, datetime]:
    """Start and end of the run. Raises UsageError where the source does not cover it."""
    start = options.start or _first_noon(series, zone)
    end = start + timedelta(days=options.days)
    if start < series.start or end > series.end:
        raise UsageError(
            f"{options.source}: covers {series.start:%Y-%m-%d} to {series.end:%Y-%m-%d}, not "
            f"{start:%Y-%m-%d} and {options.days} days; choose --from and --days within"
        )
    return start, end


def _first_noon(series: IntensitySeries, zone: ZoneInfo) -> datetime:
    day = series.start.astimezone(zone).date()
    noon = require_utc(datetime.combine(day, clock_time(12), zone))
    return noon if noon >= series.start else noon + timedelta(days=1)


def look_for_port(options: Options) -> None:
    """Raises UsageError where the page cannot have its port: somebody else's page would be taken for ours."""
    if options.page is None:
        return
    try:
        socket.create_server((HOST, options.page)).close()
    except OSError:
        raise UsageError(f"--page {options.page}: cannot be had; is another page there? Name another port") from None


@contextmanager
def folder_of(options: Options) -> Iterator[Path]:
    """Where the parts work. Raises UsageError for one to keep that holds something already."""
    if options.keep is None:
        with tempfile.TemporaryDirectory(prefix="plugd-demo-") as name:
            yield Path(name)
        return
    folder = options.keep.absolute()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        empty = not any(folder.iterdir())
    except OSError as error:
        raise UsageError(f"--keep {folder}: cannot be used ({error.strerror})") from error
    if not empty:
        raise UsageError(f"--keep {folder}: is not empty; name a new folder")
    yield folder


def simulate(
    options: Options, folder: Path, start: datetime, end: datetime, progress: Callable[[float], None]
) -> tuple[Path, Path]:
    """Start everything, let time pass, end everything. Returns the stub's ledger and the daemon's state."""
    ledger, state = folder / "ledger.jsonl", folder / "state"
    with ExitStack() as left:
        broker = running_broker(folder, left)
        conductor = Conductor(start, ("plug", "plugd"))
        left.callback(conductor.close)
        children = Children(folder)
        left.callback(children.close)
        left.callback(conductor.hang_up)
        clock = f"{HOST}:{conductor.port}"
        neso = children.start(
            "neso", "plugd_hil.neso", "--source", options.source, "--seed", str(options.seed), "--clock", clock,
            says=True,
        )  # fmt: skip
        stub = ("plugd_hil.can_elcon", "--period", str(CAN_PERIOD_S)) if options.plug == CAN else (
            "plugd_hil.plug", "--dialect", options.plug, "--broker", f"{HOST}:{broker.port}", "--topic", "ev-plug",
            "--soc-topic", "car/soc", *TELLING.get(options.plug, ()),
        )  # fmt: skip
        plug = children.start(
            "plug", *stub, "--power", str(POWER_KW), "--soc", str(100 * SOC_START), "--car", "driver",
            "--seed", str(options.seed), "--clock", clock, "--ledger", str(ledger), "--tell", options.soc, says=True,
        )  # fmt: skip
        config = _configured(options, folder, (broker.port, neso["port"]), plug, state)
        look = () if options.look_s is None else ("--look", str(options.look_s))
        children.start("plugd", "plugd_hil.daemon", "-c", str(config), "--clock", clock, *look)
        _let_pass(conductor, children, broker, (start, end), progress)
        if options.page is not None:
            _stand_open(conductor, children, end, options.page)
        children.running["plugd"].terminate()
        conductor.dismiss("plugd", lambda: children.ended("plugd"))
        children.running["plug"].terminate()
        conductor.dismiss("plug", lambda: children.ended("plug"))
    return ledger, state


def _configured(
    options: Options, folder: Path, ports: tuple[int, object], plug: dict[str, object], state: Path
) -> Path:
    """The daemon's configuration, written down. `ports`: broker and forecasts; `plug`: what the stub said of itself."""
    config, token = folder / "plugd.toml", folder / "token"
    drawn(state, "ev/ev-plug")
    token.write_text("demo\n", encoding="utf-8")
    token.chmod(0o600)
    broker_port, neso_port = ports
    config.write_text(
        CONFIG.format(
            host=HOST,
            broker_port=broker_port,
            plug=options.plug,
            power_kw=POWER_KW,
            neso_port=neso_port,
            state=state,
            more=_plug_config(options, plug),
            page="false" if options.page is None else "true",
            page_port=options.page or 8480,
            token=token,
        ),
        encoding="utf-8",
    )
    if options.more is not None:
        with config.open("a", encoding="utf-8") as tables:
            tables.write(options.more.read_text(encoding="utf-8"))
    configuration.load(config)
    return config


def _plug_config(options: Options, plug: dict[str, object]) -> str:
    """What the configuration says of the plug's way to plugd, and of who tells the SOC."""
    told = options.soc == "arrival"
    if options.plug == CAN:  # there the battery tells it on the bus
        return CAN_CONFIG.format(
            channel=plug["channel"], period_s=CAN_PERIOD_S, soc='soc = "pylontech"' if told else ""
        )
    return '[car]\nsoc_topic = "car/soc"' if told else ""


def _let_pass(
    conductor: Conductor,
    children: Children,
    broker: BrokerProcess,
    span: tuple[datetime, datetime],
    progress: Callable[[float], None],
) -> None:
    """Time passes from start to end. Raises PlugdError, in its last words, when a part ends or hangs."""
    start, end = span

    def look() -> None:
        if broker.ended:
            raise PlugdError(f"the demo stopped: the broker ended before its time: {broker.last_words}")
        children.look()

    def moved(now: datetime) -> None:
        look()
        progress((now - start) / (end - start))

    try:
        conductor.gather(look=look)
        conductor.run_until(end, moved)
    except (ConnectionError, TimeoutError) as error:
        children.look(patience_s=1.0)
        raise PlugdError(f"the demo stopped: {error}") from error


def _stand_open(conductor: Conductor, children: Children, end: datetime, port: int) -> None:
    """Time goes on at its natural speed, so that the page can be tried, until Ctrl-C."""
    print(f"The page is at http://{HOST}:{port}/ (token: demo). Ctrl-C ends.", file=sys.stderr, flush=True)
    began = time.monotonic()
    with suppress(KeyboardInterrupt):
        while True:
            time.sleep(0.2)
            until = end + timedelta(seconds=time.monotonic() - began)
            conductor.run_until(until, lambda _: children.look())
