"""Configuration and state in one document, for a bug report. Secrets are in files of their own and not in it."""

import platform
from datetime import datetime, timedelta
from typing import Any

from pydantic import TypeAdapter

from plugd import __version__
from plugd.adapters.store import SqliteStore
from plugd.config import Config
from plugd.config.complaint import USER
from plugd.daemon import state_folder
from plugd.domain import Memory, Overrides, Record
from plugd.errors import StoreError
from plugd.inspection import readable

SINCE = timedelta(days=2)
LAST = 50
"""Lines of the log that are shown."""
WINS = {
    "minimum": "nights.morning_minimum_pct",
    "ready_by": "nights.ready_by",
    "horizon": "nights.horizon",
    "week": "nights.week",
}
"""What hub or page may set, and the key that it is used instead of."""


def dumped(config: Config, now: datetime) -> dict[str, Any]:
    """The document. What hub or page set is named beside the keys that it wins over."""
    document: dict[str, Any] = {
        "plugd": __version__,
        "python": platform.python_version(),
        "machine": platform.platform(),
        "at": now.isoformat(),
        "configuration": _without_users(config.model_dump(mode="json")),
        "not_in_the_file": sorted(key for key in _flat(config) if key not in _flat(config, only_set=True)),
    }
    try:
        return document | _state(config, now)
    except StoreError as error:
        return document | {"state": str(error)}


def _state(config: Config, now: datetime) -> dict[str, Any]:
    """What is stored. Raises StoreError."""
    folder = readable(state_folder(config))
    if folder is None:
        return {"state": f"{state_folder(config)}: nothing is stored yet"}
    with SqliteStore(folder, hold=False) as store:
        memory = store.load()
        lines = store.records(now - SINCE)[-LAST:]
        forecast = store.latest_forecast()
    return {
        "wins_over_the_file": _winners(memory.overrides) if memory else {},
        "memory": TypeAdapter(Memory).dump_python(memory, mode="json") if memory else None,
        "log": TypeAdapter(tuple[Record, ...]).dump_python(lines, mode="json"),
        "forecast": forecast
        and {
            "issued_at": forecast.issued_at.isoformat(),
            "region": forecast.region,
            "half_hours": len(forecast.expected),
            "until": forecast.expected[-1].start.isoformat() if forecast.expected else None,
        },
    }


def _winners(set_by_people: Overrides) -> dict[str, Any]:
    """Key of the configuration, or `mode` and `trips`: what was set."""
    told = TypeAdapter(Overrides).dump_python(set_by_people, mode="json")
    found = {WINS.get(name, name): value for name, value in told.items() if value is not None and value != []}
    return found if found.get("mode") != "smart" else {key: found[key] for key in found if key != "mode"}


def _flat(config: Config, *, only_set: bool = False) -> dict[str, Any]:
    """Dotted keys of all tables, or of those that the file has."""
    tables = config.model_dump(mode="json", exclude_unset=only_set)
    found: dict[str, Any] = {}
    for name, value in tables.items():
        if isinstance(value, dict):
            found |= {f"{name}.{key}": item for key, item in value.items()}
        else:
            found[name] = value
    return found


def _without_users(value: Any) -> Any:
    """Addresses without a user before the host."""
    if isinstance(value, dict):
        return {key: _without_users(item) for key, item in value.items()}
    return USER.sub("***@", value) if isinstance(value, str) else value
