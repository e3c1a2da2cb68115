"""`python -m plugd.config FILE`: reads the file for `plugd.config.handed`, and says on stdout what it found."""

import pickle  # nosec B403 # it only writes
import sys
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from plugd.config.handed import MARK, table
from plugd.config.loading import load
from plugd.errors import ConfigError


class _Values(pickle.Pickler):
    """Of a model only its values."""

    def reducer_override(self, value: Any) -> Any:
        return (table, (type(value).__name__, vars(value))) if isinstance(value, BaseModel) else NotImplemented


def main() -> int:
    """The child."""
    found: object
    try:
        found = load(Path(sys.argv[1]))
    except ConfigError as error:
        found = error
    sys.stdout.buffer.write(MARK)
    _Values(sys.stdout.buffer).dump(found)
    return 0


if __name__ == "__main__":
    sys.exit(main())
