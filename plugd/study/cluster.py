"""The same runs on a Dask cluster: an executor like any other, whose workers may be on other machines."""

from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any

from plugd.errors import PlugdError, UsageError

ANSWER_WITHIN_S = 10


class Cluster(Executor):
    """Runs on the workers of the scheduler at `address`, which must have plugd in the same version."""

    def __init__(self, address: str) -> None:
        """Connect. Raises UsageError without Dask or for no address, PlugdError where no scheduler answers."""
        try:
            from distributed import Client  # noqa: PLC0415 - an extra of its own
        except ImportError as error:
            raise UsageError("--dask: Dask is missing; pip install 'plugd[dask]', or use --workers") from error
        try:
            client: Any = Client  # whose signature Dask does not tell
            self._client = client(address, timeout=ANSWER_WITHIN_S, set_as_default=False)
        except ValueError as error:
            raise UsageError(f"--dask {address}: {error}; write it as tcp://host:8786") from error
        except OSError as error:  # among them its TimeoutError
            raise PlugdError(f"--dask {address}: no scheduler answers; start one with `dask scheduler`") from error
        self._executor = self._client.get_executor(pure=False)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Hand one call to the cluster."""
        found: Future[Any] = self._executor.submit(fn, *args, **kwargs)
        return found

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the cluster as it was found."""
        self._executor.shutdown(wait=wait and not cancel_futures)
        self._client.close()
