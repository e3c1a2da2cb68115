"""What the fuzz programs share: how inputs are counted, and what an error may look like."""

from dataclasses import dataclass

LONGEST = 600


@dataclass(slots=True)
class Count:
    """Inputs thrown at one parser."""

    tried: int = 0
    taken: int = 0
    refused: int = 0


def readable(error: Exception, given: object) -> str:
    """The error's text: one line that a terminal can show. Raises AssertionError for another."""
    text = str(error)
    if not text or not text.isprintable() or len(text) > LONGEST:
        raise AssertionError(f"an error that no person can read, {text!r}, after {given!r}")
    return text
