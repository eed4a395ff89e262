"""Stage costs over time: of controllers, of one told the plant, of policies with cleared memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.policies.policy_file import PolicyFile
from agents.policies.registry import get_controller
from baselines.planning.informed import InformedPredictiveControl
from shake_env.controller import Controller
from shake_env.errors import ParameterError, ScenarioError
from shake_env.model.parameters import FloatArray
from shake_env.rollout import Earthquake, begin_rollout, run_rollout
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.engine import BoolArray, StepResult

INFORMED = "nmpc-informed"  # told the plant; not a controller of the registry


@dataclass(frozen=True)
class StageCosts:
    """Stage costs of a controller, without what a broken limit costs."""

    costs: FloatArray  # (T, N); 0 after an episode has ended
    lost: NDArray[np.bool_]  # (N,) whether a limit was broken


class _CostLog:
    """Keeps the stage cost of each control period."""

    def __init__(self) -> None:
        self.rows: list[FloatArray] = []

    def add(self, result: StepResult, running: BoolArray) -> None:
        self.rows.append(np.where(running, -result.reward - result.limit_cost, 0.0))


class ClearedMemory:
    """A policy whose memory is set to rest once; estimates of its base law stay.

    Parameters
    ----------
    policy
        With a memory.
    period
        Control period at whose decision the memory is at rest.

    Raises
    ------
    ParameterError
        If it is no policy with a memory.
    """

    def __init__(self, policy: Controller, period: int) -> None:
        if not isinstance(policy, PolicyFile) or policy.memory is None:
            raise ParameterError(
                "controller", type(policy).__name__, "has no memory: name a policy with one"
            )
        self._policy, self._period, self._arrays = policy, period, len(policy.memory.state_widths)

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the action and the memory, which counts the periods besides."""
        count, own = (0, None) if state is None else (state[0], state[1:])
        if count == self._period and own is not None:
            own = (*(np.zeros_like(part) for part in own[: self._arrays]), *own[self._arrays :])
        action, own = self._policy.predict(observation, own, episode_start, deterministic)
        return action, (count + 1, *(own or ()))


def stage_costs(
    name: str,
    scenario: Scenario,
    earthquakes: Sequence[Earthquake],
    cleared_at: int | None = None,
    on_step: Callable[[float], None] = lambda share: None,
) -> StageCosts:
    """Return the stage costs of a controller on earthquakes.

    Parameters
    ----------
    name
        As `agents.policies.registry.get_controller` takes it, or ``nmpc-informed``.
    scenario, earthquakes
        What it drives.
    cleared_at
        Control period at which the memory of a policy is cleared; None: never.
    on_step
        Told the share of the work done, 0 to 1.

    Raises
    ------
    ScenarioError
        If the scenario draws no plant to be told.
    ParameterError
        If a memory is to be cleared and the controller is no policy with one.
    """
    simulation, observation = begin_rollout(scenario, earthquakes)
    controller: Controller
    if name == INFORMED:
        plants = simulation.plant_batch
        if plants is None:
            raise ScenarioError("uncertainty", "none", "draws nothing to adapt to: name field")
        controller = InformedPredictiveControl(scenario, plants.plant)
    else:
        controller = get_controller(name, scenario)
    if cleared_at is not None:
        controller = ClearedMemory(controller, cleared_at)
    log, steps = _CostLog(), int(simulation.episode_steps.max())
    broken = run_rollout(controller, simulation, observation, [log], on_step)
    costs = np.stack(log.rows)
    costs = np.pad(costs, ((0, steps - len(costs)), (0, 0)))  # a roll-out ends when no table runs
    return StageCosts(costs, np.array([reason is not None for reason in broken]))
