"""What fails at the moment: each fault by its code, and by what failed where that has several ways to."""

from collections.abc import Iterator
from dataclasses import dataclass, field

from plugd.domain import Fault


@dataclass(slots=True)
class Register:
    """The faults that stand."""

    _standing: dict[tuple[str, str], Fault] = field(default_factory=dict)

    def stand(self, code: str, text: str, what: str = "") -> None:
        """It fails, or fails still."""
        self._standing[code, what] = Fault(code, text)

    def end(self, code: str, what: str = "") -> None:
        """It works, or works again."""
        self._standing.pop((code, what), None)

    def stands(self, code: str, what: str = "") -> bool:
        """Whether it fails."""
        return (code, what) in self._standing

    def __iter__(self) -> Iterator[Fault]:
        return iter(tuple(self._standing.values()))
