"""A critic that sees more than the policy: the true state, the drawn plant and the ground to come.

A simulator knows what no sensor measures. A critic is used in training alone, so that it may see all of
it, while the policy sees what the scenario shows (Pinto, Andrychowicz, Welinder, Zaremba and Abbeel,
"Asymmetric Actor Critic for Image-Based Robot Learning", RSS 2018). The values of a state that is
known in full are also the right baseline where the observation is not the state (Baisero and Amato,
"Unbiased Asymmetric Reinforcement Learning under Partial Observability", AAMAS 2022).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, MlpExtractor

from agents.learning.features import (
    CLIP,
    PREVIEW_SHARE,
    PREVIEW_SPACING,
    LinearFeatures,
    full_state_matrix,
)
from agents.learning.vec_env import ShakeTableVecEnv
from agents.policies.estimated_law import EstimatedLaw
from shake_env.model.parameters import FloatArray
from shake_env.motion.targets import FilteredNoise, MotionSet
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uniform
from shake_env.simulation.engine import StepResult
from shake_env.simulation.simulation import Simulation

AHEAD = 2.0  # [s] of the ground to come
BLOCK = 0.05  # [s] over which changes of the target to come are squared and averaged
FINE_AHEAD = 0.25  # [s] in which each change is told, beside that


class AsymmetricVecEnv(ShakeTableVecEnv):
    """A `ShakeTableVecEnv` whose observations go on with what only a critic may see.

    `Privileged.size` entries of the order of 1 stand behind the scenario's own observation and what an
    estimator believes. All else is as without them: actions, rewards, random numbers and states.

    Parameters
    ----------
    scenario, num_envs, base, authority, reward_scale
        As of `ShakeTableVecEnv`.
    """

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int,
        *,
        base: FloatArray | EstimatedLaw | None = None,
        authority: float = 1.0,
        reward_scale: float = 1.0,
    ) -> None:
        super().__init__(scenario, num_envs, base=base, authority=authority, reward_scale=reward_scale)
        self.privileged = Privileged(self.simulation)
        own = self.observation_space
        assert isinstance(own, spaces.Box)
        low, high = (
            np.append(b, np.full(self.privileged.size, s * CLIP))
            for b, s in ((own.low, -1.0), (own.high, 1.0))
        )
        self.observation_space = spaces.Box(low.astype(np.float32), high.astype(np.float32))

    def reset(self) -> NDArray[np.float32]:
        """Start an episode in every lane; see `ShakeTableVecEnv.reset`."""
        return self._with_told(super().reset())

    def step_wait(
        self,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Advance all tables; see `ShakeTableVecEnv.step_wait`."""
        shown, reward, done, infos = super().step_wait()
        return self._with_told(shown), reward, done, infos

    def set_state(self, state: Mapping[str, NDArray[Any]], lanes: Sequence[int] | None = None) -> None:
        """Put lanes where others stood; see `ShakeTableVecEnv.set_state`."""
        super().set_state(state, lanes)
        self.privileged.look_ahead(range(self.num_envs) if lanes is None else lanes)

    def _with_told(self, shown: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.concatenate([shown, self.privileged()], axis=1)

    def _final_info(self, result: StepResult, lane: int) -> dict[str, Any]:
        info = super()._final_info(result, lane)
        told = self.privileged()[lane]  # before the next episode begins
        info["terminal_observation"] = np.concatenate([info["terminal_observation"], told])
        return info

    def _start(
        self,
        lanes: Sequence[int],
        begun: Mapping[int, np.random.Generator] = MappingProxyType({}),
    ) -> NDArray[np.float32]:
        observation = super()._start(lanes, begun)
        self.privileged.look_ahead(lanes)
        return observation


class Privileged:
    """What a simulation knows of N tables and no sensor shows, as numbers of the order of 1.

    Errors of the true state
        As of a full observation (`agents.learning.features.full_state_matrix`).
    Drawn parameters
        -1 at the lower end of a range and 1 at the upper; storeys' factors each.
    Ground to come
        Changes of the target over each control period of `FINE_AHEAD`, and the mean square of these
        changes in each `BLOCK` of `AHEAD`, from the end of the present period on.

    Parameters
    ----------
    simulation
        The tables.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation, scenario = simulation, simulation.scenario
        self._errors = full_state_matrix(scenario) / _amplitude(scenario)
        self._ranges = _ranges(scenario)
        self._plants = np.zeros((simulation.lanes, len(self._ranges)))
        period = scenario.control_period
        self._block, self._fine = round(BLOCK / period), round(FINE_AHEAD / period)
        self._ahead = round(AHEAD / period) // self._block * self._block
        spread = PREVIEW_SHARE * np.sqrt(period / PREVIEW_SPACING * scenario.plant.target_variance)
        self._change = float(spread * _amplitude(scenario))
        self._changes = np.zeros((simulation.lanes, 0))  # of the target, over each period of an episode
        self.size = len(self._errors) + len(self._ranges) + self._fine + self._ahead // self._block

    def look_ahead(self, lanes: Sequence[int]) -> None:
        """Take down the ground to come and the plants of lanes that were put somewhere."""
        simulation = self._simulation
        scout = Simulation(simulation.scenario, len(lanes))
        state = simulation.get_state(list(lanes))
        scout.set_state(state)
        counts = simulation.step_count[list(lanes)]
        left = int((simulation.episode_steps[list(lanes)] - counts).max())
        now = scout.engine.ground(preview=False).target[:, -1]
        coming = scout.ground_ahead(left + self._ahead)[0].target[:, :, -1]
        changes = np.diff(coming, axis=0, prepend=now[None]) / self._change
        width = int(counts.max()) + len(changes)
        if width > self._changes.shape[1]:
            more = width - self._changes.shape[1]
            self._changes = np.pad(self._changes, ((0, 0), (0, more)))
        for lane, count, row in zip(lanes, counts, changes.T, strict=True):
            self._changes[lane, count : count + len(row)] = row
        for lane, values in zip(lanes, state.get("plant_values", ()), strict=False):
            self._plants[lane] = [
                (values[name] - r.low) / (r.high - r.low) * 2.0 - 1.0 for name, r in self._ranges.items()
            ]

    def __call__(self) -> NDArray[np.float32]:
        """Return what is known of the tables now (N, size)."""
        simulation = self._simulation
        ground = simulation.engine.ground(preview=False)
        errors = simulation.model.full_state(simulation.state, ground) @ self._errors.T
        at = simulation.step_count[:, None] + np.arange(self._ahead)
        coming = np.take_along_axis(self._changes, at, axis=1)
        blocks = coming.reshape(len(at), -1, self._block)
        told = (errors, self._plants, coming[:, : self._fine], np.mean(blocks**2, axis=2))
        known: NDArray[np.float32] = np.concatenate(told, axis=1).astype(np.float32)
        return np.clip(known, -CLIP, CLIP)


def _amplitude(scenario: Scenario) -> float:
    """Return the amplitude of a scenario's filtered noise, also among other motions; 1 without."""
    motion = scenario.motion
    every = motion.scaled if isinstance(motion, MotionSet) else (motion,)
    return next((m.amplitude for m in every if isinstance(m, FilteredNoise) and m.amplitude), 1.0)


def _ranges(scenario: Scenario) -> dict[str, Uniform]:
    """Return the range of every number that a plant draws, by its name among the drawn values."""
    kinds = vars(scenario.uncertainty)
    if not scenario.uncertainty.active:
        return {}
    names = scenario.uncertainty.sample(np.random.default_rng(0), scenario.specimen.stories)
    return {name: kinds.get(name) or kinds["storey_factor"] for name in names}


class PrivilegedFeatures(LinearFeatures):
    """`LinearFeatures` of the scenario's own entries, and behind them the privileged ones as they are.

    Parameters
    ----------
    observation_space
        Of an `AsymmetricVecEnv`.
    matrix, clip, sizes
        As of `LinearFeatures`, of the scenario's own entries.
    """

    def __init__(self, observation_space: spaces.Box, matrix: list[list[float]], **options: Any) -> None:
        super().__init__(observation_space, matrix, **options)
        self._features_dim += observation_space.shape[0] - self.matrix.shape[1]

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return features (batch, features + privileged)."""
        told = observations[..., self.matrix.shape[1] :]
        return torch.cat([super().forward(observations), told], dim=-1)


class _SeesMore:
    """A policy of SB3 over `LinearFeatures`, which its critic has with the privileged entries."""

    def privileged_features(self) -> BaseFeaturesExtractor:
        """Return the features of the critic."""
        policy: Any = self
        features = PrivilegedFeatures(policy.observation_space, **policy.features_extractor_kwargs)
        return features.to(policy.device)


class AsymmetricActorCritic(_SeesMore, ActorCriticPolicy):
    """PPO's policy with an asymmetric critic; see :func:`asymmetric`."""

    def __init__(self, *spaces_and_schedule: Any, **options: Any) -> None:
        options["share_features_extractor"] = False
        super().__init__(*spaces_and_schedule, **options)

    def _build_mlp_extractor(self) -> None:
        super()._build_mlp_extractor()
        self.vf_features_extractor = self.privileged_features()
        wider = MlpExtractor(
            self.vf_features_extractor.features_dim,
            net_arch=self.net_arch,
            activation_fn=self.activation_fn,
            device=self.device,
        )
        self.mlp_extractor.value_net = wider.value_net


class AsymmetricQ(_SeesMore):
    """SAC's, TD3's or TQC's policy with asymmetric critics; see :func:`asymmetric`."""

    def make_critic(self, features_extractor: BaseFeaturesExtractor | None = None) -> Any:
        """Return a critic over the features with the privileged entries."""
        return super().make_critic(self.privileged_features())  # type: ignore[misc]


@cache
def asymmetric(kind: type[BasePolicy]) -> type[BasePolicy]:
    """Return a policy class with an asymmetric critic.

    Its actor, and so what is exported of it, is that of `kind`, which reads the scenario's own entries
    (`LinearFeatures`). For environments that are an `AsymmetricVecEnv`.

    Parameters
    ----------
    kind
        Policy without memory of PPO, SAC, TD3 or TQC.
    """
    mixed = AsymmetricActorCritic if issubclass(kind, ActorCriticPolicy) else AsymmetricQ
    return type(f"Asymmetric{kind.__name__}", (mixed, kind), {"__doc__": mixed.__doc__})
