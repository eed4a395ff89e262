"""Analytic policy gradient: an SB3 policy trained by gradients taken through the plant itself.

The cost of short windows is differentiated through the physics (Qiao et al., 2021, and Freeman et al.,
Brax, 2021, call it the analytic policy gradient), and what follows a window is a learned value at its
end, as in short-horizon actor-critic (SHAC; Xu et al., ICLR 2022), or is left out.
"""

from __future__ import annotations

import copy
import sys
import time
from typing import Any, ClassVar, Self

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.type_aliases import GymEnv, MaybeCallback, Schedule
from stable_baselines3.common.utils import safe_mean, update_learning_rate

from agents.learning.apg.actor_critic import latent, set_gradient, state_value, trained_parameters
from agents.learning.apg.loop_gradient import Kept
from agents.learning.apg.td_lambda import td_lambda_targets
from agents.learning.apg.window_rollout import Window, WindowRollout
from agents.learning.memory_policies import GRUPolicy, MemoryPolicy, TCNPolicy
from agents.learning.vec_env import ShakeTableVecEnv
from shake_env.errors import ParameterError


class AnalyticPolicyGradient(BaseAlgorithm):
    """Learn the mean action of an actor-critic policy by back-propagation through the plant.

    Every update follows all tables over one window of H control periods and descends

    ``-sum_t gamma^t r_t - gamma^H V(s_H)``,

    r the environment's reward, with Adam under a bound on the gradient's norm. States are passed from
    window to window as data. With ``terminal_value`` V is the policy's critic, fitted after each window
    to TD(lambda) targets and followed by a slow copy that the targets and the actor use; without, V
    is zero and the critic is left alone. After a window without a finite gradient the actor is taken
    back to its mean over those before (`retreats` counts how often). The policy is SB3's own: PPO goes
    on from its parameters, and the other way round. Exploration is neither needed nor learned:
    ``log_std`` stays.

    A callback's ``on_rollout_start`` comes before each window, ``on_step`` and ``on_rollout_end`` after
    it; ``num_timesteps`` counts control periods of all tables.

    Parameters
    ----------
    policy
        ``"MlpPolicy"``, ``"GRUPolicy"``, ``"TCNPolicy"`` or a subclass of `ActorCriticPolicy` with a
        Gaussian action.
    env
        A `ShakeTableVecEnv`; no other has a plant to differentiate. None to only predict.
    learning_rate
        Of the actor; a schedule may depend on the progress remaining.
    window
        Control periods H that a gradient looks back through.
    gamma
        Discount per control period.
    td_lambda
        Lambda of the critic's targets.
    max_grad_norm
        Bound on the norm of the actor's, and of the critic's gradient.
    terminal_value
        Whether the critic's value stands at the window's end.
    critic_learning_rate
        Of the critic, relative to the actor's.
    critic_epochs, critic_batches
        Passes over a window's samples per update, and parts that each is cut into.
    target_rate
        Share of its way to the critic that the slow copy goes per window; and of its way to the actor
        that the mean goes which an actor without a gradient is taken back to.
    plant_dtype
        ``"float64"`` or ``"float32"``: precision of the plant's state.
    checkpoint
        Control periods of a segment that is run again when the gradient is taken, instead of being kept;
        0: all of a window is kept. Near the square root of `window` memory is least.
    stagger
        Whether first episodes are shortened so that lanes stand at different places of their motions.

    Raises
    ------
    ParameterError
        If the environment is of another kind, the policy has no Gaussian actor-critic form, or an option
        is outside its range.
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {
        "MlpPolicy": ActorCriticPolicy,
        "GRUPolicy": GRUPolicy,
        "TCNPolicy": TCNPolicy,
    }
    policy: ActorCriticPolicy

    def __init__(
        self,
        policy: str | type[ActorCriticPolicy],
        env: GymEnv | str | None,
        learning_rate: float | Schedule = 2e-3,
        window: int = 64,
        gamma: float = 0.995,
        td_lambda: float = 0.95,
        max_grad_norm: float = 1.0,
        terminal_value: bool = True,
        critic_learning_rate: float = 1.0,
        critic_epochs: int = 2,
        critic_batches: int = 4,
        target_rate: float = 0.2,
        plant_dtype: str = "float64",
        checkpoint: int = 0,
        stagger: bool = True,
        stats_window_size: int = 100,
        tensorboard_log: str | None = None,
        policy_kwargs: dict[str, Any] | None = None,
        verbose: int = 0,
        seed: int | None = None,
        device: torch.device | str = "auto",
        _init_setup_model: bool = True,
    ) -> None:
        super().__init__(
            policy, env, learning_rate, policy_kwargs=policy_kwargs, stats_window_size=stats_window_size,
            tensorboard_log=tensorboard_log, verbose=verbose, device=device, support_multi_env=True,
            seed=seed, supported_action_spaces=(spaces.Box,),
        )  # fmt: skip
        if plant_dtype not in ("float64", "float32"):
            raise ParameterError("plant_dtype", plant_dtype, "known: float32, float64")
        if checkpoint < 0:
            raise ParameterError("checkpoint", checkpoint, "is a number of control periods, or 0")
        self.window = window
        self.gamma = gamma
        self.td_lambda = td_lambda
        self.max_grad_norm = max_grad_norm
        self.terminal_value = terminal_value
        self.critic_learning_rate = critic_learning_rate
        self.critic_epochs = critic_epochs
        self.critic_batches = critic_batches
        self.target_rate = target_rate
        self.plant_dtype = plant_dtype
        self.checkpoint = checkpoint
        self.stagger = stagger
        self.memory: torch.Tensor | None = None  # (N, memory) the policy's, at a window's start
        self.retreats = 0
        self._tables: WindowRollout | None = None
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
        self.slow_policy = copy.deepcopy(self.policy).requires_grad_(False)
        slow = self.slow_policy.parameters()
        self._slow = {id(p): q for p, q in zip(self.policy.parameters(), slow, strict=True)}
        self._actor, self._critic = trained_parameters(self.policy)

    @property
    def tables(self) -> WindowRollout:
        """The environment's tables in torch."""
        if self._tables is None or self._tables.env is not self.env:
            if not isinstance(self.env, ShakeTableVecEnv):
                remedy = "must be a ShakeTableVecEnv, whose plant is known"
                raise ParameterError("env", type(self.env).__name__, remedy)
            dtype = torch.float64 if self.plant_dtype == "float64" else torch.float32
            self._tables = WindowRollout(self.env, device=self.device, dtype=dtype)
        return self._tables

    def learn(
        self,
        total_timesteps: int,
        callback: MaybeCallback = None,
        log_interval: int = 1,
        tb_log_name: str = "AnalyticPolicyGradient",
        reset_num_timesteps: bool = True,
        progress_bar: bool = False,
    ) -> Self:
        """Train for `total_timesteps` control periods of all tables together; as SB3's."""
        begins = reset_num_timesteps or self._last_obs is None
        total_timesteps, callback = self._setup_learn(
            total_timesteps, callback, reset_num_timesteps, tb_log_name, progress_bar
        )
        tables = self.tables
        if begins:  # the parameters may have been given since the model was made
            self.slow_policy.load_state_dict(self.policy.state_dict())
            if self.stagger:
                tables.env.stagger()
        callback.on_training_start(locals(), globals())
        iteration = 0
        while self.num_timesteps < total_timesteps:
            callback.on_rollout_start()
            self._update_current_progress_remaining(self.num_timesteps, total_timesteps)
            self.train()
            self.num_timesteps += self.window * tables.env.num_envs
            iteration += 1
            callback.update_locals(locals())
            going_on = callback.on_step()
            callback.on_rollout_end()
            if log_interval is not None and iteration % log_interval == 0:
                self.dump_logs(iteration)
            if not going_on:
                break
        callback.on_training_end()
        return self

    def train(self) -> None:
        """Follow one window, take a step of the actor and fit the critic."""
        self.policy.set_training_mode(True)
        rate = self.lr_schedule(self._current_progress_remaining)
        update_learning_rate(self.policy.optimizer, rate)
        loss, window, critic_features = self.window_loss()
        norm = set_gradient(self.policy, loss, self._actor, self.max_grad_norm)
        if np.isfinite(norm):
            self._follow(self._actor)
            self._step()
        else:
            self._retreat()
        if self.terminal_value:
            update_learning_rate(self.policy.optimizer, rate * self.critic_learning_rate)
            self.logger.record("train/value_loss", self._fit_critic(window, critic_features))
            self._follow(self._critic)
        self._last_obs, done, infos = self.tables.sync_env(window)
        self._last_episode_starts = done
        self._update_info_buffer(infos, done)
        self._n_updates += 1
        counted = float(window.steps.sum())
        self.logger.record("train/stage_cost", -float(window.returns.sum()) / counted)
        self.logger.record("train/broken_limits", int(window.terminated.sum()))
        self.logger.record("train/gradient_norm", norm)
        self.logger.record("train/retreats", self.retreats)
        self.logger.record("train/learning_rate", rate)
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")

    def window_loss(self) -> tuple[torch.Tensor, Window, list[torch.Tensor]]:
        """Follow the tables over the next window.

        Returns
        -------
        loss, window, critic_features
            What the actor descends: the mean discounted stage cost of the window and of what follows it,
            in units of the environment's reward; the window; and the critic's features at its H + 1
            ends of control periods, none without a terminal value.
        """
        assert isinstance(self.policy.action_net, torch.nn.Linear)  # as for any Gaussian action
        dtype = self.policy.action_net.weight.dtype

        def act(observation: torch.Tensor, memory: Kept) -> tuple[torch.Tensor, Kept, Kept]:
            (actor, critic), memory = latent(self.policy, observation.to(dtype), memory)
            action = self.policy.action_net(self.policy.mlp_extractor.forward_actor(actor))[:, 0]
            return action, memory, critic if self.terminal_value else None

        window = self.tables.rollout(
            act,
            self.window,
            recalled=self._begin(),
            segment=self.checkpoint,
            parameters=self._actor,
        )
        self.memory = None if window.recalled is None else window.recalled.detach()
        critic_features: list[torch.Tensor] = []
        if self.terminal_value and window.history is not None:
            whole = window.history.shape[:-1]
            (_, critic), _ = latent(self.policy, window.history.flatten(end_dim=1).to(dtype), None)
            critic_features = list(critic.reshape(*whole, -1))
        elif window.aside is not None:
            (_, critic), _ = latent(self.policy, window.shown.to(dtype), window.recalled)
            critic_features = [*window.aside, critic]
        steps = torch.arange(self.window, device=self.device)
        discount = (self.gamma**steps).to(window.rewards.dtype)
        total = (discount[:, None] * window.rewards).sum(dim=0)
        if self.terminal_value:
            lanes = torch.arange(len(window.ends), device=self.device)
            last = torch.stack(critic_features)[window.ends, lanes]
            at_end = state_value(self.slow_policy, last).to(total.dtype)
            follows = torch.where(window.terminated, 0.0, self.gamma ** window.ends.to(total) * at_end)
            total = total + follows
        return -total.mean() / discount.sum(), window, [each.detach() for each in critic_features]

    def _begin(self) -> torch.Tensor | None:
        """Return the policy's memory at the window's start, at rest where an episode begins."""
        if not isinstance(self.policy, MemoryPolicy):
            return None
        assert self.env is not None
        rest = self.policy.rest(self.env.num_envs)
        if self.memory is None or len(self.memory) != len(rest):
            return rest
        begun = torch.as_tensor(self._last_episode_starts, device=self.device)[:, None]
        return torch.where(begun, 0.0, self.memory.to(rest))

    def _step(self) -> None:
        self.policy.optimizer.step()
        self.policy.optimizer.zero_grad(set_to_none=True)

    @torch.no_grad()
    def _retreat(self) -> None:
        """Reset the actor to the mean of its parameters over the last windows with a finite gradient.

        After too large a step the loop is unstable: the cost overflows within a window, and its
        gradient is not finite.
        """
        for parameter in self._actor:
            parameter.copy_(self._slow[id(parameter)])
        self.retreats += 1

    @torch.no_grad()
    def _targets(self, window: Window, stacked: torch.Tensor) -> torch.Tensor:
        """Return TD(lambda) targets (H, N) by the slow critic, and of use up to each lane's end."""
        values = state_value(self.slow_policy, stacked).cpu().numpy()
        rewards, ended = window.rewards.detach().cpu().numpy(), window.broken != 0
        targets = td_lambda_targets(rewards, values, window.steps, ended, self.gamma, self.td_lambda)
        return torch.as_tensor(targets, dtype=stacked.dtype, device=stacked.device)

    def _fit_critic(self, window: Window, critic_features: list[torch.Tensor]) -> float:
        stacked = torch.stack(critic_features)
        targets = self._targets(window, stacked)
        steps = torch.arange(self.window, device=stacked.device)
        counted = steps[:, None] < window.ends
        inputs, goals = stacked[:-1][counted], targets[counted]
        losses = []
        for _ in range(self.critic_epochs):
            for part in torch.randperm(len(inputs)).to(inputs.device).chunk(self.critic_batches):
                loss = torch.nn.functional.mse_loss(state_value(self.policy, inputs[part]), goals[part])
                norm = set_gradient(self.policy, loss, self._critic, self.max_grad_norm)
                if np.isfinite(norm):
                    self._step()
                losses.append(loss.item())
        return float(np.mean(losses))

    @torch.no_grad()
    def _follow(self, parameters: list[torch.nn.Parameter]) -> None:
        for parameter in parameters:
            self._slow[id(parameter)].lerp_(parameter, self.target_rate)

    def predict(
        self,
        observation: NDArray[np.float32] | dict[str, NDArray[np.float32]],
        state: tuple[NDArray[np.float32], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[np.float32], ...] | None]:
        """Return actions and the recurrent state; deterministic unless asked, for so it was trained."""
        return self.policy.predict(observation, state, episode_start, deterministic)

    def dump_logs(self, iteration: int = 0) -> None:
        """Write what was recorded, with times, to the logger."""
        seconds = max((time.time_ns() - self.start_time) / 1e9, sys.float_info.epsilon)
        done = self.num_timesteps - self._num_timesteps_at_start
        if iteration > 0:
            self.logger.record("time/iterations", iteration, exclude="tensorboard")
        if self.ep_info_buffer:
            self.logger.record("rollout/ep_rew_mean", safe_mean([e["r"] for e in self.ep_info_buffer]))
            self.logger.record("rollout/ep_len_mean", safe_mean([e["l"] for e in self.ep_info_buffer]))
        self.logger.record("time/fps", int(done / seconds))
        self.logger.record("time/time_elapsed", int(seconds), exclude="tensorboard")
        self.logger.record("time/total_timesteps", self.num_timesteps, exclude="tensorboard")
        self.logger.dump(step=self.num_timesteps)

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "_tables", "_actor", "_critic", "_slow", "memory"]

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        return ["policy", "policy.optimizer", "slow_policy"], []
