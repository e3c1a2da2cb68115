"""Every implementation of the plug contract, with the world around it."""

from collections.abc import Callable, Iterator
from typing import cast

import pytest

from plugd_hil.broker import Mosquitto
from tests.contract.rigs import KINDS, RIGS, WITH_DEAD_MAN, Rig


def _params(names: tuple[str, ...]) -> list[object]:
    marks = {kind: [pytest.mark.requires("mosquitto")] for kind in KINDS}
    return [pytest.param(name, marks=marks.get(name, []), id=name.replace(" ", "-")) for name in names]


def _broker(request: pytest.FixtureRequest) -> Callable[[], Mosquitto]:
    return lambda: cast(Mosquitto, request.getfixturevalue("mosquitto"))


@pytest.fixture(params=_params(tuple(RIGS)))
def rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    """Each implementation: car connected and half full, relay off."""
    yield from RIGS[request.param](_broker(request))


@pytest.fixture(params=_params(WITH_DEAD_MAN))
def dead_man(request: pytest.FixtureRequest) -> Iterator[Rig]:
    """Those that come on by themselves, and have a button."""
    yield from RIGS[request.param](_broker(request))
