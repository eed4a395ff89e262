"""The scenario for training: shorter episodes, early termination, rewards of the order of 1."""

from __future__ import annotations

import math
import os
from dataclasses import replace

import gymnasium

from shake_env.errors import ParameterError, ScenarioError
from shake_env.model.parameters import is_number
from shake_env.motion.targets import FilteredNoise
from shake_env.scenario.limits import Limits
from shake_env.scenario.overrides import Overrides, make_scenario
from shake_env.scenario.scenario import Scenario

HORIZON = 0.25  # [s] over which the discount decays to 1 / e
GAMMA = 0.98  # [-] discount per control period of 5 ms for that horizon
EPISODE = 10.0  # [s]
STATE_LIMIT = 12.0  # [-] multiples of a state's rms


def make_training_scenario(
    scenario: str | os.PathLike[str] | Scenario = "linear",
    overrides: Overrides | None = None,
    *,
    horizon: float = HORIZON,
    duration: float | None = EPISODE,
    state_limit: float = STATE_LIMIT,
) -> Scenario:
    """Return a scenario with shorter episodes and a tighter bound on the scaled state.

    Without limits an episode only ends when a scaled state exceeds 1000. An untrained policy then spends
    its episodes in states with stage costs of 10^4 to 10^6, from which nothing useful is learned. Here
    an episode ends at `state_limit`. That costs what a motionless table would pay over `horizon`, times
    `Limits.cost_factor`. A scenario with limits of its own keeps them.

    Parameters
    ----------
    scenario
        Name (``"linear"``), Gymnasium id (``"ShakeTable-linear-v0"``, with or without ``shake_env:``) or
        a scenario.
    overrides
        As for :func:`shake_env.make_scenario`.
    horizon
        Time over which the discount decays to 1 / e [s]; see :func:`horizon_of`.
    duration
        Duration of an episode of filtered noise [s]; None: the scenario's own.
    state_limit
        Bound of each scaled state [multiples of its rms].

    Raises
    ------
    ScenarioError
        If the scenario is unknown, or reserved for testing, as ``records`` is.
    ParameterError
        If a number is outside its range.
    """
    made = make_scenario(find_scenario(scenario), overrides)
    if made.reserved_for_testing:
        remedy = f"is reserved for testing: train on {made.train_on}, which has the same table"
        raise ScenarioError("scenario", made.name, remedy)
    if made.limits == Limits():
        limits = Limits(state_limit=state_limit, cost_horizon=horizon)
        made = replace(made, limits=limits)
    if isinstance(made.motion, FilteredNoise) and duration is not None:
        made = replace(made, motion=replace(made.motion, duration=duration))
    return made


def reward_scale(scenario: Scenario, gamma: float) -> float:
    """Return the factor on rewards that makes values of the order of a stage cost at unit amplitude.

    ``(1 - gamma) / amplitude^2``. Unscaled values are 1 / (1 - gamma) times that, and a value function
    spends thousands of gradient steps on growing to that size while the policy follows its noise.
    """
    horizon_of(gamma, scenario.control_period)
    motion = scenario.motion
    noise = isinstance(motion, FilteredNoise) and motion.amplitude
    return (1.0 - gamma) / (motion.amplitude**2 if noise else 1.0)


def horizon_of(gamma: float, control_period: float) -> float:
    """Return the time [s] over which a discount `gamma` per control period [s] decays to 1 / e.

    Raises
    ------
    ParameterError
        If gamma is not above 0 and below 1.
    """
    if not (is_number(gamma) and 0.0 < gamma < 1.0):
        raise ParameterError("gamma", gamma, "must lie above 0 and below 1")
    return -control_period / math.log(gamma)


def checked_action_scale(value: float) -> float:
    """Return the valve current of action 1 as a fraction of the current limit.

    Raises
    ------
    ParameterError
        If it is not above 0, or above 1.
    """
    if not (is_number(value) and 0.0 < value <= 1.0):
        raise ParameterError("action_scale", value, "must lie above 0 and not above 1")
    return float(value)


def find_scenario(scenario: str | os.PathLike[str] | Scenario) -> str | os.PathLike[str] | Scenario:
    """Return the scenario that a Gymnasium id stands for; a name or a scenario as it is."""
    if not isinstance(scenario, str):
        return scenario
    spec = gymnasium.registry.get(scenario.removeprefix("shake_env:"))
    if spec is None or spec.entry_point != "shake_env.env:ShakeTableEnv":
        return scenario
    name: str | Scenario = spec.kwargs.get("scenario", "linear")
    return name
