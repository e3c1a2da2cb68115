"""Reading the file. What comes out can be trusted; what cannot be is a ConfigError of one line."""

import os
import stat
import tomllib
from pathlib import Path
from typing import Any, get_args, get_origin

from pydantic import BaseModel, SecretStr, ValidationError

from plugd.config.complaint import complaint, not_toml, one_line
from plugd.config.sections import DaySection
from plugd.config.whole import Config, at
from plugd.domain import Capability, Car, DayRule, Household, Nights, RelayRules
from plugd.errors import ConfigError
from plugd.units import from_pct

MAX_BYTES = 256 * 1024
"""No configuration is this long; a log or a disk image named by mistake is."""

MAX_SECRET_BYTES = 4096
SECRET_FILES = ("broker.password_file", "web.token_file")
WEEKDAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")


def load(path: Path) -> Config:
    """The configuration in `path`. Raises ConfigError: file, key, value and remedy on one line."""
    name = one_line(str(path), 200)
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise ConfigError(f"{name}: no such file; plugd init writes one, or name another with -c") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "not a file name"
        raise ConfigError(f"{name}: cannot be read ({reason}); name a file plugd may read with -c") from error
    if len(content) > MAX_BYTES:
        raise ConfigError(f"{name}: longer than {MAX_BYTES // 1024} KiB; is this the right file?")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ConfigError(f"{name}: line {line}: not UTF-8; save it as UTF-8 text") from error
    config = parse(text, name, path.parent, os.environ.get("CREDENTIALS_DIRECTORY"))
    _check_files(config, name)
    return config


def parse(text: str, name: str = "plugd.toml", folder: Path = Path(), credentials: str | None = None) -> Config:
    """The configuration in `text`. `name` is told in errors; relative paths count from `folder`.

    A secret's file is looked for in `credentials` first, systemd's folder for those.
    """
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{name}: {not_toml(error, text)}") from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{name}: not TOML: a number too long or lists too deep; shorten it") from error
    try:
        return Config.model_validate(raw, context={"folder": folder, "credentials": credentials})
    except ValidationError as error:
        (_, first), *others = complaints(error)
        more = f" (and {len(others)} more)" if others else ""
        raise ConfigError(f"{name}: {first}{more}") from None


def complaints(error: ValidationError) -> tuple[tuple[str, str], ...]:
    """What is wrong with a document, each as (dotted key, the line for a person)."""
    known = known_keys()
    return tuple(
        (one.get("ctx", {}).get("key") or ".".join(str(part) for part in one["loc"]), complaint(one, known))
        for one in error.errors(include_url=False)
    )


def known_keys(model: type[BaseModel] = Config, under: str = "") -> tuple[str, ...]:
    """Every dotted key of the models, tables included, in the order of the file."""
    keys: list[str] = []
    for name, field in model.model_fields.items():
        key, kind = under + name, field.annotation
        keys.append(key)
        if get_origin(kind) is dict:  # nights.week: a table for each weekday
            names, kind = get_args(kind)
            for each in get_args(names):
                keys += [f"{key}.{each}", *known_keys(kind, f"{key}.{each}.")]
        elif isinstance(kind, type) and issubclass(kind, BaseModel):
            keys += known_keys(kind, f"{key}.")
    return tuple(keys)


def password(config: Config) -> SecretStr | None:
    """What `broker.password_file` holds now. Raises ConfigError."""
    return _secret(config, "broker.password_file")


def token(config: Config) -> SecretStr | None:
    """What `web.token_file` holds now. Raises ConfigError."""
    return _secret(config, "web.token_file")


def household(config: Config, capability: Capability) -> Household:
    """What the core works with: SOC as fractions, dwell in seconds. `capability` is the plug's own."""
    car, nights, relay = config.car, config.nights, config.relay
    return Household(
        timezone=config.home.timezone,
        car=Car(
            capacity_kwh=car.capacity_kwh,
            efficiency=car.efficiency,
            soc_min=from_pct(car.soc_min_pct),
            soc_max=from_pct(car.soc_max_pct),
            taper_from=from_pct(car.taper_from_pct),
            taper_share=from_pct(car.taper_share_pct),
            soc_max_age_s=car.soc_max_age_min * 60,
            daily_use_kwh=car.daily_use_kwh,
            daily_use_sd_kwh=car.daily_use_sd_kwh,
        ),
        nights=Nights(
            horizon=nights.horizon,
            plug_in=nights.plug_in,
            plug_in_sd_min=nights.plug_in_sd_min,
            plug_out=nights.plug_out,
            plug_out_sd_min=nights.plug_out_sd_min,
            ready_by=nights.ready_by,
            confidence=nights.confidence,
            minimum=from_pct(nights.morning_minimum_pct),
            default_window=nights.default_window,
            learn=nights.learn,
            week=tuple(sorted((WEEKDAYS.index(name), _rule(day)) for name, day in nights.week.items())),
        ),
        relay=RelayRules(
            min_on_s=relay.min_on_min * 60,
            min_off_s=relay.min_off_min * 60,
            max_switch_on=relay.max_switch_on,
            random_delay_s=relay.random_delay_s,
        ),
        capability=capability,
        max_current_a=config.plug.max_current_a,
        mains_voltage_v=config.plug.mains_voltage_v,
        guard_margin_s=relay.random_delay_s + 1800,
    )


def _rule(day: DaySection) -> DayRule:
    minimum = None if day.minimum_pct is None else from_pct(day.minimum_pct)
    return DayRule(ready_by=day.ready_by, minimum=minimum, away=day.away)


def _check_files(config: Config, name: str) -> None:
    """That the files named can be used, found out now and not at the first connection."""
    try:
        for key in SECRET_FILES:
            _secret(config, key)
        if config.broker.ca_file is not None:
            _content("broker.ca_file", config.broker.ca_file, MAX_BYTES)
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}") from error


def _secret(config: Config, key: str) -> SecretStr | None:
    path: Path | None = at(config, key)
    if path is None:
        return None
    content = _content(key, path, MAX_SECRET_BYTES)
    said = _said(key, path)
    if path.stat().st_mode & stat.S_IROTH:
        raise ConfigError(f"{said}: everyone may read it; chmod 600 {one_line(str(path), 200)}")
    return secret(content, said)


def secret(content: bytes, said: str) -> SecretStr:
    """What a secret's file holds. Raises ConfigError, which `said` names."""
    try:
        word = content.decode("utf-8").rstrip("\r\n")
    except UnicodeDecodeError:
        raise ConfigError(f"{said}: not UTF-8; write the secret alone, on one line") from None
    if not word or not word.isprintable():
        raise ConfigError(f"{said}: must hold the secret alone, on one line")
    return SecretStr(word)


def _content(key: str, path: Path, limit: int) -> bytes:
    try:
        with path.open("rb") as file:
            content = file.read(limit + 1)
    except OSError as error:
        raise ConfigError(
            f"{_said(key, path)}: cannot be read ({error.strerror}); create it, readable to plugd's user"
        ) from error
    if len(content) > limit:
        raise ConfigError(f"{_said(key, path)}: longer than {limit} bytes; is this the right file?")
    return content


def _said(key: str, path: Any) -> str:
    return f'{key} = "{one_line(str(path), 200)}"'
