"""The configuration file `etc/plugd.toml`: closed models of its tables, and the door that reads it.

The models stand on pydantic. It is imported by who asks for them, and not by the daemon, which is handed their values.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from plugd.config.reading import household
from plugd.config.secret_files import password, token

if TYPE_CHECKING:
    from plugd.config.loading import known_keys, load, parse
    from plugd.config.whole import Config, doubts
else:
    _MODULES = {"known_keys": "loading", "load": "loading", "parse": "loading", "Config": "whole", "doubts": "whole"}

    def __getattr__(name: str) -> Any:
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


__all__ = ["Config", "doubts", "household", "known_keys", "load", "parse", "password", "token"]
