"""The regions that the forecast knows by number: the areas of the network operators, and three nations."""

from difflib import get_close_matches
from itertools import zip_longest

REGIONS = {
    1: "North Scotland",
    2: "South Scotland",
    3: "North West England",
    4: "North East England",
    5: "Yorkshire",
    6: "North Wales and Merseyside",
    7: "South Wales",
    8: "West Midlands",
    9: "East Midlands",
    10: "East England",
    11: "South West England",
    12: "South England",
    13: "London",
    14: "South East England",
    15: "England",
    16: "Scotland",
    17: "Wales",
}
"""By the Carbon Intensity API's `regionid`."""
NATION = ("gb", "great britain", "britain", "nation", "national", "uk")
LEAST_LETTERS = 4
"""Fewer may be a postcode."""
LONGEST = 40
"""No name is longer."""
MOST_NEAR = 3


def region_of(text: str) -> int | None:
    """The region that is called so, or alone begins so."""
    word = text.casefold()
    exact = [number for number, name in REGIONS.items() if name.casefold() == word]
    begun = [number for number, name in REGIONS.items() if name.casefold().startswith(word)]
    found = exact or (begun if len(word) >= LEAST_LETTERS else [])
    return found[0] if len(found) == 1 else None


def near(text: str) -> tuple[str, ...]:
    """The regions that may have been meant by a name that is none's, or that several begin with."""
    word = text.casefold()
    begun = [name for name in REGIONS.values() if name.casefold().startswith(word)]
    close = get_close_matches(word[:LONGEST], [name.casefold() for name in REGIONS.values()], MOST_NEAR)
    return tuple(begun or [name for name in REGIONS.values() if name.casefold() in close])


def listed() -> str:
    """All of them, two beside each other."""
    half = (len(REGIONS) + 1) // 2
    names = [f"{number:>2} {name}" for number, name in REGIONS.items()]
    return "\n".join(
        f"  {one:<30}{other}".rstrip() for one, other in zip_longest(names[:half], names[half:], fillvalue="")
    )
