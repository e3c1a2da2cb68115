"""Runs are independent: one that fails is named, and the others come through."""

import os
import pickle
from dataclasses import replace
from datetime import timedelta
from functools import partial

from plugd.study.engine import Account
from plugd.study.forecasts import Noise
from plugd.study.measured import Measured
from plugd.study.runs import Failure, Here, Run, paper_run, perform, pool, simulated
from tests.study.test_engine import FOUND, START


def runs(*names: str) -> list[Run]:
    return [paper_run(name, FOUND, START, START + timedelta(days=3), horizon=2, seed=k) for k, name in enumerate(names)]


class Deadly(Measured):
    """A series that ends the process that looks into it."""

    __slots__ = ()

    def index(self, moment: object) -> int:
        os._exit(3)


def test_a_run_is_frozen_and_survives_the_way_to_a_worker() -> None:
    run = runs("mpc")[0]
    again = pickle.loads(pickle.dumps(run))
    assert again == run
    assert simulated(again) == simulated(run)


def test_a_run_that_fails_names_its_parameters_and_loses_no_other() -> None:
    told: list[tuple[int, int]] = []
    asked = runs("uncontrolled", "nonsense", "mpc")
    outcomes = perform(asked, Here, lambda done, of: told.append((done, of)))
    assert [type(outcome) for outcome in outcomes] == [Account, Failure, Account]
    text = str(outcomes[1])
    assert text == (
        "run failed: nonsense, a synthetic year 2023-01-01 to 2023-01-04, seed 1, noise target, "
        "end value on, solver exact: UsageError: 'nonsense' is no strategy"
    )
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_a_worker_that_dies_loses_no_other_run() -> None:
    asked = runs("uncontrolled", "uncontrolled")
    asked[1] = replace(asked[1], found=Deadly(FOUND.name, FOUND.start, FOUND.actual, FOUND.error))
    outcomes = perform(asked, partial(pool, 2))
    assert [type(outcome) for outcome in outcomes] == [Account, Failure]
    assert "its worker died" in str(outcomes[1])
    assert "seed 1" in str(outcomes[1])
    assert outcomes[0] == simulated(asked[0])


def test_every_solver_finds_the_same_carbon() -> None:
    exact = paper_run("mpc", FOUND, START, START + timedelta(days=7), horizon=2, noise=Noise.TARGET)
    found, by_osqp = simulated(exact), simulated(replace(exact, solver="osqp"))
    assert abs(by_osqp.carbon_g / found.carbon_g - 1) < 0.005  # over a year, ties cancel to less than 0.001
    assert by_osqp != found  # it was another solver


def test_the_same_run_gives_the_same_account() -> None:
    run = runs("mpc")[0]
    assert simulated(run) == simulated(run)
    other = replace(run, world=replace(run.world, driver=replace(run.world.driver, seed=9)))
    assert simulated(other) != simulated(run)
