"""Memory is given back where the C library can be told to, and nothing happens where it cannot."""

import subprocess
import sys

import pytest

from plugd.adapters import allocator
from plugd.adapters.allocator import EVERY_S, Allocator
from tests.programs import environment

PROGRAM = """
import ctypes
from pathlib import Path
from plugd.adapters.allocator import Allocator

def resident_kb():
    return int(Path("/proc/self/status").read_text().split("VmRSS:")[1].split()[0])

tidy = Allocator().tidy
libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p
pieces = []
for _ in range(1000):
    pieces.append(libc.malloc(60_000))
    ctypes.memset(ctypes.c_void_p(pieces[-1]), 1, 60_000)
    libc.malloc(3000)  # kept: what lies between them the C library does not give back by itself
for piece in pieces:
    libc.free(ctypes.c_void_p(piece))
before = resident_kb()
tidy(0.0)
print(before - resident_kb())
"""


@pytest.mark.skipif(allocator._of_the_c_library("malloc_trim") is None, reason="the C library has no malloc_trim")
def test_what_is_free_in_the_middle_is_given_back() -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, env=environment()
    )
    assert int(done.stdout) > 50_000


def test_it_is_done_every_half_hour(monkeypatch: pytest.MonkeyPatch) -> None:
    trimmed: list[int] = []
    monkeypatch.setattr(allocator, "_of_the_c_library", lambda name: trimmed.append if name == "malloc_trim" else None)
    tidy = Allocator().tidy
    for now_s in (0.0, 10.0, EVERY_S - 1.0, EVERY_S, EVERY_S + 10.0):
        tidy(now_s)
    assert len(trimmed) == 2


def test_where_the_c_library_cannot_nothing_happens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(allocator, "_of_the_c_library", lambda name: None)
    Allocator().tidy(0.0)
    monkeypatch.undo()
    assert allocator._of_the_c_library("no_such_function") is None
