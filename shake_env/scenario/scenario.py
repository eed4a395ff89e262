"""A scenario: one frozen value that says everything about an experiment."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from shake_env.errors import ParameterError, ScenarioError, unknown
from shake_env.model.discretization import DiscretePlant, check_directions
from shake_env.model.nonlinearity import Nonlinearity
from shake_env.model.parameters import Actuator, GroundFilter, ModelEquations, Specimen
from shake_env.model.plant import REFERENCE_CURRENT, CoupledPlant
from shake_env.model.ranges import RANGES, check, check_ranges
from shake_env.model.resolution import check_resolution
from shake_env.model.specimen_state import is_state_value
from shake_env.motion.targets import FilteredNoise, Motion, MotionSet, RecordedMotion
from shake_env.scenario.limits import Limits
from shake_env.scenario.objective import Objective, StageCost
from shake_env.scenario.observation import ObservationLayout, Sensing
from shake_env.scenario.plants.samples import PlantSamples
from shake_env.scenario.plants.values import specimen_values, with_specimen_values
from shake_env.scenario.tables.table import DEFAULT_TABLE, TABLE_NAMES, named_table
from shake_env.scenario.uncertainty import MASS_FACTOR, STIFFNESS_FACTOR, Uncertainty

_KINDS: tuple[tuple[str, type | tuple[type, ...]], ...] = (
    ("actuator", Actuator),
    ("specimen", Specimen),
    ("ground", GroundFilter),
    ("equations", ModelEquations),
    ("motion", (FilteredNoise, RecordedMotion, MotionSet)),
    ("objective", Objective),
    ("limits", Limits),
    ("nonlinearity", Nonlinearity),
    ("uncertainty", Uncertainty),
    ("sensing", Sensing),
)


MOST_SUBSTEPS = 1000  # physics steps a control period
UNIFORM = ("stories", "mass_ratio", "storey_frequency", "damping_ratio")  # what makes equal storeys

SAMPLED = ("coulomb_friction", "delay", "yield_drift", "supply_pressure", "valve_natural_frequency")


class TruePlant(NamedTuple):
    """What may differ of a drawn plant from a scenario's own."""

    actuator: Actuator
    specimen: Specimen
    nonlinearity: Nonlinearity
    delay: float  # [physics steps]


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

    name: str = "linear"  # in tables, figures and results
    table: str = DEFAULT_TABLE  # name of the table that the actuator is; it changes nothing computed
    actuator: Actuator = field(default_factory=Actuator)
    specimen: Specimen = field(default_factory=Specimen.uniform)
    ground: GroundFilter = field(default_factory=GroundFilter)
    equations: ModelEquations = field(default_factory=ModelEquations)
    motion: Motion = field(default_factory=FilteredNoise)
    objective: Objective = field(default_factory=Objective)
    physics_step: float = 1e-3  # [s] of the integration
    control_rate: float = 200.0  # [Hz] of the controller; its period is a whole number of steps
    # Of the directions of a step's noise, two lose 1e-9 of any mean square at 1 ms
    # (`DiscretePlant.noise`); None draws all above rounding, which takes twice as many.
    noise_directions: int | None = 2  # [-] random numbers a physics step
    # The linear plant has no current limit; the action needs a unit. Five times the rated current is
    # over five times LQR's rms at 200 Hz, so that clipping to [-1, 1] leaves the linear optimum alone.
    current_limit: float = 5.0 * REFERENCE_CURRENT  # [A] current of action 1
    limits: Limits = field(default_factory=Limits)
    nonlinearity: Nonlinearity = field(default_factory=Nonlinearity)
    delay: float = 0  # [physics steps] from the controller's command to the valve
    uncertainty: Uncertainty | PlantSamples = field(default_factory=Uncertainty)
    sensing: Sensing = field(default_factory=Sensing)
    train_on: str | None = None  # scenario to train and tune on instead of this one, which is for tests

    @property
    def reserved_for_testing(self) -> bool:
        """Whether nothing is trained or tuned on this scenario."""
        return self.train_on is not None

    def __post_init__(self) -> None:
        for name, kind in _KINDS:
            if not isinstance(getattr(self, name), kind):
                raise ScenarioError(name, getattr(self, name), f"must be a {_names(kind)}")
        check_ranges(self)
        ratio = 1.0 / (self.control_rate * self.physics_step)
        if round(ratio) < 1 or not math.isclose(ratio, round(ratio), rel_tol=1e-9):
            nearest = 1.0 / (max(round(ratio), 1) * self.physics_step)
            raise ParameterError(
                "control_rate",
                self.control_rate,
                f"its period is {ratio:.6g} physics steps of {self.physics_step} s and must be a whole "
                f"number of them: try {nearest:.6g} Hz",
            )
        if round(ratio) > MOST_SUBSTEPS:
            raise ParameterError(
                "control_rate",
                self.control_rate,
                f"its period is {ratio:.6g} physics steps of {self.physics_step} s, and must be at most "
                f"{MOST_SUBSTEPS} of them: raise the rate or the step",
            )
        check_resolution(self.actuator, self.specimen, self.ground, self.nonlinearity, self.physics_step)
        self._check_equations()
        self._check_samples()
        self.sensing.preview_steps(self.physics_step)
        check_directions("noise_directions", self.noise_directions)

    def _check_samples(self) -> None:
        if not isinstance(self.uncertainty, PlantSamples):
            return
        factors = (f"{kind}_{i}" for kind in (MASS_FACTOR, STIFFNESS_FACTOR)
                   for i in range(1, self.specimen.stories + 1))  # fmt: skip
        known = {*UNIFORM, *SAMPLED, *vars(self.actuator), *specimen_values(self.specimen), *factors}
        for name in self.uncertainty.names:
            if name not in known and not is_state_value(name):
                raise unknown(ScenarioError, "uncertainty.posterior, parameter", name, known)

    def _check_equations(self) -> None:
        if self.specimen.coupled and self.nonlinearity.yielding.active:
            raise ScenarioError(
                "nonlinearity.yielding", self.nonlinearity.yielding, "needs storeys: give no matrices"
            )
        asked = {
            "nonlinearity": self.nonlinearity.active,
            "delay": bool(self.delay),
            "uncertainty": self.uncertainty.active,
        }
        if self.equations != ModelEquations() and any(asked.values()):
            name = next(name for name, given in asked.items() if given)
            raise ScenarioError(name, getattr(self, name), 'needs equations="corrected"')
        for sensor in self.sensing.sensors or ():
            if self.equations != ModelEquations() and sensor.lowpass_frequency is not None:
                path = f"sensing.sensors.{sensor.signal}.lowpass_frequency"
                raise ScenarioError(path, sensor.lowpass_frequency, 'needs equations="corrected"')
        valve = self.nonlinearity.valve
        if self.uncertainty.valve_time_constant and valve.natural_frequency is not None:
            raise ScenarioError(
                "uncertainty.valve_time_constant",
                self.uncertainty.valve_time_constant,
                "a valve with a natural frequency has no time constant: leave one of them out",
            )
        if self.uncertainty.valve_natural_frequency and valve.natural_frequency is None:
            raise ScenarioError(
                "uncertainty.valve_natural_frequency",
                self.uncertainty.valve_natural_frequency,
                "the valve is of first order: set nonlinearity.valve.natural_frequency",
            )
        if self.uncertainty.supply_pressure and not math.isfinite(valve.supply_pressure):
            raise ScenarioError(
                "uncertainty.supply_pressure",
                self.uncertainty.supply_pressure,
                "the supply is infinite: set nonlinearity.valve.supply_pressure",
            )
        if self.uncertainty.storey_factor and self.specimen.coupled:
            raise ScenarioError(
                "uncertainty.storey_factor", self.uncertainty.storey_factor, "needs storeys"
            )

    def drawn(self, stream: np.random.Generator) -> Scenario:
        """Return this scenario with a true plant drawn from its uncertainty."""
        return self.with_plant(self.uncertainty.sample(stream, self.specimen.stories))

    def with_plant(self, values: Mapping[str, float]) -> Scenario:
        """Return this scenario with these values of its uncertain parameters, by their names.

        Beside those of `Uncertainty` these are all of the actuator and of `plants.values`, and
        ``yield_drift`` and ``supply_pressure``.
        """
        return replace(self, **self.true_plant(values)._asdict())

    def true_plant(self, values: Mapping[str, float]) -> TruePlant:
        """Return what `with_plant` changes, checked: a scenario of it is made ten times as slowly.

        Raises
        ------
        ParameterError
            If a value is outside its range.
        ScenarioError
            If the physics step is too long for a motion of the plant.
        """
        actuator, specimen, parts = self.actuator, self.specimen, self.nonlinearity
        uniform = {name: values[name] for name in UNIFORM if name in values}
        if uniform:
            now = {**specimen.uniform_values(actuator.table_mass), **uniform}
            specimen = Specimen.uniform(**now, table_mass=actuator.table_mass)
        changed = {name: value for name, value in values.items() if name in vars(actuator)}
        if changed:
            actuator = replace(actuator, **changed)
        specimen = with_specimen_values(specimen, values)
        if "coulomb_friction" in values:
            parts = replace(parts, friction=parts.friction.at(values["coulomb_friction"]))
        if "yield_drift" in values:
            yielding = replace(parts.yielding, yield_drift=values["yield_drift"])
            parts = replace(parts, yielding=yielding)
        valve: dict[str, Any] = {}
        if "supply_pressure" in values:
            rated = parts.valve.rated
            valve |= {"supply_pressure": values["supply_pressure"], "rated_pressure": rated}
        if "valve_natural_frequency" in values:
            valve["natural_frequency"] = values["valve_natural_frequency"]
        if valve:
            parts = replace(parts, valve=replace(parts.valve, **valve))
        if any(name.startswith((MASS_FACTOR, STIFFNESS_FACTOR)) for name in values):
            floors = range(1, specimen.stories + 1)
            masses, stiffnesses = (
                tuple(values.get(f"{kind}_{i}", 1.0) * each[i - 1] for i in floors)
                for kind, each in (
                    (MASS_FACTOR, specimen.masses),
                    (STIFFNESS_FACTOR, specimen.stiffnesses),
                )
            )
            specimen = replace(specimen, masses=masses, stiffnesses=stiffnesses)
        delay = values.get("delay", self.delay)
        check("delay", delay, RANGES["Scenario"]["delay"])
        check_resolution(actuator, specimen, self.ground, parts, self.physics_step)
        return TruePlant(actuator, specimen, parts, delay)

    @property
    def parts(self) -> Nonlinearity:
        """The nonlinear parts of the tables that are stepped: friction also where it is only drawn."""
        friction, most = self.nonlinearity.friction, self.uncertainty.largest("coulomb_friction")
        if most is None or friction.active:
            return self.nonlinearity
        return replace(self.nonlinearity, friction=friction.at(most))

    @property
    def longest_delay(self) -> float:
        """Longest loop delay [physics steps] that a drawn plant can have."""
        most = self.uncertainty.largest("delay")
        return self.delay if most is None else max(self.delay, math.ceil(most))

    @property
    def input_unit(self) -> str:
        """Unit of the input that action 1 stands for: ``"A"`` of a valve, or ``"V"``."""
        return named_table(self.table).input_unit if self.table in TABLE_NAMES else "A"

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
        return DiscretePlant(self.plant, self.physics_step, self.substeps, self.noise_directions)

    @cached_property
    def observation(self) -> ObservationLayout:
        """Where each part of an observation lies."""
        samples, spacing = self.sensing.preview_steps(self.physics_step)
        return ObservationLayout(self.sensing, self.plant, samples, spacing)

    @cached_property
    def stage_cost(self) -> StageCost:
        """The objective with coefficients in SI."""
        return self.objective.coefficients(self.plant)
