"""How well sets of parameters explain logs: sensor noise, and what the model lacks.

A predicted reading is simulated under the logged command, without feedback from the readings (output
error). With white sensor noise and a constant offset, the orthonormal Fourier coefficients of its error,
but the mean, are independent with the noise's variance: the likelihood in them is exact. What the model
lacks is a relative error of each channel at each frequency, of standard deviation `share`, alike over
a band of `BAND`: coefficients within a band then repeat one another, and count as one. Theory:
``docs/updating.md``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize_scalar

from agents.laboratory.identification.parameters import clip_delays, plants_at
from agents.laboratory.identification.prediction import predict_response
from agents.laboratory.logs.findings import require_sound
from agents.laboratory.logs.test_log import CURRENT, TestLog
from shake_env.errors import LogError, ParameterError, unknown
from shake_env.model.parameters import FloatArray
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.engine import BoolArray

BAND = 1.0  # [Hz] over which the model's relative error is alike
UNKNOWN_NOISE = 1e-3  # of a channel's rms, where the scenario has no sensor for it
SIGNIFICANT = 6.0  # twice the gain in log likelihood below which no discrepancy is assumed
LANES = 512  # tables simulated at a time
WORST = 1e8  # of a whitened residual, so that a table that diverges has a finite cost


@dataclass(frozen=True)
class LogData:
    """A log as the likelihood takes it."""

    log: TestLog
    channels: tuple[str, ...]
    coefficients: FloatArray  # (coefficients, channels) of the readings
    variance: FloatArray  # (channels,) of the sensor noise
    power: FloatArray  # (coefficients, channels) of the readings, smoothed over `BAND`
    inside: BoolArray  # (coefficients,) within the band that is fitted

    @classmethod
    def from_log(
        cls,
        log: TestLog,
        scenario: Scenario,
        without: Sequence[str] = (),
        band: tuple[float, float] | None = None,
    ) -> LogData:
        """Return the data of a log.

        Parameters
        ----------
        log
            Of a test.
        scenario
            Whose sensors took it.
        without
            Measured channels that are not used.
        band
            Lowest and highest frequency [Hz] that are fitted; None: all.

        Raises
        ------
        LogError
            If a channel has a fault, none is left, or the step is not the control period.
        ParameterError
            If the band holds no frequency of the log, or `without` names no channel of it.
        """
        if not math.isclose(log.sampling_interval, scenario.control_period, rel_tol=1e-4):
            raise LogError(
                f"{log.name}, sampling_interval",
                log.sampling_interval,
                f"the scenario's control period is {scenario.control_period:g} s: another rate",
            )
        require_sound(log, without)
        channels = tuple(name for name in log.measured if name not in without)
        if not channels:
            raise LogError(f"{log.name}, channels", log.measured, "leave at least one in")
        readings = np.stack([log.channels[name] for name in channels], axis=-1)
        coefficients = fourier_coefficients(readings)
        frequency = np.repeat(np.fft.rfftfreq(log.samples, log.sampling_interval)[1:], 2)
        low, high = (0.0, math.inf) if band is None else band
        known = frequency[: len(coefficients)]
        inside = (known >= low) & (known <= high)
        if not inside.any():
            raise ParameterError(
                "band", band, f"holds none of the log's frequencies, up to {known[-1]:g} Hz"
            )
        for name in without:
            if name not in log.channels:
                raise unknown(ParameterError, "without", name, log.measured)
        width = max(1, round(BAND * log.duration) * 2 + 1)
        return cls(
            log=log,
            channels=channels,
            coefficients=coefficients,
            variance=np.array([_variance(scenario, n, log.channels[n]) for n in channels]),
            power=uniform_filter1d(coefficients**2, min(width, len(coefficients)), axis=0),
            inside=inside,
        )

    @property
    def repeats(self) -> float:
        """Coefficients of one kind in a band, which an error of the model makes alike."""
        return max(1.0, BAND * self.log.duration)


def slip_after(scenarios: Sequence[Scenario], currents: Sequence[FloatArray]) -> FloatArray | None:
    """Return the storeys' slips (N, stories) after tests under some commands; None: as new."""
    slip = None
    if scenarios and scenarios[0].nonlinearity.yielding.active:
        for current in currents:
            slip = predict_response(scenarios, current, (), slip).slip
    return slip


def fourier_coefficients(signals: FloatArray) -> FloatArray:
    """Return orthonormal real Fourier coefficients (..., samples - 1, c) of signals (..., samples, c).

    Without the mean; real and imaginary parts take turns, by rising frequency. White noise has its own
    variance in each of them.
    """
    samples = signals.shape[-2]
    whole = np.fft.rfft(signals, axis=-2)[..., 1:, :] * math.sqrt(2.0 / samples)
    if samples % 2 == 0:
        whole[..., -1, :] /= math.sqrt(2.0)
    parts = np.stack([whole.real, whole.imag], axis=-2)
    flat = parts.reshape(*whole.shape[:-2], -1, signals.shape[-1])
    coefficients: FloatArray = flat[..., : samples - 1, :]
    return coefficients


def _variance(scenario: Scenario, channel: str, values: FloatArray) -> float:
    layout = scenario.observation
    if not scenario.sensing.full_state and channel in layout.reading_names:
        place = layout.reading_names.index(channel)
        noise, step = (layout.sensor_values(n)[place] for n in ("noise", "resolution"))
        variance = float(noise**2 + step**2 / 12.0)
        if variance > 0.0:
            return variance
    return float(UNKNOWN_NOISE**2 * np.mean(values**2)) or 1e-30


@dataclass(frozen=True)
class Likelihood:
    """Of parameters, given logs of one table and specimen."""

    scenario: Scenario
    names: tuple[str, ...]
    data: tuple[LogData, ...]
    shares: tuple[
        FloatArray, ...
    ]  # of each log: (channels,) standard deviation of the model's error [-]
    # (samples,) [A] commands of the tests that the specimen bore before the first log, in order
    earlier: tuple[FloatArray, ...] = ()

    @classmethod
    def from_data(
        cls,
        scenario: Scenario,
        names: Sequence[str],
        data: Sequence[LogData],
        earlier: Sequence[FloatArray] = (),
    ) -> Likelihood:
        """Return a likelihood without discrepancy; see the fields."""
        shares = tuple(np.zeros(len(each.channels)) for each in data)
        return cls(scenario, tuple(names), tuple(data), shares, tuple(earlier))

    def with_share(self, share: float) -> Likelihood:
        """Return this likelihood with one share of discrepancy in every channel."""
        return replace(self, shares=tuple(np.full_like(each, share) for each in self.shares))

    @cached_property
    def weights(self) -> list[FloatArray]:
        """One over the standard deviation of each coefficient of each log; 0 outside the band."""
        weights = []
        for each, share in zip(self.data, self.shares, strict=True):
            variance = each.variance + each.repeats * share**2 * each.power
            weights.append(np.where(each.inside[:, None], 1.0 / np.sqrt(variance), 0.0))
        return weights

    def errors(self, points: FloatArray) -> list[FloatArray]:
        """Return the errors (N, coefficients, channels) of each log at N points (N, p).

        They are not numbers where a point is outside of what the model can be.
        """
        tables = plants_at(self.scenario, self.names, clip_delays(self.names, points))
        possible = [table for table in tables if table is not None]
        places = np.array([i for i, table in enumerate(tables) if table is not None], dtype=int)
        errors_of_logs = [np.full((len(tables), *each.coefficients.shape), np.nan) for each in self.data]
        for first in range(0, len(possible), LANES):
            chunk = slice(first, first + LANES)
            slip = slip_after(possible[chunk], self.earlier)
            for each, errors in zip(self.data, errors_of_logs, strict=True):
                current = each.log.channels[CURRENT]
                prediction = predict_response(possible[chunk], current, each.channels, slip)
                errors[places[chunk]] = each.coefficients - fourier_coefficients(prediction.readings)
                slip = prediction.slip  # the specimen of the next log bore this one
        return errors_of_logs

    def residuals(self, points: FloatArray) -> FloatArray:
        """Return the whitened errors (N, all coefficients of all logs) at N points (N, p)."""
        rows = [
            (error * weight).reshape(len(points), -1)
            for error, weight in zip(self.errors(points), self.weights, strict=True)
        ]
        whole = np.concatenate(rows, axis=1)
        return np.nan_to_num(whole, nan=WORST, posinf=WORST, neginf=-WORST).clip(-WORST, WORST)

    def log_density(self, points: FloatArray) -> FloatArray:
        """Return the log likelihood (N,), but a constant, at N points (N, p)."""
        density: FloatArray = -0.5 * np.sum(self.residuals(points) ** 2, axis=1)
        return density

    def with_discrepancy(self, point: FloatArray) -> Likelihood:
        """Return the likelihood whose shares explain the errors at a point (p,) best."""
        errors = self.errors(point[None])
        shares = tuple(_shares(each, error[0]) for each, error in zip(self.data, errors, strict=True))
        return replace(self, shares=shares)

    def fit_of(self, point: FloatArray) -> list[dict[str, float]]:
        """Return the share of each channel's power that a point (p,) explains, a dictionary a log."""
        return [
            {
                name: float(1.0 - np.sum(error[0, :, c] ** 2) / np.sum(each.coefficients[:, c] ** 2))
                for c, name in enumerate(each.channels)
            }
            for each, error in zip(self.data, self.errors(point[None]), strict=True)
        ]


def _shares(each: LogData, error: FloatArray) -> FloatArray:
    """Return the share of discrepancy (channels,) that errors (coefficients, channels) ask for."""
    shares = np.zeros(len(each.channels))
    for c in range(len(shares)):
        e2, power = error[each.inside, c] ** 2, each.power[each.inside, c]
        noise = float(each.variance[c])

        def cost(
            log_share: float, e2: FloatArray = e2, power: FloatArray = power, noise: float = noise
        ) -> float:
            variance = noise + math.exp(2.0 * log_share) * power
            return float(np.sum(np.log(variance) + e2 / variance))

        best = minimize_scalar(cost, bounds=(math.log(1e-5), math.log(3.0)), method="bounded")
        none = float(np.sum(math.log(noise) + e2 / noise))
        # Errors of the model repeat one another over a band: so does what speaks for them.
        if (none - best.fun) / each.repeats**0.5 > SIGNIFICANT:
            shares[c] = math.exp(best.x)
    return shares
