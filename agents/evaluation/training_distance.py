"""How far a scenario lies from the one that a policy was trained on.

The distance is the largest departure of the parameters below from the training range: the range that the
training scenario drew from, or its one value. A departure is counted in the parameter's own step, a
factor or a difference: a policy one step away is called far outside. Other equations are infinitely far.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from agents.policies.policy_file import PolicyFile
from agents.scenario_options import ScenarioOptions
from shake_env.errors import ShakeError
from shake_env.motion.targets import FilteredNoise
from shake_env.scenario.observation import UNITS
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uniform

FAR = 1.0  # distance beyond which a reader is warned


@dataclass(frozen=True)
class Parameter:
    """A parameter of a scenario, and the step in which its departures are counted."""

    title: str
    value: Callable[[Scenario], float | None]  # nominal; None: the scenario has none
    step: float  # a factor above 1, or a difference
    difference: bool = False
    drawn: str = ""  # field of `Uncertainty` that may draw it
    unit: float = 1.0  # of a drawn value, in the parameter's own

    def interval(self, scenario: Scenario) -> tuple[float, float] | None:
        """Return the least and largest value of a scenario; None: it has none."""
        drawn: Uniform | None = getattr(scenario.uncertainty, self.drawn) if self.drawn else None
        if drawn is not None:
            unit = self.unit * (1e3 * scenario.physics_step if self.drawn == "delay" else 1.0)
            return unit * drawn.low, unit * drawn.high
        value = self.value(scenario)
        return None if value is None else (value, value)

    def departure(self, inside: tuple[float, float], given: tuple[float, float]) -> float:
        """Return how many steps `given` reaches beyond `inside`, at least 0."""
        below, above = self._steps(given[0], inside[0]), self._steps(inside[1], given[1])
        return max(below, above, 0.0)

    def _steps(self, low: float, high: float) -> float:
        if low == high:
            return 0.0
        if self.difference:
            return (high - low) / self.step
        if min(low, high) <= 0.0 or math.isinf(max(low, high)):  # one has it, the other has not
            return math.inf if high > low else -math.inf
        return math.log(high / low) / math.log(self.step)


def _storey_frequency(scenario: Scenario) -> float:
    """Return the storey frequency [Hz] of equal storeys with the specimen's first frequency."""
    stories = scenario.specimen.stories
    first = float(scenario.specimen.fixed_base_frequencies[0])
    return first / (2.0 * math.sin(math.pi / (2.0 * (2 * stories + 1))))


def _damping_ratio(scenario: Scenario) -> float:
    each = scenario.specimen
    storeys = zip(each.masses, each.stiffnesses, each.dampings, strict=True)
    return float(np.mean([c / (2.0 * math.sqrt(m * k)) for m, k, c in storeys]))


def _noise(signal: str, scenario: Scenario) -> float | None:
    """Return the rms noise of a signal's sensor, in its unit."""
    sensors = scenario.sensing.sensors or ()
    return next((each.noise for each in sensors if each.signal == signal), None)


def _amplitude(scenario: Scenario) -> float | None:
    motion = scenario.motion
    return motion.amplitude if isinstance(motion, FilteredNoise) else None


PARAMETERS = (
    Parameter(
        "specimen mass over table mass",
        lambda s: s.specimen.mass / s.actuator.table_mass,
        1.5,
        drawn="mass_ratio",
    ),
    Parameter("storey frequency [Hz]", _storey_frequency, 1.25, drawn="storey_frequency"),
    Parameter("damping ratio of a storey", _damping_ratio, 3.0, drawn="damping_ratio"),
    Parameter("table mass [kg]", lambda s: s.actuator.table_mass, 1.25),
    Parameter("oil-column frequency [Hz]", lambda s: s.actuator.oil_column_frequency, 1.25),
    Parameter("velocity at action 1 [m/s]", lambda s: s.actuator.velocity_gain * s.current_limit, 1.25),
    Parameter("supply pressure [Pa]", lambda s: s.nonlinearity.valve.supply_pressure, 1.25),
    Parameter("yield drift [m]", lambda s: s.nonlinearity.yielding.yield_drift, 1.5),
    Parameter(
        "Coulomb friction [N]",
        lambda s: s.nonlinearity.friction.coulomb,
        150.0,
        difference=True,
        drawn="coulomb_friction",
    ),
    Parameter(
        "loop delay [ms]",
        lambda s: 1e3 * s.physics_step * s.delay,
        2.0,
        difference=True,
        drawn="delay",
    ),
    *(
        Parameter(f"noise of {signal} [{UNITS[signal]}]", partial(_noise, signal), 3.0)
        for signal in UNITS
    ),
    Parameter("amplitude of the filtered noise", _amplitude, 1.5),
)


def training_distance(trained: Scenario, scenario: Scenario) -> tuple[float, str]:
    """Return the distance of a scenario from a training scenario, and what makes it, in words."""
    if trained.equations != scenario.equations:
        return math.inf, "other equations of motion"
    worst, reason = 0.0, "nothing"
    for parameter in PARAMETERS:
        inside, given = parameter.interval(trained), parameter.interval(scenario)
        if inside is None or given is None:
            continue
        departure = parameter.departure(inside, given)
        if departure > worst:
            worst = departure
            reason = f"{parameter.title} {_words(given)}, trained {_words(inside)}"
    return worst, reason


def _words(interval: tuple[float, float]) -> str:
    low, high = interval
    return f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"


def training_warning(policy: PolicyFile, scenario: Scenario) -> str:
    """Return in words that a policy is driven far outside its training; empty where it is not."""
    trained = _training_scenario(policy.card)
    if trained is None:
        return ""
    distance, reason = training_distance(trained, scenario)
    if not distance > FAR:
        return ""
    return (
        f"is driven far outside of its training on {trained.name}: {reason} (distance {distance:.2g}, "
        f"far is above {FAR:g})"
    )


def _training_scenario(card: dict[str, Any]) -> Scenario | None:
    """Return the scenario that a policy's card names; None where it names none that can be built."""
    try:
        options = card["config"]["scenario"]
        return ScenarioOptions(**{**options, "set": tuple(options.get("set", ()))}).build()
    except (ShakeError, KeyError, TypeError, AttributeError, ValueError):
        return None  # a card may come from anywhere
