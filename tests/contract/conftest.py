"""Every implementation of the plug contract, with the world around it."""

from collections.abc import Callable, Iterator
from typing import cast

import pytest

from plugd_hil.broker import Mosquitto
from tests.contract.rigs import OVER_A_BROKER, RIGS, SLOW, Rig


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Time is real here: what waits for silence or a timer is tested of every plug only when asked for."""
    if config.getoption("--every-plug"):
        return
    kept: list[pytest.Item] = []
    left: list[pytest.Item] = []
    for item in items:
        name = getattr(item, "callspec", None) and item.callspec.params.get("rig_name")  # type: ignore[attr-defined]
        (left if name in SLOW and item.get_closest_marker("quick") is None else kept).append(item)
    items[:] = kept
    config.hook.pytest_deselected(items=left)


def _params(names: tuple[str, ...]) -> list[object]:
    needs = [pytest.mark.requires("mosquitto")]
    return [
        pytest.param(name, marks=needs if name in OVER_A_BROKER else [], id=name.replace(" ", "-")) for name in names
    ]


def _broker(request: pytest.FixtureRequest) -> Callable[[], Mosquitto]:
    return lambda: cast(Mosquitto, request.getfixturevalue("mosquitto"))


@pytest.fixture
def rig(request: pytest.FixtureRequest, rig_name: str) -> Iterator[Rig]:
    """The implementation of this name: car connected and half full, relay off."""
    yield from RIGS[rig_name](_broker(request))


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Every implementation that a test is about."""
    if "rig" in metafunc.fixturenames:
        about = metafunc.definition.get_closest_marker("about")
        metafunc.parametrize("rig_name", _params(about.args[0] if about else tuple(RIGS)))
