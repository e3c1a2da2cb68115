"""`plugd demo`: the daemon, a broker, a stub plug with a car and a stub of the API, on a simulated clock.

Every part is a process of its own and speaks the real protocol. Nothing is left behind.
"""

import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from datetime import date, datetime, timedelta
from datetime import time as clock_time
from itertools import takewhile
from pathlib import Path
from types import FrameType
from zoneinfo import ZoneInfo

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from plugd import config as configuration
from plugd.adapters.store import SqliteStore
from plugd.cli import Parser
from plugd.domain import Capability, Household
from plugd.errors import PlugdError, UsageError
from plugd.series import IntensitySeries, load
from plugd.study.world import Battery, Driver
from plugd.units import require_utc, to_pct
from plugd_hil.account import Night, foresight, nights, per_kwh, read_ledger, uncontrolled
from plugd_hil.broker import HOST, BrokerProcess, any_broker
from plugd_hil.children import Children
from plugd_hil.conductor import Conductor
from plugd_hil.plug import DIALECTS
from plugd_hil.synthetic import synthetic_year

POWER_KW = 2.3
SOC_START = 0.5
SYNTHETIC = "synthetic"
MOST_DAYS = 366

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


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run came to."""

    source: str
    nights: tuple[Night, ...]
    ours: tuple[float, float]
    uncontrolled: tuple[float, float]
    perfect: tuple[float, float]
    guarded: int
    wall_s: float

    @property
    def reduction_pct(self) -> float | None:
        """Less carbon per kWh than charging on arrival."""
        ours, theirs = per_kwh(*self.ours), per_kwh(*self.uncontrolled)
        return round(100.0 * (1.0 - ours / theirs), 2) if ours is not None and theirs else None

    def document(self, zone: ZoneInfo) -> dict[str, object]:
        """The JSON answer (interface: the demo)."""
        return {
            "source": self.source,
            "nights": [_night(night, zone) for night in self.nights],
            "carbon_g_per_kwh": per_kwh(*self.ours),
            "uncontrolled_g_per_kwh": per_kwh(*self.uncontrolled),
            "perfect_g_per_kwh": per_kwh(*self.perfect),
            "reduction_pct": self.reduction_pct,
            "missed_mornings": sum(night.missed for night in self.nights),
            "energy_kwh": round(self.ours[0], 3),
            "guard_interventions": self.guarded,
            "wall_s": round(self.wall_s, 1),
        }


def _night(night: Night, zone: ZoneInfo) -> dict[str, object]:
    return {
        "date": night.stay.arrival.astimezone(zone).date().isoformat(),
        "arrival_soc_pct": to_pct(night.arrival_soc),
        "charged_kwh": round(night.charged_kwh, 3),
        "carbon_g_per_kwh": per_kwh(night.charged_kwh, night.carbon_g),
        "switch_ons": night.switch_ons,
        "morning_soc_pct": to_pct(night.morning_soc),
        "minimum_pct": to_pct(night.minimum),
        "reason": night.reason,
    }


def run(options: Options, progress: Callable[[float], None] = lambda _: None) -> Outcome:
    """Run the whole system. Raises UsageError for the arguments, PlugdError where a part fails."""
    began = time.monotonic()
    series = series_for(options)
    household = Household(capability=Capability(POWER_KW, dead_man=True))
    start, end = span(options, series, ZoneInfo(household.timezone))
    with _folder(options) as folder:
        ledger, store_folder = _simulate(options, folder, start, end, progress)
        truth = read_ledger(ledger)
        with SqliteStore(store_folder) as store:
            records = store.records(start)
            memory = store.load()
    held = series.held()

    def actual(slot: datetime) -> float:
        value = held.actual_at(slot)
        if value is None:
            raise UsageError(f"{options.source}: ends before {slot:%Y-%m-%d %H:%M}")
        return value

    driver = Driver(seed=options.seed)
    stays = tuple(takewhile(lambda s: s.arrival < end, driver.stays(start)))
    stays = tuple(s for s in stays if s.arrival >= start)
    found = nights(truth, stays, records, household, actual)
    over = tuple(night.stay for night in found)
    last = over[-1].departure if over else end
    return Outcome(
        source=options.source,
        nights=found,
        ours=(sum(n.charged_kwh for n in found), sum(n.carbon_g for n in found)),
        uncontrolled=uncontrolled(over, household, actual, _battery(household)),
        perfect=foresight(over, household, _endless(actual, held), _battery(household), (start, last)),
        guarded=memory.guard_count if memory else 0,
        wall_s=time.monotonic() - began,
    )


@contextmanager
def _folder(options: Options) -> Iterator[Path]:
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


def _endless(actual: Callable[[datetime], float], series: IntensitySeries) -> Callable[[datetime], float]:
    """The last value for whatever lies beyond the series: the plans of its last nights reach there."""
    last = series.end - timedelta(minutes=30)
    return lambda slot: actual(min(slot, last))


def _battery(household: Household) -> Battery:
    capacity_kwh = household.car.capacity_kwh
    return Battery(capacity_kwh, SOC_START * capacity_kwh, household.car.efficiency)


def _simulate(
    options: Options, folder: Path, start: datetime, end: datetime, progress: Callable[[float], None]
) -> tuple[Path, Path]:
    """Start everything, let time pass, end everything. Returns the stub's ledger and the daemon's state."""
    ledger, state = folder / "ledger.jsonl", folder / "state"
    with ExitStack() as left:
        try:
            broker = any_broker(os.environ.get("PATH", ""), folder)
        except LookupError as error:
            raise PlugdError(str(error)) from error
        left.callback(broker.stop)
        try:
            broker.start()
        except RuntimeError as error:
            raise PlugdError(str(error).strip()) from error
        conductor = Conductor(start, ("plug", "plugd"))
        left.callback(conductor.close)
        environment = {k: v for k, v in os.environ.items() if k != "STATE_DIRECTORY"}
        children = Children({**environment, "PYTHONUNBUFFERED": "1"}, folder)
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
        config, token = folder / "plugd.toml", folder / "token"
        token.write_text("demo\n", encoding="utf-8")
        token.chmod(0o600)
        config.write_text(
            CONFIG.format(
                host=HOST,
                broker_port=broker.port,
                plug=options.plug,
                power_kw=POWER_KW,
                neso_port=neso["port"],
                state=state,
                more=_plug_config(options, plug),
                page="false" if options.page is None else "true",
                page_port=options.page or 8480,
                token=token,
            ),
            encoding="utf-8",
        )
        configuration.load(config)
        children.start("plugd", "plugd_hil.daemon", "-c", str(config), "--clock", clock)
        _let_pass(conductor, children, broker, (start, end), progress)
        if options.page is not None:
            _stand_open(conductor, children, end, options.page)
        children.running["plugd"].terminate()
        conductor.dismiss("plugd", lambda: children.ended("plugd"))
        children.running["plug"].terminate()
        conductor.dismiss("plug", lambda: children.ended("plug"))
    return ledger, state


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


# -- the command ----------------------------------------------------------------------------------


def table(outcome: Outcome, household: Household) -> Table:
    """A line per night."""
    zone = ZoneInfo(household.timezone)
    shown = Table(title=f"{outcome.source}: {len(outcome.nights)} nights", title_justify="left")
    for name in ("night", "arrived", "charged", "g/kWh", "on", "morning", "why"):
        shown.add_column(name, justify="left" if name in ("night", "why") else "right", no_wrap=name != "why")
    for night in outcome.nights:
        row = _night(night, zone)
        clean = row["carbon_g_per_kwh"]
        mark = " missed" if night.missed else ""
        shown.add_row(
            f"{night.stay.arrival.astimezone(zone):%a %d %b}",
            f"{100 * night.arrival_soc:.0f} %",
            f"{night.charged_kwh:.1f} kWh",
            "-" if clean is None else f"{clean:.0f}",
            str(night.switch_ons),
            f"{100 * night.morning_soc:.0f} %{mark}",
            night.reason,
        )
    return shown


def summary(outcome: Outcome) -> str:
    """The last line: against charging on arrival, and against perfect foresight."""
    ours, theirs, best = (per_kwh(*pair) for pair in (outcome.ours, outcome.uncontrolled, outcome.perfect))
    missed = sum(night.missed for night in outcome.nights)
    if ours is None or theirs is None or best is None:
        return f"Nothing was charged in {len(outcome.nights)} nights; missed mornings: {missed}."
    return (
        f"{ours:.0f} g/kWh against {theirs:.0f} when charging on arrival: {outcome.reduction_pct:.0f} % less "
        f"(with perfect foresight {best:.0f} g/kWh). Missed mornings: {missed}."
    )


@contextmanager
def _bar(console: Console) -> Iterator[Callable[[float], None]]:
    """A progress bar on stderr, where somebody looks."""
    if not console.is_terminal:
        yield lambda _: None
        return
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("simulating", total=1.0)
        yield lambda share: progress.update(task, completed=share)


def _parsed(arguments: Sequence[str] | None) -> Options:
    parser = Parser(prog="plugd demo", description="The daemon against a stub plug with a car, through a real broker.")
    parser.add_argument("--days", type=int, default=7, help="how many days (default 7)")
    parser.add_argument("--from", dest="start", metavar="DATE", help="first day; it starts at local noon")
    parser.add_argument("--seed", type=int, default=0, help="another driver, other forecast errors")
    parser.add_argument("--source", default=SYNTHETIC, metavar="synthetic|FILE", help="whose intensity")
    parser.add_argument("--plug", default="tasmota", choices=(*DIALECTS, CAN), help="which dialect the plug speaks")
    parser.add_argument("--soc", default="arrival", choices=("arrival", "never"), help="when the car tells its SOC")
    parser.add_argument("--json", action="store_true", help="one JSON document, and nothing else")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep the daemon's state there, for plugd report")
    parser.add_argument(
        "--page", type=int, nargs="?", const=8480, metavar="PORT", help="show the page, and let time go on at the end"
    )
    asked = parser.parse_args(arguments)
    if not 1 <= asked.days <= MOST_DAYS:
        parser.error(f"--days {asked.days}: choose 1 to {MOST_DAYS}")
    zone = ZoneInfo(Household().timezone)
    start = None
    if asked.start is not None:
        try:
            start = require_utc(datetime.combine(date.fromisoformat(asked.start), clock_time(12), zone))
        except ValueError:
            parser.error(f"--from {asked.start}: write a date as 2023-01-02")
    return Options(
        asked.days, start, asked.seed, asked.source, asked.plug, asked.soc, asked.json, asked.keep, asked.page
    )


@contextmanager
def _unwound() -> Iterator[None]:
    """SIGTERM ends the demo as Ctrl-C does, by way of every `finally`: no process stays behind."""

    def end(signum: int, _frame: FrameType | None) -> None:
        raise SystemExit(128 + signum)

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _told(options: Options, outcome: Outcome, household: Household) -> None:
    if options.json:
        print(json.dumps(outcome.document(ZoneInfo(household.timezone)), indent=2))
        return
    console = Console(width=None if sys.stdout.isatty() else 140)
    if options.source == SYNTHETIC:
        console.print("The intensity is synthetic: a GB-like year of plugd's own making.", style="italic")
    console.print(table(outcome, household))
    console.print(summary(outcome))
    if options.keep is not None:
        console.print(f"Kept: plugd -c {options.keep / 'plugd.toml'} report --out report.html", soft_wrap=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command. Exit 0 done, 1 failed, 2 usage."""
    try:
        options = _parsed(arguments)
        with _unwound(), _bar(Console(stderr=True)) as progress:
            outcome = run(options, progress)
        _told(options, outcome, Household())
        sys.stdout.flush()
    except PlugdError as error:
        print(f"plugd demo: {error}", file=sys.stderr)
        return 2 if isinstance(error, UsageError) else 1
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        with suppress(OSError):
            sys.stdout.close()
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
