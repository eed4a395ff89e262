"""Paired roll-outs: rewards as differences between a table and a shadow of it without exploration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, cast

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices

from agents.learning.vec_env import ShakeTableVecEnv
from shake_env.errors import ParameterError

Against = Literal["mean", "base"]


class PairedVecEnv(VecEnvWrapper):
    """N shake tables whose reward is the difference to a shadow of each.

    An earthquake changes the return of an episode by a hundred times what one explored action changes.
    A table and its shadow have the same plant, earthquake and sensor noise (common random numbers;
    Glasserman and Yao, Management Science 38, 1992), so that the shadow's cost is a control variate
    (Greensmith, Bartlett and Baxter, JMLR 5, 2004) that follows the earthquake itself, which no function
    of the observation does (Mao et al., "Variance reduction for reinforcement learning in input-driven
    environments", ICLR 2019). What the shadow does after an action does not depend on its exploration:
    subtracting it leaves the gradient's expectation as it was.

    Three lines of a script change::

        env = PairedVecEnv(make_sb3_env("laboratory", 256, ...), interval=256)
        model = PPO("MlpPolicy", env, n_steps=256, gae_lambda=0.99, ...)
        env.follow(model)

    Against the mean action
        For algorithms that learn from each roll-out once (PPO, RecurrentPPO). A shadow takes the
        model's deterministic action and is put back to its table's state at each roll-out. What
        biases the gradient is the end: the effect of an action is counted up to the next time that the
        shadow is put back, and what comes later is lost, most for the last actions of a roll-out.
        Between, table and shadow drift apart, and the variance grows.
    Against the base controller
        For algorithms that keep transitions (SAC, TD3, TQC, CrossQ). The difference to a mean action
        would be stored, and would be to another policy when it is used. The shadow takes the action
        0, which is the base controller alone, and keeps its own place: the difference of two returns
        then has the same best policy as the return. It is stationary, and follows the earthquake less
        well than the mean action's.

    It needs a simulator that can be put back (`ShakeTableVecEnv.get_state` and `set_state`): no physical
    table, and no other environment. Each control period is simulated twice.

    Parameters
    ----------
    venv
        2 N tables: a `ShakeTableVecEnv`, or wrappers of one that change each lane alone. The first half
        learn, the second half are their shadows.
    interval
        Control periods after which shadows are put back to their tables; of PPO its ``n_steps``. None:
        never within an episode.
    against
        What drives the shadows: the model's ``"mean"`` action, or ``"base"``, no action.
    gain
        Factor on the differences. PPO scales advantages itself; off-policy algorithms want rewards of
        the order of 1.

    Raises
    ------
    ParameterError
        If the environment is of another kind, its number of tables is odd or an option is outside its
        range.
    """

    def __init__(
        self,
        venv: VecEnv,
        *,
        interval: int | None = None,
        against: Against = "mean",
        gain: float = 1.0,
    ) -> None:
        if not isinstance(venv.unwrapped, ShakeTableVecEnv):
            remedy = "must be a ShakeTableVecEnv, or what make_sb3_env returns: its state is set"
            raise ParameterError("venv", type(venv.unwrapped).__name__, remedy)
        if venv.num_envs % 2:
            raise ParameterError("num_envs", venv.num_envs, "must be even: half of them are shadows")
        if interval is not None and interval < 1:
            raise ParameterError("interval", interval, "must be 1 control period or more, or None")
        if against not in ("mean", "base"):
            raise ParameterError("against", against, "known: mean, base")
        if not gain > 0.0:
            raise ParameterError("gain", gain, "must be above 0")
        super().__init__(venv)
        self.num_envs = venv.num_envs // 2
        self.interval, self.against, self.gain = interval, against, gain
        self._model: BaseAlgorithm | None = None
        self._memory: tuple[NDArray[Any], ...] | None = None  # the shadows', of a recurrent policy
        self._begun = np.ones(self.num_envs, dtype=bool)  # where an episode begins
        self._since = 0  # control periods since the shadows were put back
        self._shown = np.zeros((venv.num_envs, *(venv.observation_space.shape or ())), np.float32)

    @property
    def tables(self) -> ShakeTableVecEnv:
        """The tables and their shadows, (2 N)."""
        return cast(ShakeTableVecEnv, self.unwrapped)

    def follow(self, model: BaseAlgorithm, *, critic: bool = False) -> None:
        """Let the shadows be driven by the mean action of a model, as it is at each control period.

        Parameters
        ----------
        model
            That learns on this environment.
        critic
            Whether an on-policy algorithm keeps its critic. The value of a difference is near zero, and
            what an untrained critic says instead is noise: without, its output is 0 and stays 0.
        """
        self._model = model
        if isinstance(model, OnPolicyAlgorithm) and not critic:
            value = model.policy.value_net
            with torch.no_grad():
                for parameter in value.parameters():
                    parameter.zero_()
                    parameter.requires_grad_(False)

    def put_back(self) -> None:
        """Put each shadow where its table stands."""
        self._copy(np.arange(self.num_envs))
        self._since = 0
        self._memory = self._table_memory()

    def go_on(self, observation: NDArray[np.float32], begun: NDArray[np.bool_]) -> None:
        """Go on where the tables were put (`ShakeTableVecEnv.set_state`) between two roll-outs.

        Parameters
        ----------
        observation
            (N, n) that they show.
        begun
            (N,) whether an episode begins there.
        """
        self._shown[: self.num_envs], self._begun = observation, np.array(begun, dtype=bool)
        self._since = self.interval or 0

    def reset(self) -> NDArray[np.float32]:
        """Start an episode in every lane; return the tables' observations (N, n)."""
        self._shown = np.array(self.venv.reset())
        self._begun[:] = True
        self._memory = None
        self._copy(np.arange(self.num_envs))
        self._since = 0
        return self._shown[: self.num_envs].copy()

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Take the tables' actions (N, 1) of the next period."""
        if self._since == self.interval:
            self.put_back()
        self.venv.step_async(np.concatenate([actions, self._shadow_actions(actions)]))

    def step_wait(
        self,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Advance all tables; rewards are differences, infos those of the tables.

        Where a limit ends the episode of a table or of its shadow alone, its cost is in the difference,
        and the shadow is put where its table then stands.
        """
        n = self.num_envs
        shown, reward, done, infos = self.venv.step_wait()
        self._shown = np.array(shown)
        self._since += 1
        self._begun = done[:n].copy()
        alone = np.flatnonzero(done[:n] != done[n:])
        if len(alone):
            self._copy(alone)
        difference = (self.gain * (reward[:n] - reward[n:])).astype(np.float32)
        return self._shown[:n].copy(), difference, self._begun.copy(), infos[:n]

    def _copy(self, lanes: NDArray[np.intp]) -> None:
        tables = self.tables
        shadows = lanes + self.num_envs
        tables.set_state(tables.get_state(lanes.tolist()), shadows.tolist())
        self._shown[shadows] = self._shown[lanes]

    def _shadow_actions(self, actions: NDArray[np.float32]) -> NDArray[np.float32]:
        if self.against == "base":
            return np.zeros_like(actions)
        if self._model is None:
            raise ParameterError("model", None, "name whose mean action the shadows take: follow(model)")
        mean, self._memory = self._model.predict(
            self._shown[self.num_envs :], self._memory, self._begun, deterministic=True
        )
        return mean.reshape(actions.shape)

    def _table_memory(self) -> tuple[NDArray[Any], ...] | None:
        """Return the memory of the tables' recurrent policy where a roll-out begins.

        Within one only the algorithm knows it, and shadows go on with their own.
        """
        states = getattr(self._model, "_last_lstm_states", None)
        if states is None or cast(Any, self._model).rollout_buffer.pos > 0:
            return self._memory
        return tuple(part.detach().cpu().numpy().copy() for part in states.pi)

    # What is asked of lanes is asked of the tables.

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of each table."""
        return self.venv.get_attr(attr_name, self._tables_of(indices))

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of tables."""
        self.venv.set_attr(attr_name, value, self._tables_of(indices))

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of each table."""
        given = self._tables_of(indices)
        return self.venv.env_method(method_name, *method_args, indices=given, **method_kwargs)

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """Return whether each table is wrapped."""
        return self.venv.env_is_wrapped(wrapper_class, self._tables_of(indices))

    def _tables_of(self, indices: VecEnvIndices) -> Sequence[int]:
        # SB3's own constructor asks before the number of tables is halved.
        return list(self._get_indices(indices))[: self.venv.num_envs // 2]
