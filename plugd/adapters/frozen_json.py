"""Frozen dataclasses as JSON, and back by their hints: what the daemon keeps is read without pydantic's 9 MiB.

Known are dataclasses, tuples, unions, enums, moments, days, clock times and JSON's own values. A key that no field has
is passed over, a field that no key has takes its default: what an older or a newer plugd wrote is read.
"""

import json
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from datetime import date, time
from enum import Enum
from functools import cache
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

Frozen = TypeVar("Frozen")
Read = Callable[[Any], Any]

_UNFIT = (TypeError, AttributeError, KeyError, OverflowError, RecursionError)
"""What a value of another shape raises beside ValueError."""


def dump(value: object) -> bytes:
    """Raises ValueError for a number that JSON has no word for."""
    return json.dumps(value, default=_plain, separators=(",", ":"), allow_nan=False).encode()


def read(kind: Callable[..., Frozen], body: bytes | str) -> Frozen:
    """Raises ValueError for what was not written from that kind."""
    try:
        found: Frozen = _reader(kind)(json.loads(body))
    except _UNFIT as error:
        raise ValueError(f"it is nothing that was kept ({error})") from error
    return found


def _plain(value: Any) -> Any:
    """What JSON does not know in what it does."""
    if isinstance(value, date | time):  # a datetime is a date
        return value.isoformat()
    return {field.name: getattr(value, field.name) for field in fields(value)}


@cache
def _reader(kind: Any) -> Read:
    """Reads a value of a kind, as a dataclass's hint names it."""
    parts = get_args(kind)
    if get_origin(kind) in (Union, UnionType):
        return _one_of(tuple(map(_reader, parts)))
    if get_origin(kind) is tuple:
        return _each(_reader(parts[0])) if parts[1:] == (...,) else _in_order(tuple(map(_reader, parts)))
    if is_dataclass(kind):
        return _made(kind)
    found: Read = kind if issubclass(kind, Enum) else getattr(kind, "fromisoformat", _exactly(kind))
    return found


def _made(kind: Any) -> Read:
    readers = {name: _reader(hint) for name, hint in get_type_hints(kind).items()}

    def read(value: Any) -> Any:
        return kind(**{name: readers[name](item) for name, item in value.items() if name in readers})

    return read


def _each(reader: Read) -> Read:
    return lambda value: tuple(map(reader, _exactly(list)(value)))


def _in_order(readers: tuple[Read, ...]) -> Read:
    def read(value: Any) -> Any:
        return tuple(reader(item) for reader, item in zip(readers, value, strict=True))

    return read


def _one_of(readers: tuple[Read, ...]) -> Read:
    """The first that can read it."""

    def read(value: Any) -> Any:
        for reader in readers[:-1]:
            try:
                return reader(value)
            except (ValueError, *_UNFIT):
                continue
        return readers[-1](value)

    return read


def _exactly(kind: Any) -> Read:
    """A value that JSON has itself; a whole number is a number too, and true is none."""
    kinds = {float: (float, int)}.get(kind, (kind,))

    def read(value: Any) -> Any:
        if type(value) not in kinds:
            raise ValueError(f"{value!r:.40} is no {kind.__name__}")
        return None if kind is NoneType else kind(value)

    return read
