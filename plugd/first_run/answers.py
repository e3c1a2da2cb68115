"""From what a person types to values of the configuration. What a value may be is for `plugd.config` alone to say."""

import re
from collections.abc import Callable
from datetime import time
from pathlib import Path
from typing import Any, get_args

from pydantic import ValidationError

from plugd.config import Config
from plugd.config.loading import complaints
from plugd.config.reading import at
from plugd.config.values import PlugKind
from plugd.config.values import clock as clock_time
from plugd.first_run.places import NATION, near, region_of

Value = str | int | float | bool
Answers = dict[str, Value]
"""By dotted key."""
Reader = Callable[[str], Answers]
"""From a line to what it means. Raises ValueError, saying what is wanted."""

DEFAULTS = Config.model_validate({"plug": {"topic": "ev-plug"}})
KINDS: tuple[str, ...] = get_args(PlugKind)
YES_NO = {"y": True, "yes": True, "true": True, "n": False, "no": False, "false": False}

KWH_PER_KM = 0.2
"""The paper takes 5 kWh for 25 km."""
KM = {"km": 1.0, "kilometres": 1.0, "mi": 1.609344, "mile": 1.609344, "miles": 1.609344}
DAYS_A_YEAR = 365.25
NONE = "-"
"""Takes back an answer that Enter would repeat."""
LONGEST = 1e12
"""What is longer is no number of anything here."""
USE_SPREAD = DEFAULTS.car.daily_use_sd_kwh / DEFAULTS.car.daily_use_kwh
"""Who drives more is taken to vary as much more."""


def nested(answers: Answers) -> dict[str, dict[str, Value]]:
    """As the file has them: tables of keys."""
    tables: dict[str, dict[str, Value]] = {}
    for key, value in answers.items():
        table, _, leaf = key.partition(".")
        tables.setdefault(table, {})[leaf] = value
    return tables


def configured(answers: Answers, folder: Path) -> Config:
    """The configuration that the answers so far would be. Raises pydantic's ValidationError."""
    return Config.model_validate(nested({"plug.topic": "to be asked", **answers}), context={"folder": folder})


def refusal(answers: Answers, asked: tuple[str, ...], later: frozenset[str], folder: Path) -> str | None:
    """Why the configuration does not take the answer to the keys `asked`; None where it does.

    What is wrong with a key of `later` is not yet: that is still to be asked.
    """
    try:
        configured(answers, folder)
    except ValidationError as error:
        wrong = complaints(error)
        ours = [text for key, text in wrong if key in asked]
        return next(iter([*ours, *(text for key, text in wrong if key not in later)]), None)
    return None


def written(value: Any) -> str:
    """A value of the configuration as a person would type it."""
    match value:
        case None:
            return ""
        case bool():
            return "y" if value else "n"
        case time():
            return f"{value:%H:%M}"
        case float():
            return f"{value:g}"
        case _:
            return str(value)


def default(key: str) -> str:
    """The configuration's own default, as it would be typed."""
    return written(at(DEFAULTS, key))


# -- readers --------------------------------------------------------------------------------------


def _number(text: str) -> int | float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return int(value) if value.is_integer() and abs(value) < LONGEST else value


def number(key: str, unit: str = "") -> Reader:
    """A number, with or without its unit."""

    def read(text: str) -> Answers:
        bare = re.sub(rf"\s*{re.escape(unit)}$", "", text, flags=re.IGNORECASE) if unit else text
        value = _number(bare)
        if value is None:
            raise ValueError(f"a number{f' of {unit}' if unit else ''} is wanted")
        return {key: value}

    return read


def word(key: str) -> Reader:
    """A word as it is."""
    return lambda text: {key: text}


def unless_none(read: Reader) -> Reader:
    """The same, and a dash for nothing."""
    return lambda text: {} if text == NONE else read(text)


def clock(key: str) -> Reader:
    """A clock time; the hour may be of one digit."""

    def read(text: str) -> Answers:
        whole = f"0{text}" if re.fullmatch(r"[0-9]:[0-9]{2}", text) else text
        try:
            clock_time(whole)
        except ValueError:
            raise ValueError("a time of 24 hours is wanted, like 07:30") from None  # quotes are for the file
        return {key: whole}

    return read


def yes_no(key: str) -> Reader:
    """Yes or no."""

    def read(text: str) -> Answers:
        if text.casefold() not in YES_NO:
            raise ValueError("y or n is wanted")
        return {key: YES_NO[text.casefold()]}

    return read


def file(key: str) -> Reader:
    """The path of a file or folder; ~ is the home of who types it."""

    def read(text: str) -> Answers:
        try:
            return {key: str(Path(text).expanduser().absolute()) if text.startswith("~") else text}
        except (RuntimeError, ValueError) as error:
            raise ValueError(f"{error}; write the whole path") from None

    return read


def place(text: str) -> Answers:
    """A region by number or name, the first half of a postcode, or the whole nation."""
    if text.casefold() in NATION:
        return {}
    number, named = _number(text), region_of(text)
    region = named if number is None else number
    if region is not None:
        return {"home.region_id": region}
    if not any(letter.isdigit() for letter in text):  # so it is no postcode
        meant = near(text)
        guess = f"; did you mean {' or '.join(meant)}?" if meant else ""
        raise ValueError(f'a region is wanted, its number, or the first half of a postcode, like "SW1"{guess}')
    return {"home.postcode": text.split(maxsplit=1)[0]}


def kind(text: str) -> Answers:
    """A kind of plug, by its number in the list or its name."""
    numbered = {str(place): name for place, name in enumerate(KINDS, start=1)}
    return {"plug.kind": numbered.get(text, text.casefold())}


def daily_use(text: str) -> Answers:
    """Battery kWh a day, or a distance a year; the spread goes with it."""
    distance = re.fullmatch(r"([0-9.,]+)\s*([a-z]+)(?: (?:a|per) year)?", text.casefold())
    if distance and distance[2] in KM:
        value = _number(distance[1].replace(",", ""))
        use_kwh = None if value is None else round(value * KM[distance[2]] * KWH_PER_KM / DAYS_A_YEAR, 1)
    else:
        use_kwh = _number(re.sub(r"\s*kwh(?: (?:a|per) day)?$", "", text, flags=re.IGNORECASE))
    if use_kwh is None:
        raise ValueError('kWh a day are wanted, or a distance a year, like "8000 miles"')
    return {"car.daily_use_kwh": use_kwh, "car.daily_use_sd_kwh": round(use_kwh * USE_SPREAD, 2)}
