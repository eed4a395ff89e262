"""A blind search of linear laws outside the catalogue: does it beat the best classical controller.

Every entry of the observation, with readings of the last periods where signals are shown, gets a
weight; the covariance matrix adaptation evolution strategy (Hansen and Ostermeier, 2001; the package
`cma`) searches all weights at once for least mean cost on validation earthquakes. It knows nothing of
the model. Two starts: the table that does nothing, and a least-squares copy of a catalogued
controller's actions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.tune import VALIDATION_SEED
from baselines.registry import make_baseline, reference_name
from shake_env.controller import Controller
from shake_env.errors import ShakeError
from shake_env.motion import FilteredNoise
from shake_env.rollout import Earthquake, noise_earthquakes, rollout
from shake_env.scenario import Scenario
from shake_env.simulation import Simulation

FloatArray = NDArray[np.float64]
HISTORY = 3  # periods of readings that a searched law remembers
SECONDS = 6.0  # of a validation earthquake


class Rows:
    """Linear laws, one row for each table or one for all.

    Parameters
    ----------
    rows
        (n,) or (N, n) action per entry of the observation.
    """

    def __init__(self, rows: FloatArray) -> None:
        self.rows = rows

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the actions (..., 1) for observations (..., n), within [-1, 1]."""
        action = np.clip(np.sum(observation * self.rows, axis=-1), -1.0, 1.0)
        return action[..., None].astype(np.float32), None


@dataclass(frozen=True)
class SearchResult:
    """What a search came to."""

    scenario: str
    start: str  # "nothing", or the controller that was copied
    rows: FloatArray  # (n,) the law
    start_cost: float  # mean stage cost on the validation earthquakes
    cost: float
    evaluations: int


def remembering(scenario: Scenario) -> Scenario:
    """Return the scenario with the history that a searched law is given."""
    if scenario.sensing.full_state:
        return scenario
    return replace(scenario, sensing=replace(scenario.sensing, history=HISTORY))


def search(
    scenario: Scenario,
    start: str,
    *,
    generations: int = 300,
    population: int = 16,
    earthquakes: int = 12,
    seed: int = 0,
    on_generation: Callable[[int, float], None] = lambda done, best: None,
) -> SearchResult:
    """Search a linear law.

    Parameters
    ----------
    scenario
        What it drives.
    start
        ``nothing``, or the name of a controller to begin with a copy of.
    generations, population, earthquakes, seed
        Of the strategy; `population` laws run on `earthquakes` validation earthquakes side by side.
    on_generation
        Told the generations done and the best cost.

    Raises
    ------
    ShakeError
        If the package `cma` is not installed.
    """
    try:
        import cma
    except ImportError:
        raise ShakeError("cma", "missing", "pip install 'shake-env[agents]'") from None
    shown = remembering(scenario)
    quakes = [_shortened(quake) for quake in noise_earthquakes(scenario, earthquakes, VALIDATION_SEED)]
    size = shown.observation.size

    def costs(laws: FloatArray) -> FloatArray:
        rows = np.repeat(laws, len(quakes), axis=0)
        found, _ = rollout(Rows(rows), shown, list(quakes) * len(laws))
        each = np.array([row.cost for row in found]).reshape(len(laws), len(quakes))
        return np.nan_to_num(each.mean(axis=1), nan=1e6, posinf=1e6)

    # Weights count in parts of an action: each entry over its spread under a controller that works.
    copied, spread = imitation(
        copy_of(scenario) if start == "nothing" else start, scenario, shown, quakes
    )
    first = np.zeros(size) if start == "nothing" else copied
    begun = float(costs(first[None])[0])
    options = {"seed": seed + 1, "popsize": population, "verbose": -9, "CMA_diagonal": generations // 3}
    strategy = cma.CMAEvolutionStrategy(first * spread, 0.03 if start == "nothing" else 0.003, options)
    best, best_cost = first, begun
    for done in range(1, generations + 1):
        asked = strategy.ask()
        laws = np.asarray(asked) / spread
        found = costs(laws)
        strategy.tell(asked, found.tolist())
        if found.min() < best_cost:
            best, best_cost = laws[int(found.argmin())], float(found.min())
        on_generation(done, best_cost)
    return SearchResult(scenario.name, start, best, begun, best_cost, generations * population)


def imitation(
    name: str, scenario: Scenario, shown: Scenario, quakes: list[Earthquake]
) -> tuple[FloatArray, FloatArray]:
    """Return the linear law (n,) that repeats a controller's actions best, and each entry's spread (n,)."""
    controller: Controller = make_baseline(name, scenario)
    streams = [np.random.default_rng(quake.seed) for quake in quakes]
    simulation = Simulation(shown, len(quakes))
    observation = simulation.start(range(len(quakes)), streams, [quake.motion for quake in quakes])
    width = scenario.observation.size  # the history comes last, and the controller does not know it
    memory, begins, seen, done = None, np.ones(len(quakes), dtype=bool), [], []
    for _ in range(int(simulation.episode_steps.min())):
        action, memory = controller.predict(observation[:, :width], memory, begins)
        begins = np.zeros(len(quakes), dtype=bool)
        seen.append(observation)
        done.append(action[:, 0])
        observation = simulation.step(action[:, 0].astype(float)).observation
    inputs, outputs = np.concatenate(seen).astype(float), np.concatenate(done).astype(float)
    scale = np.maximum(inputs.std(axis=0), 1e-6)
    ridge = 1e-4 * len(inputs) * np.eye(inputs.shape[1])
    scaled = inputs / scale
    row: FloatArray = np.linalg.solve(scaled.T @ scaled + ridge, scaled.T @ outputs) / scale
    return row, scale


def copy_of(scenario: Scenario) -> str:
    """Return the controller whose signals set the scale of a search."""
    return reference_name(scenario)


def _shortened(quake: Earthquake) -> Earthquake:
    if not isinstance(quake.motion, FilteredNoise):
        return quake
    return replace(quake, motion=replace(quake.motion, duration=min(SECONDS, quake.motion.duration)))
