"""A controller on a set of earthquakes: trajectories and the figures by which a test is judged."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from shake_env.controller import Controller
from shake_env.errors import ParameterError
from shake_env.limits import REASONS
from shake_env.motion import FilteredNoise, Motion, MotionSet, RecordedMotion
from shake_env.parameters import FloatArray
from shake_env.preparation import TableCapacity, fit_amplitude
from shake_env.records import RECORD_NAMES
from shake_env.scenario import Scenario
from shake_env.simulation import Simulation, StepResult, checked_action


@dataclass(frozen=True)
class Earthquake:
    """A motion with the seed that fixes its noise; the same for every controller."""

    name: str
    motion: Motion
    seed: int = 0


def noise_earthquakes(scenario: Scenario, number: int, seed: int = 0) -> list[Earthquake]:
    """Return `number` seeded filtered-noise earthquakes of the scenario's own duration and amplitude."""
    motion = scenario.motion if isinstance(scenario.motion, FilteredNoise) else FilteredNoise()
    return [Earthquake(f"noise {seed + i}", motion, seed + i) for i in range(number)]


def recorded_earthquakes(scenario: Scenario) -> list[Earthquake]:
    """Return the embedded records, prepared as the scenario's own motion is if that is a record.

    A scenario of several recorded motions gives those. Where the scenario limits the stroke, a record is
    scaled until the table can repeat it (`preparation.fit_amplitude`); `Earthquake.motion` says by what.
    """
    motion = scenario.motion
    if isinstance(motion, MotionSet):
        return [Earthquake(m.source.name, m) for m in motion.scaled]
    limited = scenario.limits.table_displacement is not None
    if not isinstance(motion, RecordedMotion):
        amplitude = 1.0 if limited else motion.amplitude
        motion = RecordedMotion(record=RECORD_NAMES[0], amplitude=amplitude)
    motions = [replace(motion, record=name) for name in RECORD_NAMES]
    if limited:
        capacity = TableCapacity.of(scenario.actuator, scenario.specimen)
        motions = [
            fit_amplitude(m, capacity, physics_step=scenario.physics_step).motion for m in motions
        ]
    return [Earthquake(m.source.name, m) for m in motions]


@dataclass(frozen=True)
class EpisodeMetrics:
    """One controller on one earthquake."""

    earthquake: str
    cost: float  # mean stage cost over the motion, a broken limit's included
    acceleration_rms_error: float  # rms of y_A - y~ over rms of y~ [-]
    acceleration_peak_error: float  # peak of |y_A - y~| over peak of |y~| [-]
    base_shear_rms_error: float  # rms of f_s - f~_s over rms of f~_s [-]
    base_shear_peak_error: float  # peak of |f_s - f~_s| over peak of |f~_s| [-]
    peak_current: float  # [A]
    peak_velocity: float  # of the table [m/s]
    peak_displacement: float  # of the table [m]
    broken_limit: str | None  # what ended the episode early; errors then count what ran


@dataclass(frozen=True)
class Trajectory:
    """One table's history; sample j of each is taken at ``time[j]``."""

    time: FloatArray  # (samples,) [s] after each physics step
    target_acceleration: FloatArray  # (samples,) [m/s^2]
    table_acceleration: FloatArray  # (samples,) [m/s^2]
    reference_base_shear: FloatArray  # (samples,) [N]
    base_shear: FloatArray  # (samples,) [N]
    control_time: FloatArray  # (steps,) [s] at each period's end
    current: FloatArray  # (steps,) [A]
    state: FloatArray  # (steps, 4 + 2 stories) [x_A, x_S] SI


class _Sums:
    """Running sums and peaks of N lanes, counted only while a lane's episode runs."""

    def __init__(self, lanes: int) -> None:
        self.squares = np.zeros((4, lanes))
        self.peaks = np.zeros((4, lanes))
        self.cost = np.zeros(lanes)
        self.extremes = np.zeros((3, lanes))  # current, velocity, displacement

    def add(self, result: StepResult, running: FloatArray) -> None:
        response, ground = result.outcome.response, result.ground
        signals = np.stack(
            [
                response.table_acceleration - ground.target,
                ground.target,
                response.base_shear - ground.reference_shear,
                ground.reference_shear,
            ]
        )
        self.squares += np.where(running, np.sum(signals**2, axis=-1), 0.0)
        peak = np.max(np.abs(signals), axis=-1)
        self.peaks = np.where(running, np.maximum(self.peaks, peak), self.peaks)
        self.cost += np.where(running, -result.reward, 0.0)
        state = response.state
        now = np.abs(np.stack([result.outcome.current, state[:, 2], state[:, 1]]))
        self.extremes = np.where(running, np.maximum(self.extremes, now), self.extremes)


def rollout(
    controller: Controller,
    scenario: Scenario,
    earthquakes: Sequence[Earthquake],
    *,
    record: Sequence[int] = (),
    on_step: Callable[[float], None] = lambda share: None,
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

    Returns
    -------
    metrics, trajectories
        One entry an earthquake, in order; trajectories by index.
    """
    if not earthquakes:
        raise ParameterError("earthquakes", earthquakes, "give at least one")
    lanes = len(earthquakes)
    simulation = Simulation(scenario, lanes)
    observation = simulation.start(
        range(lanes),
        [np.random.default_rng(e.seed) for e in earthquakes],
        [e.motion for e in earthquakes],
    )
    steps = int(simulation.episode_steps.max())
    running = np.ones(lanes, dtype=bool)
    reasons: list[str | None] = [None] * lanes
    sums, traces = _Sums(lanes), {index: _Trace() for index in record}
    memory: tuple[Any, ...] | None = None
    start = np.ones(lanes, dtype=bool)
    for t in range(steps):
        action, memory = controller.predict(observation, memory, start, deterministic=True)
        start = np.zeros(lanes, dtype=bool)
        # A finished lane idles at rest, so that an unstable one cannot overflow.
        chosen = np.where(running, checked_action(action, (lanes, 1))[:, 0], 0.0)
        result = simulation.step(chosen)
        sums.add(result, running)
        for index, trace in traces.items():
            if running[index]:
                trace.add(result, index)
        for lane in np.flatnonzero(running & result.terminated):
            reasons[lane] = REASONS[int(result.outcome.broken[lane]) - 1]
        running &= ~(result.terminated | result.truncated)
        simulation.state[~running] = 0.0
        observation = result.observation
        if t % 64 == 0:
            on_step((t + 1) / steps)
        if not running.any():
            break
    on_step(1.0)
    metrics = _metrics(earthquakes, sums, simulation.episode_steps, reasons)
    step, period = scenario.physics_step, scenario.control_period
    return metrics, {index: trace.trajectory(step, period) for index, trace in traces.items()}


def _metrics(
    earthquakes: Sequence[Earthquake], sums: _Sums, steps: FloatArray, reasons: list[str | None]
) -> list[EpisodeMetrics]:
    rms, peak = np.sqrt(sums.squares), sums.peaks
    tiny = np.finfo(float).tiny  # a target of zero amplitude divides 0 by it, not by 0
    return [
        EpisodeMetrics(
            earthquake=quake.name,
            cost=float(sums.cost[i] / steps[i]),
            acceleration_rms_error=float(rms[0, i] / max(rms[1, i], tiny)),
            acceleration_peak_error=float(peak[0, i] / max(peak[1, i], tiny)),
            base_shear_rms_error=float(rms[2, i] / max(rms[3, i], tiny)),
            base_shear_peak_error=float(peak[2, i] / max(peak[3, i], tiny)),
            peak_current=float(sums.extremes[0, i]),
            peak_velocity=float(sums.extremes[1, i]),
            peak_displacement=float(sums.extremes[2, i]),
            broken_limit=reasons[i],
        )
        for i, quake in enumerate(earthquakes)
    ]


class _Trace:
    """Collects one lane."""

    def __init__(self) -> None:
        self.signals: list[FloatArray] = []
        self.current: list[float] = []
        self.state: list[FloatArray] = []

    def add(self, result: StepResult, lane: int) -> None:
        response, ground = result.outcome.response, result.ground
        self.signals.append(
            np.stack(
                [
                    ground.target[lane],
                    response.table_acceleration[lane],
                    ground.reference_shear[lane],
                    response.base_shear[lane],
                ]
            )
        )
        self.current.append(float(result.outcome.current[lane]))
        self.state.append(response.state[lane].copy())

    def trajectory(self, physics_step: float, period: float) -> Trajectory:
        target, table, reference, shear = np.concatenate(self.signals, axis=-1)
        return Trajectory(
            time=physics_step * np.arange(1, len(target) + 1, dtype=np.float64),
            target_acceleration=target,
            table_acceleration=table,
            reference_base_shear=reference,
            base_shear=shear,
            control_time=period * np.arange(1, len(self.current) + 1, dtype=np.float64),
            current=np.asarray(self.current),
            state=np.stack(self.state),
        )
