"""A controller on a set of earthquakes: trajectories and the figures by which a test is judged."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from shake_env.controller import Controller, decide
from shake_env.errors import ParameterError
from shake_env.model.specimen_state import SpecimenState
from shake_env.motion.processing import fit_amplitude
from shake_env.motion.targets import FilteredNoise, Motion, MotionSet, RecordedMotion
from shake_env.records import RECORD_NAMES, Record
from shake_env.scenario.capacity import scenario_capacity
from shake_env.scenario.limits import REASONS
from shake_env.scenario.presets import laboratory_noise
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uncertainty
from shake_env.simulation.engine import BoolArray, Observations, StepResult
from shake_env.simulation.metrics import EpisodeMetrics, MetricAccumulator
from shake_env.simulation.simulation import Simulation, checked_action
from shake_env.simulation.streams import earthquake_stream
from shake_env.simulation.trajectory import Recorder, Trajectory


@dataclass(frozen=True)
class Earthquake:
    """A motion with the seed that fixes its noise; the same for every controller."""

    name: str
    motion: Motion
    seed: int = 0
    specimen: SpecimenState | None = None  # at the start; None: that of a drawn plant, else as new


class PeriodLog(Protocol):
    """What is told every control period of a roll-out, such as a recorder of logs."""

    def add(self, result: StepResult, running: BoolArray) -> None:
        """Take a control period of the lanes that are `running` (N,)."""


def noise_earthquakes(scenario: Scenario, number: int, seed: int = 0) -> list[Earthquake]:
    """Return `number` seeded filtered-noise earthquakes of the scenario's own duration and amplitude.

    Where its own motion is recorded: of the linear scenario's, or of the laboratory's if the stroke is
    limited.
    """
    motion = scenario.motion
    if not isinstance(motion, FilteredNoise):
        limited = scenario.limits.table_displacement is not None
        motion = laboratory_noise() if limited else FilteredNoise()
    return _shaking([Earthquake(f"noise {seed + i}", motion, seed + i) for i in range(number)])


def record_amplitude(scenario: Scenario) -> float:
    """Return the amplitude at which a scenario takes a record, before it is scaled to the table.

    The scenario's own; but where the stroke is limited the amplitude of filtered noise was chosen for
    that, and a record is scaled on its own account.
    """
    limited = scenario.limits.table_displacement is not None
    return 1.0 if limited and isinstance(scenario.motion, FilteredNoise) else scenario.motion.amplitude


def recorded_earthquakes(scenario: Scenario) -> list[Earthquake]:
    """Return the embedded records, prepared as the scenario's own motion is if that is one of them.

    A scenario of several recorded motions, or of a record from a file, gives those. Where the scenario
    limits the stroke, an embedded record is scaled until the table can repeat it
    (`shake_env.motion.processing.fit_amplitude`); `Earthquake.motion` says by what.
    """
    motion = scenario.motion
    if isinstance(motion, MotionSet):
        return _shaking(
            [Earthquake(m.source.name, m) for m in motion.scaled if isinstance(m, RecordedMotion)]
        )
    if isinstance(motion, RecordedMotion) and isinstance(motion.record, Record):
        return _shaking([Earthquake(motion.source.name, motion)])
    limited = scenario.limits.table_displacement is not None
    if not isinstance(motion, RecordedMotion):
        motion = RecordedMotion(record=RECORD_NAMES[0], amplitude=record_amplitude(scenario))
    motions = [replace(motion, record=name) for name in RECORD_NAMES]
    if limited:
        capacity = scenario_capacity(scenario)
        motions = [
            fit_amplitude(m, capacity, physics_step=scenario.physics_step).motion for m in motions
        ]
    return _shaking([Earthquake(m.source.name, m) for m in motions])


def _shaking(earthquakes: list[Earthquake]) -> list[Earthquake]:
    """Return earthquakes; raise ParameterError where one has no amplitude to relate an error to."""
    for quake in earthquakes:
        if not isinstance(quake.motion, MotionSet) and quake.motion.amplitude == 0.0:
            raise ParameterError(
                "amplitude", quake.motion.amplitude, f"{quake.name} holds no motion: must be above 0"
            )
    return earthquakes


def rollout(
    controller: Controller,
    scenario: Scenario,
    earthquakes: Sequence[Earthquake],
    *,
    record: Sequence[int] = (),
    on_step: Callable[[float], None] = lambda share: None,
    log: PeriodLog | None = None,
) -> tuple[list[EpisodeMetrics], dict[int, Trajectory]]:
    """Run a controller on every earthquake, all side by side.

    Parameters
    ----------
    controller
        What drives the tables.
    scenario
        Plant, objective and limits; its motion is replaced by each earthquake's.
    earthquakes
        What the tables are asked to repeat.
    record
        Indices of earthquakes whose trajectory is wanted.
    on_step
        Told the share of the work done, 0 to 1.
    log
        Told every control period, such as `agents.laboratory`'s recorder of logs.

    Returns
    -------
    metrics, trajectories
        One entry an earthquake, in order; trajectories by index.
    """
    simulation, observation = begin_rollout(scenario, earthquakes)
    sums, recorder = MetricAccumulator(simulation.lanes), Recorder(record)
    logs = (sums, recorder) if log is None else (sums, recorder, log)
    reasons = run_rollout(controller, simulation, observation, logs, on_step)
    names = [quake.name for quake in earthquakes]
    metrics = sums.metrics(names, simulation.episode_steps, reasons)
    return metrics, recorder.trajectories(scenario.physics_step, scenario.control_period)


def begin_rollout(
    scenario: Scenario, earthquakes: Sequence[Earthquake]
) -> tuple[Simulation, Observations]:
    """Return the tables of a roll-out at the start of their earthquakes, and their observations.

    Raises
    ------
    ParameterError
        If there is no earthquake.
    """
    if not earthquakes:
        raise ParameterError("earthquakes", earthquakes, "give at least one")
    simulation = Simulation(scenario, len(earthquakes))
    observation = simulation.start(
        range(len(earthquakes)),
        [earthquake_stream(e.seed) for e in earthquakes],
        [e.motion for e in earthquakes],
        [e.specimen for e in earthquakes],
    )
    return simulation, observation


def run_rollout(
    controller: Controller,
    simulation: Simulation,
    observation: Observations,
    logs: Sequence[PeriodLog],
    on_step: Callable[[float], None] = lambda share: None,
) -> list[str | None]:
    """Run a controller on a roll-out's tables that `begin_rollout` started; return what ended each lane.

    Parameters
    ----------
    controller, on_step
        See `rollout`.
    simulation, observation
        Of `begin_rollout`.
    logs
        Each told every control period.
    """
    lanes = simulation.lanes
    steps = int(simulation.episode_steps.max())
    running = np.ones(lanes, dtype=bool)
    reasons: list[str | None] = [None] * lanes
    memory: tuple[Any, ...] | None = None
    start = np.ones(lanes, dtype=bool)
    for t in range(steps):
        action, memory = decide(controller, observation, memory, start)
        # A finished lane idles at rest, so that an unstable one cannot overflow.
        chosen = np.where(running, checked_action(action, (lanes, 1))[:, 0], 0.0)
        result = simulation.step(chosen)
        for log in logs:
            log.add(result, running)
        for lane in np.flatnonzero(running & result.terminated):
            reasons[lane] = REASONS[int(result.broken[lane]) - 1]
        running &= ~(result.terminated | result.truncated)
        start = ~running  # a finished lane stands as one that begins: no controller takes it for a jump
        if start.any():
            simulation.rest(start)
        observation = result.observation
        if t % 64 == 0:
            on_step((t + 1) / steps)
        if not running.any():
            break
    on_step(1.0)
    return reasons


def sampled_plants(scenario: Scenario, earthquakes: Sequence[Earthquake]) -> list[Scenario]:
    """Return the scenario with the plant that each earthquake's lane of a roll-out draws."""
    if not scenario.uncertainty.active:
        return [scenario] * len(earthquakes)
    plants = []
    for quake in earthquakes:
        stream = earthquake_stream(quake.seed)
        quake.motion.pick(stream)  # a set of motions draws before the plant does
        plants.append(replace(scenario.drawn(stream), uncertainty=Uncertainty()))
    return plants
