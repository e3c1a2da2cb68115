"""The program: its arguments, its log, its exit codes."""

import argparse
import logging
import sys
from collections.abc import Sequence
from contextlib import suppress

from plugd import __version__
from plugd.cli import apart, check, dump, forecast, history, init, plan, plug, report, run
from plugd.cli.log import begin
from plugd.cli.parsing import DEFAULT_CONFIG, Commands, Parser
from plugd.errors import AlreadyRunning, ConfigError, PlugdError, UsageError

EXIT_CODES: tuple[tuple[type[PlugdError], int], ...] = (
    (ConfigError, 78),
    (AlreadyRunning, 75),
    (UsageError, 2),
    (PlugdError, 1),
)
COMMANDS = (
    run.add,
    apart.add,
    init.add,
    check.add,
    plan.add,
    forecast.add,
    history.add,
    report.add,
    plug.add,
    dump.add,
)
"""In the order of `plugd --help`."""


def parser() -> Parser:
    """The arguments of every command, but of those that read their own."""
    whole = Parser(
        prog="plugd",
        description="Charge an electric car when the grid is cleanest, over several nights at once.",
    )
    whole.add_argument("-c", "--config", metavar="FILE", help=f"default: $PLUGD_CONFIG, else {DEFAULT_CONFIG}")
    whole.add_argument("-v", "--verbose", action="store_true", help="say more on stderr")
    whole.add_argument("--version", action="version", version=f"plugd {__version__}")
    commands = Commands(whole.add_subparsers(dest="command", required=True, metavar="COMMAND"))
    for add in COMMANDS:
        add(commands)
    return whole


def _parsed(given: Sequence[str]) -> argparse.Namespace:
    whole = parser()  # gone when the command begins: the daemon's would take its place for years
    options, rest = whole.parse_known_args(given)
    if options.reads_rest:
        options.rest = rest
    elif rest:
        whole.error(f"unrecognized arguments: {' '.join(rest)}")
    return options


def _commanded(given: Sequence[str]) -> int:
    options = _parsed(given)
    code: int
    if options.reads_rest:
        code = options.does(options)
        return code
    # Only the daemon's log is read by somebody; the other commands say all that matters themselves.
    level = logging.INFO if options.command == "run" else logging.ERROR
    begin(level, options.verbose)
    code = options.does(options)
    return code


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command. Returns the exit code; errors are one line on stderr."""
    try:
        try:
            return _commanded(list(sys.argv[1:] if arguments is None else arguments))
        finally:
            sys.stdout.flush()  # here, where a closed pipe is expected, and not at the interpreter's end
    except PlugdError as error:
        print(f"plugd: {error}", file=sys.stderr)
        return next(code for kind, code in EXIT_CODES if isinstance(error, kind))
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        with suppress(OSError):
            sys.stdout.close()
        return 1
