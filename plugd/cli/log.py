"""How log lines look: for a person at a terminal or in a file, and for systemd's journal, which has its own time."""

import logging
import os
import sys

PRIORITIES = ((logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6), (logging.DEBUG, 7))
"""(from this level on, syslog's number for it): `journalctl -p warning` finds what failed."""


class LogLine(logging.Formatter):
    """One line: when (not in the journal), how bad (where it is), of whom (where it is not of plugd), and what."""

    def __init__(self, journal: bool, named: bool) -> None:
        super().__init__(datefmt="%Y-%m-%d %H:%M:%S")
        self._journal = journal
        self._named = named

    def format(self, record: logging.LogRecord) -> str:
        """The line; a traceback follows on lines of its own."""
        said = super().format(record)
        whose = f"{record.name}: " if self._named or not record.name.startswith("plugd") else ""
        if self._journal:
            return f"<{_priority(record.levelno)}>{whose}{said}"
        level = "" if record.levelno == logging.INFO else f"{record.levelname}: "
        return f"{self.formatTime(record, self.datefmt)} {level}{whose}{said}"


def _priority(level: int) -> int:
    return next((number for least, number in PRIORITIES if level >= least), 7)


def _to_journal() -> bool:
    """Whether stderr goes to systemd's journal, which says so by device and inode."""
    try:
        found = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError):  # closed, or no file at all
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{found.st_dev}:{found.st_ino}"


def begin(level: int, verbose: bool) -> None:
    """Log to stderr from this level on; everything, and who said it, where that is wanted."""
    lines = logging.StreamHandler()
    lines.setFormatter(LogLine(_to_journal(), named=verbose))
    logging.basicConfig(level=logging.DEBUG if verbose else level, handlers=[lines])
    logging.getLogger("apscheduler").setLevel(logging.WARNING)
