"""The store with a second copy of the memory: one JSON file beside the database, replaced in one go.

Flash cards damage files that nobody was writing. What people have set must outlive that: mode, minimum, trips, and how
full the car is. Two generations are kept, each with its checksum; a torn or empty one is passed over.
"""

import hashlib
import os
from contextlib import suppress
from datetime import datetime, timedelta
from pathlib import Path

from plugd.adapters.store import SqliteStore, remembered, worded
from plugd.domain import Memory
from plugd.errors import StoreError

COPY, OLDER = "memory.json", "memory.1.json"
EVERY = timedelta(hours=2)
"""Of the plan; what people say is copied at once."""


def replaced(path: Path, body: bytes) -> None:
    """Write a file so that it is the old one or the new one whenever the power fails. Raises OSError."""
    fresh = path.with_name(path.name + ".new")
    with fresh.open("wb") as file:
        file.write(body)
        file.flush()
        os.fsync(file.fileno())
    fresh.rename(path)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def sealed(body: bytes) -> bytes:
    """A body under its checksum."""
    return hashlib.sha256(body).hexdigest().encode() + b"\n" + body


def opened(path: Path) -> bytes | None:
    """The body of a sealed file; None where there is none, or it is not whole."""
    try:
        seal, _, body = path.read_bytes().partition(b"\n")
    except OSError:
        return None
    return body if hashlib.sha256(body).hexdigest().encode() == seal else None


class KeptTwice(SqliteStore):
    """The daemon's store. Reading falls back on the copy; a copy that cannot be written is an error as any other."""

    def __init__(self, folder: Path, hold: bool = True) -> None:
        """Raises StoreError, AlreadyRunning."""
        super().__init__(folder, hold)
        self._folder = folder
        self._said: object = None
        self._copied_at: datetime | None = None
        self.fell_back = False
        """Whether the last `load` had to take the copy."""

    def load(self) -> Memory | None:
        """The last saved memory, from the copy where the database lacks it. Raises StoreError where neither helps."""
        self.fell_back = False
        try:
            memory = super().load()
        except StoreError:
            memory = self._copy()
            if memory is None:
                raise
        else:
            if memory is not None:
                return memory
            memory = self._copy()
        self.fell_back = memory is not None
        return memory

    def save(self, memory: Memory) -> None:
        """Keep the memory in both. Raises StoreError."""
        try:
            super().save(memory)
        finally:
            self._keep_copy(memory)

    def _keep_copy(self, memory: Memory) -> None:
        said = (memory.overrides, memory.presence, memory.press, memory.soc.told_at, memory.flow.cut)
        made_at = memory.plan.made_at if memory.plan else None
        due = self._copied_at is None or (made_at is not None and abs(made_at - self._copied_at) >= EVERY)
        if said == self._said and not due:
            return
        path, body = self._folder / COPY, worded(memory)
        try:
            with suppress(FileNotFoundError):
                path.rename(self._folder / OLDER)
            replaced(path, sealed(body))
        except OSError as error:
            raise StoreError(f"{path}: {error.strerror}; make room, and check its owner and the card") from error
        self._said, self._copied_at = said, made_at or self._copied_at

    def _copy(self) -> Memory | None:
        """The newest copy that is whole and can be read."""
        for name in (COPY, OLDER):
            body = opened(self._folder / name)
            if body is None:
                continue
            with suppress(ValueError):
                return remembered(body)
        return None
