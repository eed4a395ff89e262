"""Simulation-based calibration: ranks of true parameters among the samples of their posteriors."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import kstest

from agents.evaluation.perturbations import observation_rescaling
from agents.laboratory.identification.identify import identify
from agents.laboratory.identification.parameters import default_prior, from_scale, plants
from agents.laboratory.logs.recorder import LogRecorder
from baselines.batch_controllers import Rescaled
from baselines.registry import make_baseline
from shake_env.errors import ShakeError
from shake_env.motion.targets import FilteredNoise
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
    sampler_moves: int | None = None,
    seed: int = 0,
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
    sampler_moves
        Moves of the sampler; None: the normal posterior.
    seed
        Of all that is drawn.
    on_progress
        Told the share of the data sets done.
    """
    prior = default_prior(scenario)
    # No limit ends a log early: what is tested is the identification, not the drive.
    plain = replace(scenario, uncertainty=Uncertainty(), limits=Limits())
    motion = FilteredNoise(duration=seconds, amplitude=amplitude)
    ranks, errors, widths, failures, times = [], [], [], [], []
    for number in range(data_sets):
        stream = np.random.default_rng([seed, number])
        truth = None
        while truth is None:
            point = prior.draw(1, stream)
            (truth,) = plants(plain, prior.names, point)
        quake = [Earthquake("noise", motion, int(stream.integers(2**31)))]
        recorder = LogRecorder(plain, quake, plant=truth)
        driver: Any = NoiseCurrent(int(stream.integers(2**31)), round(seconds * plain.control_rate))
        if controller != "none":
            driver = Rescaled(make_baseline(controller, plain), observation_rescaling(truth, plain))
        rollout(driver, truth, quake, log=recorder)
        begun = time.perf_counter()
        try:
            found = identify(
                recorder.logs(), plain, prior=prior, discrepancy=False, samples=samples,
                sampler_moves=sampler_moves, seed=number,
            )  # fmt: skip
        except ShakeError as error:
            failures.append([number, str(error)])
            continue
        times.append(time.perf_counter() - begun)
        ranks.append(np.sum(found.posterior.points < point, axis=0).tolist())
        estimate = from_scale(prior.names, found.fit.mode)
        true = from_scale(prior.names, point[0])
        errors.append(((estimate - true) / np.where(true > 0.0, true, np.inf)).tolist())
        widths.append((found.fit.deviations / prior.deviations).tolist())
        on_progress("calibration", (number + 1) / data_sets)
    shares = (np.array(ranks) + 0.5) / (samples + 1.0)
    tests = {n: float(kstest(shares[:, i], "uniform").pvalue) for i, n in enumerate(prior.names)}
    inside = np.mean(np.abs(shares - 0.5) <= 0.45, axis=0)
    return {
        "data_sets": data_sets,
        "failures": failures,
        "seconds_each": float(np.median(times)),
        "p_values": tests,
        "uniform": {name: p >= LEVEL for name, p in tests.items()},
        "inside_90": dict(zip(prior.names, inside.tolist(), strict=True)),
        "median_error": dict(zip(prior.names, np.median(np.abs(errors), axis=0).tolist(), strict=True)),
        "median_width": dict(zip(prior.names, np.median(widths, axis=0).tolist(), strict=True)),
        "ranks": dict(zip(prior.names, np.array(ranks).T.tolist(), strict=True)),
    }


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
