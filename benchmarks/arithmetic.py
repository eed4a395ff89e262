"""Kernels against the machine's arithmetic, and closed loops against how a textbook runs them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.signal import dlsim

from baselines.analysis.batch_response import mean_squares
from baselines.lqr.sampled import sampled_lqr
from benchmarks.timing import seconds_each
from shake_env import make_scenario
from shake_env.model.discretization import DiscretePlant, DiscreteStateSpace, zero_order_hold
from shake_env.simulation.simulation import Simulation

TABLES = 1024
CONTROLLED = "augmented product, controlled table alone"  # what an action reaches: 4 + 2 n_m states
FULL = "augmented product, with ground and reference"


def kernel(spell: float, spells: int) -> dict[str, float]:
    """Return multiply-adds a second (1e9) of the largest matrix product, and of steps at 1024 tables."""
    a = np.random.default_rng(0).normal(size=(768, 768))
    product = np.empty_like(a)
    scenario = make_scenario("linear", {"stories": 5})
    simulation = Simulation(scenario, TABLES)
    simulation.start(range(TABLES), [np.random.default_rng(i) for i in range(TABLES)])
    still = np.zeros(TABLES)
    matrix, ground = simulation.model.dynamics.matrix, simulation.tables.maps.noise
    step = TABLES * matrix.size
    work: dict[str, tuple[Any, int]] = {
        "matrix product 768 x 768": (lambda: np.matmul(a, a, out=product), 768**3),
        CONTROLLED: (_product(matrix), step),
        FULL: (_product(whole := _whole(scenario.discrete)), TABLES * whole.size),
        "whole step, with its ground": (lambda: simulation.step(still), step + TABLES * ground.size),
    }
    alone = simulation.engine.advance_ground
    work["ground alone, with its copies"] = (alone, TABLES * ground.size)
    times = seconds_each({name: call for name, (call, _) in work.items()}, spell, spells)
    return {name: work[name][1] / each / 1e9 for name, each in times.items()}


def _whole(discrete: DiscretePlant) -> np.ndarray:
    """Return one control period of all states, and the two errors after each physics step, as a map."""
    errors = np.array([[1.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, -1.0]])
    lifted = discrete.lifted
    return np.vstack([lifted.state, *(errors @ outputs for outputs in lifted.outputs)])


def _product(matrix: np.ndarray) -> Callable[[], object]:
    columns, moved = np.zeros((matrix.shape[1], TABLES)), np.empty((len(matrix), TABLES))
    return lambda: np.matmul(matrix, columns, out=moved)


def loop(stories: int = 2) -> DiscreteStateSpace:
    """Return the closed loop of the sampled LQR at 500 Hz: white noise in, ``[e_a, e_f, u]`` out."""
    scenario = make_scenario(
        "linear", {"stories": stories, "control_rate": 500.0, "physics_step": 0.002}
    )
    gain = sampled_lqr(scenario.discrete, scenario.stage_cost).gain
    plant, scale = scenario.plant.coupled, scenario.plant.state_scale
    model = zero_order_hold(plant, 0.002, scale)
    # Scaled: raw SI states span ten decades, and a comparison to 1e-10 would be one of rounding.
    A = (model.A - np.outer(model.B[:, 0], gain)) * scale / scale[:, None]
    C = np.stack([model.C[0] - model.C[2], model.C[1] - model.C[3], -gain]) * scale
    return DiscreteStateSpace(A, model.B[:, 1:] / scale[:, None], C, np.zeros((3, 1)), 0.002)


def textbook(model: DiscreteStateSpace, inputs: np.ndarray) -> np.ndarray:
    """Return the mean square of each output (N, 3), sample by sample; inputs (samples, N, 1)."""
    x = np.zeros((inputs.shape[1], model.order))
    total = np.zeros((inputs.shape[1], len(model.C)))
    for u in inputs:
        y = x @ model.C.T + u @ model.D.T
        total += y**2
        x = x @ model.A.T + u @ model.B.T
    return total / len(inputs)


def closed_loops(quakes: int, alone: int = 4) -> dict[str, float]:
    """Return the seconds that `quakes` earthquakes of 10 s at 500 Hz take, and how far the ways differ.

    Evaluated are the mean squares of the acceleration error, the force error and the current. dlsim runs
    `alone` of the earthquakes, and its time is taken times their number.
    """
    model = loop()
    noise = np.random.default_rng(0).normal(size=(5000, quakes))
    system = (model.A, model.B, model.C, model.D, model.dt)
    results: dict[str, np.ndarray] = {}

    def blocks() -> None:
        results["blocks"] = mean_squares(model, noise[:, None, :]).T

    def batch() -> None:
        results["textbook batch"] = textbook(model, noise[:, :, None])

    def scipys() -> None:
        outputs = [dlsim(system, noise[:, i])[1] for i in range(alone)]
        results["scipy dlsim"] = np.mean(np.square(outputs), axis=1)

    work: dict[str, Callable[[], object]] = {
        "blocks": blocks, "textbook batch": batch, "scipy dlsim": scipys
    }  # fmt: skip
    times = seconds_each(work, 0.05, 5)
    times["scipy dlsim"] *= quakes / alone
    ours = results["blocks"]
    apart = [np.abs(r / ours[: len(r)] - 1.0).max() for r in results.values()]
    return {"earthquakes": quakes, **times, "largest relative difference": float(max(apart))}
