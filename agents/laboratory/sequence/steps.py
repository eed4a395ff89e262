"""The actions of a sequence: plan it, forecast the next shake, close it with its log."""

from __future__ import annotations

import os
from collections.abc import Callable
from collections.abc import Sequence as Items
from dataclasses import replace
from pathlib import Path

import numpy as np

from agents.execution.units import UnitRunner
from agents.laboratory.forecasting.forecast import Forecast, advice, check_forecast, forecast
from agents.laboratory.forecasting.page import forecast_to_json, write_page
from agents.laboratory.identification.consistency import part_covered, require_motion
from agents.laboratory.identification.damage import damage_after
from agents.laboratory.identification.identify import Identified, identify, require_same_table
from agents.laboratory.identification.parameters import (
    Prior,
    default_prior,
    plants_at,
    require_parameter,
)
from agents.laboratory.identification.posterior import Posterior
from agents.laboratory.logs.log_file import write_log
from agents.laboratory.logs.test_log import TestLog
from agents.laboratory.sequence.state import Sequence, Shake
from agents.seeds import FORECAST_SEED, SHAKE_SEEDS, require_seed
from shake_env.errors import LogError, ParameterError
from shake_env.model.parameters import FloatArray
from shake_env.model.specimen_state import SLIP
from shake_env.motion.targets import MotionSet
from shake_env.scenario.plants.samples import PlantSamples
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.scenario_writer import write_scenario
from shake_env.scenario.uncertainty import Uncertainty
from shake_env.sequence_env import AMPLITUDES, rising_amplitudes

Progress = Callable[[str, float], None]
ROUNDS = 100  # of draws of a prior, of which as many as are asked for must be possible


def no_progress(what: str, share: float) -> None:
    """Say nothing."""


def plan_sequence(
    folder: str | os.PathLike[str],
    scenario: Scenario,
    *,
    amplitudes: Items[float] = AMPLITUDES,
    controllers: Items[str] = ("lqg",),
    prior: Prior | None = None,
    required_probability: float = 0.95,
    probability: float = 0.9,
    samples: int = 200,
    seed: int = 0,
) -> Sequence:
    """Begin a sequence: write its state and the first belief.

    Parameters
    ----------
    folder
        For its files; it must hold no sequence yet.
    scenario
        Test with its full motion; its uncertainty gives the first belief.
    amplitudes
        Of the shakes, factors on the motion, rising.
    controllers
        Among which each forecast chooses.
    prior
        First belief; None: `default_prior`.
    required_probability, probability, samples, seed
        See `agents.laboratory.forecasting.forecast`.

    Raises
    ------
    ParameterError
        If the amplitudes do not rise, the folder holds a sequence, or a number is outside its range.
    ScenarioError
        If a controller is unknown.
    """
    folder = Path(folder)
    amplitudes = rising_amplitudes(amplitudes)
    if not 0.0 < required_probability < 1.0:
        raise ParameterError("required_probability", required_probability, "must lie between 0 and 1")
    require_seed(seed)
    for name in prior.names if prior is not None else ():
        require_parameter(name, scenario)
    check_forecast(controllers, amplitudes, samples, probability)
    if isinstance(scenario.motion, MotionSet):
        raise ParameterError("motion", "a set", "a sequence repeats one motion: name it")
    shakes = tuple(Shake(amplitude) for amplitude in amplitudes)
    sequence = Sequence(
        folder, scenario, tuple(controllers), required_probability, probability, samples, seed, shakes
    )
    if (folder / "sequence.json").exists():
        raise ParameterError("folder", str(folder), "holds a sequence already: give another")
    if isinstance(scenario.uncertainty, PlantSamples) and prior is None:
        raise ParameterError("prior", "samples", "give the posterior's file as --prior, too")
    belief = first_belief(scenario, prior, samples=4 * samples, seed=seed)
    folder.mkdir(parents=True, exist_ok=True)
    belief.write(sequence.posterior_file(0))
    sequence.write()
    return sequence


def first_belief(
    scenario: Scenario, prior: Prior | None = None, *, samples: int, seed: int = 0
) -> Posterior:
    """Return samples of a prior as a posterior of no logs; None: `default_prior`."""
    prior = default_prior(scenario) if prior is None else prior
    return Posterior(
        scenario=replace(scenario, uncertainty=Uncertainty()),
        names=prior.names,
        points=_possible(scenario, prior, samples, seed),
        method="prior",
        seed=seed,
        logs=(),
        shares=(),
    )


def next_shake(
    sequence: Sequence,
    *,
    override: str | None = None,
    page: bool = True,
    runner: UnitRunner | None = None,
    on_progress: Progress = no_progress,
) -> tuple[Sequence, list[Forecast]]:
    """Forecast the next shake on the present belief, choose its controller, and write its scenario.

    Parameters
    ----------
    sequence
        As `read_sequence` returns it.
    override
        Reason why the shake is made although its forecast calls it unsafe.
    page
        Whether the forecast's page is written to the shake's folder.
    runner, on_progress
        See `forecast`.

    Raises
    ------
    ParameterError
        If the forecast calls it unsafe and no reason is given, or all shakes are done.
    """
    shake, number = sequence.next, sequence.number
    believed = sequence.posterior.uncertain
    forecasts = forecast(
        believed,
        sequence.controllers,
        amplitudes=(shake.amplitude,),
        samples=sequence.samples,
        probability=sequence.probability,
        seed=FORECAST_SEED + SHAKE_SEEDS * number + sequence.seed,
        runner=runner,
        on_progress=on_progress,
    )
    chosen = advice(forecasts, sequence.required_probability)
    folder = sequence.shake_folder(number + 1)
    if page:
        write_page(forecasts, chosen, f"Shake {number + 1}, amplitude {shake.amplitude:g}", folder)
    if chosen.amplitude == 0.0 and not (override or "").strip():
        raise ParameterError(
            f"shake {number + 1}",
            shake.amplitude,
            f"is unsafe: {chosen.reason}; --override REASON makes it",
        )
    best = next(each for each in forecasts if each.controller == chosen.controller)
    sequence = sequence.with_next(
        controller=chosen.controller,
        forecast=forecast_to_json(best),
        override=override if chosen.amplitude == 0.0 else None,
    )
    write_scenario(designed_on(sequence), folder / "test.toml")
    sequence.write()
    return sequence, forecasts


def designed_on(sequence: Sequence) -> Scenario:
    """Return the scenario that the next shake's controller is designed on and its log must be of.

    The model at the belief's mean, with the motion at the shake's amplitude.
    """
    model = sequence.posterior.nominal
    motion = sequence.scenario.motion
    assert not isinstance(motion, MotionSet)  # `plan_sequence` refuses it
    return replace(model, motion=replace(motion, amplitude=sequence.next.amplitude * motion.amplitude))


def close_shake(
    sequence: Sequence,
    log: TestLog,
    *,
    without: Items[str] = (),
    band: tuple[float, float] | None = None,
    discrepancy: bool = True,
    on_progress: Progress = no_progress,
) -> tuple[Sequence, Identified]:
    """Hold the next shake's forecast against its log, update the belief, and write both.

    A log that ends before its motion (`part_covered`) updates the belief; its figures are not held
    against the forecast, and do not count in the calibration.

    Parameters
    ----------
    sequence
        Whose next shake has been forecast.
    log
        Of that shake.
    without, band, discrepancy, on_progress
        See `identify`.

    Raises
    ------
    ParameterError
        If the shake has not been forecast.
    LogError
        If the log is of another table, rate or motion, or was read already.
    """
    shake, number = sequence.next, sequence.number
    if shake.forecast is None:
        raise ParameterError(
            f"shake {number + 1}", None, "has no forecast yet: give shake sequence next first"
        )
    if any(each.log is not None and each.log[1] == log.sha256 for each in sequence.shakes):
        raise LogError(log.name, log.sha256[:12], "closed an earlier shake already")
    model = designed_on(sequence)
    if log.scenario_text is not None:
        require_same_table(log, model)
    require_motion(log, model)
    left_out = {f"{name}_{figure}" for name in without for figure in ("rms", "peak")}
    measured = {name: value for name, value in measured_figures(log).items() if name not in left_out}
    # The forecast is of the whole motion: figures of a part of it are neither inside nor outside.
    covered = part_covered(log, model)
    intervals = {} if covered else shake.forecast["intervals"]
    inside = {
        name: bool(intervals[name][0] <= value <= intervals[name][2])
        for name, value in measured.items()
        if name in intervals
    }
    belief = sequence.posterior
    yields = sequence.scenario.nonlinearity.yielding.active
    earlier = sequence.logs if yields else []
    result = identify(
        [log],
        belief.nominal,
        prior=belief.prior(),
        earlier=earlier,
        without=without,
        band=band,
        discrepancy=discrepancy,
        samples=max(2, 4 * sequence.samples),
        seed=sequence.seed + number + 1,
        on_progress=on_progress,
    )
    posterior = replace(result.posterior, logs=(*belief.logs, (log.name, log.sha256)))
    damage = None
    if yields:
        posterior = with_damage(posterior, [*earlier, log])
        damage = damage_intervals(posterior, sequence.probability)
    write_log(log, sequence.shake_folder(number + 1) / "log.h5")
    posterior.write(sequence.posterior_file(number + 1))
    sequence = sequence.with_next(
        log=(log.name, log.sha256),
        measured=measured,
        inside=inside,
        damage=damage,
        covered=covered,
    )
    sequence.write()
    return sequence, replace(result, posterior=posterior)


def with_damage(posterior: Posterior, logs: Items[TestLog]) -> Posterior:
    """Return a posterior with the damage that tests left in each sample's specimen.

    Samples that the model cannot be are left out.
    """
    tables = plants_at(posterior.scenario, posterior.names, posterior.points)
    possible = np.array([table is not None for table in tables])
    states = damage_after([table for table in tables if table is not None], logs)
    return replace(posterior, points=posterior.points[possible], states=tuple(states))


def damage_intervals(posterior: Posterior, probability: float) -> dict[str, list[float]]:
    """Return low end, median and high end of each value of a specimen's damage, SI."""
    columns = {
        name: [state.values[name] for state in posterior.states] for name in posterior.states[0].values
    }
    alpha = posterior.scenario.nonlinearity.yielding.stiffness_ratio
    for name in list(columns):
        if name.startswith(SLIP):
            drift = name.replace(SLIP, "remaining_drift")
            columns[drift] = [(1.0 - alpha) * value for value in columns[name]]
    tail = 0.5 - 0.5 * probability
    ends = [tail, 0.5, 1.0 - tail]
    return {name: np.quantile(values, ends).tolist() for name, values in columns.items()}


def measured_figures(log: TestLog) -> dict[str, float]:
    """Return rms and peak of each measured channel, SI, as forecasts call them."""
    values_of = {}
    for name in log.measured:
        values = log.channels[name]
        values_of[f"{name}_rms"] = float(np.sqrt(np.mean(values**2)))
        values_of[f"{name}_peak"] = float(np.max(np.abs(values)))
    return values_of


def _possible(scenario: Scenario, prior: Prior, number: int, seed: int) -> FloatArray:
    """Return draws (number, p) of a prior that the model can be."""
    stream = np.random.default_rng(seed)
    points = np.zeros((0, len(prior.names)))
    for _ in range(ROUNDS):
        draws = prior.draw(number, stream)
        possible = [table is not None for table in plants_at(scenario, prior.names, draws)]
        points = np.concatenate([points, draws[possible]])
        if len(points) >= number:
            return points[:number]
    raise ParameterError(
        "prior",
        prior.names,
        f"only {len(points)} of {ROUNDS * number} draws are a plant that the model can be: narrow it, "
        "or shorten the physics step",
    )
