"""A plant for each table of a batch, where the scenario does not know its own for sure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.dynamics import nonlinear as nonlinear_dynamics
from shake_env.dynamics import yielding_reference as reference
from shake_env.dynamics.drawn_plants import DrawnPlants, rows_of
from shake_env.dynamics.ground import GroundMaps
from shake_env.dynamics.nonlinear import (
    NonlinearDynamics,
    arrival,
    commands_under_way,
    floor_rows,
)
from shake_env.errors import ScenarioError
from shake_env.model.discretization import MOST_DIRECTIONS, DiscretePlant
from shake_env.model.parameters import FloatArray, replace_unchecked, stacked
from shake_env.model.plant import CoupledPlant
from shake_env.model.specimen_state import SpecimenState
from shake_env.numba_support import compiled_module
from shake_env.scenario.objective import StageCost
from shake_env.scenario.scenario import Scenario, TruePlant
from shake_env.simulation.transition import TableModel

IntArray = NDArray[np.int64]


class PlantBatch:
    """The drawn plants of N tables, stacked so that one update steps them all.

    Parameters
    ----------
    scenario
        With an uncertainty; its own values are the nominal plant.
    lanes
        Number of tables N.

    Raises
    ------
    ScenarioError
        If the equations are not the corrected ones.
    """

    def __init__(self, scenario: Scenario, lanes: int) -> None:
        nominal = TableModel.from_scenario(scenario)
        if not isinstance(nominal.dynamics, NonlinearDynamics):
            raise ScenarioError("uncertainty", scenario.uncertainty, "is not active: nothing to draw")
        self.scenario = scenario
        self._values: list[dict[str, float]] = [{}] * lanes  # what was drawn for each
        self._dynamics: dict[str, Any] = {
            name: _repeat(getattr(nominal.dynamics, name), lanes) for name in nonlinear_dynamics.ARRAYS
        }
        self._cost: dict[str, Any] = {
            field.name: np.full(lanes, getattr(nominal.stage_cost, field.name))
            for field in fields(StageCost)
        }
        # How many directions of noise lie above rounding differs from plant to plant.
        self._directions = scenario.noise_directions or MOST_DIRECTIONS
        discrete = replace(scenario.discrete, directions=self._directions)
        maps = GroundMaps.from_plant(discrete, scenario.nonlinearity.yielding)
        self._noise = _repeat(maps.noise, lanes)
        self._record = _repeat(maps.record, lanes)
        self._reference: dict[str, Any] = {
            name: _repeat(getattr(maps.yielding, name), lanes)
            for name in (reference.ARRAYS if maps.yielding else ())
        }
        self._floors = None if nominal.floor_rows is None else _repeat(nominal.floor_rows, lanes)
        # The stacks are filled in place: these values see every change.
        self.model = replace(
            nominal,
            dynamics=replace(nominal.dynamics, **self._dynamics),
            stage_cost=StageCost(**self._cost),
            floor_rows=self._floors,
        )
        yielding = maps.yielding and replace(maps.yielding, **self._reference)
        self.maps = GroundMaps(self._noise, self._record, yielding)
        self._compiled = self._new_compiled()

    def _new_compiled(self) -> DrawnPlants | None:
        """Return what makes plants faster, or None where there is no numba, or no chain of storeys."""
        scenario, objective = self.scenario, self.scenario.objective
        compiled = compiled_module("shake_env.kernels.plant_matrices")
        if compiled is None or scenario.specimen.coupled:
            return None
        stacks = {f"reference_{name}": stack for name, stack in self._reference.items()}
        stacks |= self._dynamics | {"noise": self._noise, "record": self._record}
        return DrawnPlants(
            scenario.ground,
            scenario.parts,
            scenario.observation.low_passes,
            scenario.physics_step,
            objective.force_weight if objective.normalised else 0.0,
            stacks | {"floors": self._floors, "force": self._cost["force"]},
        )

    @property
    def plants(self) -> list[Scenario]:
        """The true scenario of each lane, made when asked for."""
        return [self.plant(lane) for lane in range(len(self._values))]

    def plant(self, lane: int) -> Scenario:
        """Return the true scenario of a lane."""
        drawn = self._values[lane]
        return self.scenario.with_plant(drawn) if drawn else self.scenario

    def sample(self, lanes: Sequence[int], streams: Sequence[np.random.Generator]) -> None:
        """Give each of `lanes` a new plant, drawn from its stream."""
        scenario, index = self.scenario, np.asarray(lanes, dtype=np.int64)
        stories, k = scenario.specimen.stories, scenario.substeps
        values = [scenario.uncertainty.sample(stream, stories) for stream in streams]
        drawn = [scenario.true_plant(each) for each in values]
        for lane, each in zip(lanes, values, strict=True):
            self._values[lane] = each
        commands = commands_under_way(scenario.longest_delay, k)
        rows = rows_of(index)
        self._dynamics["coulomb"][rows] = [true.nonlinearity.friction.coulomb for true in drawn]
        self._dynamics["arrival"][rows] = [arrival(true.delay, k, commands) for true in drawn]
        if self._compiled is None:
            self._put(index, drawn)
            return
        valves = [true.nonlinearity.valve for true in drawn]
        actuators, specimens = [true.actuator for true in drawn], [true.specimen for true in drawn]
        done = self._compiled.put(index, actuators, specimens, valves)
        if done < len(drawn):
            self._put(index[done:], drawn[done:])  # which says what is wrong

    def _put(self, index: IntArray, drawn: Sequence[TruePlant]) -> None:
        """Write the matrices of plants, made in arrays.

        All at once, from parameters whose numbers are arrays: one by one, Python costs ten times what
        the arithmetic does.
        """
        scenario = self.scenario
        plant = CoupledPlant(
            stacked([true.actuator for true in drawn]),
            stacked([true.specimen for true in drawn]),
            scenario.ground,
            scenario.equations,
        )
        parts, step, k = scenario.parts, scenario.physics_step, scenario.substeps
        valve = stacked([true.nonlinearity.valve for true in drawn])
        own_parts = replace_unchecked(parts, valve=valve) if parts.valve.active else parts
        dynamics = NonlinearDynamics.from_plant(
            plant,
            own_parts,
            step,
            k,
            longest_delay=scenario.longest_delay,
            low_passes=scenario.observation.low_passes,
        )
        for name, stack in self._dynamics.items():
            if name not in ("coulomb", "arrival"):
                stack[index] = getattr(dynamics, name)
        cost = scenario.objective.coefficients(plant)
        for name, column in self._cost.items():
            column[index] = getattr(cost, name)
        if self._floors is not None:
            self._floors[index] = floor_rows(plant, parts.yielding)
        maps = GroundMaps.from_plant(DiscretePlant(plant, step, k, self._directions), parts.yielding)
        self._noise[index] = maps.noise
        self._record[index] = maps.record
        for name, stack in self._reference.items():
            stack[index] = getattr(maps.yielding, name)

    def damage(self, lane: int) -> FloatArray | None:
        """Return ``[x_r, x_r', s]`` of a lane's specimen and reference (2, 3 stories), as drawn with it.

        None: as new.
        """
        stories = self.scenario.specimen.stories
        state = SpecimenState.from_values(self._values[lane], stories)
        if state is None:
            return None
        return state.initial(self.scenario.nonlinearity.yielding, stories)

    def _stacks(self) -> dict[str, FloatArray]:
        """Return the matrices and numbers of the plants (N, ...) by the names that a state has."""
        stacks = {
            f"plant_{group}_{part}": stack
            for group in ("dynamics", "cost", "reference")
            for part, stack in getattr(self, f"_{group}").items()
        }
        stacks |= {"plant_noise": self._noise, "plant_record": self._record}
        return stacks if self._floors is None else stacks | {"plant_floors": self._floors}

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Return everything that `set_state` needs, arrays with a row a table.

        ``plant_values`` are dictionaries of what was drawn, by name.
        """
        values = np.empty(len(self._values), dtype=object)
        values[:] = [dict(each) for each in self._values]
        return {name: stack.copy() for name, stack in self._stacks().items()} | {"plant_values": values}

    def set_state(self, state: Mapping[str, NDArray[Any]], lanes: Sequence[int]) -> None:
        """Give the tables `lanes` the plants of a state of as many."""
        for name, stack in self._stacks().items():
            stack[lanes] = state[name]
        for lane, values in zip(lanes, state["plant_values"], strict=True):
            self._values[lane] = dict(values)


def _repeat(matrix: FloatArray, lanes: int) -> FloatArray:
    return np.repeat(np.asarray(matrix, dtype=float)[None], lanes, axis=0)
