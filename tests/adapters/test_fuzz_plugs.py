"""A few thousand of the payloads of `make fuzz`, the same in every run."""

import pytest

from tests.fuzz_plugs import CORPUS, throw


@pytest.mark.parametrize("kind", list(CORPUS))
def test_no_payload_breaks_a_plug_or_makes_it_do_what_it_may_not(kind: str) -> None:
    assert throw(kind, 1500, seed=7) > 0, "not one value was nonsense: the fuzzer does not reach the parser"
