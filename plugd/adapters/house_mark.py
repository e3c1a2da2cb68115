"""What sets this house apart from all that were set up like it: a few letters beside the store, drawn once.

Random delays and pauses are drawn from it. From the configuration alone a thousand houses with the names of the
manual would switch, and ask NESO again, in the same second.
"""

import secrets
from contextlib import suppress
from pathlib import Path

from plugd.adapters.kept_twice import opened, replaced, sealed

FILE = "house"


def house_mark(folder: Path) -> str:
    """The letters, drawn at the first start. On a disk that keeps nothing they are others at each."""
    kept = opened(folder / FILE)
    return drawn(folder, secrets.token_hex(8)) if not kept else kept.decode("ascii", "replace")


def drawn(folder: Path, mark: str) -> str:
    """Keep these letters, where that can be. Simulations choose them, so as to be the same every time."""
    with suppress(OSError):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        replaced(folder / FILE, sealed(mark.encode("ascii")))
    return mark
