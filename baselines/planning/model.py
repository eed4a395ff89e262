"""The model of one table as planning and estimation step it: matrices, scales, limits, disturbances."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from baselines.estimation.estimator_model import ModelError
from shake_env.dynamics.nonlinear import (
    FLOW,
    FORCE,
    NonlinearDynamics,
    controlled_plant,
    controlled_scale,
    floor_rows,
)
from shake_env.errors import ShakeError, install_hint
from shake_env.model.discretization import first_order_hold
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import (
    LOAD_PRESSURE,
    REFERENCE_CURRENT,
    SPOOL_POSITION,
    TABLE_DISPLACEMENT,
    TABLE_VELOCITY,
    StateSpace,
)
from shake_env.numba_support import compiled_module
from shake_env.scenario.scenario import Scenario

STEP_LENGTHS = (1.0, 0.6, 0.3, 0.1, 0.03, 0.01, 0.003)  # of an iteration, tried in this order


def compiled(name: str) -> Any:
    """Return a compiled module of this room.

    Raises
    ------
    ShakeError
        If numba is missing or switched off: uncompiled, a plan takes minutes.
    """
    module = compiled_module(f"baselines.planning.{name}")
    if module is None:
        raise ShakeError("numba", "missing", f"planning needs it; {install_hint('fast')}")
    return module


@dataclass(frozen=True)
class Plan:
    """Currents of N tables over H control periods, and what comes of them."""

    current: FloatArray  # (N, H) [A]
    state: FloatArray  # (N, H + 1, n) SI
    response: FloatArray  # (N, H, 2 k) y_A [m/s^2] after each physics step, then f_s [N]
    gain: FloatArray  # (N, H, n) feedback on the scaled state [A]
    cost: FloatArray  # (N,) sum of the stage costs, and the tail's
    largest_ratio: FloatArray  # (N,) of a limited quantity over its hard limit
    iterations: Any  # (N,)


@dataclass(frozen=True)
class PlanningModel:
    """One table: ``[x_A, x_S]``, slips, low-passes, the spool's velocity, disturbances, then commands.

    With disturbances, a force on the table and a flow through the valve that the model leaves out
    follow the state, each a first-order Gauss-Markov process (`ModelError`).
    """

    scenario: Scenario  # its own plant, without what is drawn
    arrays: tuple[Any, ...]  # see period_kernel.ModelArrays
    scale: FloatArray  # (n,) SI size of each state
    order: int  # m, states before the commands under way
    disturbances: int  # 0 or 2, the last of the m
    rows: FloatArray  # (R, n) limited quantities over their limits, on the scaled state
    group: Any  # (R,) a limit of the largest of several rows has one number
    bounds: FloatArray  # (4,) see ilqr_kernel

    @classmethod
    def of(cls, scenario: Scenario, error: ModelError | None = None) -> PlanningModel:
        """Return the model of a scenario's nominal plant.

        Raises
        ------
        ScenarioError
            If the equations are not the corrected ones.
        """
        parts, plant = scenario.parts, scenario.plant
        dynamics = NonlinearDynamics.of(
            plant,
            parts,
            scenario.physics_step,
            scenario.substeps,
            delay=scenario.delay,
            low_passes=scenario.observation.low_passes,
        )
        scale = controlled_scale(plant, parts, scenario.observation.low_passes)
        advance, slope, C, D = dynamics.advance, dynamics.slope, dynamics.C, dynamics.D
        order = len(advance)
        if error is not None:
            continuous, scale = disturbed(scenario, error)
            model, change = first_order_hold(continuous, scenario.physics_step, scale)
            level = model.B + change
            advance, slope = np.hstack([model.A, level]), change[:, 1:]
            C, D = continuous.C, continuous.D[:, 1:]
        kernel = compiled("period_kernel")
        switches = kernel.switches(parts, scenario.specimen.stories, order)
        active = _active_columns(switches, scenario.specimen.stories)
        m = len(advance)
        arrays = (
            advance[:, np.r_[: m + 1, m + 1 + active]],
            slope[:, active],
            C,
            D[:, active],
            dynamics.valve.reshape(3, 1),
            np.reshape(dynamics.coulomb, 1),
            dynamics.arrival,
        )
        commands = dynamics.arrival.shape[-1] - 1
        whole = np.concatenate([scale, np.full(commands, REFERENCE_CURRENT)])
        rows, group = _limit_rows(scenario, whole)
        return cls(
            scenario=scenario,
            arrays=(
                *(np.ascontiguousarray(array[None], dtype=float) for array in arrays),
                kernel.scalars(parts),
                switches,
            ),
            scale=whole,
            order=m,
            disturbances=m - order,
            rows=rows,
            group=group,
            bounds=_bounds(scenario),
        )

    def made_smoother(self, factor: float) -> PlanningModel:
        """Return the model with dry friction smoothed over `factor` times its velocity.

        A dead band is that much narrower: inside it the current has no slope.
        """
        parts = self.scenario.nonlinearity
        friction, valve = parts.friction, parts.valve
        friction = replace(friction, smoothing_velocity=factor * friction.smoothing_velocity)
        valve = replace(valve, dead_band=valve.dead_band / factor)
        scenario = replace(self.scenario, nonlinearity=replace(parts, friction=friction, valve=valve))
        scalars = compiled("period_kernel").scalars(scenario.parts)
        *matrices, _, switches = self.arrays
        return replace(self, scenario=scenario, arrays=(*matrices, scalars, switches))

    @property
    def states(self) -> int:
        """Length n of the state, the commands under way included."""
        return len(self.scale)

    @property
    def substeps(self) -> int:
        """Physics steps k of a control period."""
        return self.scenario.substeps

    def improve(
        self,
        current: FloatArray,
        start: FloatArray,
        target: FloatArray,
        shear: FloatArray,
        *,
        place: FloatArray | None = None,
        place_weight: float = 0.0,
        weights: FloatArray | None = None,
        tail: tuple[FloatArray, FloatArray] | None = None,
        models: tuple[Any, ...] | None = None,
        step_lengths: Sequence[float] = STEP_LENGTHS,
        iterations: int,
        tolerance: float = 0.0,
    ) -> Plan:
        """Improve plans of N tables; see `ilqr_kernel.improve`.

        Parameters
        ----------
        current
            (N, H) [A] to start from.
        start
            (N, n) state [SI].
        target, shear
            (N, H, k) y~ [m/s^2] and f~_s [N] after each physics step.
        place, place_weight
            (N, H) where the table should be at each period's end [m], and what a squared metre costs.
        weights
            (N, 3) weights of acceleration, force and current in SI; None: the scenario's stage cost.
        tail
            (1 or N, n, n) and (N, n): ``z'P z / 2 + p'z`` of the scaled state at the end; None: nothing.
        models
            Matrices of the N tables; None: this model's.
        step_lengths, iterations, tolerance
            Of the search: lengths tried in order, most iterations, and the share of the cost that an
            iteration has to save.
        """
        N, H = current.shape
        n, k, cost = self.states, self.substeps, self.scenario.stage_cost
        if weights is None:
            weights = np.array([[cost.acceleration, cost.force, cost.current]])
        weights = np.hstack([weights, np.full((len(weights), 1), place_weight)])
        P, p = (np.zeros((1, n, n)), np.zeros((N, n))) if tail is None else tail
        place = np.zeros((N, H)) if place is None else place
        signals = tuple(np.ascontiguousarray(a, dtype=float) for a in (target, shear, place, p))
        common = (weights, self.rows, self.group, self.bounds, np.ascontiguousarray(P))
        U = np.array(current, dtype=float)
        X, Y, gain = np.zeros((N, H + 1, n)), np.zeros((N, H, 2 * k)), np.zeros((N, H, n))
        X[:, 0] = start
        found = np.zeros((N, 3))
        compiled("ilqr_kernel").least_costs(
            U, X, Y, gain, signals, common, self.arrays if models is None else models, self.scale,
            np.array(step_lengths, dtype=float), iterations, tolerance, found,
        )  # fmt: skip
        return Plan(U, X, Y, gain, found[:, 0], found[:, 1], found[:, 2].astype(int))


def disturbed(scenario: Scenario, error: ModelError) -> tuple[StateSpace, FloatArray]:
    """Return the continuous plant with a force and a flow as its last states, and the states' scale.

    Both are in units of what the state's scale says, as in `baselines.estimation.estimator_model`.
    """
    plant, parts = scenario.plant, scenario.parts
    low_passes = scenario.observation.low_passes
    base = controlled_plant(plant, parts, low_passes)
    scale = controlled_scale(plant, parts, low_passes)
    n = base.order
    sizes = np.array([scale[LOAD_PRESSURE] * plant.actuator.piston_area, scale[SPOOL_POSITION]])
    enters = [1 + FORCE, 1 + FLOW]
    A, B = np.zeros((n + 2, n + 2)), np.zeros((n + 2, base.B.shape[1]))
    A[:n, :n], A[:n, n:], B[:n] = base.A, base.B[:, enters], base.B
    A[n, n], A[n + 1, n + 1] = -1.0 / error.force_time, -1.0 / error.flow_time
    C = np.hstack([base.C, base.D[:, enters]])
    return StateSpace(A, B, C, base.D), np.concatenate([scale, sizes])


def _active_columns(switches: Any, stories: int) -> Any:
    """Return the columns of g whose parts are on, in order."""
    places = [c for c in range(3) if switches[c] >= 0]
    if switches[3] >= 0:
        places += range(3, 3 + stories)
    return np.array(places, dtype=int)


def _limit_rows(scenario: Scenario, scale: FloatArray) -> tuple[FloatArray, Any]:
    limits, rows, group = scenario.limits, [], []
    for place, limit in (
        (TABLE_DISPLACEMENT, limits.table_displacement),
        (TABLE_VELOCITY, limits.table_velocity),
        (LOAD_PRESSURE, limits.load_pressure),
    ):
        if limit is not None:
            row = np.zeros(len(scale))
            row[place] = scale[place] / limit
            rows.append(row)
            group.append(place)
    if limits.specimen_acceleration is not None:
        floors = floor_rows(scenario.plant, scenario.nonlinearity.yielding)
        for floor in floors:
            row = np.zeros(len(scale))
            row[4 : 4 + len(floor)] = floor * scale[4 : 4 + len(floor)] / limits.specimen_acceleration
            rows.append(row)
            group.append(len(scale))
    return np.reshape(rows, (-1, len(scale))).astype(float), np.array(group, dtype=np.int64)


def _bounds(scenario: Scenario) -> FloatArray:
    limits = scenario.limits
    acceleration = math.inf if limits.table_acceleration is None else limits.table_acceleration
    current = scenario.current_limit
    if limits.current is not None:
        current = min(current, limits.current)
    return np.array([acceleration, limits.soft_share, limits.soft_weight, current])
