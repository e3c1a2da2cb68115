"""What the C library keeps of memory that nobody uses any more, given back.

glibc gives each thread an arena of its own, and keeps what is free in the middle of one: 3.6 of 61 MB after four days
with the page open. Elsewhere (musl, macOS) nothing is done, and nothing needs to be.
"""

import ctypes
from collections.abc import Callable

M_TRIM_THRESHOLD, M_ARENA_MAX = -1, -8
TOP_BYTES = 1 << 16
"""What may be free at the heap's end before it is given back at once."""
EVERY_S = 1800.0


def _of_the_c_library(name: str) -> Callable[..., int] | None:
    try:
        found: Callable[..., int] = getattr(ctypes.CDLL(None), name)
    except (OSError, AttributeError):
        return None
    return found


class Allocator:
    """The C library's, from now on with one arena: the interpreter's lock lets one thread at a time allocate anyway."""

    def __init__(self) -> None:
        self._trim = _of_the_c_library("malloc_trim")
        self._due_s = 0.0
        if limit := _of_the_c_library("mallopt"):
            limit(M_ARENA_MAX, 1)
            limit(M_TRIM_THRESHOLD, TOP_BYTES)

    def tidy(self, now_s: float) -> None:
        """Give back what is free, every half hour of the monotonic clock: it takes a millisecond."""
        if self._trim is not None and now_s >= self._due_s:
            self._due_s = now_s + EVERY_S
            self._trim(0)
