"""The least cost of an episode over the whole sequence of currents, everything known: a true bound.

No law, whatever it is shown, costs less on that earthquake than the best sequence of currents. It is
found by control-limited iterative LQR on the exact nonlinear period (`ilqr_kernel`), started from what
controllers did, and what is found is no more than what they cost. On a linear plant without limits it
is the global optimum. Elsewhere the problem has local optima: starts that end together say how far it is
to be trusted, and a cost that was found is one that can be reached.

Dry friction makes local optima wherever the table reverses. There each start is first improved on the
plant with smoother friction, then with less and less smooth friction, and on the plant itself at the end
(graduated smoothing, Pang, Suh, Yang and Tedrake, IEEE Transactions on Robotics 39, 2023, use the same
for contact). The starts take different steps of smoothing, so that their agreement tells something.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.estimation.lqg import estimated
from baselines.lqr.feedforward import FeedforwardLQR
from baselines.lqr.preview import PreviewFeedback
from baselines.planning.episodes import Episode, driven, episodes
from baselines.planning.model import Plan, PlanningModel
from shake_env.controller import Controller, decide
from shake_env.model.parameters import FloatArray
from shake_env.rollout import Earthquake
from shake_env.scenario.scenario import Scenario

THREADS = 2  # earthquakes that are searched at a time where there are many; no lock is held meanwhile
ITERATIONS = 80
TOLERANCE = 1e-5  # [-] of the cost: two iterations that save less end the search
# Factors of the friction's smoothing velocity that a start passes, and each next one.
SMOOTHER = ((16.0, 8.0, 4.0, 2.0), (32.0, 12.0, 6.0, 3.0, 1.5))
SMOOTHER_ITERATIONS, SMOOTHER_TOLERANCE = 25, 1e-2  # on such a plant: it is only a better start
PLACES = (0.01, 0.05)  # [m] what the starting laws weigh an error of place with; see `preview_lqr`


@dataclass(frozen=True)
class Start:
    """What one starting sequence led to."""

    name: str
    first_cost: float  # mean stage cost of the start itself, run on the true plant
    cost: float  # mean stage cost that it led to
    feasible: bool  # whether that keeps every hard limit
    iterations: int
    seconds: float


@dataclass(frozen=True)
class OptimalEpisode:
    """The best sequence of currents that was found for an episode."""

    episode: Episode
    cost: float  # mean stage cost; infinite if no start led to one that keeps the limits
    current: FloatArray  # (T) [A]
    state: FloatArray  # (T + 1, n) SI, from rest
    response: FloatArray  # (T, 2 k) y_A [m/s^2] after each physics step, then f_s [N]
    gain: FloatArray  # (T, n) feedback of the last iteration on the scaled state [A]
    starts: tuple[Start, ...]

    @property
    def disagreement(self) -> float:
        """Cost of the worst start over that of the best one, minus 1 [-]."""
        costs = [start.cost for start in self.starts if start.feasible]
        return max(costs) / min(costs) - 1.0 if costs else math.inf


def starting_laws(scenario: Scenario) -> dict[str, Controller]:
    """Return laws to start from, on the scenario's own information: place held tightly, and loosely.

    Where friction or an orifice is there to be fed forward, the first law does so.
    """
    direct = scenario.sensing.full_state and not scenario.delay
    held = scenario.ground.highpass_frequency is not None
    parts = scenario.nonlinearity
    laws: dict[str, Controller] = {}
    for position in PLACES:
        place = position if held else None
        feeds = not laws and (parts.friction.active or parts.valve.flow_active)

        def make(full: Scenario, place: float | None = place, feeds: bool = feeds) -> Controller:
            if feeds:
                return FeedforwardLQR(full, position=place)
            return PreviewFeedback(full, position=place)

        name = ("feed-forward" if feeds else "preview LQR") + (f" {position:g} m" if held else "")
        if name not in laws:
            laws[name] = make(scenario) if direct else estimated(scenario, make)
    if len(laws) == 1:
        laws["half its current"] = _Share(next(iter(laws.values())), 0.5)
    return laws


class _Share:
    """A law of which a share of the current is given."""

    def __init__(self, law: Controller, share: float) -> None:
        self._law, self._share = law, share

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the share of the law's action (..., 1)."""
        action, memory = decide(self._law, observation, state, episode_start, deterministic)
        return np.float32(self._share) * action, memory


def optimal_episodes(
    scenario: Scenario,
    earthquakes: Sequence[Earthquake],
    starts: Mapping[str, Sequence[FloatArray]] | None = None,
    *,
    plant: Scenario | None = None,
    signals: Callable[[Scenario, FloatArray], FloatArray] | None = None,
    iterations: int = ITERATIONS,
    threads: int = 1,
    on_step: Callable[[float], None] = lambda share: None,
) -> list[OptimalEpisode]:
    """Return the optimum of each earthquake.

    Parameters
    ----------
    scenario, earthquakes
        As for a roll-out; an uncertain plant is the one that the earthquake's seed draws.
    starts
        By name, currents (up to T) [A] of each earthquake to start from; None: what `starting_laws` do.
    plant, signals
        The table that is planned for and its reference shear, where they are not the episode's own; see
        `episodes`.
    iterations
        At most, of each start.
    threads
        Earthquakes that are searched at a time.
    on_step
        Told the share of the work done, 0 to 1.

    Raises
    ------
    ScenarioError
        If the equations are not the corrected ones.
    ShakeError
        If numba is missing.
    """
    problems = episodes(scenario, earthquakes, plant, signals)
    if starts is None:
        laws = starting_laws(scenario)
        starts = {name: driven(law, scenario, earthquakes)[0] for name, law in laws.items()}
    given = starts

    def search(i: int) -> OptimalEpisode:
        own = {name: currents[i] for name, currents in given.items()}
        return optimum(problems[i], own, iterations=iterations)

    found = []
    with ThreadPoolExecutor(threads) as pool:
        for each in pool.map(search, range(len(problems))):
            found.append(each)
            on_step(len(found) / len(problems))
    return found


def optimum(
    episode: Episode, starts: Mapping[str, FloatArray], *, iterations: int = ITERATIONS
) -> OptimalEpisode:
    """Return the best that any of the starting currents (up to T, then zeros) leads to."""
    model, T = episode.model, episode.periods
    results: list[Start] = []
    best: tuple[bool, float, Plan] | None = None

    def improved(on: PlanningModel, current: FloatArray, most: int, tolerance: float) -> Plan:
        return on.improve(
            current, np.zeros((1, on.states)), episode.target[None], episode.shear[None],
            iterations=most, tolerance=tolerance,
        )  # fmt: skip

    parts = model.scenario.parts
    smoother = parts.friction.active or parts.valve.dead_band > 0.0
    for index, (name, given) in enumerate(starts.items()):
        current = np.zeros((1, T))
        current[0, : len(given)] = given[:T]
        began = time.thread_time()
        first = float(improved(model, current, 0, 0.0).cost[0]) / T
        plan, passed = None, 0
        if smoother and iterations:
            nearer = current
            for factor in SMOOTHER[index % len(SMOOTHER)]:
                easier = improved(
                    model.made_smoother(factor), nearer, SMOOTHER_ITERATIONS, SMOOTHER_TOLERANCE
                )
                nearer, passed = easier.current, passed + int(easier.iterations[0])
            plan = improved(model, nearer, iterations, TOLERANCE)
        if plan is None or plan.largest_ratio[0] > 1.0 or plan.cost[0] > first * T:
            plan = improved(model, current, iterations, TOLERANCE)
        seconds = time.thread_time() - began
        feasible, cost = bool(plan.largest_ratio[0] <= 1.0), float(plan.cost[0]) / T
        results.append(Start(name, first, cost, feasible, passed + int(plan.iterations[0]), seconds))
        if best is None or (feasible, -cost) > (best[0], -best[1]):
            best = (feasible, cost, plan)
    assert best is not None  # at least one start
    feasible, cost, plan = best
    return OptimalEpisode(
        episode, cost if feasible else math.inf, plan.current[0], plan.state[0], plan.response[0],
        plan.gain[0], tuple(results),
    )  # fmt: skip
