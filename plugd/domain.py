"""The frozen values that cross modules. Numbers carry their unit; SOC is a fraction; times are aware UTC."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import date, datetime, time
from enum import StrEnum

Series = tuple[float, ...]


# -- the grid's carbon intensity ------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Intensity:
    """Mean carbon intensity of the half hour that begins at `start`."""

    start: datetime
    g_per_kwh: float


@dataclass(frozen=True, slots=True)
class Forecast:
    """What the source said at one moment, keyed by each row's own time, never by position.

    `expected` are its forecasts, `actual` the measured values it gave beside them (national only),
    both sorted with one value a half hour. `dropped` says what was left out, one short text a cause.
    """

    issued_at: datetime
    region: str
    expected: tuple[Intensity, ...]
    actual: tuple[Intensity, ...] = ()
    dropped: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class PastRow:
    """A half hour as the source tells it afterwards: what it forecast last, and what was measured (national only)."""

    start: datetime
    forecast: float | None
    actual: float | None


class SlotSource(StrEnum):
    """Where an outlook's number came from."""

    NESO = "neso"
    CORRECTED = "corrected"
    TAIL = "tail"


@dataclass(frozen=True, slots=True)
class OutlookSlot:
    """Expected intensity of one half hour, with its standard deviation."""

    start: datetime
    g_per_kwh: float
    sd_g_per_kwh: float
    source: SlotSource


@dataclass(frozen=True, slots=True)
class Outlook:
    """One expected intensity per half hour, without gaps, to the end of the last session."""

    slots: tuple[OutlookSlot, ...]
    forecast_until: datetime | None
    """End of the last half hour that the source itself covers, None without a forecast."""


# -- the house ------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Car:
    """The battery and how it is driven. SOC as fractions, energies in battery kWh."""

    capacity_kwh: float = 50.0
    efficiency: float = 0.9
    soc_min: float = 0.2
    soc_max: float = 0.8
    daily_use_kwh: float = 5.8
    daily_use_sd_kwh: float = 2.67
    taper_from: float = 1.0
    """From this SOC on it takes less, in a straight line down to `taper_share` of the power when full; 1: never."""
    taper_share: float = 0.2
    soc_max_age_s: float = 1800.0
    """An older word of the car counts as none: the SOC is then called what it is, carried on by the meter."""


@dataclass(frozen=True, slots=True)
class DayRule:
    """What is special about the session that ends on one weekday."""

    ready_by: time | None = None
    minimum: float | None = None
    away: bool = False


@dataclass(frozen=True, slots=True)
class Trip:
    """A dated override of one morning."""

    day: date
    ready_by: time | None = None
    minimum: float | None = None
    away: bool = False


@dataclass(frozen=True, slots=True)
class Nights:
    """When the car is expected, in local time, and what its owner asks of a morning."""

    horizon: int = 4
    plug_in: time = time(18, 0)
    plug_in_sd_min: float = 60.0
    plug_out: time = time(9, 0)
    plug_out_sd_min: float = 60.0
    ready_by: time | None = None
    confidence: float = 0.98
    minimum: float = 0.5
    default_window: tuple[time, time] = (time(23, 0), time(6, 0))
    week: tuple[tuple[int, DayRule], ...] = ()
    """(weekday, 0 = Monday, of the session's end; its rule)."""
    learn: bool = False
    """Whether what was seen of the household replaces these times and the daily use, once enough of it was."""


@dataclass(frozen=True, slots=True)
class Range:
    """A quantity by its mean, and by the quantiles below and above it that promises are made on."""

    low: float
    mean: float
    high: float


ByKind = tuple[Range, Range]
"""On weekdays, and on Saturdays and Sundays."""


@dataclass(frozen=True, slots=True)
class Learned:
    """What was learned of a household. None where too little was seen: then the configured figures count."""

    plug_in_min: ByKind | None = None
    """Minutes after the midnight before, local time, by the day the evening belongs to; 1500 is one in the night."""
    plug_out_min: ByKind | None = None
    """Minutes after the midnight before, by the day of the morning."""
    use_kwh: ByKind | None = None
    """Driven in a day, by that day."""


@dataclass(frozen=True, slots=True)
class RelayRules:
    """How often a relay may move. Guard, reserve and a person are counted apart and not limited."""

    min_on_s: float = 900.0
    min_off_s: float = 600.0
    max_switch_on: int = 6
    random_delay_s: float = 600.0
    hold_g_per_kwh: float = 5.0
    """The slot under way and the next are left only for slots cleaner by more than this."""


@dataclass(frozen=True, slots=True)
class Capability:
    """What a plug can be told: on and off, or any power from `power_min_kw` up (0 is always allowed)."""

    power_max_kw: float
    modulating: bool = False
    power_min_kw: float = 0.0
    dead_man: bool = False
    """Whether it comes on by itself when plugd falls silent."""
    fixed_timer_s: float | None = None
    """After how long, where one off cannot be given a shorter time than another."""


@dataclass(frozen=True, slots=True)
class Household:
    """All that stays the same until the configuration is edited."""

    timezone: str = "Europe/London"
    car: Car = field(default_factory=Car)
    nights: Nights = field(default_factory=Nights)
    relay: RelayRules = field(default_factory=RelayRules)
    capability: Capability = field(default_factory=lambda: Capability(power_max_kw=2.3, dead_man=True))
    guard_margin_s: float = 2400.0
    """Between the guard's last safe finish and the session end: a random delay and half an hour."""
    planner_slack_s: float = 1200.0
    """How much earlier still the planner aims, so that in health the guard never fires."""
    max_current_a: float | None = None
    """More than this for a minute at a plain plug is cut. None: not watched."""
    mains_voltage_v: float = 230.0
    """What a current is reckoned with where the plug tells only the power."""
    end_value: bool = True
    """Whether energy left at the horizon's end counts for what it saves later."""
    learned: Learned | None = None
    """None: nothing yet, or not wanted."""


# -- what was seen --------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Reading:
    """What the plug last told. `at`: when it told the relay's state; `metered_at`: power and energy."""

    at: datetime
    on: bool
    power_kw: float | None = None
    energy_kwh: float | None = None
    """The meter's own total: it may reset or be missing."""
    metered_at: datetime | None = None
    changed_by_other: bool | None = None
    """The relay's new state where it moved since the last reading without being told: a press, a power cut."""
    came_back: bool = False
    """The plug was away (power cut, Wi-Fi, broker) since the last reading."""
    soc: float | None = None
    """How full the battery is, where it tells the charger itself (CAN) and its last word is not too old."""
    soc_at: datetime | None = None
    current_a: float | None = None
    changed_over: str = ""
    """The topic on which somebody else was heard to order the change."""
    nonsense: bool = False
    """The meter tells what cannot be, again and again."""


class Mode(StrEnum):
    """What the owner wants."""

    OFF = "off"
    SMART = "smart"
    NOW = "now"


@dataclass(frozen=True, slots=True)
class SetMode:
    """Off, smart, or now until full, unplugged or changed."""

    mode: Mode


@dataclass(frozen=True, slots=True)
class SetSoc:
    """How full the car is, as a fraction, said by `source` (hub, car)."""

    soc: float
    source: str = "hub"


@dataclass(frozen=True, slots=True)
class SetMinimum:
    """The morning minimum, as a fraction."""

    minimum: float


@dataclass(frozen=True, slots=True)
class SetReadyBy:
    """The session end, local time; None to go back to the configured rule."""

    ready_by: time | None


@dataclass(frozen=True, slots=True)
class SetWeek:
    """The weekdays that differ, in the order of the week; None to go back to the configured ones."""

    week: tuple[tuple[int, DayRule], ...] | None


@dataclass(frozen=True, slots=True)
class SetTrip:
    """One morning that differs. It replaces what was set for that day before."""

    trip: Trip


@dataclass(frozen=True, slots=True)
class ClearTrip:
    """That morning is as any other again; None: every morning that a trip was set for."""

    day: date | None


@dataclass(frozen=True, slots=True)
class SetHorizon:
    """How many sessions are planned together."""

    sessions: int


@dataclass(frozen=True, slots=True)
class SetConnected:
    """Whether the car is at the plug."""

    connected: bool


@dataclass(frozen=True, slots=True)
class Replan:
    """Plan now."""


Command = (
    SetMode | SetSoc | SetMinimum | SetReadyBy | SetWeek | SetTrip | ClearTrip | SetHorizon | SetConnected | Replan
)


@dataclass(frozen=True, slots=True)
class Answer:
    """What is told to whoever sent a command."""

    command: str
    ok: bool
    message: str


@dataclass(frozen=True, slots=True)
class Fault:
    """Something that does not work: a stable code for programs, a sentence for people. What to do: `remedies`."""

    code: str
    text: str


@dataclass(frozen=True, slots=True)
class Observation:
    """Everything one tick may know of the world. A port that failed is None here, and a fault."""

    reading: Reading | None = None
    forecast: Forecast | None = None
    history: tuple[Intensity, ...] = ()
    commands: tuple[Command, ...] = ()
    faults: tuple[Fault, ...] = ()


# -- what is planned ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Session:
    """One expected stay at the plug, and what its end must find."""

    start: datetime
    end: datetime
    """The session end: guard, planner and report use this one time."""
    minimum: float
    daily_use_kwh: float
    """Driven after it, in battery kWh, the cautious quantile."""
    ceiling: float


@dataclass(frozen=True, slots=True)
class PlanSlot:
    """Planned mean power over a half hour or a part of one. `limit_kw`: the most it could have had."""

    start: datetime
    end: datetime
    power_kw: float
    limit_kw: float
    intensity_g_per_kwh: float


@dataclass(frozen=True, slots=True)
class SessionPlan:
    """A session with what the plan makes of it."""

    session: Session
    slots: tuple[PlanSlot, ...]
    soc_end: float
    shortfall_kwh: float
    """Battery kWh by which its end stays under the morning minimum."""

    @property
    def energy_kwh(self) -> float:
        """Planned energy at the plug."""
        return sum(s.power_kw * (s.end - s.start).total_seconds() / 3600.0 for s in self.slots)

    @property
    def intensity_g_per_kwh(self) -> float | None:
        """Mean intensity of what is planned, None where nothing is."""
        energy_kwh = self.energy_kwh
        if energy_kwh <= 0.0:
            return None
        return (
            sum(s.power_kw * (s.end - s.start).total_seconds() / 3600.0 * s.intensity_g_per_kwh for s in self.slots)
            / energy_kwh
        )


@dataclass(frozen=True, slots=True)
class Plan:
    """All sessions of the horizon, and how the solver got there."""

    made_at: datetime
    sessions: tuple[SessionPlan, ...]
    status: str
    solver: str
    carbon_g: float
    gap: float

    def slots(self) -> Iterator[PlanSlot]:
        """Every slot, in order of time."""
        for session in self.sessions:
            yield from session.slots


@dataclass(frozen=True, slots=True)
class Switch:
    """The relay's state from a moment on."""

    at: datetime
    on: bool


@dataclass(frozen=True, slots=True)
class Switching:
    """A relay's orders: sorted switches, good until `until`. Before the first one the relay is off."""

    switches: tuple[Switch, ...]
    until: datetime

    def state(self, now: datetime) -> bool:
        """Whether the relay is wanted on."""
        return next((s.on for s in reversed(self.switches) if s.at <= now), False)

    def next(self, now: datetime, on: bool) -> datetime | None:
        """The next moment at which the relay goes on (or off)."""
        return next((s.at for s in self.switches if s.at > now and s.on is on), None)


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What a modulating charger is told until the next word."""

    power_kw: float
    until: datetime

    def __post_init__(self) -> None:
        if self.power_kw < 0:
            raise ValueError(f"power_kw is {self.power_kw}; plugd only charges")


@dataclass(frozen=True, slots=True)
class Relay:
    """What a plug is told. An off that is not `held` is on a timer: the plug comes on if plugd falls silent."""

    on: bool
    held: bool = False
    """A person's own off, or an electrical cut: no timer."""
    on_by: datetime | None = field(default=None, compare=False)
    """By when the timer of an off has to be over: the last safe start. None: whenever it is."""


Orders = Switching | Setpoint
Wanted = Relay | Setpoint


class Status(StrEnum):
    """What plugd is doing, for hubs and people."""

    WAITING_FOR_FORECAST = "waiting_for_forecast"
    HOLDING = "holding_for_cleaner_night"
    WAITING = "waiting_to_start"
    CHARGING = "charging"
    BOOSTING = "boosting"
    READY = "ready"
    DISCONNECTED = "disconnected"
    OFF = "off"
    FAULT = "fault"


# -- what is remembered ---------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class SocEstimate:
    """State of charge as far as it is known: mean and standard deviation, as fractions of capacity."""

    mean: float
    sd: float
    source: str
    told_at: datetime | None
    """When somebody who knows last said it; None if never."""
    driven_to: datetime
    """Driving up to this moment is already in the mean."""
    meter_kwh: float | None = None
    """The meter's total that the mean includes."""
    metered_at: datetime | None = None
    peak_kw: float = 0.0
    """Highest power since the relay last went on: a fall from it, then nothing, means the car is full."""
    last_kw: float = 0.0
    """Power of the last reading that showed any."""
    car_said: float | None = None
    """The car's last word that was believed, until somebody else says another."""
    doubted: float | None = None
    """A word of the car that was too far off to be believed at once."""
    doubted_at: datetime | None = None
    unseen_kwh: float = 0.0
    """What flowed by the power since the meter's total last moved."""
    lent_kwh: float = 0.0
    """What was counted by the power because the total is not believed; 0 while it is."""


@dataclass(frozen=True, slots=True)
class Overrides:
    """What people set through hub or page. None: the configuration's word counts."""

    mode: Mode = Mode.SMART
    minimum: float | None = None
    ready_by: time | None = None
    horizon: int | None = None
    trips: tuple[Trip, ...] = ()
    """In order of their days. Each is forgotten when its day is over."""
    week: tuple[tuple[int, DayRule], ...] | None = None


@dataclass(frozen=True, slots=True)
class Presence:
    """Whether the car is at the plug, as told; None where nobody said."""

    connected: bool | None = None
    since: datetime | None = None


@dataclass(frozen=True, slots=True)
class Press:
    """A person used the plug's own button. Over at `until`, at a plug-in or unplugging, or at a person's word."""

    on: bool
    until: datetime | None
    after_off: bool = False
    """Whether it has taken back a person's off: the next off is meant again."""


@dataclass(frozen=True, slots=True)
class Cut:
    """Switched off because too much flowed. It stays so until a person sets the mode to off."""

    at: datetime
    current_a: float
    limit_a: float


@dataclass(frozen=True, slots=True)
class Leak:
    """Power that flows through a relay that says it is off. One word of the meter makes none: `sure` does."""

    since: datetime
    metered_at: datetime | None
    energy_kwh: float | None
    """The meter's total as it began."""
    power_kw: float
    sure: bool = False


@dataclass(frozen=True, slots=True)
class Flow:
    """What was seen to flow at a plain plug, beside what should."""

    over_since: datetime | None = None
    """Since when more flows than the socket bears."""
    over_metered_at: datetime | None = None
    """The meter's word that said so first: one alone is not enough."""
    cut: Cut | None = None
    idle_since: datetime | None = None
    """Since when the relay is on and nothing flows."""
    flowed: bool = False
    """Something has flowed since the relay went on."""
    stopped_at: datetime | None = None
    """When the car last stopped by itself. None once it takes power again."""
    woken_for: date | None = None
    """The day whose morning a sleeping car was last woken for."""
    wake_until: datetime | None = None
    """The relay is off to wake the car, until then."""
    wakes: int = 0
    leak: Leak | None = None


@dataclass(frozen=True, slots=True)
class SeenNight:
    """What was observed of one night and the day after it. None: that was not."""

    day: date
    """The local day on which it ended."""
    plug_in_min: float | None = None
    """Minutes after the local midnight before, see `Learned`."""
    plug_out_min: float | None = None
    use_kwh: float | None = None
    """What the battery lost on `day` until the next night, in kWh."""


@dataclass(frozen=True, slots=True)
class Habits:
    """The nights that were seen, and what the next one is being made of."""

    nights: tuple[SeenNight, ...] = ()
    """In order of their days; none older than a few months."""
    arrived_at: datetime | None = None
    """The last plug-in that was told as it happened."""
    left_at: datetime | None = None
    """The unplugging after it."""
    level_kwh: float | None = None
    """The battery by its last word and what flowed since, with nothing taken off for driving."""
    full: bool = False
    """That word was a car that had stopped taking power, and not a number."""
    day: date | None = None
    """The morning that the last word's night, or the day before it, leads to."""
    used_kwh: float = 0.0
    """What the battery lost since the morning before `day`."""
    whole: bool = False
    """That counts from a word of the night before on."""
    late: bool = False
    """The last word came when the car was home for the night."""


@dataclass(frozen=True, slots=True)
class Memory:
    """All that one tick leaves for the next, and for the next start of the daemon."""

    soc: SocEstimate
    overrides: Overrides = field(default_factory=Overrides)
    presence: Presence = field(default_factory=Presence)
    plan: Plan | None = None
    orders: Orders | None = None
    relay_on: bool | None = None
    """What the relay was last told or seen to be."""
    relay_since: datetime | None = None
    switch_ons: tuple[datetime, ...] = ()
    """When the plan switched it on, in the last day."""
    press: Press | None = None
    guarding: bool = False
    """The guard has fired and holds on until the minimum is measured as reached."""
    guard_count: int = 0
    observed_kw: float | None = None
    """Power the car really takes, smoothed."""
    flow: Flow = field(default_factory=Flow)
    on_by: datetime | None = None
    """By when the timer of the off in force is over, where the plug's timer is fixed."""
    habits: Habits = field(default_factory=Habits)
    moved: tuple[datetime, ...] = ()
    """When the relay was last moved by somebody else, in ten minutes."""
    moved_over: str = ""
    """The topic over which it was moved, as far as it was heard."""
    contested_until: datetime | None = None
    """So long plugd leaves the relay to whoever else switches it, but for the guard."""


@dataclass(frozen=True, slots=True)
class Savings:
    """Grams saved against charging on arrival: in the night under way or just over, and since the ledger began."""

    today_g: float
    total_g: float


@dataclass(frozen=True, slots=True)
class Decision:
    """What one tick decided, and why."""

    at: datetime
    memory: Memory
    status: Status
    reason: str
    sessions: tuple[Session, ...]
    outlook: Outlook | None
    forecast_issued_at: datetime | None = None
    faults: tuple[Fault, ...] = ()
    answers: tuple[Answer, ...] = ()
    saved: Savings | None = None
    """None where no ledger is kept."""
    running_since: datetime | None = None
    """When the program that decides was started."""


@dataclass(frozen=True, slots=True)
class Record:
    """One line of the log that reports are made of: a half hour or less."""

    at: datetime
    soc: float
    power_kw: float | None
    energy_kwh: float | None
    on: bool
    status: Status
    reason: str
    intensity_g_per_kwh: float | None
