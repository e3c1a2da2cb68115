"""The error tree. Adapters raise these `from` the library's own, so that the cycle knows what it may catch.

PlugdError
├── ConfigError          the configuration file: exit 78
├── UsageError           an argument or an input file: exit 2
├── AlreadyRunning       another daemon holds the state folder: exit 75
├── ForecastError        ForecastUnavailable (ForecastLate) | ForecastMalformed
├── PlugError            PlugTimeout | PlugRefused | PlugFault
└── StoreError
"""


class PlugdError(Exception):
    """Whatever plugd itself reports. Its text is one line for a person: what is wrong, where, what to do."""


class ConfigError(PlugdError):
    """The configuration cannot be used."""


class UsageError(PlugdError):
    """A command's argument or input file cannot be used."""


class AlreadyRunning(PlugdError):
    """Another daemon works with the same state folder."""


class ForecastError(PlugdError):
    """No forecast this time."""


class ForecastUnavailable(ForecastError):
    """The source did not answer, or answered that it cannot."""


class ForecastLate(ForecastUnavailable):
    """The answer is under way: ask again in a few seconds."""


class ForecastMalformed(ForecastError):
    """The source answered something that is not a forecast."""


class PlugError(PlugdError):
    """The plug did not do or tell what it was asked."""


class PlugTimeout(PlugError):
    """No word from the plug in time, or no connection to it."""


class PlugRefused(PlugError):
    """The plug answered, and is not in the wanted state."""


class PlugFault(PlugError):
    """The plug reports a fault of its own."""


class SolveError(PlugdError):
    """No plan from a solver."""


class StoreError(PlugdError):
    """State cannot be read or written."""
