"""Series as files, as `plugd study` is given them."""

from pathlib import Path

from plugd_hil.synthetic import synthetic_year


def written(path: Path, days: int) -> Path:
    """The first days of 2023, with forecasts 5 % too high and too low in turn."""
    found = synthetic_year(days=days)
    rows = (
        f"{at:%Y-%m-%dT%H:%MZ},{g},{g * (1.05 if at.hour % 2 else 0.95):.1f}"
        for at, g in zip(found.times(), found.actual, strict=True)
        if g
    )
    path.write_text("\n".join(["from,actual,forecast", *rows]))
    return path
