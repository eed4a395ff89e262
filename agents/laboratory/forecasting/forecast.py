"""What a test will do, before it: a batch of tables, one for each sample of the posterior.

An interval holds what is not known of table and specimen (samples), what the sensors add (their noise,
which goes round the loop), and what the model lacks (`with_model_error`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from agents.execution.units import Unit, UnitRunner, report
from agents.laboratory.forecasting.coupling import Coupling, coupling
from agents.laboratory.forecasting.quantities import UNITS, OutcomeRecorder, Outcomes, beyond_limits
from agents.policies.own_controller import is_own_controller, own_source
from agents.policies.registry import find_controller, get_controller
from agents.seeds import FORECAST_SEED, require_seed
from shake_env.errors import ParameterError, ScenarioError
from shake_env.model.parameters import FloatArray
from shake_env.motion.targets import MotionSet
from shake_env.rollout import Earthquake, begin_rollout, run_rollout
from shake_env.scenario.plants.samples import PlantSamples
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uncertainty
from shake_env.simulation.engine import BoolArray

BATCH = 250  # tables of a batch
# The channel whose share of model error a quantity has: the first of these that is measured.
FORCES = ("base_shear", "floor_acceleration_1", "load_pressure", "table_acceleration")
MOTIONS = {
    "peak_displacement": ("table_displacement",),
    "peak_velocity": ("table_velocity", "table_displacement"),
    "peak_pressure": ("load_pressure",),
    "peak_current": ("spool_position", "table_velocity"),
}


@dataclass(frozen=True)
class Forecast:
    """Of one controller at one amplitude."""

    controller: str
    amplitude: float  # [-] of the motion of the full test
    outcomes: Outcomes  # with the model's error
    broken: BoolArray  # (N,) a limit is reached
    coupling: Coupling
    probability: float  # of the intervals

    @property
    def limit_probability(self) -> float:
        """Probability that a limit is reached (Jeffreys' estimate)."""
        return float((np.sum(self.broken) + 0.5) / (len(self.broken) + 1.0))

    def interval(self, quantity: str) -> tuple[float, float, float]:
        """Return low end, median and high end of a quantity."""
        values = {**self.outcomes.values, **self.outcomes.measured}[quantity]
        tail = 0.5 - 0.5 * self.probability
        low, middle, high = np.quantile(values, [tail, 0.5, 1.0 - tail])
        return float(low), float(middle), float(high)

    def band(self, history: FloatArray) -> FloatArray:
        """Return low end, median and high end (3, points) of a history (N, points)."""
        tail = 0.5 - 0.5 * self.probability
        band: FloatArray = np.quantile(history, [tail, 0.5, 1.0 - tail], axis=0)
        return band


def centred_scenario(scenario: Scenario) -> Scenario:
    """Return the scenario at the middle of what is drawn, where that is samples.

    Raises
    ------
    ScenarioError
        If the scenario draws one of several motions.
    """
    if isinstance(scenario.motion, MotionSet):
        raise ScenarioError("motion", "a set", "a forecast is of one motion: name it by --motion")
    if isinstance(scenario.uncertainty, PlantSamples):
        return scenario.with_plant(scenario.uncertainty.middle)
    return scenario


def design_of(scenario: Scenario) -> Scenario:
    """Return the scenario that a controller is designed on: ranges stay, samples do not."""
    if isinstance(scenario.uncertainty, PlantSamples):
        return replace(scenario, uncertainty=Uncertainty())
    return scenario


def run_batch(scenario: Scenario, name: str, amplitude: float, seeds: Sequence[int]) -> dict[str, Any]:
    """Return the outcomes of one controller on samples of a scenario's uncertainty, by their fields.

    A method that repeats its tests does so on each sample. `amplitude` is a factor on the scenario's
    own motion.
    """
    assert not isinstance(scenario.motion, MotionSet)  # `centred_scenario` refuses it
    motion = replace(scenario.motion, amplitude=amplitude * scenario.motion.amplitude)
    quakes = [Earthquake(f"sample {seed}", motion, seed) for seed in seeds]
    if find_controller(name).needs_earthquakes:
        controller = get_controller(name, scenario, quakes)
    else:  # the laboratory designs it on the middle of the samples, as one plant
        controller = get_controller(name, design_of(scenario))
    simulation, observation = begin_rollout(scenario, quakes)
    recorder = OutcomeRecorder(scenario, len(quakes), drifts=simulation.first_drifts)
    run_rollout(controller, simulation, observation, [recorder], report)
    return vars(recorder.outcomes())


def forecast(
    scenario: Scenario,
    controllers: Sequence[str],
    *,
    amplitudes: Sequence[float] = (1.0,),
    samples: int = 500,
    probability: float = 0.9,
    seed: int = FORECAST_SEED,
    runner: UnitRunner | None = None,
    on_progress: Callable[[str, float], None] = lambda what, share: None,
) -> list[Forecast]:
    """Return the forecast of every controller at every amplitude.

    Parameters
    ----------
    scenario
        Test with its motion; its uncertainty is the belief, best as samples of a posterior.
    controllers
        Names, as `agents.policies.registry.find_controller` takes them.
    amplitudes
        Factors on the scenario's motion.
    samples
        Tables of each forecast.
    probability
        Of the intervals.
    seed
        Of the first sample.
    runner
        Runs the batches; None: this process.
    on_progress
        Told a controller, and its share of the work that is done.

    Raises
    ------
    ParameterError
        If a number is outside its range.
    ScenarioError
        If a controller does not suit the scenario, or nothing is uncertain.
    """
    check_forecast(controllers, amplitudes, samples, probability)
    require_seed(seed)
    if not scenario.uncertainty.active:
        raise ScenarioError(
            "uncertainty", "none", "name a posterior in [uncertainty.posterior], or ranges of parameters"
        )
    scenario = centred_scenario(scenario)
    count = math.ceil(samples / BATCH)
    seeds = np.array_split(np.arange(seed, seed + samples), count)
    jobs = [
        (name, float(a), part.tolist()) for name in controllers for a in amplitudes for part in seeds
    ]
    units = [
        Unit(
            f"{job[0]} at {job[1]:g}",
            run_batch,
            (scenario, *job),
            (scenario, *job, own_source(job[0]) if is_own_controller(job[0]) else None),
        )
        for job in jobs
    ]
    shares = dict.fromkeys(range(len(units)), 0.0)

    def on_share(index: int, share: float) -> None:
        shares[index] = share
        name = jobs[index][0]
        own = [shares[i] for i, job in enumerate(jobs) if job[0] == name]
        on_progress(name, sum(own) / len(own))

    done = [Outcomes(**fields) for fields in (runner or UnitRunner()).run(units, on_share)]
    result = []
    for number in range(0, len(jobs), count):
        name, amplitude, _ = jobs[number]
        outcomes = Outcomes.joined([done[number + i] for i in range(count)])
        result.append(forecast_of_outcomes(scenario, name, amplitude, outcomes, probability, seed))
    return result


def forecast_of_outcomes(
    scenario: Scenario, name: str, amplitude: float, outcomes: Outcomes, probability: float, seed: int
) -> Forecast:
    """Return the forecast of outcomes, with the error of the model that the scenario's samples know."""
    wider = with_model_error(outcomes, scenario, np.random.default_rng(seed))
    broken = outcomes.broken | beyond_limits(wider.values, scenario.limits)
    attributed = coupling(scenario, amplitude, outcomes)
    return Forecast(name, amplitude, wider, broken, attributed, probability)


def with_model_error(outcomes: Outcomes, scenario: Scenario, stream: np.random.Generator) -> Outcomes:
    """Return outcomes with what the model lacks: a relative error of each channel's response.

    A peak, rms or ordinate has a factor ``exp(share xi)``. A relative error e of the base shear or the
    acceleration becomes ``abs(e + share (xi_1 + i xi_2) / sqrt(2))``: the lacking part is as often in
    phase with the error as in quadrature. xi are standard normal, one a channel and sample.
    """
    samples = scenario.uncertainty
    if not isinstance(samples, PlantSamples) or not any(samples.shares):
        return outcomes
    shares = dict(zip(samples.channels, samples.shares, strict=True))
    number = len(outcomes.broken)
    drawn = {name: stream.standard_normal((2, number)) for name in sorted(shares)}

    def channel_of(names: Sequence[str]) -> str | None:
        return next((name for name in names if name in shares), None)

    values = {}
    for name, column in outcomes.values.items():
        channel = channel_of(MOTIONS.get(name, FORCES))
        if channel is None:
            values[name] = column
            continue
        share, (first, second) = shares[channel], drawn[channel]
        if name.endswith("_error"):
            values[name] = np.hypot(column + share * first / 2**0.5, share * second / 2**0.5)
        else:
            values[name] = column * np.exp(share * first)
    measured = {}
    for name, column in outcomes.measured.items():
        channel = name.rpartition("_")[0]
        factor = np.exp(shares[channel] * drawn[channel][0]) if channel in shares else 1.0
        measured[name] = column * factor
    return replace(outcomes, values=values, measured=measured)


@dataclass(frozen=True)
class Advice:
    """Which controller to use, and how strong the test may be."""

    controller: str
    amplitude: float  # largest of those forecast that keeps every limit; 0: none does
    probability: float  # asked for, of keeping every limit
    reason: str


def advice(forecasts: Sequence[Forecast], probability: float = 0.95) -> Advice:
    """Return the controller of least base-shear error among those that bear the largest amplitude.

    Parameters
    ----------
    forecasts
        Of any controllers and amplitudes.
    probability
        With which every limit must be kept.
    """
    safe = [each for each in forecasts if 1.0 - each.limit_probability >= probability]
    if not safe:
        best = min(forecasts, key=lambda each: each.limit_probability)
        reason = (
            f"no controller keeps every limit with a probability of {probability:g}; {best.controller} "
            f"comes nearest, with {1.0 - best.limit_probability:.3f} at {best.amplitude:g}"
        )
        return Advice(best.controller, 0.0, probability, reason)
    amplitude = max(each.amplitude for each in safe)
    rivals = [each for each in safe if each.amplitude == amplitude]
    best = min(rivals, key=lambda each: each.interval("base_shear_error")[1])
    low, middle, high = best.interval("base_shear_error")
    reason = (
        f"base-shear error {100 * middle:.1f} % ({100 * low:.1f} to {100 * high:.1f} %) at amplitude "
        f"{amplitude:g}, every limit kept with a probability of {1.0 - best.limit_probability:.3f}"
    )
    return Advice(best.controller, amplitude, probability, reason)


def check_forecast(
    controllers: Sequence[str], amplitudes: Sequence[float], samples: int, probability: float
) -> None:
    """Raise ParameterError or ScenarioError where arguments of `forecast` are none."""
    if not controllers:
        raise ParameterError("controllers", controllers, "name at least one, such as lqg")
    for name in controllers:
        find_controller(name)
    if not amplitudes or not all(0.0 < a <= 100.0 for a in amplitudes):
        raise ParameterError("amplitudes", tuple(amplitudes), "must be factors above 0, at most 100")
    if not 2 <= samples <= 100_000:
        raise ParameterError("samples", samples, "must be 2 to 100 000")
    if not 0.0 < probability < 1.0:
        raise ParameterError("probability", probability, "must lie between 0 and 1")


__all__ = ["UNITS", "Advice", "Forecast", "advice", "centred_scenario", "forecast", "run_batch"]
