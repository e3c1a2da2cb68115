"""What a single value of the configuration may be. Each refusal says what to write instead."""

from datetime import time
from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import urlsplit
from zoneinfo import ZoneInfo, available_timezones

from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo

from plugd.config.complaint import nearest


def clock(value: object) -> time:
    """A local clock time, from "HH:MM" or TOML's own 18:00:00."""
    if isinstance(value, time) and not (value.second or value.microsecond):
        return value
    if isinstance(value, str) and len(value) == 5 and value[2] == ":" and value.isascii():
        hours, minutes = value[:2], value[3:]
        if hours.isdigit() and minutes.isdigit() and int(hours) < 24 and int(minutes) < 60:
            return time(int(hours), int(minutes))
    raise ValueError('must be a clock time of 24 hours in quotes, like "07:30"')


def window(value: object) -> tuple[time, time]:
    """Two clock times, from "HH:MM-HH:MM"; the second may be next morning."""
    if isinstance(value, str) and value.count("-") == 1:
        start, end = (clock(part.strip()) for part in value.split("-"))
        if start != end:
            return start, end
        raise ValueError("begins when it ends; write two different times")
    raise ValueError('must be two clock times in quotes, like "23:00-06:00"')


def path(value: object, info: ValidationInfo) -> Path:
    """A path; a relative one counts from the configuration file's folder."""
    if not isinstance(value, str) or not value or "\0" in value:
        raise ValueError("must be the path of a file or folder, in quotes")
    if value.startswith("~"):
        raise ValueError("~ is not expanded here; write the whole path")
    return Path((info.context or {}).get("folder", ""), value)


def secret_file(value: object, info: ValidationInfo) -> Path:
    """A path as above, of a secret. What systemd handed over under that file's name (LoadCredential=) goes first."""
    named = path(value, info)
    folder = (info.context or {}).get("credentials")
    if folder is None:
        return named
    handed = Path(folder, named.name)
    return handed if handed.is_file() and handed.read_bytes().strip() else named  # the stand-in for none is blank


def timezone(value: str) -> str:
    """A name of the time zone database."""
    try:
        ZoneInfo(value)
    except (KeyError, ValueError, OSError):
        hint = nearest(value, sorted(available_timezones())) or 'a name like "Europe/London"'
        raise ValueError(f"is no time zone; write {hint}") from None
    return value


def postcode(value: str) -> str:
    """The outward code, upper case: all that the forecast's source looks at."""
    outward = value.strip().upper()
    if 2 <= len(outward) <= 4 and outward.isascii() and outward.isalnum() and outward[0].isalpha():
        return outward
    raise ValueError('must be the first half of a postcode, like "SW1" or "RG10"')


def topic(value: str) -> str:
    """An MQTT topic to write to."""
    if any(c in value for c in "+#\0\n\r") or value.startswith(("/", "$")) or value.endswith("/"):
        raise ValueError("must be a plain MQTT topic: no + # $, no / at either end")
    return value


def plug_topic(value: str) -> str:
    """A topic in which `{topic}` stands for the plug's own; empty where the plug has none."""
    if value:
        topic(value.replace("{topic}", "topic"))
    return value


def url(value: str) -> str:
    """A server's address, without a closing slash."""
    try:
        parts = urlsplit(value)
        usable = parts.scheme in ("http", "https") and parts.hostname and parts.port != 0
    except ValueError:  # a bad port or bracket
        usable = False
    if not usable or parts.query or parts.fragment or not value.isprintable() or " " in value:
        raise ValueError("must be the address of a server: http:// or https://, a host, no query")
    if parts.username or parts.password:
        raise ValueError("must hold no user or password")
    return value.rstrip("/")


def host(value: str) -> str:
    """A machine's name or address."""
    if any(c in value for c in "@/ ") or not value.isprintable():
        raise ValueError("must be a name or an address alone; port, username and password_file are keys of their own")
    return value


def bind(value: str) -> str:
    """Where to listen."""
    host, _, port = value.rpartition(":")
    if host and port.isascii() and port.isdigit() and 0 < len(port) < 6 and int(port) < 65536:
        return value
    raise ValueError('must be an address and a port, like "127.0.0.1:8480"')


def percent(value: float) -> float:
    """Percent, not a fraction."""
    if 0 < value < 1:
        raise ValueError(f"looks like a fraction; write percent: {value * 100:g}")
    return value


Clock = Annotated[time, BeforeValidator(clock)]
Window = Annotated[tuple[time, time], BeforeValidator(window)]
File = Annotated[Path, BeforeValidator(path)]
SecretFile = Annotated[Path, BeforeValidator(secret_file)]
Percent = Annotated[float, Field(ge=0, le=100), AfterValidator(percent)]
Text = Annotated[str, Field(min_length=1, max_length=200)]
Topic = Annotated[Text, AfterValidator(topic)]
PlugTopic = Annotated[str, Field(max_length=200), AfterValidator(plug_topic)]
Word = Annotated[str, Field(max_length=200)]
Weekday = Literal["mon", "tue", "wed", "thu", "fri", "sat", "sun"]
PlugKind = Literal[
    "tasmota", "shelly2", "openevse", "mqtt", "can_elcon", "shelly1", "zigbee2mqtt", "esphome"
]  # fmt: skip
