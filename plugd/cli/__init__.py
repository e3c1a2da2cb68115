"""The commands. Each is thin: it reads arguments, calls one function, prints, and turns errors into exit codes.

A command, or a group of them, is a module here with an `add` that `program.COMMANDS` names.
"""

from plugd.cli.parsing import Parser
from plugd.cli.program import main, parser

__all__ = ["Parser", "main", "parser"]
