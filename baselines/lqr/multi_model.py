"""Multi-model LQR: one gain for a set of specimens, least in mean or in worst stationary cost.

The cost of a gain on each model, and its gradient ``2 ((R + G'PG) K - G'PF - S') Sigma``, come from two
Lyapunov equations (Makila and Toivonen, IEEE TAC 32, 1987); the sum or a sharpening soft maximum over
the set is minimised by BFGS from the nominal LQR. Where that does not stabilise the whole set, the
plants are first damped by a factor below 1 a period, in which every gain of interest is stable, and the
factor is raised to 1 as the gain allows (Perdomo, Umenberger and Simchowitz, NeurIPS 2021).

What it promises holds for the models of the set and no other: take the set denser than the uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.optimize import minimize

from baselines.lqr.design_states import DesignStates
from baselines.lqr.discrete_lyapunov import discrete_lyapunov
from baselines.lqr.preview import preview_lqr
from baselines.lqr.sampled import ScaledProblem
from shake_env.errors import NumericalError, ParameterError
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import REFERENCE_CURRENT
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uncertainty

Aim = Literal["mean", "worst"]

SHARPNESS = (10.0, 30.0, 100.0, 300.0)  # of the soft maximum, relative to the worst cost
HOMOTOPY_STEPS = 50
RESTARTS = 30
_WALL = 1e6  # cost of an unstable gain relative to the start's, for the line search


@dataclass(frozen=True)
class MultiModelDesign:
    """One gain and what it costs on each model, beside the nominal LQR."""

    gain: FloatArray  # (n,) [A per SI unit of each state]
    costs: FloatArray  # (models,) stationary expected stage cost
    nominal_costs: FloatArray  # (models,) of the nominal LQR; infinite where it is unstable


def drawn_models(scenario: Scenario, number: int, seed: int = 0) -> list[Scenario]:
    """Return `number` scenarios with true plants drawn from the scenario's uncertainty."""
    drawn = (
        scenario.drawn(np.random.default_rng(s)) for s in np.random.SeedSequence(seed).spawn(number)
    )
    return [replace(true, uncertainty=Uncertainty()) for true in drawn]


@dataclass(frozen=True)
class ModelSet:
    """The lifted problems of a set, in the nominal plant's scale, stacked."""

    F: FloatArray  # (models, m, m)
    G: FloatArray  # (models, m, 1)
    W: FloatArray  # (models, m, m) covariance of a period's noise
    Q: FloatArray  # (models, m, m)
    R: FloatArray  # (models, 1, 1)
    S: FloatArray  # (models, m, 1)
    constant: FloatArray  # (models,) cost that no gain changes

    @classmethod
    def from_scenarios(
        cls, nominal: Scenario, models: Sequence[Scenario], position: float | None = None
    ) -> ModelSet:
        """Stack `models`, which share the nominal's states; `position` as for `multi_model_lqr`.

        Raises
        ------
        ParameterError
            If the set is empty, or a model has other states or another control period.
        """
        layout, period = nominal.plant.layout, nominal.control_period
        if not models:
            raise ParameterError("models", models, "give at least one")
        states = cls.states(nominal, models, position)
        parts: dict[str, list[FloatArray]] = {name: [] for name in ("F", "G", "W", "Q", "R", "S")}
        constant = []
        for model in models:
            if (model.plant.layout, model.control_period) != (layout, period):
                raise ParameterError("model", model, "must have the nominal's states and period")
            p = ScaledProblem.from_plant(
                model.discrete, DesignStates.from_plant(model.plant, whole=not np.any(states.left_out))
            )
            ratio = p.scale / nominal.plant.state_scale[p.indices]  # own to nominal units
            Q, R, S = p.stage(model.stage_cost)
            fixed = p.unreached(model.stage_cost)
            if position is not None:
                place = p.place(model.plant, position)
                on_x, on_u = place @ p.F, place @ p.G
                Q, R, S = Q + np.outer(on_x, on_x), R + on_u**2, S + np.outer(on_x, on_u)
                fixed += float(np.sum((place @ p.N) ** 2))
            N = p.N * ratio[:, None]
            parts["F"].append(p.F * ratio[:, None] / ratio)
            parts["G"].append(p.G * ratio[:, None])
            parts["W"].append(N @ N.T)
            parts["Q"].append(Q / np.outer(ratio, ratio))
            parts["R"].append(R)
            parts["S"].append(S / ratio[:, None])
            constant.append(fixed)
        stacked = {name: np.stack(values) for name, values in parts.items()}
        return cls(**stacked, constant=np.array(constant))

    @staticmethod
    def states(nominal: Scenario, models: Sequence[Scenario], position: float | None) -> DesignStates:
        """Return what the design works on: the whole state where one of the models needs it."""
        whole = position is not None or not all(
            np.any(DesignStates.from_plant(each.plant).left_out) for each in (nominal, *models)
        )
        return DesignStates.from_plant(nominal.plant, whole=whole)

    def radii(self, K: FloatArray) -> FloatArray:
        """Return each closed loop's spectral radius, (models,), under the gain K (1, m)."""
        radii: FloatArray = np.max(np.abs(np.linalg.eigvals(self.F - self.G @ K)), axis=-1)
        return radii

    def costs(self, K: FloatArray, discount: float = 1.0) -> tuple[FloatArray, FloatArray]:
        """Return cost (models,) and its gradient (models, m) where `discount` scales F and G.

        The closed loops must be stable.
        """
        F, G = discount * self.F, discount * self.G
        closed, turned = F - G @ K, (F - G @ K).swapaxes(-1, -2)
        Sigma = discrete_lyapunov(closed, self.W, turned)
        cross = self.S @ K
        P = discrete_lyapunov(turned, self.Q - cross - cross.swapaxes(-1, -2) + K.T @ self.R @ K, closed)
        slope = (self.R + G.swapaxes(-1, -2) @ P @ G) @ K
        slope = slope - G.swapaxes(-1, -2) @ P @ F - self.S.swapaxes(-1, -2)
        costs = np.einsum("kij,kji->k", P, self.W) + self.constant
        return costs, 2.0 * (slope @ Sigma)[:, 0]


def multi_model_lqr(
    nominal: Scenario, models: Sequence[Scenario], aim: Aim = "mean", position: float | None = None
) -> MultiModelDesign:
    """Design one gain for a set of models.

    Parameters
    ----------
    nominal
        Whose LQR the search starts from; it need not be in the set.
    models
        Specimens (or whole plants) of the same states; each is judged by its own stage cost.
    aim
        ``"mean"`` or ``"worst"`` of the models' costs.
    position
        [m] error of the table's place that is worth a motionless table's stage cost, here part of the
        costs; None: no error of place is worth anything.

    Raises
    ------
    ParameterError
        If the set does not fit the nominal scenario, or the aim is unknown.
    ScenarioError
        If the position is weighed and the ground filter has no high-pass.
    NumericalError
        If no gain that stabilises the whole set was found.
    """
    if aim not in ("mean", "worst"):
        raise ParameterError("aim", aim, "must be 'mean' or 'worst'")
    problem = ModelSet.from_scenarios(nominal, models, position)
    states = ModelSet.states(nominal, models, position)
    retained = states.indices
    scale = nominal.plant.state_scale[retained]
    start = preview_lqr(nominal.discrete, nominal.stage_cost, 0.0, position=position).gain[retained]
    K = (start * scale / REFERENCE_CURRENT)[None, :]
    stable = problem.radii(K) < 1.0
    before = np.full(len(models), np.inf)
    if stable.any():
        held = ModelSet(**{name: value[stable] for name, value in vars(problem).items()})
        before[stable] = held.costs(K)[0]
    for _ in range(HOMOTOPY_STEPS):
        radius = float(np.max(problem.radii(K)))
        if radius < 1.0:
            break
        K = _descend(problem, K, 0.995 / radius, None, iterations=20)
    else:
        raise NumericalError("spectral radius", radius, "no gain found for the whole set")
    K = _descend(problem, K, 1.0, None)
    for sharpness in SHARPNESS if aim == "worst" else ():
        K = _descend(problem, K, 1.0, sharpness)
    gain = np.zeros(nominal.plant.layout.order)
    gain[retained] = K[0] * REFERENCE_CURRENT / scale
    gain = states.completed(gain, np.ones(len(gain)))
    return MultiModelDesign(gain, problem.costs(K)[0], before)


def _descend(
    problem: ModelSet,
    K: FloatArray,
    discount: float,
    sharpness: float | None,
    iterations: int | None = None,
) -> FloatArray:
    """Return a gain of less mean, or of less soft maximum, than K by BFGS."""
    first, _ = problem.costs(K, discount)
    reference = float(np.mean(first)) if sharpness is None else float(np.max(first))

    def objective(trial: FloatArray) -> tuple[float, FloatArray]:
        if not discount * np.max(problem.radii(trial)) < 1.0:
            return _WALL, np.zeros(trial.shape[1])
        costs, slopes = problem.costs(trial, discount)
        relative = costs / reference
        if sharpness is None:
            return float(np.mean(relative)), np.mean(slopes, axis=0) / reference
        peak = float(np.max(relative))
        powers = np.exp(sharpness * (relative - peak))
        value = peak + float(np.log(np.mean(powers))) / sharpness
        return value, powers @ slopes / (np.sum(powers) * reference)

    value = np.inf
    for _ in range(RESTARTS):
        change = _round(problem, K, discount)

        def turned(
            theta: FloatArray, K: FloatArray = K, change: FloatArray = change
        ) -> tuple[float, FloatArray]:
            cost, slope = objective(K + (change @ theta)[None, :])
            return cost, slope @ change

        options = {"gtol": 1e-7} | ({} if iterations is None else {"maxiter": iterations})
        minimum = minimize(turned, np.zeros(K.shape[1]), jac=True, method="BFGS", options=options)
        K = K + (change @ minimum.x)[None, :]
        if iterations is not None or minimum.fun > (1.0 - 1e-9) * value:
            break
        value = minimum.fun
    return K


def _round(problem: ModelSet, K: FloatArray, discount: float) -> FloatArray:
    """Return directions of the gain, (m, m), that each move the current by as much.

    In them the cost is nearly round. It stops being so on the way, hence the restarts.
    """
    closed = discount * (problem.F - problem.G @ K)
    spread = np.mean(discrete_lyapunov(closed, problem.W, closed.swapaxes(-1, -2)), axis=0)
    values, vectors = np.linalg.eigh(spread)
    directions: FloatArray = vectors / np.sqrt(np.maximum(values, 1e-12 * values[-1]))
    return directions
