"""A drive file: how it is played, with a displacement feedback underneath; and the model of a period.

Laboratories write the whole current of a test ahead and play it back. A weak feedback of displacement
keeps the table in its place underneath; what it asks for is in the drive's own response, and a method
that corrects the drive corrects that, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.controller import Controller, decide
from shake_env.errors import ParameterError, ScenarioError
from shake_env.model.nonlinearity import Nonlinearity
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import TABLE_DISPLACEMENT
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uncertainty
from shake_env.simulation.transition import dynamics_of

HOLD_FREQUENCY = 0.2  # [Hz] of the displacement feedback underneath a drive


class DisplacementHold:
    """Weak feedback of the table's displacement, ``u = -gain x_a``, against drift.

    Parameters
    ----------
    scenario
        Whose observation it reads: the full state, or a reading of the displacement.
    frequency
        [Hz] of the first-order loop that it closes around valve and piston.

    Raises
    ------
    ParameterError
        If the frequency is not a number above 0 Hz.
    ScenarioError
        If the scenario shows no displacement.
    """

    def __init__(self, scenario: Scenario, frequency: float = HOLD_FREQUENCY) -> None:
        if not 0.0 < frequency < math.inf:
            raise ParameterError("frequency", frequency, "must be above 0 Hz, finite")
        shown, plant = scenario.observation, scenario.plant
        self.gain = 2.0 * math.pi * frequency / scenario.actuator.velocity_gain  # [A/m]
        if scenario.sensing.full_state:
            self._entry = plant.layout.table_displacement
            scale = float(plant.state_scale[self._entry])
        elif "table_displacement" in shown.reading_names:
            place = shown.reading_names.index("table_displacement")
            self._entry = shown.readings.start + place
            scale = float(shown.reading_scale[place])
        else:
            raise ScenarioError("sensing", shown.reading_names, "must show the table's displacement")
        self._weight = -self.gain * scale / scenario.current_limit

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the action (..., 1) for an observation (..., n), within [-1, 1]."""
        action = np.clip(self._weight * observation[..., self._entry], -1.0, 1.0)
        return action[..., None].astype(np.float32), None


class DriveFile:
    """A prepared current, played back; zero once it has ended.

    Memory is the index of the coming step, and the feedback's own.

    Parameters
    ----------
    drive
        (steps,) fraction of the current limit, for any number of tables; or (N, steps), one a lane.
    feedback
        A controller whose action is added; None: none.
    damage
        (N,) energy that the tests in which the drive was found took from the specimens, over that of
        one perfect test; None: it was found without tests.

    Raises
    ------
    ParameterError
        If the drive is not finite or has another number of axes; in `predict`, if it is for another
        number of lanes.
    """

    def __init__(
        self,
        drive: FloatArray,
        feedback: Controller | None = None,
        damage: FloatArray | None = None,
    ) -> None:
        if drive.ndim not in (1, 2) or not np.isfinite(drive).all():
            raise ParameterError("drive shape", drive.shape, "must be (steps,) or (N, steps), finite")
        self.drive, self.feedback, self.damage = drive, feedback, damage
        self._padded = np.concatenate([drive, np.zeros((*drive.shape[:-1], 1))], axis=-1)

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the action (..., 1) for an observation (..., n), within [-1, 1]."""
        lanes = observation.shape[:-1]
        if self.drive.ndim == 2 and lanes != self.drive.shape[:1]:
            raise ParameterError(
                "observation shape", observation.shape, f"needs {len(self.drive)} lanes"
            )
        index, below = (np.zeros(lanes, dtype=int), None) if state is None else state
        if episode_start is not None:
            index = np.where(np.reshape(episode_start, lanes), 0, index)
        at = np.minimum(index, self.drive.shape[-1])
        if self.drive.ndim == 1:
            action = self._padded[at]
        else:
            action = np.take_along_axis(self._padded, at[:, None], axis=-1)[:, 0]
        if self.feedback is not None:
            added, below = decide(self.feedback, observation, below, episode_start, deterministic)
            action = action + added[..., 0]
        return np.clip(action, -1.0, 1.0)[..., None].astype(np.float32), (index + 1, below)


@dataclass(frozen=True)
class PeriodModel:
    """One control period of the nominal linear table, its loop delay and a displacement hold within.

    ``x[i+1] = F x[i] + G u[i]``; ``[y_A, f_s]`` after each physics step are ``Z_x x[i] + Z_u u[i]``.
    """

    F: FloatArray  # (m, m) SI
    G: FloatArray  # (m,) per A
    Z_x: FloatArray  # (2, k, m) [m/s^2, N]
    Z_u: FloatArray  # (2, k)

    @classmethod
    def from_scenario(cls, scenario: Scenario, hold: float = 0.0) -> PeriodModel:
        """Run the nominal linear update on a basis; `hold` [A/m] is the displacement feedback's gain."""
        nominal = replace(scenario, nonlinearity=Nonlinearity(), uncertainty=Uncertainty())
        dynamics = dynamics_of(nominal)
        m = dynamics.states
        current = np.zeros(m + 1)
        current[m], current[TABLE_DISPLACEMENT] = 1.0, -hold
        response = dynamics.control_step(np.eye(m + 1, m), current)
        outputs = np.stack([response.table_acceleration, response.base_shear])  # (2, m + 1, k)
        return cls(
            F=response.state[:m].T,
            G=response.state[m],
            Z_x=np.swapaxes(outputs[:, :m], 1, 2),
            Z_u=outputs[:, m],
        )

    def frequency_response(self, omega: FloatArray, period: float) -> NDArray[np.complex128]:
        """Return current to the period's mean table acceleration [m/s^2 per A]; `omega` in rad/s."""
        z = np.exp(1j * omega * period)[:, None, None]
        # States span ten decades; balancing by G's own size keeps the solve's digits.
        size = np.maximum(np.abs(self.G), 1e-12 * np.max(np.abs(self.G)))
        F, G = self.F * size / size[:, None], self.G / size
        inside = np.linalg.solve(
            z * np.eye(len(F)) - F, np.broadcast_to(G[:, None], (len(z), len(G), 1))
        )
        row, direct = np.mean(self.Z_x[0], axis=0) * size, np.mean(self.Z_u[0])
        response: NDArray[np.complex128] = inside[..., 0] @ row + direct
        return response
