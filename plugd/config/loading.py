"""Reading the file. What comes out can be trusted; what cannot be is a ConfigError of one line."""

import os
import tomllib
from pathlib import Path
from typing import get_args, get_origin

from pydantic import BaseModel, ValidationError

from plugd.config.complaint import complaint, not_toml, one_line
from plugd.config.secret_files import SECRET_FILES, content_of, secret_at
from plugd.config.whole import Config
from plugd.errors import ConfigError

MAX_BYTES = 256 * 1024
"""No configuration is this long; a log or a disk image named by mistake is."""


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


def _check_files(config: Config, name: str) -> None:
    """That the files named can be used, found out now and not at the first connection."""
    try:
        for key in SECRET_FILES:
            secret_at(config, key)
        if config.broker.ca_file is not None:
            content_of("broker.ca_file", config.broker.ca_file, MAX_BYTES)
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}") from error
