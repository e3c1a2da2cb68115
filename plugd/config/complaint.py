"""Turns what pydantic and tomllib say into one line for a person: key, value, what to write instead."""

import json
import re
from collections.abc import Iterable, Mapping
from datetime import time
from pathlib import Path
from typing import Any

MASKED = ("pass", "secret", "token", "apikey", "api_key")
"""A key with one of these words in it is never shown with its value, wherever it was written."""
USER = re.compile(r"[^/@\s\"]*@")
"""A user, and perhaps a password, in front of a host."""

MUST = {
    "bool_type": "must be true or false, without quotes",
    "int_type": "must be a whole number, without quotes",
    "float_type": "must be a number, without quotes",
    "string_type": "must be text in quotes",
    "model_type": "must be a table: [{key}]",
    "dict_type": "must be a table: [{key}]",
    "finite_number": "must be a finite number",
    "greater_than": "must be more than {gt:g}",
    "greater_than_equal": "must be at least {ge:g}",
    "less_than": "must be less than {lt:g}",
    "less_than_equal": "must be at most {le:g}",
    "string_too_short": "must not be empty",
    "string_too_long": "must be at most {max_length} characters long",
    "string_pattern_mismatch": "may hold letters, digits, - and _, at most 32 of them",
    "literal_error": "must be one of {expected}",
    "value_error": "{error}",
    "impossible": "{remedy}",
}
"""What each of pydantic's errors means here, filled from its own context and `key`."""

UNITS: tuple[tuple[str, str, float, float, str], ...] = (
    ("_kwh", "le", 1e-3, 1.0, "Wh"),
    ("_kw", "le", 1e-3, 0.5, "W"),
    ("_a", "le", 1e-3, 1.0, "mA"),
    ("_min", "le", 1 / 60, 4.0, "seconds"),
    ("efficiency", "le", 1e-2, 0.3, "percent"),
    ("confidence", "le", 1e-2, 0.5, "percent"),
    ("bitrate", "ge", 1e3, 10_000.0, "kbit/s"),
)
"""(end of the key, bound that is broken, factor, least plausible, unit): values that pass in another."""


def one_line(text: str, limit: int = 80) -> str:
    """`text` on one line: whatever a terminal would act on is escaped, and what is long is cut."""
    shown = text if text.isprintable() else text.encode("unicode_escape").decode("ascii")
    return shown if len(shown) <= limit else shown[: limit - 1] + "…"


def shown(value: Any, key: str = "") -> str:
    """A value as the file has it, short, on one line, and never a secret's."""
    leaf = key.rpartition(".")[2].lower()
    match value:
        case _ if any(word in leaf for word in MASKED) and not leaf.endswith("_file"):
            return "***"
        case bool():
            return "true" if value else "false"
        case str() | Path():
            return one_line(USER.sub("***@", json.dumps(str(value), ensure_ascii=False)))
        case int() if _huge(value):
            return "(a huge number)"
        case time():
            return f'"{value:%H:%M}"'
        case Mapping():
            return "(a table)"
        case list() | tuple():
            return "(a list)"
        case _:
            return one_line(str(value))


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The known word that was probably meant."""
    from difflib import get_close_matches  # noqa: PLC0415 - for who mistyped; the daemon is spared it

    known, word = list(known), word.lower()
    by_start = [k for k in known if len(word) > 2 and (k.startswith(word) or word.startswith(k))]
    close = get_close_matches(word, [k.lower() for k in known], n=1) if len(word) < 100 else []
    return next((k for k in known if [k.lower()] == close), by_start[0] if by_start else None)


def _unknown(key: str, known: tuple[str, ...]) -> str:
    """What to write for a key that nothing is called: a neighbour, its place, or the list."""
    table, _, leaf = key.rpartition(".")
    here = [k.rpartition(".")[2] for k in known if k.rpartition(".")[0] == table]
    elsewhere = {k.rpartition(".")[2]: k for k in reversed(known)}  # the first of a name counts
    meant = nearest(leaf, here)
    if meant:
        return f"is no key; did you mean {table + '.' if table else ''}{meant}?"
    meant = leaf if leaf in elsewhere else nearest(leaf, elsewhere)
    if meant:
        return f"is no key; did you mean {elsewhere[meant]}?"
    if not here:
        return "is no key, and stands in no table that there is"
    return f"is no key; known {'in [' + table + ']' if table else 'here'}: {', '.join(here)}"


def _in_another_unit(key: str, value: Any, context: Mapping[str, Any]) -> str | None:
    """A word on the unit, where that explains a number out of range."""
    if not isinstance(value, int | float) or _huge(value):
        return None
    for end, bound, factor, least, unit in UNITS:
        meant = value * factor
        if key.endswith(end) and bound in context and meant >= least and (bound == "ge" or meant <= context[bound]):
            return f"looks like {unit}; write {meant:g}"
    return None


def _huge(value: object) -> bool:
    """Whether a number is too long to be worked with or printed."""
    return isinstance(value, int) and value.bit_length() > 128


def _one_of(template: str, word: str) -> str:
    """A list of allowed words, and the one that was probably meant."""
    guess = nearest(word, re.findall(r"'(\w+)'", template))
    return f"{template}; did you mean '{guess}'?" if guess else template


def complaint(error: Mapping[str, Any], known: tuple[str, ...]) -> str:
    """One of pydantic's errors in our words. `known`: every dotted key there is."""
    context = error.get("ctx", {})
    path, value = [str(part) for part in error["loc"]], context.get("value", error["input"])
    if path[-1:] == ["[key]"]:  # no value is wrong, but a key of nights.week
        path, value = path[:-1], None
    key = context.get("key", ".".join(path))
    kind = error["type"]
    if kind == "extra_forbidden":
        remedy = _unknown(key, known)
    elif kind in MUST:
        remedy = MUST[kind].format(**{**context, "key": key})
        remedy = _in_another_unit(key, value, context) or remedy
    else:
        remedy = one_line(error["msg"])
    if kind == "literal_error":
        remedy = _one_of(remedy, value if isinstance(value, str) else path[-1])
    mistyped_secret = kind == "extra_forbidden" and any(word in remedy for word in MASKED)
    is_set = "" if value is None else f" = {'***' if mistyped_secret else shown(value, key)}"
    return f"{one_line(key)}{is_set}: {remedy}"


def not_toml(error: Exception, text: str) -> str:
    """A syntax error in our words, with line and column first."""
    found = re.search(r" \(at (line \d+, column \d+)\)$", str(error))
    lines = text.split("\n")
    place = found[1] if found else f"line {len(lines)}, column {len(lines[-1]) + 1}"
    said = re.sub(r" \(at .*\)$", "", str(error))
    return f"{place}: not TOML: {one_line(said)}; one `key = value` a line, text and times in quotes"
