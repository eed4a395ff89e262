"""What N tables would have measured under a log's command: the project's own simulation, a lane each.

One lane per set of parameters: a batch of perturbed tables gives all sensitivities in one pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from shake_env.dynamics.low_pass import first_low_pass
from shake_env.dynamics.nonlinear import (
    NonlinearDynamics,
    arrival,
    commands_under_way,
    floor_rows,
)
from shake_env.errors import LogError
from shake_env.model.parameters import FloatArray, stacked
from shake_env.model.plant import CoupledPlant
from shake_env.scenario.observation import STATE_SIGNALS
from shake_env.scenario.scenario import Scenario

PERIODS = 256  # simulated in one call: bounds what N tables' states take of memory


@dataclass(frozen=True)
class Predicted:
    """What N tables did under one command."""

    readings: FloatArray  # (N, samples, channels) without noise
    slip: FloatArray  # (N, stories) of yielding storeys at the end [m]; (N, 0) where none yield
    energy: FloatArray  # (N,) dissipated in the first storey [J]; zeros where none yield


def predict_response(
    scenarios: Sequence[Scenario],
    current: FloatArray,
    channels: Sequence[str],
    slip: FloatArray | None = None,
) -> Predicted:
    """Return what N tables do under one command, from rest.

    Parameters
    ----------
    scenarios
        N tables that differ in values of their parameters only, with storeys of equal number.
    current
        (samples,) [A] command of each control period.
    channels
        Names of measured channels.
    slip
        (N, stories) of the storeys at the start [m], which earlier shakes left; None: zeros.

    Raises
    ------
    LogError
        If a channel is none that the plant has.
    """
    first = scenarios[0]
    dynamics, plant, scale = _tables(scenarios)
    lanes = len(scenarios)
    wants_floors = any(name.startswith("floor_acceleration_") for name in channels)
    rows = floor_rows(plant, first.nonlinearity.yielding) if wants_floors else None
    filtered = first_low_pass(plant, first.parts)
    behind = {each.signal: filtered + i for i, each in enumerate(first.observation.low_passes)}
    columns = [behind.get(name, _column(name)) for name in channels]
    state = np.zeros((lanes, dynamics.states))
    n, yielding = first.specimen.stories, first.nonlinearity.yielding
    slips = slice(4 + 2 * n, 4 + 3 * n) if yielding.active else slice(0, 0)
    if slip is not None and yielding.active:
        state[:, slips] = slip * scale[:, slips]
        floors = np.cumsum((1.0 - yielding.stiffness_ratio) * slip, axis=1)
        state[:, 4 : 4 + n] = floors * scale[:, 4 : 4 + n]
    energy, force, drift = np.zeros(lanes), np.zeros(lanes), state[:, 4] / scale[:, 4]
    readings = np.empty((lanes, len(current), len(channels)))
    with np.errstate(over="ignore", invalid="ignore"):  # a table that diverges fits nothing
        for begin in range(0, len(current), PERIODS):
            periods = slice(begin, begin + PERIODS)
            commands = np.repeat(current[periods, None], lanes, axis=1)
            response = dynamics.control_periods(state, commands)
            states, shear = response.state, response.base_shear[..., -1]
            state = states[-1]
            if yielding.active:
                forces = np.concatenate([force[None], shear])
                drifts = np.concatenate([drift[None], states[..., 4] / scale[:, 4]])
                energy += np.sum(0.5 * (forces[1:] + forces[:-1]) * np.diff(drifts, axis=0), axis=0)
                force, drift = forces[-1], drifts[-1]
            for c, place in enumerate(columns):
                if place >= 0:
                    column = states[..., place]
                elif place == _ACCELERATION:
                    column = response.table_acceleration[..., -1]
                elif place == _SHEAR:
                    column = shear
                else:
                    assert rows is not None  # a floor is asked for
                    width = rows.shape[-1]
                    storeys = states[..., 4 : 4 + width] / scale[:, 4 : 4 + width]
                    column = np.sum(rows[:, _FLOORS - place] * storeys, axis=-1)
                readings[:, periods, c] = column.T
        for c, place in enumerate(columns):
            if place >= 0:
                readings[:, :, c] /= scale[:, place, None]
        return Predicted(readings, state[:, slips] / scale[:, slips], energy)


_ACCELERATION, _SHEAR, _FLOORS = -1, -2, -3


def _column(name: str) -> int:
    """Return the place of a channel in the state, or a code: acceleration, shear, or a floor."""
    if name in STATE_SIGNALS:
        return STATE_SIGNALS[name]
    if name == "table_acceleration":
        return _ACCELERATION
    if name == "base_shear":
        return _SHEAR
    if name.startswith("floor_acceleration_"):
        return _FLOORS - (int(name.rsplit("_", 1)[1]) - 1)
    raise LogError("channel", name, "is not measured on a table")


def _tables(scenarios: Sequence[Scenario]) -> tuple[NonlinearDynamics, CoupledPlant, FloatArray]:
    """Return the update of N tables, their plants stacked, and the scale (N, states) of each state.

    Nonlinear parts are common to a batch, but for friction and supply pressure. The yield drift is
    another value of each lane: states measured in units of it have the same nonlinear part in every
    lane. The matrices of each lane are put into such units; states are divided by `scale` to be SI.
    """
    first = scenarios[0]
    plant = CoupledPlant(
        stacked([each.actuator for each in scenarios]),
        stacked([each.specimen for each in scenarios]),
        first.ground,
        first.equations,
    )
    k, parts = first.substeps, first.parts
    longest = max(each.longest_delay for each in scenarios)
    dynamics = NonlinearDynamics.from_plant(
        plant, parts, first.physics_step, k,
        longest_delay=longest, low_passes=first.observation.low_passes,
    )  # fmt: skip
    missing = np.array([each.nonlinearity.valve.missing for each in scenarios])
    commands = commands_under_way(longest, k)
    dynamics = replace(
        dynamics,
        valve=np.concatenate([dynamics.valve[:, :2], missing[:, None]], axis=1),
        coulomb=np.array([each.nonlinearity.friction.coulomb for each in scenarios]),
        arrival=np.stack([arrival(each.delay, k, commands) for each in scenarios]),
    )
    m, n = dynamics.advance.shape[-2], first.specimen.stories
    inputs = dynamics.slope.shape[-1]
    scale, scale_g = np.ones((len(scenarios), m + commands)), np.ones((len(scenarios), inputs))
    if parts.yielding.active:
        drift = np.array([each.nonlinearity.yielding.yield_drift for each in scenarios])
        scale[:, 4 : 4 + 3 * n] = (parts.yielding.yield_drift / drift)[:, None]
        scale_g[:, 3 : 3 + n] = scale[:, 4, None]
    own, ones = scale[:, :m], np.ones((len(scenarios), 1))
    columns = np.concatenate([own, ones, scale_g], axis=1)
    dynamics = replace(
        dynamics,
        advance=own[:, :, None] * dynamics.advance / columns[:, None],
        slope=own[:, :, None] * dynamics.slope / scale_g[:, None],
        C=dynamics.C / own[:, None],
        D=dynamics.D / scale_g[:, None],
    )
    return dynamics, plant, scale
