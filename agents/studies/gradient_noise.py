"""Signal and noise of score-function gradients: estimators beside the exact gradient.

A policy explores about a base controller with white noise of standard deviation s. Any such gradient
is a mean of ``A_t e_t phi_t / s``, with e the standard normal exploration, phi what the policy sees and
A an estimate of the advantage. Estimators differ in A alone. The exact gradient along the same linear
law comes from the closed loop's adjoint, so that the bias of an estimator is seen beside its noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from agents.learning.apg.window_rollout import WindowRollout
from agents.learning.asymmetric import AsymmetricVecEnv
from agents.learning.features import FeatureMap
from agents.learning.vec_env import ShakeTableVecEnv
from agents.policies.base_law import base_law
from agents.policies.base_names import BaseLaw
from agents.seeds import VALIDATION_SEED
from shake_env.model.parameters import FloatArray
from shake_env.scenario.scenario import Scenario

RIDGE = 1e-4  # [-] of the features' mean square
CRITIC_FEATURES = 24  # directions of the features that the quadratic critic sees


@dataclass(frozen=True, kw_only=True)
class NoiseSettings:
    """What is estimated, and from how much."""

    base_controller: BaseLaw = "lqg-searched"
    residual_scale: float = 0.02  # [-] of the current limit
    log_std: float = -3.0  # of the exploration, over the scale
    n_envs: int = 64
    rollout: int = 256  # control periods between two times that shadows are put back
    rollouts: int = 12
    seed: int = VALIDATION_SEED


@dataclass(frozen=True)
class EstimatorNoise:
    """An estimator's advantage, and its gradient beside the exact one."""

    estimator: str
    advantage_rms: float  # [-] in stage costs
    action_share: float  # [-] of it that one explored action explains, rms
    cosine: float  # [-] of the gradient's direction, in coordinates in which the features are white
    along: float  # [-] of the exact gradient that is estimated; 1: without bias
    along_error: float  # [-] standard error of that
    samples: int  # samples for a signal-to-noise ratio of 1 along the exact gradient


@dataclass(frozen=True)
class GradientNoise:
    """What `gradient_noise` found."""

    scenario: str
    settings: NoiseSettings
    stage_cost: float  # [-] mean
    slope_rms: float  # [-] cost over the rest of a window per unit of action
    explained_by_critic: float  # [-] of the return's variance
    explained_by_asymmetric: float  # [-] of it by a critic that sees what no sensor shows
    estimators: tuple[EstimatorNoise, ...]


@dataclass(frozen=True)
class Explored:
    """Roll-outs (R, T, N) of tables and of their shadows without exploration."""

    explored: FloatArray  # standard normal
    cost: FloatArray
    shadow_cost: FloatArray
    features: NDArray[np.float32]  # (R, T, N, features)
    privileged: NDArray[np.float32]  # (R, T, N, p) see `agents.learning.asymmetric`


def gradient_noise(
    scenario: Scenario,
    settings: NoiseSettings | None = None,
    on_progress: Callable[[float], None] = lambda share: None,
) -> GradientNoise:
    """Return how much of each estimator's gradient is signal.

    Parameters
    ----------
    scenario
        With sensors or the full state; no table may be lost under the exploration.
    settings
        What is estimated.
    on_progress
        Told the share of the work done, 0 to 1.
    """
    chosen = NoiseSettings() if settings is None else settings
    tables = chosen.n_envs
    base = base_law(chosen.base_controller, scenario)
    env = ShakeTableVecEnv(scenario, tables, base=base, authority=chosen.residual_scale)
    features = FeatureMap(scenario, env.law is not None)
    env.seed(chosen.seed + tables)
    slopes, observations = _exact(env, features, chosen, lambda share: on_progress(0.6 * share))
    pairs = AsymmetricVecEnv(scenario, 2 * tables, base=base, authority=chosen.residual_scale)
    pairs.seed(chosen.seed)
    runs = _explore(pairs, features, chosen, lambda share: on_progress(0.6 + 0.4 * share))
    flat = observations.reshape(-1, observations.shape[-1]).astype(float)
    moments = flat.T @ flat / len(flat)
    moments += RIDGE * np.trace(moments) / len(moments) * np.eye(len(moments))
    exact = flat.T @ slopes.reshape(-1) / len(flat)
    judge = _Judge(exact, moments, math.exp(chosen.log_std), float(np.std(slopes)), runs)
    period = scenario.control_period
    critic, explained = _critic(runs, math.exp(-period / 0.25))
    asymmetric, explained_by_more = _critic(runs, math.exp(-period / 0.25), privileged=True)
    difference, zero = runs.shadow_cost - runs.cost, np.zeros_like(critic)
    cases = (
        ("returns over 0.25 s", -runs.cost, zero, 0.25, 1.0),
        ("returns over 0.25 s, critic", -runs.cost, critic, 0.25, 1.0),
        ("lambda 0.9, critic", -runs.cost, critic, 0.25, 0.9),
        ("lambda 0.9, asymmetric critic", -runs.cost, asymmetric, 0.25, 0.9),
        ("paired, lambda 0.9", difference, zero, 2.0, 0.9),
        ("paired, lambda 0.95", difference, zero, 2.0, 0.95),
        ("paired, lambda 0.99", difference, zero, 2.0, 0.99),
    )
    rows = []
    for name, reward, values, horizon, smoothing in cases:
        gamma = math.exp(-period / horizon)
        rows.append(judge.noise(name, advantages(reward, values, gamma, smoothing)))
    return GradientNoise(
        scenario=scenario.name,
        settings=chosen,
        stage_cost=float(runs.shadow_cost.mean()),
        slope_rms=judge.slope,
        explained_by_critic=explained,
        explained_by_asymmetric=explained_by_more,
        estimators=tuple(rows),
    )


def _exact(
    env: ShakeTableVecEnv,
    features: FeatureMap,
    chosen: NoiseSettings,
    on_progress: Callable[[float], None],
) -> tuple[FloatArray, NDArray[np.float32]]:
    """Return minus the slope of the cost (R, T/2, N) of the rest of a window along each action.

    Of each window the first half is taken, whose actions are followed by half a window at least; and
    the features (R, T/2, N, features) there.
    """
    env.reset()
    tables = WindowRollout(env)
    half = chosen.rollout // 2
    slopes, observations = [], []
    for number in range(chosen.rollouts):
        added = torch.zeros((chosen.rollout, chosen.n_envs), dtype=torch.float64, requires_grad=True)
        steps = iter(added)
        shown: list[NDArray[np.float32]] = []

        def act(
            observation: torch.Tensor,
            memory: torch.Tensor | None,
            steps: object = steps,
            shown: list[NDArray[np.float32]] = shown,
        ) -> tuple[torch.Tensor, torch.Tensor | None, None]:
            shown.append(features(observation.detach().numpy().astype(np.float32)))
            return next(steps), memory, None  # type: ignore[call-overload]

        window = tables.rollout(act, chosen.rollout)
        (slope,) = torch.autograd.grad(window.rewards.sum(), added)
        slopes.append(slope[:half].numpy().copy())
        observations.append(np.stack(shown[:half]))
        tables.sync_env(window)
        on_progress((number + 1) / chosen.rollouts)
    return np.stack(slopes), np.stack(observations)


def _explore(
    env: AsymmetricVecEnv,
    features: FeatureMap,
    chosen: NoiseSettings,
    on_progress: Callable[[float], None],
) -> Explored:
    """Return roll-outs of the tables, the first half of the lanes, with exploration, and of shadows."""
    n, shape = chosen.n_envs, (chosen.rollouts, chosen.rollout, chosen.n_envs)
    lanes, shadows = range(n), range(n, 2 * n)
    noise = np.random.default_rng(chosen.seed).standard_normal(shape)
    costs, observations, told = np.empty((*shape[:2], 2 * n)), [], []
    shown = env.reset()
    own = shown.shape[1] - env.privileged.size
    for number, rollout in enumerate(noise):
        env.set_state(env.get_state(lanes), shadows)
        for t, each in enumerate(rollout):
            observations.append(features(shown[:n, :own]))
            told.append(shown[:n, own:])
            action = np.concatenate([math.exp(chosen.log_std) * each, np.zeros(n)])
            env.step_async(action[:, None].astype(np.float32))
            shown, reward, _, _ = env.step_wait()
            costs[number, t] = -reward
        on_progress((number + 1) / chosen.rollouts)
    seen, known = (np.stack(each).reshape(*shape, -1) for each in (observations, told))
    return Explored(noise, costs[..., :n], costs[..., n:], seen, known)


def advantages(reward: FloatArray, values: FloatArray, gamma: float, smoothing: float) -> FloatArray:
    """Return generalised advantages (R, T, N) (Schulman et al., 2016), nothing behind a roll-out's end.

    Parameters
    ----------
    reward, values
        (R, T, N) of roll-outs.
    gamma, smoothing
        Discount and lambda per control period.
    """
    result = np.zeros_like(reward)
    following, behind = np.zeros_like(reward[:, 0]), np.zeros_like(reward[:, 0])
    for t in range(reward.shape[1] - 1, -1, -1):
        error = reward[:, t] + gamma * following - values[:, t]
        behind = error + gamma * smoothing * behind
        result[:, t], following = behind, values[:, t]
    return result


def _critic(runs: Explored, gamma: float, privileged: bool = False) -> tuple[FloatArray, float]:
    """Return values (R, T, N) by least squares on other tables, and what they explain of the returns.

    Of a constant, the features' main directions and their products, and the privileged entries.
    """
    returns = advantages(-runs.cost, np.zeros_like(runs.cost), gamma, 1.0)
    flat = runs.features.reshape(-1, runs.features.shape[-1]).astype(float)
    _, vectors = np.linalg.eigh(flat.T @ flat / len(flat))
    main = flat @ vectors[:, -CRITIC_FEATURES:]
    main /= np.sqrt(np.mean(main**2, axis=0)) + 1e-12
    i, j = np.triu_indices(main.shape[1])
    parts = [np.ones((len(main), 1)), main, main[:, i] * main[:, j]]
    if privileged:
        parts.append(runs.privileged.reshape(len(main), -1).astype(float))
    inputs = np.concatenate(parts, axis=1)
    inputs = inputs.reshape(*returns.shape, -1)
    values = np.empty_like(returns)
    half = returns.shape[2] // 2
    for fitted, taken in ((slice(0, half), slice(half, None)), (slice(half, None), slice(0, half))):
        x = inputs[:, :, fitted].reshape(-1, inputs.shape[-1])
        normal = x.T @ x
        normal += RIDGE * np.trace(normal) / len(normal) * np.eye(len(normal))
        weights = np.linalg.solve(normal, x.T @ returns[:, :, fitted].reshape(-1))
        values[:, :, taken] = inputs[:, :, taken] @ weights
    early = slice(0, returns.shape[1] // 2)
    rest = np.var((returns - values)[:, early]) / np.var(returns[:, early])
    return values, float(1.0 - rest)


class _Judge:
    """Compares advantages with the exact gradient."""

    def __init__(
        self, exact: FloatArray, moments: FloatArray, deviation: float, slope: float, runs: Explored
    ) -> None:
        self.slope, self._deviation = slope, deviation
        values, vectors = np.linalg.eigh(moments)
        self._white = vectors @ np.diag(1.0 / np.sqrt(values)) @ vectors.T
        direction = np.linalg.solve(moments, exact)
        self._exact, self._size = exact, math.sqrt(exact @ direction)
        half = runs.explored.shape[1] // 2  # of later ones the effect is cut off by the roll-out's end
        self._half = half
        self._scores = runs.explored[:, :half] / deviation
        self._features = runs.features[:, :half]
        self._projected = self._features @ (direction / self._size)

    def noise(self, name: str, advantage: FloatArray) -> EstimatorNoise:
        """Return an estimator's noise from its advantages (R, T, N)."""
        A = advantage[:, : self._half] - advantage[:, : self._half].mean()
        weighed = A * self._scores
        gradient = np.einsum("rtn,rtnk->k", weighed, self._features) / A.size
        ours, exact = self._white @ gradient, self._white @ self._exact
        along = weighed * self._projected
        lanes = along.mean(axis=(0, 1))
        return EstimatorNoise(
            estimator=name,
            advantage_rms=float(A.std()),
            action_share=self.slope * self._deviation / float(A.std()),
            cosine=float(ours @ exact / np.linalg.norm(ours) / np.linalg.norm(exact)),
            along=float(along.mean() / self._size),
            along_error=float(lanes.std(ddof=1) / math.sqrt(len(lanes)) / self._size),
            samples=max(1, round(float(along.var()) / self._size**2)),
        )
