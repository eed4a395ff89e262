"""A native Stable-Baselines3 `VecEnv` over the batch kernel: no copies of environments, no workers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from numpy.typing import NDArray
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices

from agents.learning.law_batch import LawBatch, MemoryBatch
from agents.learning.plan_batch import PlanBatch
from agents.policies.estimated_law import EstimatedLaw
from agents.policies.plan_law import PlanLaw
from shake_env.env import single_spaces
from shake_env.model.inputs import batch_action
from shake_env.model.parameters import FloatArray
from shake_env.scenario.limits import OBSERVATION_BOUND, REASONS
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.engine import LaneState, StepResult
from shake_env.simulation.sensors import SensorMemory
from shake_env.simulation.simulation import Simulation
from shake_env.simulation.streams import earthquake_stream, episode_stream, stream_array


class ShakeTableVecEnv(VecEnv):
    """N shake tables for SB3, autoreset at the end of each episode.

    Lane i of ``seed(s)`` repeats ``ShakeTableEnv.reset(seed=s + i)``. A lane's info is empty while its
    episode runs (building N dictionaries costs more than stepping N tables); at its end it holds
    ``terminal_observation``, ``TimeLimit.truncated``, the ``episode`` record of SB3's Monitor (`r`
    return, `l` steps) and, if a limit was broken, ``broken_limit``.

    Parameters
    ----------
    scenario
        What is simulated.
    num_envs
        Number of tables N.
    base
        (n,) linear law that the actions correct, fraction of the current limit per entry of the
        observation; or one behind an estimator, and what that believes is then shown behind each
        observation; or a plan, shown likewise, which the actions correct or not; None for no such law.
    authority
        What action 1 adds to it, as a fraction of the current limit.
    reward_scale
        Factor on the rewards that the learner gets; the ``episode`` record keeps the true ones.
    """

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        *,
        base: FloatArray | EstimatedLaw | PlanLaw | None = None,
        authority: float = 1.0,
        reward_scale: float = 1.0,
    ) -> None:
        self.scenario = scenario
        self.law = base if isinstance(base, EstimatedLaw) else None
        self.plan = base if isinstance(base, PlanLaw) else None
        size = scenario.observation.size
        if isinstance(base, EstimatedLaw):  # its own action comes last of what it shows
            self.base = np.eye(1, size + base.shown, size + base.shown - 1)[0]
        elif isinstance(base, PlanLaw):  # here first
            self.base = float(base.corrected) * np.eye(1, size + base.shown, size)[0]
        else:
            self.base = np.zeros(size) if base is None else base
        self._corrects = bool(np.any(self.base))
        self.authority = authority
        self.reward_scale = reward_scale
        self.simulation = Simulation(scenario, num_envs)
        self.render_mode = None
        _, actions = single_spaces(scenario)
        bound, shown = OBSERVATION_BOUND, (len(self.base),)
        super().__init__(num_envs, spaces.Box(-bound, bound, shown, np.float32), actions)
        self._streams: list[np.random.Generator | None] = [None] * num_envs
        self._action: NDArray[np.floating[Any]] = np.zeros(num_envs)
        self._returns = np.zeros(num_envs)
        self._observation = np.zeros((num_envs, scenario.observation.size), dtype=np.float32)
        self._shown = np.zeros((num_envs, len(self.base)), dtype=np.float32)
        self._laws: MemoryBatch | None = LawBatch(self.law, num_envs) if self.law else None
        if self.plan is not None:
            self._laws = PlanBatch(self.plan, num_envs, lambda: self.simulation.motions)

    def reset(self) -> NDArray[np.float32]:
        """Start an episode in every lane; seeds given to ``seed`` are used once."""
        begun = {i: earthquake_stream(seed) for i, seed in enumerate(self._seeds) if seed is not None}
        for lane, seed in enumerate(self._seeds):
            if seed is not None or self._streams[lane] is None:
                self._streams[lane], _ = seeding.np_random(seed)
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = 0.0
        self._observation = self._start(range(self.num_envs), begun)
        return self._look().copy()

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Take the actions (N, 1) of the next period."""
        correction = batch_action(actions, (self.num_envs, 1))
        if self._laws is not None:
            self._action = self._laws.act(correction[:, None], self.authority, self._shown)
            return
        if not self._corrects and self.authority == 1.0:
            self._action = correction.copy()  # which the engine takes at any precision
            return
        self._action = np.multiply(correction, self.authority, dtype=float)
        if self._corrects:
            self._action += self._shown @ self.base

    def step_wait(
        self,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Advance all tables; lanes whose episode ended come back with their next one begun."""
        result = self.simulation.step(self._action)
        true = result.reward
        self._returns += true
        scaled = true if self.reward_scale == 1.0 else self.reward_scale * true
        reward = scaled.astype(np.float32)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        self._observation, done = result.observation, result.terminated
        shown = self._look(stepped=True)
        if result.ended:
            done = done | result.truncated
            lanes = np.flatnonzero(done)
            for lane in lanes:
                infos[lane] = self._final_info(result, int(lane))
            self._returns[lanes] = 0.0
            self._observation[lanes] = self._start(lanes.tolist())
            self._look(lanes)
        return shown.copy(), reward, done, infos

    def _look(
        self, lanes: NDArray[np.intp] | None = None, *, stepped: bool = False
    ) -> NDArray[np.float32]:
        """Return what is shown (N, n): the observation, and behind it what the law believes or plans.

        Of some lanes it is made anew; `stepped` after a period under the actions given.
        """
        if self._laws is None:
            self._shown = self._observation
        else:
            age = self.simulation.step_count
            self._laws.show(self._observation, age, self._shown, lanes=lanes, stepped=stepped)
        return self._shown

    def _final_info(self, result: StepResult, lane: int) -> dict[str, Any]:
        return {
            "terminal_observation": self._shown[lane].copy(),
            "TimeLimit.truncated": bool(result.truncated[lane]),
            **self._episode_info(lane, int(result.broken[lane])),
        }

    def _episode_info(self, lane: int, broken: int) -> dict[str, Any]:
        info: dict[str, Any] = {
            "episode": {
                "r": float(self._returns[lane]),
                "l": int(self.simulation.step_count[lane]),
            },
        }
        if broken:
            info["broken_limit"] = REASONS[broken - 1]
        return info

    def _start(
        self,
        lanes: Sequence[int],
        begun: Mapping[int, np.random.Generator] = MappingProxyType({}),
    ) -> NDArray[np.float32]:
        """Start an episode in each lane: that of a stream `begun` for it, or the next of its own."""
        streams = [
            begun.get(lane) or episode_stream(stream)
            for lane in lanes
            if (stream := self._streams[lane])
        ]
        return self.simulation.start(lanes, streams)

    @property
    def law_memory(self) -> FloatArray:
        """What the law behind an estimator remembers (N, M), before it sees the observation; a copy."""
        return np.zeros((self.num_envs, 0)) if self._laws is None else self._laws.memory

    @property
    def observation(self) -> NDArray[np.float32]:
        """What the tables show now, (N, n), without what a law believes of it."""
        return self._observation.copy()

    def advance_to(
        self,
        state: FloatArray,
        memory: SensorMemory,
        observation: NDArray[np.float32],
        *,
        steps: NDArray[np.int_],
        returns: FloatArray,
        broken: NDArray[np.int_],
        law_memory: FloatArray | None = None,
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Go on from where the tables were taken by a copy of them, as learning through the plant does.

        The copy has read the ground and the sensors' noise of this environment on the way.

        Parameters
        ----------
        state, memory, observation
            Of all tables, at the end.
        steps
            (N,) control periods of each lane's episode that were run.
        returns
            (N,) sum of the true rewards over them.
        broken
            (N,) code of the limit that ended the episode, or 0.
        law_memory
            (N, M) of the law behind an estimator, before it sees the observation.

        Returns
        -------
        observation, done, infos
            Lanes whose episode ended come back with their next one begun; the info of such a lane holds
            its ``episode`` record and ``broken_limit``.
        """
        simulation = self.simulation
        simulation.state, simulation.memory = state, memory
        simulation.step_count[:] += steps
        self._returns += returns
        done = (broken != 0) | (simulation.step_count >= simulation.episode_steps)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        lanes = np.flatnonzero(done)
        self._observation = observation.astype(np.float32)
        for lane in lanes:
            infos[lane] = self._episode_info(int(lane), int(broken[lane]))
        self._returns[lanes] = 0.0
        if law_memory is not None and self._laws is not None:
            self._laws.memory = law_memory
        if len(lanes):
            self._observation[lanes] = self._start(lanes.tolist())
        return self._look().copy(), done, infos

    def stagger(self) -> None:
        """Shorten the first episode of each lane, so that they come to stand at different places."""
        steps = self.simulation.episode_steps
        shares = (np.arange(self.num_envs) + 1.0) / self.num_envs
        steps[:] = np.maximum(np.ceil(steps * shares), 1).astype(int)

    def get_state(self, lanes: Sequence[int] | None = None) -> LaneState:
        """Return everything that lanes go on from, arrays with one row a lane.

        Those of `Simulation.get_state`, and of the environment ``stream`` (an array of generators),
        ``returns``, ``observation`` and ``law_memory``. The rows of one lane given to another by
        :meth:`set_state` make it go on as the first, the episodes that follow included.

        Parameters
        ----------
        lanes
            Indices of the lanes; None: all N.
        """
        index = range(self.num_envs) if lanes is None else list(lanes)
        state = self.simulation.get_state(lanes)
        state["stream"] = stream_array([self._streams[lane] for lane in index])
        state["law_memory"] = self.law_memory[index]
        for name, values in self._own().items():
            state[name] = values[index].copy()
        return state

    def set_state(self, state: Mapping[str, NDArray[Any]], lanes: Sequence[int] | None = None) -> None:
        """Put lanes where others stood; the rest goes on as it was.

        Parameters
        ----------
        state
            What :meth:`get_state` returned, of a VecEnv of the same scenario and law.
        lanes
            Indices of the lanes that take its rows, in order; None: all N.

        Raises
        ------
        ScenarioError
            If the state is of another scenario or of another number of lanes.
        """
        index = range(self.num_envs) if lanes is None else list(lanes)
        own = self._own()
        apart = (*own, "stream", "law_memory")
        rest = {name: array for name, array in state.items() if name not in apart}
        self.simulation.set_state(rest, lanes)
        for lane, stream in zip(index, stream_array(state["stream"]), strict=True):
            self._streams[lane] = stream
        for name, values in own.items():
            values[index] = state[name]
        if self._laws is not None:
            memory = self._laws.memory
            memory[index] = state["law_memory"]
            self._laws.memory = memory
        self._look(np.asarray(index))

    def _own(self) -> dict[str, NDArray[Any]]:
        """Return what the environment keeps of its lanes beside the simulation, arrays of its own."""
        self._observation = self._observation.copy()
        return {"returns": self._returns, "observation": self._observation}

    def close(self) -> None:
        """Release nothing: there are no workers."""

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute, the same for every lane."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the batch; lanes have none of their own."""
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the batch once, and return its result for every lane asked for."""
        result = getattr(self, method_name)(*method_args, **method_kwargs)
        return [result for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """Return True for `Monitor` only: an info at an episode's end holds the record that it writes.

        ``evaluate_policy`` then reports true returns, whatever `reward_scale` is.
        """
        return [issubclass(wrapper_class, Monitor) for _ in self._get_indices(indices)]
