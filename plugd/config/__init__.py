"""The configuration file `etc/plugd.toml`: closed models of its tables, and the door that reads it."""

from plugd.config.loading import household, known_keys, load, parse, password, token
from plugd.config.whole import Config, doubts

__all__ = ["Config", "doubts", "household", "known_keys", "load", "parse", "password", "token"]
