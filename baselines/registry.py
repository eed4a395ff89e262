"""Every classical controller by name: how it is made for a scenario, and what of it can be tuned.

A controller is designed on the nominal model alone; one that a scenario does not suit says so by a
ScenarioError. Values that `shake tune` has found for a named scenario stand in ``tuned.json`` and are
taken unless others are given.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import resources
from typing import Any

from baselines.lqg import lqg
from baselines.lqr import lqr
from shake_env.controller import Controller, NoControl
from shake_env.errors import ParameterError, ScenarioError, unknown
from shake_env.scenario import Scenario


@dataclass(frozen=True)
class Tunable:
    """A free parameter of a controller, searched between `low` and `high`.

    Raises
    ------
    ParameterError
        Unless ``low <= default <= high``, above 0 where the search is logarithmic.
    """

    low: float
    high: float
    default: float
    logarithmic: bool = True

    def __post_init__(self) -> None:
        ordered = self.low <= self.default <= self.high and self.low < self.high
        if not ordered or (self.logarithmic and self.low <= 0.0):
            raise ParameterError("tunable range", self, "needs low <= default <= high, above 0 if log")


@dataclass(frozen=True)
class Baseline:
    """A classical controller that can be asked for by name."""

    make: Callable[..., Controller]  # of a scenario, and its tunable parameters by keyword
    summary: str
    tunable: Mapping[str, Tunable] = field(default_factory=dict)


BASELINES: dict[str, Baseline] = {
    "none": Baseline(lambda scenario: NoControl(), "zero current: the table that does nothing"),
    "lqr": Baseline(lqr, "sampled-data LQR on the full state"),
    "lqg": Baseline(
        lqg,
        "sampled-data LQR on a Kalman filter's estimate, the loop delay predicted away",
        {"model_error": Tunable(0.002, 0.2, 0.02)},
    ),
}


def make_baseline(
    name: str, scenario: Scenario, parameters: Mapping[str, float] | None = None
) -> Controller:
    """Return the controller called `name`, designed on a scenario's nominal model.

    Parameters
    ----------
    name
        Of `BASELINES`.
    scenario
        What it is to drive.
    parameters
        Its tunable parameters; None takes what was tuned for the scenario's name, and defaults else.

    Raises
    ------
    ScenarioError
        If there is none of that name, a parameter is unknown, or the scenario does not suit it.
    """
    if name not in BASELINES:
        raise unknown(ScenarioError, "controller", name, BASELINES)
    baseline = BASELINES[name]
    chosen = tuned_parameters(name, scenario.name) if parameters is None else dict(parameters)
    for each in chosen:
        if each not in baseline.tunable:
            raise unknown(ScenarioError, f"parameter of {name}", each, baseline.tunable)
    values = {each: tunable.default for each, tunable in baseline.tunable.items()} | chosen
    return baseline.make(scenario, **values)


def tuned_parameters(name: str, scenario_name: str) -> dict[str, float]:
    """Return the tuned parameters of a controller for a named scenario; none where nothing was tuned."""
    found = _tuned().get(scenario_name, {}).get(name, {}).get("parameters", {})
    return {each: float(value) for each, value in found.items()}


@lru_cache(maxsize=1)
def _tuned() -> dict[str, Any]:
    file = resources.files("baselines") / "tuned.json"
    if not file.is_file():
        return {}
    found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return found


def reference_name(scenario: Scenario) -> str:
    """Return the controller that costs are relative to: LQR, with an estimator where it needs one."""
    return "lqr" if scenario.sensing.full_state else "lqg"
