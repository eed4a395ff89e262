"""The parameters of table and specimen that logs are asked for, and what each prior says of them.

Parameters are estimated on a scale on which a normal prior is sensible: the logarithm, and for the
delay the number of physics steps itself.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from shake_env.errors import ParameterError, ScenarioError, unknown
from shake_env.model.parameters import FloatArray
from shake_env.scenario.plants.values import (
    DAMPING,
    MASS,
    STIFFNESS,
    specimen_names,
    specimen_values,
)
from shake_env.scenario.scenario import Scenario

NO_LEAKAGE = 1e-14  # [m^3/(Pa s)] below which a table is taken to have none that is known
USUAL_LEAKAGE = 2e-13  # [m^3/(Pa s)] middle of the prior there


@dataclass(frozen=True)
class Parameter:
    """What can be estimated."""

    unit: str
    spread: float  # standard deviation of the prior on the parameter's scale
    excitation: str  # what a test must do to tell it


_TABLE = {
    "bulk_modulus": Parameter(
        "Pa", 0.3, "band-limited noise through the oil-column frequency (20 to 60 Hz)"
    ),
    "leakage": Parameter(
        "m^3/(Pa s)", 1.0, "large load pressure at low velocity: a stiff specimen shaken below 2 Hz"
    ),
    "valve_gain": Parameter("m/A", 0.1, "slow sines of large velocity, with the spool measured"),
    "valve_time_constant": Parameter("s", 0.2, "band-limited noise of current up to 50 Hz"),
    "table_mass": Parameter("kg", 0.05, "noise between 5 and 25 Hz with load pressure measured"),
    "table_damping": Parameter(
        "N s/m", 0.5, "sines of large velocity below 2 Hz with load pressure measured"
    ),
    "delay": Parameter("physics steps", 1.0, "band-limited noise of current up to 50 Hz"),
    "coulomb_friction": Parameter(
        "N", 0.5, "a slow triangle of small velocity with many reversals, load pressure measured"
    ),
    "supply_pressure": Parameter("Pa", 0.1, "large velocity at large load pressure"),
}
_SPECIMEN = {
    MASS: Parameter(
        "kg", 0.3, "noise through the first mode, with base shear or load pressure measured"
    ),
    STIFFNESS: Parameter(
        "N/m", 0.3, "noise through every mode, with the floors' accelerations measured"
    ),
    DAMPING: Parameter("N s/m", 0.5, "free vibration, or noise at the modes, with floors measured"),
    "yield_drift": Parameter("m", 0.3, "a shake strong enough to yield the storeys"),
}
LINEAR = ("delay",)  # estimated on their own scale


def find_parameter(name: str) -> Parameter:
    """Return a parameter by its name.

    Raises
    ------
    ParameterError
        If there is none of that name.
    """
    known = {**_TABLE, **_SPECIMEN}
    if _base(name) not in known:
        raise unknown(ParameterError, "parameter", name, known)
    return known[_base(name)]


def require_parameter(name: str, scenario: Scenario) -> Parameter:
    """Return a parameter of a scenario's plant by its name.

    Raises
    ------
    ParameterError
        If the plant has none of that name.
    """
    known = [each for each in nominal_values(scenario) if _base(each) in {**_TABLE, **_SPECIMEN}]
    if name not in known:
        raise unknown(ParameterError, "parameter", name, known)
    return find_parameter(name)


def _base(name: str) -> str:
    return STIFFNESS if name.startswith(f"{STIFFNESS}_") else name


def parameter_names(scenario: Scenario) -> tuple[str, ...]:
    """Return the parameters that a scenario's logs are asked for by default, in order.

    Friction, delay and yield drift only where the scenario has them; the supply pressure on request.
    """
    parts = scenario.nonlinearity
    left_out = {"supply_pressure"}
    if not parts.friction.coulomb > 0.0:
        left_out.add("coulomb_friction")
    if not scenario.delay:
        left_out.add("delay")
    specimen = [
        n for n in specimen_names(scenario.specimen) if specimen_values(scenario.specimen)[n] > 0
    ]
    names = [*(name for name in _TABLE if name not in left_out), *specimen]
    if parts.yielding.active:
        names.append("yield_drift")
    return tuple(name for name in names if nominal_values(scenario).get(name) != 0.0)


def nominal_values(scenario: Scenario) -> dict[str, float]:
    """Return a scenario's own values of all parameters, SI."""
    parts = scenario.nonlinearity
    return {
        **{name: float(value) for name, value in vars(scenario.actuator).items()},
        "coulomb_friction": parts.friction.coulomb,
        "delay": float(scenario.delay),
        "yield_drift": parts.yielding.yield_drift,
        "supply_pressure": parts.valve.supply_pressure,
        **specimen_values(scenario.specimen),
    }


@dataclass(frozen=True)
class Prior:
    """A normal distribution of the parameters on their scales.

    Raises
    ------
    ParameterError
        If sizes differ, or the covariance is not positive definite.
    """

    names: tuple[str, ...]
    mean: FloatArray  # (p,) on the parameters' scales
    covariance: FloatArray  # (p, p)

    def __post_init__(self) -> None:
        p = len(self.names)
        if self.mean.shape != (p,) or self.covariance.shape != (p, p) or not p:
            shapes = (p, self.mean.shape, self.covariance.shape)
            raise ParameterError("prior", shapes, "must have a mean and a covariance of its names")
        try:
            np.linalg.cholesky(self.covariance)
        except np.linalg.LinAlgError:
            raise ParameterError(
                "prior", self.names, "its covariance must be positive definite"
            ) from None

    @property
    def deviations(self) -> FloatArray:
        """Standard deviations (p,) on the parameters' scales."""
        deviations: FloatArray = np.sqrt(np.diag(self.covariance))
        return deviations

    @property
    def root(self) -> FloatArray:
        """W (p, p) with ``W'W`` the inverse of the covariance."""
        root: FloatArray = np.linalg.inv(np.linalg.cholesky(self.covariance))
        return root

    def draw(self, number: int, stream: np.random.Generator) -> FloatArray:
        """Return `number` draws (number, p) on the parameters' scales, delays not below zero."""
        factor = np.linalg.cholesky(self.covariance)
        drawn = self.mean + stream.standard_normal((number, len(self.names))) @ factor.T
        return clip_delays(self.names, drawn)


def clip_delays(names: Sequence[str], points: FloatArray) -> FloatArray:
    """Return points (..., p) with delays not below zero."""
    least = np.array([0.0 if name in LINEAR else -math.inf for name in names])
    limited: FloatArray = np.maximum(points, least)
    return limited


def to_scale(names: Sequence[str], values: Mapping[str, float]) -> FloatArray:
    """Return values on the parameters' scales (p,)."""
    return np.array([values[n] if n in LINEAR else math.log(values[n]) for n in names])


def from_scale(names: Sequence[str], points: FloatArray) -> FloatArray:
    """Return values in SI (..., p) of points on the parameters' scales."""
    linear = np.array([name in LINEAR for name in names])
    values: FloatArray = np.where(linear, points, np.exp(np.where(linear, 0.0, points)))
    return values


def plants_at(scenario: Scenario, names: Sequence[str], points: FloatArray) -> list[Scenario | None]:
    """Return the scenario with each of N points (N, p) on the parameters' scales.

    None where a value is outside its range, or the physics step does not resolve the plant: such a
    point has no probability.
    """
    scenarios: list[Scenario | None] = []
    with np.errstate(over="ignore"):
        values = from_scale(names, points)
    for row in values:
        try:
            scenarios.append(scenario.with_plant(dict(zip(names, row.tolist(), strict=True))))
        except (ParameterError, ScenarioError):
            scenarios.append(None)
    return scenarios


def default_prior(
    scenario: Scenario,
    names: Sequence[str] | None = None,
    given: Mapping[str, tuple[float, float]] | None = None,
) -> Prior:
    """Return the prior that a scenario's files give.

    Parameters
    ----------
    scenario
        Its values are the medians; where its uncertainty names a parameter, the range's middle is, and
        its spread is that of the range.
    names
        Of the parameters; None: `parameter_names`.
    given
        Median [SI] and standard deviation on the parameter's scale, by name, before everything else.
    """
    names = parameter_names(scenario) if names is None else tuple(names)
    nominal, median, spread = nominal_values(scenario), {}, {}
    for name in names:
        about = find_parameter(name)
        median[name], spread[name] = nominal.get(name, 0.0), about.spread
        if name == "leakage" and nominal[name] < NO_LEAKAGE:
            median[name], spread[name] = USUAL_LEAKAGE, 1.5
    common = np.zeros((2, len(names)))  # what mass ratio and storey frequency move together
    drawn = {key: r for key, r in vars(scenario.uncertainty).items() if r is not None}
    for name in set(drawn) & set(names):
        low, high = drawn[name].low, drawn[name].high
        if name in LINEAR:
            median[name], spread[name] = 0.5 * (low + high), max((high - low) / 12**0.5, 1e-3)
        elif low > 0.0:
            median[name], spread[name] = math.sqrt(low * high), max(math.log(high / low) / 12**0.5, 1e-3)
    for row, (key, power) in enumerate((("mass_ratio", 1.0), ("storey_frequency", 2.0))):
        if key in drawn and drawn[key].low > 0.0 and drawn[key].high > drawn[key].low:
            width = power * math.log(drawn[key].high / drawn[key].low) / 12**0.5
            for i, name in enumerate(names):
                if name.startswith(STIFFNESS) or (name in (MASS, DAMPING) and row == 0):
                    common[row, i] = width
                    spread[name] = 0.1 if name != DAMPING else spread[name]
    for name, (middle, deviation) in (given or {}).items():
        if name in median:
            median[name], spread[name] = middle, deviation
    for name in names:
        if name not in LINEAR and not (0.0 < median[name] < math.inf):
            raise ParameterError(f"prior of {name}", median[name], "needs a median above 0, finite")
    covariance = np.diag([spread[name] ** 2 for name in names]) + common.T @ common
    return Prior(names, to_scale(names, median), covariance)
