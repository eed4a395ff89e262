"""A plant for each table of a batch, where the scenario does not know its own for sure."""

from __future__ import annotations

import copy
from dataclasses import fields, replace
from typing import Any

import numpy as np

from shake_env import nonlinear_dynamics, reference
from shake_env.errors import ScenarioError
from shake_env.excitation import GroundMaps
from shake_env.nonlinear_dynamics import NonlinearDynamics
from shake_env.objective import StageCost
from shake_env.parameters import FloatArray
from shake_env.scenario import Scenario
from shake_env.transition import TableModel, dynamics_of, floors_of

DIRECTIONS = 6  # noise draws a physics step in every lane, see _with_directions


class Fleet:
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
        nominal = TableModel.of(scenario)
        if not isinstance(nominal.dynamics, NonlinearDynamics):
            raise ScenarioError("uncertainty", scenario.uncertainty, "is not active: nothing to draw")
        self.scenario = scenario
        self.plants: list[Scenario] = [scenario] * lanes  # the true scenario of each lane
        self._dynamics: dict[str, Any] = {
            name: _repeat(getattr(nominal.dynamics, name), lanes) for name in nonlinear_dynamics.ARRAYS
        }
        self._cost: dict[str, Any] = {
            field.name: np.full(lanes, getattr(nominal.stage_cost, field.name))
            for field in fields(StageCost)
        }
        maps = GroundMaps.of(scenario.discrete, scenario.nonlinearity.yielding)
        self._noise = _repeat(_with_directions(maps.noise, scenario), lanes)
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
        stacked = maps.yielding and replace(maps.yielding, **self._reference)
        self.maps = GroundMaps(self._noise, self._record, stacked)

    def draw(self, lane: int, stream: np.random.Generator) -> None:
        """Give a lane a new plant, drawn from `stream`."""
        true = self.scenario.drawn(stream)
        self.plants[lane] = true
        dynamics = dynamics_of(true)
        for name, stack in self._dynamics.items():
            stack[lane] = getattr(dynamics, name)
        for name, column in self._cost.items():
            column[lane] = getattr(true.stage_cost, name)
        if self._floors is not None:
            self._floors[lane] = floors_of(true)
        maps = GroundMaps.of(true.discrete, true.nonlinearity.yielding)
        self._noise[lane] = _with_directions(maps.noise, true)
        self._record[lane] = maps.record
        for name, stack in self._reference.items():
            stack[lane] = getattr(maps.yielding, name)

    def snapshot(self) -> dict[str, Any]:
        """Return everything that `restore` needs."""
        stacks = (
            self._dynamics, self._cost, self._reference, self._noise, self._record, self._floors,
            self.plants,
        )  # fmt: skip
        return {"stacks": copy.deepcopy(stacks)}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Take the plants of a `snapshot`."""
        dynamics, cost, yielding, noise, record, floors, plants = snapshot["stacks"]
        for ours, theirs in (
            (self._dynamics, dynamics),
            (self._cost, cost),
            (self._reference, yielding),
        ):
            for name, stack in ours.items():
                stack[...] = theirs[name]
        self._noise[...], self._record[...] = noise, record
        if self._floors is not None:
            self._floors[...] = floors
        self.plants[:] = plants


def _repeat(matrix: FloatArray, lanes: int) -> FloatArray:
    return np.repeat(np.asarray(matrix, dtype=float)[None], lanes, axis=0)


def _with_directions(noise_map: FloatArray, scenario: Scenario) -> FloatArray:
    """Return a noise map with `DIRECTIONS` draws a physics step, the strongest last.

    Of the directions of one short step's noise only three to five lie above rounding, how many differs
    from plant to plant. Missing ones get no weight; one too many is the weakest, itself rounding.
    """
    layout, k = scenario.plant.layout, scenario.substeps
    exogenous = layout.filter_states + 2 * layout.stories
    draws = noise_map[:, exogenous:].reshape(len(noise_map), k, -1)
    fitted = np.zeros((len(noise_map), k, DIRECTIONS))
    kept = min(DIRECTIONS, draws.shape[-1])
    fitted[:, :, DIRECTIONS - kept :] = draws[:, :, draws.shape[-1] - kept :]
    return np.concatenate([noise_map[:, :exogenous], fitted.reshape(len(noise_map), -1)], axis=1)
