"""Perturbed tables: which parameters may differ from the design model, and the observation then."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.batch_controllers import Rescaled
from shake_env.controller import Controller, decide
from shake_env.errors import ParameterError
from shake_env.model.parameters import ModelEquations, Specimen
from shake_env.scenario.scenario import UNIFORM, Scenario
from shake_env.scenario.uncertainty import Uniform

Change = tuple[tuple[str, float], ...]  # quantities and their values; (): nothing is changed


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """Something that may not be as it was designed for."""

    name: str  # that of `Uncertainty`, where a scenario may draw it
    title: str
    unit: str
    values: tuple[float, ...]  # of a sweep, in `unit`
    coarse: tuple[float, ...]  # of a map's side
    relative: bool = False  # whether these are factors on the nominal value
    logarithmic: bool = False  # whether its axis is
    corrected: bool = False  # whether only the corrected equations have it

    def suits(self, scenario: Scenario) -> bool:
        """Return whether the scenario can have it changed."""
        return not self.corrected or scenario.equations == ModelEquations()

    def around(self, scenario: Scenario, coarse: bool = False) -> tuple[float, ...]:
        """Return the values of a sweep, ascending; the nominal one is among them."""
        nominal = nominal_value(scenario, self.name)
        unit = nominal if self.relative else 1.0
        values: tuple[float, ...]
        if self.name == "noise" and scenario.sensing.full_state:
            values = STATE_NOISE[::2] if coarse else STATE_NOISE
        else:
            values = self.coarse if coarse else self.values
        rounded = {float(f"{unit * value:.6g}") for value in values}
        if self.name == "delay" and scenario.uncertainty.delay is not None:
            step = 1e3 * scenario.physics_step
            rounded = {step * round(value / step) for value in rounded}  # drawn delays are whole steps
        near = {value for value in rounded if abs(value - nominal) <= 1e-5 * abs(nominal)}
        return tuple(sorted((rounded - near) | {nominal}))

    def title_for(self, scenario: Scenario) -> str:
        """Return what it is called there."""
        if self.name == "noise" and scenario.sensing.full_state:
            return "noise on the measured states"
        return self.title

    def unit_for(self, scenario: Scenario) -> str:
        """Return the unit of its values there."""
        return "% of rms" if self.name == "noise" and scenario.sensing.full_state else self.unit


# Of a state that is shown whole, in per cent of each state's rms at unit intensity.
STATE_NOISE = (0.0, 0.03, 0.1, 0.3, 1.0, 3.0)
QUANTITIES: dict[str, Quantity] = {
    each.name: each
    for each in (
        Quantity(
            name="mass_ratio", title="specimen mass over table mass", unit="-", relative=True,
            values=(0.1, 0.2, 0.5, 1.0, 1.5, 1.8, 2.5, 4.0), coarse=(0.2, 0.5, 1.0, 1.8, 4.0),
            logarithmic=True,
        ),
        Quantity(
            name="storey_frequency", title="storey frequency", unit="Hz", relative=True,
            values=(0.4, 0.55, 0.7, 0.85, 1.0, 1.3, 1.7, 2.2), coarse=(0.4, 0.7, 1.0, 1.3, 2.2),
            logarithmic=True,
        ),
        Quantity(
            name="damping_ratio", title="damping of a storey", unit="-", relative=True,
            values=(0.1, 0.2, 0.4, 1.0, 2.0, 4.0), coarse=(0.2, 1.0, 4.0), logarithmic=True,
        ),
        Quantity(
            name="coulomb_friction", title="Coulomb friction", unit="N",
            values=(0.0, 50.0, 100.0, 150.0, 300.0, 450.0, 600.0),
            coarse=(0.0, 150.0, 300.0, 600.0), corrected=True,
        ),
        Quantity(
            name="delay", title="loop delay", unit="ms",
            values=(0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 7.0), coarse=(0.0, 1.0, 2.5, 4.0), corrected=True,
        ),
        Quantity(
            name="noise", title="noise and offset of the sensors", unit="times",
            values=(0.0, 0.5, 1.0, 2.0, 4.0, 10.0, 20.0), coarse=(0.0, 1.0, 4.0, 10.0),
        ),
        Quantity(
            name="amplitude", title="amplitude of the motion", unit="times",
            values=(0.1, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0), coarse=(0.1, 0.5, 1.0, 1.5),
            logarithmic=True,
        ),
    )
}  # fmt: skip


def nominal_value(scenario: Scenario, name: str) -> float:
    """Return what controllers are designed for, in the quantity's unit."""
    if name in UNIFORM:
        return float(scenario.specimen.uniform_values(scenario.actuator.table_mass)[name])
    return {
        "coulomb_friction": scenario.nonlinearity.friction.coulomb,
        "delay": 1e3 * scenario.physics_step * scenario.delay,
        "noise": 0.0 if scenario.sensing.full_state else 1.0,
        "amplitude": 1.0,
    }[name]


def training_range(scenario: Scenario, name: str) -> tuple[float, float] | None:
    """Return the range that a scenario draws a quantity from, in its unit; None: it does not."""
    drawn: Uniform | None = getattr(scenario.uncertainty, name, None)
    if drawn is None:
        return None
    unit = 1e3 * scenario.physics_step if name == "delay" else 1.0
    return unit * drawn.low, unit * drawn.high


def perturb(scenario: Scenario, values: Mapping[str, float]) -> Scenario:
    """Return the scenario with other true values of some quantities, amplitude and state noise left out.

    What the scenario draws is drawn from a range of no width: nothing else of an episode changes.
    """
    given = dict(values)
    drawn = {name: value for name, value in given.items() if training_range(scenario, name)}
    new: dict[str, Any] = {}
    if drawn:
        steps = {"delay": 1e-3 / scenario.physics_step}
        ranges = {name: Uniform(*2 * (steps.get(name, 1.0) * value,)) for name, value in drawn.items()}
        new["uncertainty"] = replace(scenario.uncertainty, **ranges)
    own = {name: value for name, value in given.items() if name not in drawn}
    specimen = {name: own[name] for name in UNIFORM if name in own}
    if specimen:
        mass = scenario.actuator.table_mass
        now = scenario.specimen.uniform_values(mass) | specimen
        new["specimen"] = Specimen.uniform(**now, table_mass=mass)
    if "coulomb_friction" in own:
        parts = scenario.nonlinearity
        friction = parts.friction.at(own["coulomb_friction"])
        new["nonlinearity"] = replace(parts, friction=friction)
    if "delay" in own:
        new["delay"] = 1e-3 * own["delay"] / scenario.physics_step
    if "noise" in own and scenario.sensing.sensors is not None:
        factor = own["noise"]
        sensors = (
            replace(each, noise=factor * each.noise, bias=factor * each.bias)
            for each in scenario.sensing.sensors
        )
        new["sensing"] = replace(scenario.sensing, sensors=tuple(sensors))
    return replace(scenario, **new)


def observation_rescaling(true: Scenario, nominal: Scenario) -> NDArray[np.float64]:
    """Return what turns an observation (n,) of `true` into the nominal scenario's scale, by product."""
    layout, other = true.observation, nominal.observation
    if layout.names != other.names:
        raise ParameterError("observation", layout.size, f"must have the nominal {other.size} entries")
    factor = np.ones(layout.size)
    factor[: layout.head] = (true.plant.state_scale / nominal.plant.state_scale)[: layout.head]
    reading = layout.reading_scale / other.reading_scale
    factor[layout.readings] = reading
    if history := true.sensing.history:
        entry = np.r_[reading, np.ones(true.sensing.last_action)]
        factor[layout.history] = np.tile(entry, history)
    return factor


class NoisyState:
    """A controller that is shown the full state with white noise on what would be measured of it.

    Parameters
    ----------
    controller
        What is fed.
    level
        Rms of the noise over each state's scale [-].
    measured
        Entries of the observation: table and specimen, not the target and what follows from it.
    seeds
        One a lane, so that a lane's noise does not depend on its neighbours.
    """

    def __init__(
        self, controller: Controller, level: float, measured: slice, seeds: Sequence[int]
    ) -> None:
        self._controller, self._level = controller, level
        self._measured, self._seeds = measured, tuple(seeds)

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the actions (N, 1) for observations (N, n), one lane a seed, and the memory."""
        if observation.ndim != 2 or len(observation) != len(self._seeds):
            raise ParameterError(
                "observation shape", observation.shape, f"needs {len(self._seeds)} lanes"
            )
        streams, memory = state or ([np.random.default_rng((s, 1)) for s in self._seeds], None)
        shaken = observation.copy()
        width = self._measured.stop - self._measured.start
        noise = np.stack([stream.standard_normal(width) for stream in streams])
        shaken[:, self._measured] += (self._level * noise).astype(np.float32)
        action, memory = decide(self._controller, shaken, memory, episode_start, deterministic)
        return action, (streams, memory)


def perturbed_pair(
    controller: Controller, nominal: Scenario, values: Mapping[str, float], seeds: Sequence[int]
) -> tuple[Scenario, Controller]:
    """Return the perturbed scenario and the controller, which still observes signals in nominal units.

    Parameters
    ----------
    controller
        Made for the nominal scenario.
    nominal
        The scenario.
    values
        Quantities and their true values, in their units; the amplitude belongs to the motion.
    seeds
        Of the lanes of the roll-out, for noise on a state that is shown whole.
    """
    true = perturb(nominal, values)
    level = values.get("noise", 0.0) / 100.0
    if level and nominal.sensing.full_state:
        controller = NoisyState(controller, level, nominal.plant.layout.controlled, seeds)
    factor = observation_rescaling(true, nominal)
    if not np.allclose(factor, 1.0, rtol=1e-12, atol=0.0):
        controller = Rescaled(controller, factor)
    return true, controller
