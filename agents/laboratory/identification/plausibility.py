"""Whether a log's units and signs can be right: what draws of the prior predict, before any fit."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from agents.laboratory.identification.likelihood import Likelihood, LogData
from agents.laboratory.identification.parameters import Prior
from agents.laboratory.logs.test_log import CURRENT, TARGET, TestLog, unit_of
from shake_env.errors import LogError
from shake_env.model.parameters import FloatArray
from shake_env.scenario.scenario import Scenario

DRAWS = 24  # of the prior, beside its mean
LOUD = 2.0  # power of a channel over its noise, below which nothing is asked of it
ALIKE = 0.7  # correlation at which a channel has the form of what is predicted
SCALED = 4.0  # rms of a channel of that form over every prediction, or below it
# Of another form: below every prediction, its noise included (g for m/s^2 is 9.81), and above it.
QUIETER, LOUDER = 5.0, 10.0
BEYOND = 1.5  # of the largest command: the most that a log may hold
NEAR = 1.3  # factor within which a ratio is taken for that of two units
# Values in SI of other usual units of a quantity.
OTHERS = {
    "m/s^2": {"g": 9.80665, "cm/s^2": 1e-2, "mm/s^2": 1e-3},
    "m": {"mm": 1e-3, "cm": 1e-2, "in": 0.0254},
    "m/s": {"mm/s": 1e-3, "cm/s": 1e-2, "in/s": 0.0254},
    "Pa": {"kPa": 1e3, "bar": 1e5, "MPa": 1e6, "psi": 6894.757},
    "N": {"kN": 1e3, "lbf": 4.448222},
    "A": {"mA": 1e-3},
    "V": {"mV": 1e-3},
}
REMEDY = (
    "correct unit, sign or factor in the mapping file or where the log is written, or leave the channel "
    "out by --without"
)


def unit_mistake(unit: str, ratio: float) -> str:
    """Return which mistake makes a channel `ratio` times what it is, in words; empty: none is known.

    Parameters
    ----------
    unit
        Its unit in SI, or V.
    ratio
        What the log holds over what it should; negative where the sign is wrong.
    """
    words = ["its sign is wrong"] if ratio < 0.0 else []
    for other, factor in OTHERS.get(unit, {}).items():
        for scale, held, declared in ((1.0 / factor, other, unit), (factor, unit, other)):
            if abs(math.log(abs(ratio) / scale)) < math.log(NEAR):
                words.append(f"its numbers are in {held} and declared as {declared}")
    return " and ".join(words)


def require_possible_command(log: TestLog, scenario: Scenario) -> None:
    """Raise LogError where a log's command is larger than the table's driver allows."""
    peak, limit = float(np.max(np.abs(log.channels[CURRENT]))), scenario.current_limit
    if peak > BEYOND * limit:
        unit = log.input_unit
        remedy = (
            f"is more than the largest command of the scenario, {limit:g} {unit}: likely its numbers "
            f"are in m{unit} and declared as {unit}; correct the unit, or the scenario's current_limit"
        )
        raise LogError(f"{log.name}, {CURRENT}, peak [{unit}]", peak, remedy)


@dataclass(frozen=True)
class _Doubt:
    """A channel that no draw of the prior explains."""

    channel: str
    ratio: float  # of the log to the prediction; negative: of the other sign
    alike: bool  # whether it has the form of the prediction

    def __str__(self) -> str:
        form = "" if self.alike else ", noise included, and of another form"
        return f"{self.channel} is {self.ratio:.3g} times what the model predicts{form}"

    @property
    def likely(self) -> str:
        """Which mistake makes it so, in words."""
        mistake = unit_mistake(unit_of(self.channel), self.ratio)
        if not mistake and not self.alike and self.ratio < 1.0:
            mistake = "the sensor was not connected, or is far quieter than the scenario has it"
        return f"{self.channel}: likely {mistake}" if mistake else ""


def require_plausible(likelihood: Likelihood, prior: Prior, seed: int = 0) -> None:
    """Raise LogError where no draw of the prior explains sign and size of a channel.

    It takes one simulation of each log, so that a wrong unit is refused without a fit.

    Parameters
    ----------
    likelihood
        Of the logs.
    prior
        Of its parameters.
    seed
        Of the draws.
    """
    draws = prior.draw(DRAWS, np.random.default_rng(seed))
    points = np.concatenate([prior.mean[None], draws])
    for each, errors in zip(likelihood.data, likelihood.errors(points), strict=True):
        predicted = (each.coefficients - errors)[:, each.inside]
        predicted = predicted[np.isfinite(predicted).all(axis=(1, 2))]
        if not len(predicted):
            continue  # no draw is possible: the fit says so
        doubts = _doubts(each, predicted)
        if doubts:
            raise LogError(each.log.name, "; ".join(map(str, doubts)), _remedy(each, doubts))
        _require_target(each)


def _doubts(data: LogData, predicted: FloatArray) -> list[_Doubt]:
    """Return the channels that no prediction (N, coefficients, channels) explains."""
    doubts = []
    for c, name in enumerate(data.channels):
        measured, draws = data.coefficients[data.inside, c], predicted[:, :, c]
        noise = data.variance[c] * len(measured)
        power, sizes = float(measured @ measured), np.sum(draws**2, axis=1)
        products = draws @ measured
        sizes = np.maximum(sizes, 1e-300)
        alike = products / np.sqrt(sizes * max(power, 1e-300))
        best = int(np.argmax(np.abs(alike)))
        if abs(alike[best]) >= ALIKE:
            # All draws of that form must agree: one that explains the channel clears it.
            gains = (products / sizes)[np.abs(alike) >= max(ALIKE, abs(alike[best]) - 0.1)]
            wrong = (gains < 0.0) | (np.abs(np.log(np.abs(gains))) > math.log(SCALED))
            if wrong.all():
                doubts.append(_Doubt(name, float(products[best] / sizes[best]), True))
            continue
        ratios = np.sqrt(power / (sizes + noise))
        if ratios.max() < 1.0 / QUIETER or ratios.min() > LOUDER:
            doubts.append(_Doubt(name, float(ratios[0]), False))
    return doubts


def _remedy(data: LogData, doubts: list[_Doubt]) -> str:
    """Return what to do: where every channel is off in one way, the command is, that all follow."""
    ratios = np.array([each.ratio for each in doubts])
    unit = data.log.input_unit
    if len(doubts) >= max(2, len(data.channels)):
        if (ratios < 0.0).all():
            return f"every channel is: likely {CURRENT} has the wrong sign; {REMEDY}"
        if (ratios > 1.0).all() or (np.abs(ratios) < 1.0).all():
            held, declared = (unit, f"m{unit}") if ratios[0] > 1.0 else (f"m{unit}", unit)
            return (
                f"every channel is: likely the numbers of {CURRENT} are in {held} and declared as "
                f"{declared}, or the log is of another table; {REMEDY}"
            )
    likely = [each.likely for each in doubts if each.likely]
    return "; ".join([*likely, REMEDY])


def _require_target(data: LogData) -> None:
    """Raise LogError where the target has the form of the table's acceleration, in another unit."""
    acceleration = data.log.channels.get("table_acceleration")
    if acceleration is None or "table_acceleration" not in data.channels:
        return
    target = data.log.channels[TARGET]
    size, power = float(target @ target), float(acceleration @ acceleration)
    product = float(target @ acceleration)
    if size == 0.0 or abs(product) < ALIKE * math.sqrt(size * power):
        return
    ratio = math.copysign(math.sqrt(size / power), product)
    if ratio > 0.0 and 1.0 / SCALED <= ratio <= SCALED:
        return
    likely = unit_mistake(unit_of(TARGET), ratio)
    words = f"{ratio:.3g} times the table's acceleration" + (f" (likely {likely})" if likely else "")
    raise LogError(f"{data.log.name}, {TARGET}", words, "correct its unit or sign in the mapping file")
