"""On-policy distillation: a student learns a teacher's actions where the student itself drives."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, is_dataclass, replace
from typing import Any, Self

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.type_aliases import GymEnv, MaybeCallback, Schedule
from stable_baselines3.common.utils import safe_mean, update_learning_rate

from agents.learning.memory_policies import MemoryPolicy
from agents.learning.vec_env import ShakeTableVecEnv
from shake_env.controller import Controller
from shake_env.errors import ParameterError

FloatRows = NDArray[np.float32]


@dataclass(frozen=True)
class Labels:
    """What N tables showed over T control periods, and what the teacher would have added."""

    shown: FloatRows  # (T, N, n)
    correction: FloatRows  # (T, N) within [-1, 1]
    begun: NDArray[np.bool_]  # (T, N) where an episode begins
    memory: FloatRows  # (T / L, N, memory) of a recurrent student before each sequence

    @property
    def samples(self) -> int:
        """Number of labels."""
        return self.correction.size


class Distillation(BaseAlgorithm):
    """Fit the mean action of a policy to a teacher's, by dataset aggregation.

    DAgger (Ross, Gordon and Bagnell, AISTATS 2011): the tables run whole episodes, in the first round
    under the teacher and then under the student; at every control period the teacher is asked what it
    would do, from the same observation. The student is fitted to the labels of the last rounds by
    least squares of the correction that it adds to the base controller. The student sees what the
    scenario shows; so does the teacher, unless it is one that is told the drawn plants
    (`baselines.planning.informed`): then the student learns the mean of the labels given the signals.

    Of SB3's manners it keeps what a callback sees: ``on_rollout_start`` before each round, ``on_step``
    and ``on_rollout_end`` after it; ``num_timesteps`` counts control periods of all tables.

    Parameters
    ----------
    policy
        `ActorCriticPolicy` or a subclass with a Gaussian action; its critic and ``log_std`` stay.
    env
        A `ShakeTableVecEnv`.
    teacher
        Controller of many tables at once, which is given the observation alone.
    learning_rate
        Of the student; a schedule may depend on the progress remaining.
    buffer_size
        Labels kept; the oldest rounds are dropped first.
    batch_size, n_epochs
        Labels of one gradient step, and passes over the kept labels per round.
    sequence_length
        Control periods that the gradient of a student with a memory looks back through. A recurrent
        student begins each such sequence with what it remembered when the labels were collected; one
        that convolves begins earlier, by as much as it sees.

    Raises
    ------
    ParameterError
        If the environment is of another kind, or the policy has no Gaussian actor-critic form.
    """

    policy: ActorCriticPolicy

    def __init__(
        self,
        policy: type[ActorCriticPolicy],
        env: GymEnv | None,
        teacher: Controller,
        learning_rate: float | Schedule = 1e-3,
        buffer_size: int = 400_000,
        batch_size: int = 4096,
        n_epochs: int = 4,
        sequence_length: int = 50,
        policy_kwargs: dict[str, Any] | None = None,
        stats_window_size: int = 100,
        tensorboard_log: str | None = None,
        verbose: int = 0,
        seed: int | None = None,
        device: torch.device | str = "auto",
        _init_setup_model: bool = True,
    ) -> None:
        super().__init__(
            policy,
            env,
            learning_rate,
            policy_kwargs=policy_kwargs,
            stats_window_size=stats_window_size,
            tensorboard_log=tensorboard_log,
            verbose=verbose,
            device=device,
            support_multi_env=True,
            seed=seed,
            supported_action_spaces=(spaces.Box,),
        )
        self.teacher = teacher
        self.buffer_size, self.batch_size = buffer_size, batch_size
        self.n_epochs, self.sequence_length = n_epochs, sequence_length
        self.rounds: list[Labels] = []
        if _init_setup_model:
            self._setup_model()

    def _setup_model(self) -> None:
        self._setup_lr_schedule()
        self.set_random_seed(self.seed)
        self.policy = self.policy_class(  # type: ignore[assignment]
            self.observation_space, self.action_space, self.lr_schedule, **self.policy_kwargs
        ).to(self.device)
        if not isinstance(self.policy, ActorCriticPolicy) or self.policy.use_sde:
            raise ParameterError("policy", self.policy_class.__name__, "must be a Gaussian actor-critic")
        if not isinstance(self.env, ShakeTableVecEnv):
            raise ParameterError("env", type(self.env).__name__, "must be a ShakeTableVecEnv")

    @property
    def tables(self) -> ShakeTableVecEnv:
        """The environment's tables."""
        assert isinstance(self.env, ShakeTableVecEnv)  # the constructor asked
        return self.env

    def learn(
        self,
        total_timesteps: int,
        callback: MaybeCallback = None,
        log_interval: int = 1,
        tb_log_name: str = "Distillation",
        reset_num_timesteps: bool = True,
        progress_bar: bool = False,
    ) -> Self:
        """Train for at least `total_timesteps` control periods of all tables together; as SB3's."""
        total_timesteps, callback = self._setup_learn(
            total_timesteps, callback, reset_num_timesteps, tb_log_name, progress_bar
        )
        callback.on_training_start(locals(), globals())
        going_on, number = True, 0
        while self.num_timesteps < total_timesteps and going_on:
            callback.on_rollout_start()
            self._update_current_progress_remaining(self.num_timesteps, total_timesteps)
            self.rounds.append(self.collect(by_teacher=not self.rounds))
            while sum(each.samples for each in self.rounds[1:]) >= self.buffer_size:
                del self.rounds[0]
            self.num_timesteps += self.rounds[-1].samples
            self.train()
            number += 1
            callback.update_locals(locals())
            going_on = callback.on_step()
            callback.on_rollout_end()
            if log_interval is not None and number % log_interval == 0:
                self.dump_logs()
        callback.on_training_end()
        return self

    def collect(self, *, by_teacher: bool) -> Labels:
        """Run an episode of each table under the student or the teacher, and label it."""
        tables, length = self.tables, self.sequence_length
        scale, raw = tables.authority, tables.scenario.observation.size
        self.policy.set_training_mode(False)
        shown: FloatRows = tables.reset()
        begun = np.ones(tables.num_envs, dtype=bool)
        steps = -(-int(tables.simulation.episode_steps.max()) // length) * length
        taught_state: tuple[Any, ...] | None = None
        memory = self._rest(tables.num_envs)
        rows: list[tuple[FloatRows, FloatRows, NDArray[np.bool_]]] = []
        memories: list[FloatRows] = []
        for t in range(steps):
            if t % length == 0:
                memories.append(memory[:, : 0 if self._lead else None].numpy().copy())
            taught, taught_state = self.teacher.predict(shown[:, :raw], taught_state, begun)
            base = np.clip(shown @ tables.base, -1.0, 1.0)
            label = np.clip((taught[:, 0] - base) / scale, -1.0, 1.0).astype(np.float32)
            with torch.no_grad():
                mean, memory = self._mean(torch.from_numpy(shown), memory, torch.from_numpy(begun))
            action = label if by_teacher else mean.clip(-1.0, 1.0).numpy()
            rows.append((shown, label, begun))
            taught_state = _with_given_action(
                taught_state, tables, np.clip(base + scale * action, -1.0, 1.0)
            )
            tables.step_async(action[:, None])
            shown, _, begun, infos = tables.step_wait()
            if self.ep_info_buffer is not None:
                self._update_info_buffer(infos, begun)
        self._last_obs, self._last_episode_starts = shown, begun
        observations, labels, starts = zip(*rows, strict=True)
        return Labels(np.stack(observations), np.stack(labels), np.stack(starts), np.stack(memories))

    def train(self) -> None:
        """Fit the student to the labels of the last rounds."""
        self.policy.set_training_mode(True)
        rate = self.lr_schedule(self._current_progress_remaining)
        update_learning_rate(self.policy.optimizer, rate)
        # In units of the labels: the gradient's bound and Adam's epsilon are relative to their size.
        size = sum(float(np.sum(each.correction**2)) for each in self.rounds)
        unit = max(size / sum(each.samples for each in self.rounds), 1e-12)
        losses = []
        for _ in range(self.n_epochs):
            for shown, label, begun, memory in self._batches():
                means = self._means(shown, memory, begun)[-len(label) :]
                loss = (means - label).square().mean() / unit
                self.policy.optimizer.zero_grad(set_to_none=True)
                loss.backward()
                torch.nn.utils.clip_grad_norm_(self.policy.parameters(), 1.0)
                self.policy.optimizer.step()
                losses.append(loss.item())
        self._n_updates += len(losses)
        newest = self.rounds[-1]
        self.logger.record("train/unexplained", float(np.mean(losses)))
        self.logger.record("train/label_rms", float(np.sqrt(np.mean(newest.correction**2))))
        self.logger.record("train/labels_at_bound", float(np.mean(np.abs(newest.correction) >= 1.0)))
        self.logger.record("train/labels", sum(each.samples for each in self.rounds))
        self.logger.record("train/learning_rate", rate)
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")

    def _batches(self) -> Any:
        """Yield the kept labels once, in random order: sequences (L, B, ...) of a student with a memory.

        One without takes single control periods, (1, B, ...). What a student that convolves sees before
        a sequence stands before it, without a label; before an episode its first period does, which
        begins an episode each time.
        """
        remembers, lead = isinstance(self.policy, MemoryPolicy), self._lead
        length = self.sequence_length if remembers else 1
        tables = self.tables.num_envs
        starts = np.array(
            [
                (i, t, lane)
                for i, each in enumerate(self.rounds)
                for t in range(0, len(each.correction), length)
                for lane in range(tables)
            ]
        )
        order = torch.randperm(len(starts)).numpy()
        count = max(1, self.batch_size // length)
        for first in range(0, len(order), count):
            chosen = starts[order[first : first + count]]
            parts: list[list[torch.Tensor]] = [[], [], [], []]
            for i in np.unique(chosen[:, 0]):
                labels, (t, lane) = self.rounds[int(i)], chosen[chosen[:, 0] == i, 1:].T
                span = t + np.arange(length)[:, None]
                seen = np.maximum(t + np.arange(-lead, length)[:, None], 0)
                for part, array, rows in zip(
                    parts,
                    (labels.shown, labels.correction, labels.begun),
                    (seen, span, seen),
                    strict=False,
                ):
                    part.append(torch.from_numpy(array[rows, lane]))
                parts[3].append(torch.from_numpy(labels.memory[t // self.sequence_length, lane]))
            shown, label, begun = (torch.cat(part, dim=1) for part in parts[:3])
            yield shown, label, begun, self._rest(len(chosen)) if lead else torch.cat(parts[3])

    @property
    def _lead(self) -> int:
        return self.policy.lead if isinstance(self.policy, MemoryPolicy) else 0

    def _rest(self, lanes: int) -> torch.Tensor:
        """Return the student's memory (lanes, memory) at the start of an episode."""
        if isinstance(self.policy, MemoryPolicy):
            return self.policy.rest(lanes).cpu()
        return torch.zeros((lanes, 0))

    def _mean(
        self, shown: torch.Tensor, memory: torch.Tensor, begun: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the student's action (B,) before its clip, and its memory after."""
        policy = self.policy
        if isinstance(policy, MemoryPolicy):
            features, memory = policy.recall(shown, torch.where(begun[:, None], 0.0, memory))
        else:
            features = policy.pi_features_extractor(shown)
        return policy.action_net(policy.mlp_extractor.forward_actor(features))[:, 0], memory

    def _means(self, shown: torch.Tensor, memory: torch.Tensor, begun: torch.Tensor) -> torch.Tensor:
        """Return the student's actions (L, B) before their clip along sequences (L, B, ...)."""
        policy = self.policy
        if isinstance(policy, MemoryPolicy):
            features = policy.recall_sequence(shown, memory, begun).flatten(end_dim=1)
        else:
            features = policy.pi_features_extractor(shown.flatten(end_dim=1))
        means: torch.Tensor = policy.action_net(policy.mlp_extractor.forward_actor(features))
        return means.reshape(begun.shape)

    def dump_logs(self) -> None:
        """Write what was recorded, with times, to the logger."""
        seconds = max((time.time_ns() - self.start_time) / 1e9, sys.float_info.epsilon)
        if self.ep_info_buffer:
            self.logger.record("rollout/ep_rew_mean", safe_mean([e["r"] for e in self.ep_info_buffer]))
        self.logger.record("time/time_elapsed", int(seconds), exclude="tensorboard")
        self.logger.record("time/total_timesteps", self.num_timesteps, exclude="tensorboard")
        self.logger.dump(step=self.num_timesteps)

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "rounds", "teacher"]


def _with_given_action(
    state: tuple[Any, ...] | None, tables: ShakeTableVecEnv, action: FloatRows
) -> tuple[Any, ...] | None:
    """Return a teacher's state that knows which action (N,) the tables were given instead of its own.

    A scenario that shows the last action says so itself.
    """
    if state is None or tables.scenario.sensing.last_action:
        return state
    if is_dataclass(memory := state[0]) and hasattr(memory, "current"):
        current = action.astype(float) * tables.scenario.current_limit
        return (replace(memory, current=current), *state[1:])  # type: ignore[type-var]
    return state
