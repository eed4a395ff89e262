"""Observer of actuator and table alone: the base shear is an input, estimated elsewhere.

A stationary Kalman filter of ``x_A`` alone. The command that acts is known, loop delay included; what
the specimen does to the table is given, with an error that the filter is told the size of.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_discrete_are

from shake_env.errors import NumericalError, ScenarioError
from shake_env.model.discretization import first_order_hold, zero_order_hold
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import StateSpace, actuator_plant
from shake_env.scenario.observation import STATE_SIGNALS
from shake_env.scenario.scenario import Scenario

SIGNALS = (*STATE_SIGNALS, "table_acceleration")  # what it reads, in this order


@dataclass(frozen=True)
class TableObserver:
    """One control period of the table, and the weight of each reading."""

    A: FloatArray  # (4, 4)
    on_last: FloatArray  # (4,) per A of the command before this reading
    on_previous: FloatArray  # (4,) and of the one before that, which the delay lets act longer
    now: FloatArray  # (4,) per N of base shear at the period's start
    following: FloatArray  # (4,) and at its end; straight between
    C: FloatArray  # (5, 4) readings
    mass: float  # of the table [kg]
    gain: FloatArray  # (4, 5)

    @classmethod
    def from_scenario(cls, scenario: Scenario, shear_error: float) -> TableObserver:
        """Solve for the stationary gain.

        Parameters
        ----------
        scenario
            Nominal actuator, control period, sensors, and a delay of at most a control period.
        shear_error
            [N] rms error of the base shear that it will be given.

        Raises
        ------
        NumericalError
            If the Riccati equation has no solution.
        """
        actuator, layout = scenario.actuator, scenario.plant.layout
        scale, period = scenario.plant.state_scale[layout.actuator], scenario.control_period
        model = actuator_plant(actuator, scenario.equations)
        force = StateSpace(model.A, model.B[:, 1:], model.C, model.D[:, 1:])
        valve = StateSpace(model.A, model.B[:, :1], model.C, model.D[:, :1])
        held, following = first_order_hold(force, period, scale)
        d = scenario.delay * scenario.physics_step
        last = np.zeros(4)
        if d < period:
            rest = zero_order_hold(valve, period - d, scale)
            last, after = rest.B[:, 0], rest.A
        else:
            after = np.eye(4)
        previous = after @ zero_order_hold(valve, d, scale).B[:, 0] if d > 0.0 else np.zeros(4)
        C = np.vstack([np.eye(4)[list(STATE_SIGNALS.values())], model.C])
        names = list(scenario.observation.reading_names)
        places = [names.index(signal) for signal in SIGNALS]
        sizes = scenario.observation.reading_scale[places]
        # A noiseless sensor still has float32's steps, and the equation wants a little noise.
        noise = np.maximum(scenario.observation.sensor_values("noise")[places], 1e-4 * sizes)
        push = (held.B + following)[:, 0] * shear_error
        noise[-1] = np.hypot(noise[-1], shear_error / actuator.table_mass)
        gain = _gain(
            held.A * scale / scale[:, None],
            push / scale,
            C * scale / sizes[:, None],
            noise / sizes,
        )
        return cls(
            held.A, last, previous, held.B[:, 0], following[:, 0], C, actuator.table_mass,
            gain * scale[:, None] / sizes,
        )  # fmt: skip

    def update(
        self, table: FloatArray, commands: FloatArray, shear: FloatArray, readings: FloatArray
    ) -> FloatArray:
        """Return the estimate of x_A (N, 4) after a period.

        Parameters
        ----------
        table
            (N, 4) estimate before.
        commands
            (N, 2) last command, and the one before [A].
        shear
            (N, 2) base shear at the period's start and end [N].
        readings
            (N, 5) of `SIGNALS`, SI.
        """
        predicted = (
            table @ self.A.T
            + commands[:, :1] * self.on_last
            + commands[:, 1:] * self.on_previous
            + shear[:, :1] * self.now
            + shear[:, 1:] * self.following
        )
        innovation = readings - predicted @ self.C.T
        innovation[:, -1] -= shear[:, 1] / self.mass
        estimate: FloatArray = predicted + innovation @ self.gain.T
        return estimate


def _gain(A: FloatArray, push: FloatArray, C: FloatArray, noise: FloatArray) -> FloatArray:
    # Beside the shear's error a little of everything, so that no state is taken for known for ever.
    Q = np.outer(push, push) + 1e-8 * np.eye(len(A))
    R = np.diag(noise**2)
    try:
        P = solve_discrete_are(A.T, C.T, Q, R)
    except np.linalg.LinAlgError as problem:
        raise NumericalError("Riccati equation", str(problem), "the table cannot be observed") from None
    gain: FloatArray = np.linalg.solve(C @ P @ C.T + R, C @ P).T
    return gain


def check_signals(measured: Sequence[str]) -> None:
    """Raise ScenarioError unless all of `SIGNALS` are measured."""
    missing = [name for name in SIGNALS if name not in measured]
    if missing:
        raise ScenarioError("sensing", tuple(measured), f"must measure {', '.join(missing)}")
