"""A scenario: one frozen value that says everything about an experiment, and the named ones."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypedDict

import numpy as np

from shake_env.discretization import DiscretePlant
from shake_env.errors import ParameterError, ScenarioError, unknown
from shake_env.limits import Limits
from shake_env.motion import FilteredNoise, Motion, RecordedMotion
from shake_env.nonlinearity import Nonlinearity
from shake_env.objective import Objective, StageCost
from shake_env.parameters import (
    Actuator,
    GroundFilter,
    ModelEquations,
    Specimen,
    require_positive,
)
from shake_env.plant import REFERENCE_CURRENT, CoupledPlant
from shake_env.uncertainty import Uncertainty

_KINDS: tuple[tuple[str, type | tuple[type, ...]], ...] = (
    ("actuator", Actuator),
    ("specimen", Specimen),
    ("ground", GroundFilter),
    ("equations", ModelEquations),
    ("motion", (FilteredNoise, RecordedMotion)),
    ("objective", Objective),
    ("limits", Limits),
)


def _names(kind: type | tuple[type, ...]) -> str:
    return " or ".join(k.__name__ for k in (kind if isinstance(kind, tuple) else (kind,)))


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """Plant, ground motion, objective, timing and limits of an experiment.

    Raises
    ------
    ParameterError
        If a rate, step or limit is not above zero, or the control period is not a whole number of
        physics steps.
    ScenarioError
        If a part is of another type.
    """

    name: str = "linear"
    actuator: Actuator = field(default_factory=Actuator)
    specimen: Specimen = field(default_factory=Specimen.uniform)
    ground: GroundFilter = field(default_factory=GroundFilter)
    equations: ModelEquations = field(default_factory=ModelEquations)
    motion: Motion = field(default_factory=FilteredNoise)
    objective: Objective = field(default_factory=Objective)
    physics_step: float = 1e-3  # [s]
    control_rate: float = 200.0  # [Hz]
    # The linear plant has no current limit; the action needs a unit. Five times the rated current is
    # over five times LQR's rms at 200 Hz, so that clipping to [-1, 1] leaves the linear optimum alone.
    current_limit: float = 5.0 * REFERENCE_CURRENT  # [A] current of action 1
    limits: Limits = field(default_factory=Limits)
    nonlinearity: Nonlinearity = field(default_factory=Nonlinearity)
    delay: int = 0  # [physics steps] from the controller's command to the valve
    uncertainty: Uncertainty = field(default_factory=Uncertainty)

    def __post_init__(self) -> None:
        for name, kind in _KINDS:
            if not isinstance(getattr(self, name), kind):
                raise ScenarioError(name, getattr(self, name), f"must be a {_names(kind)}")
        require_positive(self, "physics_step", "control_rate", "current_limit")
        if not isinstance(self.delay, (int, np.integer)) or self.delay < 0:
            raise ParameterError(
                "delay", self.delay, "must be a whole number of physics steps, at least 0"
            )
        ratio = 1.0 / (self.control_rate * self.physics_step)
        if round(ratio) < 1 or not math.isclose(ratio, round(ratio), rel_tol=1e-9):
            nearest = 1.0 / (max(round(ratio), 1) * self.physics_step)
            raise ParameterError(
                "control_rate",
                self.control_rate,
                f"its period is {ratio:.6g} physics steps of {self.physics_step} s and must be a whole "
                f"number of them: try {nearest:.6g} Hz",
            )

    def drawn(self, stream: np.random.Generator) -> Scenario:
        """Return this scenario with a true plant drawn from its uncertainty."""
        values = self.uncertainty.sample(stream)
        changes: dict[str, Any] = {}
        specimen = {name: values[name] for name in _UNIFORM if name in values}
        if specimen:
            table_mass = self.actuator.table_mass
            now = {**self.specimen.uniform_values(table_mass), **specimen}
            changes["specimen"] = Specimen.uniform(**now, table_mass=table_mass)
        actuator = {name: value for name, value in values.items() if name in vars(self.actuator)}
        if actuator:
            changes["actuator"] = replace(self.actuator, **actuator)
        if "coulomb_friction" in values:
            friction = replace(self.nonlinearity.friction, coulomb=values["coulomb_friction"])
            changes["nonlinearity"] = replace(self.nonlinearity, friction=friction)
        if "delay" in values:
            changes["delay"] = round(values["delay"])
        return replace(self, **changes)

    @property
    def longest_delay(self) -> int:
        """Longest loop delay [physics steps] that a drawn plant can have."""
        uncertain = self.uncertainty.delay
        return int(self.delay) if uncertain is None else math.ceil(uncertain.high)

    @property
    def substeps(self) -> int:
        """Physics steps per control period."""
        return round(1.0 / (self.control_rate * self.physics_step))

    @property
    def control_period(self) -> float:
        """Control period [s]."""
        return self.substeps * self.physics_step

    @cached_property
    def plant(self) -> CoupledPlant:
        """The continuous coupled plant."""
        return CoupledPlant(self.actuator, self.specimen, self.ground, self.equations)

    @cached_property
    def discrete(self) -> DiscretePlant:
        """The plant at the physics step and control rate: what baselines are designed on."""
        return DiscretePlant(self.plant, self.physics_step, self.substeps)

    @cached_property
    def stage_cost(self) -> StageCost:
        """The objective with coefficients in SI."""
        return self.objective.coefficients(self.plant)


NAMED: dict[str, Callable[[], Scenario]] = {
    "linear": Scenario,
    "as-printed": lambda: Scenario(name="as-printed", equations=ModelEquations.as_printed()),
}


class Overrides(TypedDict, total=False):
    """What can be changed about a scenario by a word; anything else by ``dataclasses.replace``."""

    stories: int
    mass_ratio: float
    storey_frequency: float
    damping_ratio: float
    specimen: Specimen
    equations: str | ModelEquations
    physics_step: float
    control_rate: float
    acceleration_weight: float
    force_weight: float
    current_weight: float
    objective: Objective
    motion: Motion
    record: str
    amplitude: float
    duration: float
    time_compression: float
    highpass_frequency: float
    current_limit: float
    limits: str | Limits
    nonlinearity: Nonlinearity
    delay: int
    uncertainty: Uncertainty


_UNIFORM = ("stories", "mass_ratio", "storey_frequency", "damping_ratio")
_WEIGHTS = ("acceleration_weight", "force_weight", "current_weight")
_MOTION = ("amplitude", "duration", "time_compression")
_DIRECT = (
    "specimen", "objective", "motion", "physics_step", "control_rate", "current_limit", "nonlinearity",
    "delay", "uncertainty",
)  # fmt: skip


def make_scenario(scenario: str | Scenario = "linear", overrides: Overrides | None = None) -> Scenario:
    """Return a named scenario, or the one given, with some of its parts changed.

    Parameters
    ----------
    scenario
        A name (``"linear"``, ``"as-printed"``) or a scenario.
    overrides
        ``stories``, ``mass_ratio``, ``storey_frequency`` [Hz], ``damping_ratio`` (equal storeys) or
        ``specimen``; ``equations`` ("corrected", "as_printed" or a value); ``physics_step`` [s],
        ``control_rate`` [Hz]; ``acceleration_weight``, ``force_weight``, ``current_weight`` or
        ``objective``; ``motion``, or ``record`` (its name), ``amplitude``, ``duration`` [s],
        ``time_compression``; ``highpass_frequency`` [Hz] of the ground filter; ``current_limit`` [A];
        ``limits`` ("off", "laboratory" or a value); ``nonlinearity``, ``delay`` [physics steps],
        ``uncertainty``.

    Raises
    ------
    ScenarioError
        If the name or an override is unknown, or two of them contradict each other.
    ParameterError
        If a value is outside its range.
    """
    if isinstance(scenario, str):
        if scenario not in NAMED:
            raise unknown(ScenarioError, "scenario", scenario, NAMED)
        scenario = NAMED[scenario]()
    if not isinstance(scenario, Scenario):
        raise ScenarioError("scenario", scenario, "must be a Scenario or the name of one")
    given: dict[str, Any] = dict(overrides or {})
    for name in given:
        if name not in Overrides.__annotations__:
            raise unknown(ScenarioError, "scenario option", name, Overrides.__annotations__)
    changes: dict[str, Any] = {name: given[name] for name in _DIRECT if name in given}
    _exclusive(given, "specimen", _UNIFORM)
    _exclusive(given, "objective", _WEIGHTS)
    _exclusive(given, "motion", (*_MOTION, "record"))
    if any(name in given for name in _UNIFORM):
        now = scenario.specimen.uniform_values(scenario.actuator.table_mass)
        now.update({name: given[name] for name in _UNIFORM if name in given})
        changes["specimen"] = Specimen.uniform(**now, table_mass=scenario.actuator.table_mass)
    if any(name in given for name in _WEIGHTS):
        weights = {name: given[name] for name in _WEIGHTS if name in given}
        changes["objective"] = replace(scenario.objective, **weights)
    if "record" in given or any(name in given for name in _MOTION):
        changes["motion"] = _changed_motion(scenario.motion, given)
    if "highpass_frequency" in given:
        changes["ground"] = replace(scenario.ground, highpass_frequency=given["highpass_frequency"])
    if "equations" in given:
        form = given["equations"]
        changes["equations"] = form if isinstance(form, ModelEquations) else ModelEquations.named(form)
    if "limits" in given:
        limits = given["limits"]
        changes["limits"] = limits if isinstance(limits, Limits) else Limits.named(str(limits))
    return replace(scenario, **changes)


def _exclusive(given: dict[str, Any], whole: str, parts: tuple[str, ...]) -> None:
    clash = [name for name in parts if name in given]
    if whole in given and clash:
        raise ScenarioError(
            whole, given[whole], f"contradicts {', '.join(clash)}: give one or the other"
        )


def _changed_motion(motion: Motion, given: dict[str, Any]) -> Motion:
    changes = {name: given[name] for name in _MOTION if name in given}
    if "record" in given:
        amplitude = {} if "amplitude" in changes else {"amplitude": motion.amplitude}
        return RecordedMotion(record=given["record"], **changes, **amplitude)
    if isinstance(motion, FilteredNoise) and "time_compression" in changes:
        raise ScenarioError(
            "time_compression", changes["time_compression"], "compresses a record: name one by record="
        )
    return replace(motion, **changes)
