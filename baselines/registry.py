"""Every classical controller by name: how it is made for a scenario, and what it is.

A controller is designed on the scenario's nominal model alone. One that a scenario does not suit says so
by a ScenarioError.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from baselines.lqr import lqr
from shake_env.controller import Controller, NoControl
from shake_env.errors import ScenarioError, unknown
from shake_env.scenario import Scenario


@dataclass(frozen=True)
class Baseline:
    """A classical controller that can be asked for by name."""

    make: Callable[[Scenario], Controller]
    summary: str


BASELINES: dict[str, Baseline] = {
    "none": Baseline(lambda scenario: NoControl(), "zero current: the table that does nothing"),
    "lqr": Baseline(lqr, "sampled-data LQR on the full state"),
}


def make_baseline(name: str, scenario: Scenario) -> Controller:
    """Return the controller called `name`, designed on a scenario's nominal model.

    Raises
    ------
    ScenarioError
        If there is none of that name, or the scenario does not suit it.
    """
    if name not in BASELINES:
        raise unknown(ScenarioError, "controller", name, BASELINES)
    return BASELINES[name].make(scenario)


def reference_name(scenario: Scenario) -> str:
    """Return the controller that costs are relative to: LQR, with an estimator where it needs one."""
    return "lqr" if scenario.sensing.full_state else "lqg"
