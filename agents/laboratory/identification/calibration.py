"""Simulation-based calibration: ranks of true parameters among the samples of their posteriors."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import kstest

from agents.evaluation.perturbations import observation_rescaling
from agents.laboratory.identification.identify import identify
from agents.laboratory.identification.parameters import Prior, default_prior, from_scale, plants_at
from agents.laboratory.identification.sampler import LEAST_SAMPLES, require_sampler
from agents.laboratory.logs.recorder import LogRecorder
from agents.laboratory.logs.test_log import TestLog
from agents.seeds import require_seed
from baselines.batch_controllers import Rescaled
from baselines.registry import make_baseline
from shake_env.errors import ParameterError, ShakeError, unknown
from shake_env.model.parameters import FloatArray
from shake_env.motion.targets import FilteredNoise, whole_periods
from shake_env.rollout import Earthquake, rollout
from shake_env.scenario.limits import Limits
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uncertainty

LEVEL = 0.01  # of the test of each parameter's ranks


def calibrate(
    scenario: Scenario,
    *,
    data_sets: int,
    seconds: float = 8.0,
    amplitude: float = 0.1,
    samples: int = 200,
    controller: str = "none",
    without: Sequence[str] = (),
    sampler_moves: int | None = None,
    seed: int = 0,
    done: Sequence[Mapping[str, Any]] = (),
    on_row: Callable[[list[dict[str, Any]]], None] = lambda rows: None,
    on_progress: Callable[[str, float], None] = lambda what, share: None,
) -> dict[str, Any]:
    """Return ranks and errors of every parameter, and the test of their uniformity.

    Parameters
    ----------
    scenario
        Whose default prior plants are drawn from; its sensors take the logs.
    data_sets
        Number of plants, each with one log.
    seconds, amplitude
        Of the filtered noise that a log holds.
    samples
        Of each posterior.
    controller
        That drives the tests on the nominal plant's design; ``none`` plays a band-limited noise of
        current, which no plant can make unstable.
    without
        Measured channels that are not used.
    sampler_moves
        Moves of the sampler; None: the normal posterior.
    seed
        Of all that is drawn.
    done
        Rows of an earlier call with the same arguments, ``data_sets`` apart; they are not made anew.
    on_row
        Told all rows after each data set.
    on_progress
        Told the share of the data sets done.

    Raises
    ------
    ParameterError
        If a number is outside its range, a log would be shorter than one control period, `without`
        names no channel of the scenario's logs, or no data set could be identified.
    """
    whole_periods(seconds, scenario.control_period, "seconds")
    check_calibration(data_sets, samples, amplitude, sampler_moves, seed, without, scenario)
    prior = default_prior(scenario)
    rows = [dict(row) for row in done]
    present = {row["number"] for row in rows}
    for number in sorted(set(range(data_sets)) - present):
        row: dict[str, Any] = {"number": number}
        stream = np.random.default_rng([seed, number])
        point, log = data_set(scenario, prior, stream, seconds, amplitude, controller)
        plain = replace(scenario, uncertainty=Uncertainty(), limits=Limits())
        begun = time.process_time()
        try:
            identified = identify(
                [log], plain, prior=prior, discrepancy=False, samples=samples, without=without,
                sampler_moves=sampler_moves, seed=number,
            )  # fmt: skip
            estimate, true = (from_scale(prior.names, p) for p in (identified.fit.mode, point))
            relative = (estimate - true) / np.where(true > 0.0, true, np.inf)
            row |= {
                "seconds": time.process_time() - begun,
                "ranks": np.sum(identified.posterior.points < point, axis=0).tolist(),
                "errors": relative.tolist(),
                "widths": (identified.fit.deviations / prior.deviations).tolist(),
            }
        except ShakeError as error:
            row["failure"] = str(error)
        rows.append(row)
        on_row(rows)
        on_progress("calibration", len(rows) / data_sets)
    return calibration_summary(prior.names, rows, samples)


def check_calibration(
    data_sets: int,
    samples: int,
    amplitude: float,
    sampler_moves: int | None,
    seed: int,
    without: Sequence[str],
    scenario: Scenario,
) -> None:
    """Raise ParameterError where arguments of `calibrate` are none."""
    if data_sets < 1:
        raise ParameterError("data_sets", data_sets, "must be at least 1")
    if samples < LEAST_SAMPLES:
        raise ParameterError("samples", samples, f"must be at least {LEAST_SAMPLES}")
    if not amplitude > 0.0:
        raise ParameterError("amplitude", amplitude, "must be above 0")
    require_sampler(0.0, sampler_moves)
    require_seed(seed)
    if not scenario.sensing.full_state:
        channels = scenario.observation.reading_names
        for name in without:
            if name not in channels:
                raise unknown(ParameterError, "without", name, channels)


def calibration_summary(
    names: Sequence[str], rows: Sequence[Mapping[str, Any]], samples: int
) -> dict[str, Any]:
    """Return the figures of data sets, whose rows `calibrate` made, as plain JSON values.

    Parameters
    ----------
    names
        Of the parameters.
    rows
        Of the data sets; at least one has ranks.
    samples
        Of each posterior.

    Raises
    ------
    ParameterError
        If no data set could be identified.
    """
    good = [row for row in rows if "failure" not in row]
    if not good:
        reason = rows[0]["failure"] if rows else "none was made"
        raise ParameterError("data_sets", len(rows), f"none could be identified: {reason}")
    ranks, errors, widths = (
        np.array([row[key] for row in good]) for key in ("ranks", "errors", "widths")
    )
    shares = (ranks + 0.5) / (samples + 1.0)
    tests = {n: float(kstest(shares[:, i], "uniform").pvalue) for i, n in enumerate(names)}
    inside = np.mean(np.abs(shares - 0.5) <= 0.45, axis=0)

    def by_name(values: FloatArray) -> dict[str, float]:
        return dict(zip(names, values.tolist(), strict=True))

    return {
        "data_sets": len(rows),
        "samples": samples,
        "failures": [[row["number"], row["failure"]] for row in rows if "failure" in row],
        "seconds_each": float(np.median([row["seconds"] for row in good])),  # of processor time
        "p_values": tests,
        "uniform": {name: p >= LEVEL for name, p in tests.items()},
        "inside_90": by_name(inside),
        "median_error": by_name(np.median(np.abs(errors), axis=0)),
        "median_width": by_name(np.median(widths, axis=0)),
        "rows": list(rows),
    }


def data_set(
    scenario: Scenario,
    prior: Prior,
    stream: np.random.Generator,
    seconds: float,
    amplitude: float,
    controller: str,
) -> tuple[FloatArray, TestLog]:
    """Return a plant's point (p,) of the prior, and the log of its test.

    Parameters are those of `calibrate`; `stream` draws the plant, its motion and its noise.
    """
    # No limit ends a log early: what is tested is the identification, not the drive.
    plain = replace(scenario, uncertainty=Uncertainty(), limits=Limits())
    motion = FilteredNoise(duration=seconds, amplitude=amplitude)
    truth = None
    while truth is None:
        point = prior.draw(1, stream)
        (truth,) = plants_at(plain, prior.names, point)
    quake = [Earthquake("noise", motion, int(stream.integers(2**31)))]
    recorder = LogRecorder(plain, quake, plant=truth)
    driver: Any = NoiseCurrent(int(stream.integers(2**31)), round(seconds * plain.control_rate))
    if controller != "none":
        driver = Rescaled(make_baseline(controller, plain), observation_rescaling(truth, plain))
    rollout(driver, truth, quake, log=recorder)
    return point[0], recorder.logs()[0]


class NoiseCurrent:
    """Plays a band-limited noise of current, the same in every lane; memory is the step.

    Parameters
    ----------
    seed
        Of the noise.
    steps
        Control periods.
    level
        Its rms [-] of the current limit.
    """

    def __init__(self, seed: int, steps: int, level: float = 0.08) -> None:
        spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(steps + 1))
        place = np.arange(len(spectrum)) / max(1, len(spectrum) - 1)
        spectrum *= (place > 0.01) & (place < 0.5)
        noise = np.fft.irfft(spectrum, steps + 1)
        self._action = np.clip(level * noise / np.std(noise), -1.0, 1.0)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, Any]:
        """Return the action of the coming step."""
        step = 0 if state is None else state[0]
        value = self._action[min(step, len(self._action) - 1)]
        return np.full((*observation.shape[:-1], 1), value, dtype=np.float32), (step + 1,)
