"""The configuration as the daemon gets it: read in a process of its own, which hands over the values.

Pydantic and the models of the file take 9 MiB and are wanted for a fifth of a second. What comes has the same names, is
frozen as the models are, and has nothing of their methods.
"""

import pickle  # nosec B403 # what our own child wrote is read
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import make_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plugd.errors import ConfigError

if TYPE_CHECKING:
    from plugd.config.whole import Config

PATIENCE_S = 30.0
"""A slow machine takes some 3 s."""
MARK = b"\0plugd\0"
"""What goes before the values: something of the site's may print at every start of Python."""


def table(name: str, values: Mapping[str, Any]) -> Any:
    """A frozen dataclass of the values."""
    return make_dataclass(name, values, frozen=True)(**values)


def python(module: str) -> tuple[str, ...]:
    """The command of a child, which looks into the current folder only where this process does.

    With -m alone it always would, and run a `token.py` of whoever works there.
    """
    with suppress(OSError):  # the folder may be gone
        if {"", str(Path.cwd())} & set(sys.path):
            return (sys.executable, "-m", module)
    return (sys.executable, "-P", "-m", module)


def load(path: Path) -> "Config":
    """As `plugd.config.load`, read by a child; by this process where there can be none. Raises ConfigError."""
    command = (*python("plugd.config"), str(path))
    try:
        said = subprocess.run(command, stdout=subprocess.PIPE, timeout=PATIENCE_S, check=True).stdout
        found: Config | ConfigError = pickle.loads(said.partition(MARK)[2])  # nosec B301 # from our own child, by a pipe
    except (OSError, subprocess.SubprocessError, EOFError, pickle.UnpicklingError):
        from plugd.config import loading  # noqa: PLC0415 - what the daemon is otherwise spared

        return loading.load(path)
    if isinstance(found, ConfigError):
        raise found
    return found
