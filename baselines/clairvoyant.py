"""The controller that knows too much: true plant, full state, half a second of the target, no delay.

Regret is counted from what it reaches. On a linear plant where no place is minded no causal law with
these samples of the target does better; one that knew the target between the control instants, too,
could: on the linear scenario LQR's cost falls to 0.22 of itself here, and to 0.14 with the whole future
known. With friction or limits it is a law that knows everything, with the engineer's feed-forward, and a
better one may exist; of yielding storeys it knows the elastic specimen. Where the stroke is limited it
minds its place, which costs: a looser one than it has would save 2 to 4 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.feedforward import FeedforwardLQR
from baselines.preview_lqr import PreviewFeedback, preview_lqr
from shake_env.controller import Controller, decide
from shake_env.errors import ParameterError
from shake_env.rollout import Earthquake
from shake_env.scenario import Scenario
from shake_env.sensing import Sensing
from shake_env.uncertainty import Uncertainty

POSITION = 0.05  # [m] see `preview_lqr`; where the stroke is limited
FRICTION_POSITION = 0.01  # [m] where a part is nonlinear, too: holding the place holds friction's drift
PREVIEW = 0.5  # [s] of samples a control period apart; a longer one gains a percent


def seen_through(scenario: Scenario) -> Scenario:
    """Return the scenario as the clairvoyant meets it: full state, preview, no delay, same plants."""
    uncertainty = replace(scenario.uncertainty, delay=None)
    return replace(scenario, sensing=Sensing(preview=PREVIEW), delay=0.0, uncertainty=uncertainty)


def true_plants(scenario: Scenario, earthquakes: Sequence[Earthquake]) -> list[Scenario]:
    """Return the scenario with the plant that each earthquake's lane of a roll-out draws."""
    if not scenario.uncertainty.active:
        return [scenario] * len(earthquakes)
    plants = []
    for quake in earthquakes:
        stream = np.random.default_rng(quake.seed)
        quake.motion.pick(stream)  # a set of motions draws before the plant does
        plants.append(replace(scenario.drawn(stream), uncertainty=Uncertainty()))
    return plants


class PerLane:
    """One controller for each table of a batch.

    Parameters
    ----------
    controllers
        One a lane.

    Raises
    ------
    ParameterError
        In `predict`, if the batch has another number of lanes.
    """

    def __init__(self, controllers: Sequence[Controller]) -> None:
        self.controllers = list(controllers)

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the actions (N, 1) for observations (N, n), each by its lane's controller."""
        if observation.ndim != 2 or len(observation) != len(self.controllers):
            raise ParameterError(
                "observation shape", observation.shape, f"needs {len(self.controllers)} lanes"
            )
        memories = (None,) * len(observation) if state is None else state
        actions, kept = [], []
        for lane, controller in enumerate(self.controllers):
            begins = None if episode_start is None else episode_start[lane : lane + 1]
            action, memory = decide(controller, observation[lane], memories[lane], begins, deterministic)
            actions.append(action)
            kept.append(memory)
        return np.stack(actions), tuple(kept)


class _Rows:
    """Linear laws of one row a lane."""

    def __init__(self, rows: NDArray[np.float64]) -> None:
        self._rows = rows

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        action = np.clip(np.sum(observation * self._rows, axis=-1), -1.0, 1.0)
        return action[..., None].astype(np.float32), None


class Rescaled:
    """A controller that reads observations over another plant's scale, by a `rescaling` (n,)."""

    def __init__(self, controller: Controller, factor: NDArray[np.float64]) -> None:
        self._controller, self._factor = controller, factor

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the inner controller's action (..., 1) for an observation (..., n), and its memory."""
        scaled = (observation * self._factor).astype(np.float32)
        return decide(self._controller, scaled, state, episode_start, deterministic)


def rescaling(seen: Scenario, plant: Scenario) -> NDArray[np.float64]:
    """Return what turns a full-state observation (n,) of `seen` into one of `plant`'s, by product."""
    factor = np.ones(seen.observation.size)
    scale = seen.plant.state_scale
    factor[: len(scale)] = scale / plant.plant.state_scale
    return factor


def clairvoyant(scenario: Scenario, earthquakes: Sequence[Earthquake]) -> tuple[Scenario, Controller]:
    """Return the scenario to run the clairvoyant on, and the clairvoyant of these earthquakes.

    Parameters
    ----------
    scenario
        What others are compared on.
    earthquakes
        One a lane of the roll-out, in order: their seeds fix the plants.
    """
    seen = seen_through(scenario)
    plants = true_plants(seen, earthquakes)
    parts = scenario.parts
    if parts.friction.active or parts.valve.flow_active:
        # Without the ground's high-pass there is no place that a table could be held in.
        position = FRICTION_POSITION if seen.ground.states == 4 else None
        if not seen.uncertainty.active:
            return seen, FeedforwardLQR(seen, position=position)
        laws = [FeedforwardLQR(plant, position=position) for plant in plants]
        scales = np.stack([rescaling(seen, plant) for plant in plants])
        return seen, PerLane([Rescaled(law, row) for law, row in zip(laws, scales, strict=True)])
    rows: dict[Any, NDArray[np.float64]] = {}
    for plant in plants:
        key = (plant.actuator, plant.specimen)
        if key not in rows:
            position = None
            if plant.limits.table_displacement is not None and plant.ground.states == 4:
                position = FRICTION_POSITION if plant.nonlinearity.active else POSITION
            design = preview_lqr(plant.discrete, plant.stage_cost, PREVIEW, position=position)
            rows[key] = PreviewFeedback(plant, design).row * rescaling(seen, plant)
    return seen, _Rows(np.stack([rows[plant.actuator, plant.specimen] for plant in plants]))
