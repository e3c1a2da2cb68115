"""What commands share: how they are added, which configuration is meant, how words of progress are shown."""

import argparse
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from plugd.config import Config

DEFAULT_CONFIG = Path("/etc/plugd/plugd.toml")

Does = Callable[[argparse.Namespace], int]
"""Runs a command. Returns the exit code; raises PlugdError for one line on stderr."""


class Parser(argparse.ArgumentParser):
    """argparse with the one line of every other error."""

    def error(self, message: str) -> NoReturn:
        """Say it on one line and end with 2."""
        print(f"{self.prog}: {message}; {self.prog} --help tells more", file=sys.stderr)
        raise SystemExit(2)


@dataclass(frozen=True, slots=True)
class Commands:
    """Where commands are added."""

    found: "argparse._SubParsersAction[Parser]"

    def add(self, name: str, does: Does, text: str) -> Parser:
        """A command, and the parser for its arguments."""
        command = self.found.add_parser(name, help=text, description=text)
        command.set_defaults(does=does, reads_rest=False)
        return command

    def add_apart(self, name: str, does: Does, text: str) -> None:
        """A command that reads its own arguments from `options.rest`, `--help` among them."""
        self.found.add_parser(name, add_help=False, help=text).set_defaults(does=does, reads_rest=True)


def config_path(options: argparse.Namespace) -> Path:
    """The configuration's file: of `-c`, of the environment, or the usual one."""
    return Path(options.config or os.environ.get("PLUGD_CONFIG") or DEFAULT_CONFIG)


def configured(options: argparse.Namespace) -> "Config | None":
    """The configuration, where there is one; one that was named must be there. Raises ConfigError."""
    from plugd.config import load

    path = config_path(options)
    named = options.config or os.environ.get("PLUGD_CONFIG")
    return load(path) if named or path.exists() else None


def progress(words: str) -> None:
    """Say how far it is, where a person looks."""
    if sys.stderr.isatty():
        print(words, file=sys.stderr)


def day(text: str) -> date:
    """An argument that is a date."""
    try:
        return date.fromisoformat(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is no date; write it as 2023-01-31") from error
