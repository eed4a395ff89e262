"""Gymnasium wrappers that run a planner beside the tables and append its plan to the observation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from agents.learning.plan_batch import PlanBatch
from agents.learning.training_scenario import checked_action_scale
from agents.policies.plan_law import PlanLaw, PlanOptions
from shake_env.env import ShakeTableEnv
from shake_env.errors import ParameterError
from shake_env.model.inputs import batch_action, checked_action
from shake_env.model.parameters import FloatArray
from shake_env.scenario.limits import OBSERVATION_BOUND
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.engine import LaneState
from shake_env.vector_env import ShakeTableVectorEnv

Observation = NDArray[np.float32]


class PlanWrapper(
    gymnasium.Wrapper[Observation, Observation, Observation, Observation],
    gymnasium.utils.RecordConstructorArgs,
):
    """One table with the plan behind its observation, and actions that may correct the plan.

    The entries are named in ``plan.names`` and bounded as the rest. `TrackingFeatures` and
    `TrainingWrapper` go outside of it.

    Parameters
    ----------
    env
        A ``ShakeTable`` environment, innermost.
    plan
        Options of a planner for the environment's scenario, or a law made for a scenario of the same
        table, sensors and rates.
    action_scale
        Valve current of action 1, as a fraction of the current limit; added to the plan's current where
        the options say `corrected`.

    Raises
    ------
    ParameterError
        If it is another environment, or `action_scale` outside its range.
    ScenarioError, ShakeError
        As `PlanLaw.from_options`.
    """

    def __init__(
        self,
        env: gymnasium.Env[Observation, Observation],
        plan: PlanOptions | PlanLaw = PlanOptions(),  # noqa: B008  # frozen
        *,
        action_scale: float = 1.0,
    ) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self, plan=plan, action_scale=action_scale)
        gymnasium.Wrapper.__init__(self, env)
        table = env.unwrapped
        if not isinstance(table, ShakeTableEnv):
            raise ParameterError("env", type(table).__name__, "must be a ShakeTable environment")
        self.plan, self.action_scale = _law(table.scenario, plan), checked_action_scale(action_scale)
        self.observation_space = _space(table.scenario, self.plan)
        self._plans = PlanBatch(self.plan, 1, lambda: [table.motion])
        self._age = np.zeros(1, dtype=np.int64)
        self._shown = np.zeros((1, *(self.observation_space.shape or ())), dtype=np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; the planner begins at rest."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._age[:] = 0
        self._plans.show(observation[None], self._age, self._shown)
        return self._shown[0].copy(), info

    def step(self, action: Observation) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Hold `action` (1,) times the scale, with the plan's current or alone, for one period."""
        given = self._plans.act(checked_action(action, (1,))[None], self.action_scale, self._shown)
        observation, reward, terminated, truncated, info = self.env.step(given)  # type: ignore[arg-type]
        self._age += 1
        self._plans.show(observation[None], self._age, self._shown, stepped=True)
        return self._shown[0].copy(), float(reward), terminated, truncated, info


class PlanVectorWrapper(VectorWrapper[Observation, Observation, Observation, Observation, NDArray[Any]]):
    """`PlanWrapper` for a batch of tables, planned together.

    Parameters
    ----------
    env
        What ``gymnasium.make_vec("shake_env:ShakeTable-v0", vectorization_mode="vector_entry_point")``
        returns, in any autoreset mode.
    plan, action_scale
        As in `PlanWrapper`.

    Raises
    ------
    ParameterError
        If it is another environment, or `action_scale` outside its range.
    ScenarioError, ShakeError
        As `PlanLaw.from_options`.
    """

    def __init__(
        self,
        env: gymnasium.vector.VectorEnv[Observation, Observation, NDArray[Any]],
        plan: PlanOptions | PlanLaw = PlanOptions(),  # noqa: B008  # frozen
        *,
        action_scale: float = 1.0,
    ) -> None:
        super().__init__(env)
        tables = env.unwrapped
        if not isinstance(tables, ShakeTableVectorEnv):
            remedy = 'must be of make_vec(..., vectorization_mode="vector_entry_point")'
            raise ParameterError("env", type(tables).__name__, remedy)
        self.tables = tables
        self.plan, self.action_scale = _law(tables.scenario, plan), checked_action_scale(action_scale)
        self.single_observation_space = _space(tables.scenario, self.plan)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._plans = PlanBatch(self.plan, self.num_envs, lambda: tables.motions)
        self._age = np.zeros(self.num_envs, dtype=np.int64)
        self._over = np.zeros(self.num_envs, dtype=bool)  # lanes whose episode ended in the last step
        self._shown = np.zeros(self.observation_space.shape or (), dtype=np.float32)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start episodes in all lanes or in those of ``options["reset_mask"]``, planners at rest."""
        observation, info = self.tables.reset(seed=seed, options=options)
        mask = np.ones(self.num_envs, dtype=bool)
        if options is not None and options.get("reset_mask") is not None:
            mask = options["reset_mask"]
        self._age[mask], self._over[mask] = 0, False
        self._plans.show(observation, self._age, self._shown, lanes=np.flatnonzero(mask))
        return self._shown.copy(), info

    def step(
        self, actions: Observation
    ) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Hold `actions` (N, 1) times the scale, with the plans' currents or alone, for one period."""
        mode = self.tables.autoreset_mode
        correction = batch_action(actions, (self.num_envs, 1))[:, None]
        given = self._plans.act(correction, self.action_scale, self._shown)[:, None]
        observation, reward, terminated, truncated, info = self.tables.step(given)  # type: ignore[arg-type]
        done = terminated | truncated
        self._age += 1
        if mode == AutoresetMode.NEXT_STEP:
            self._age[self._over] = 0
        last = observation
        ended = np.flatnonzero(done & (mode == AutoresetMode.SAME_STEP))
        if len(ended):
            last = observation.copy()
            last[ended] = np.stack(info["final_obs"][ended])
        self._plans.show(last, self._age, self._shown, stepped=True)
        if len(ended):
            for lane in ended:
                info["final_obs"][lane] = self._shown[lane].copy()
            self._age[ended] = 0
            self._plans.show(observation, self._age, self._shown, lanes=ended)
        self._over = done
        return self._shown.copy(), reward, terminated, truncated, info

    def get_state(self, lanes: Sequence[int] | None = None) -> LaneState:
        """Return everything that lanes go on from, as ``ShakeTableVectorEnv.get_state``.

        In it are ``plan_memory``, ``plan_age`` and ``plan_over`` as well.
        """
        index = range(self.num_envs) if lanes is None else list(lanes)
        state = self.tables.get_state(lanes)
        own = {"memory": self._plans.memory, "age": self._age, "over": self._over}
        return state | {f"plan_{name}": array[index].copy() for name, array in own.items()}

    def set_state(self, state: Mapping[str, NDArray[Any]], lanes: Sequence[int] | None = None) -> None:
        """Put lanes where others stood; the rest goes on as it was.

        Parameters
        ----------
        state
            What :meth:`get_state` returned, of a wrapper of the same scenario and options.
        lanes
            Indices of the lanes that take its rows, in order; None: all N.
        """
        index = np.arange(self.num_envs) if lanes is None else np.asarray(lanes)
        own = ("plan_memory", "plan_age", "plan_over")
        self.tables.set_state({k: v for k, v in state.items() if k not in own}, lanes)
        memory: FloatArray = self._plans.memory
        memory[index], self._age[index], self._over[index] = (state[name] for name in own)
        self._plans.memory = memory
        observation = np.zeros((self.num_envs, state["observation"].shape[1]), dtype=np.float32)
        observation[index] = state["observation"]
        self._plans.show(observation, self._age, self._shown, lanes=index)


def _law(scenario: Scenario, plan: PlanOptions | PlanLaw) -> PlanLaw:
    return plan if isinstance(plan, PlanLaw) else PlanLaw.from_options(scenario, plan)


def _space(scenario: Scenario, law: PlanLaw) -> Any:
    """Return the space of an observation (n + e,), bounds as the environment's own."""
    shape, bound = (scenario.observation.size + law.shown,), OBSERVATION_BOUND
    return spaces.Box(-bound, bound, shape, np.float32)
