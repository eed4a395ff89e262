"""Minimal control synthesis: adaptive gains around a fixed loop, with and without bounds.

Stoten and Gomez (Phil. Trans. R. Soc. A 359, 2001) put an adaptive outer loop around the controller that
a shaking table has: ``u = u_inner + K x + K_r r``, with gains that start at zero and follow ``K = alpha
integral y_e x' dt + beta y_e x'``, y_e the weighted error from a reference model. Plain MCS has no bound
on what noise and unmodelled dynamics make of the integral. The bounded variant adds an integral of the
error to the regressor (MCSI; Hodgson and Stoten, Int. J. Control 65, 1996), a leakage to zero and a
projection onto a box (Ioannou and Sun, Robust Adaptive Control, 1996, secs. 8.4 and 8.5).

The reference model is of second order on displacement, ``x_m'' + 2 zeta_m omega_m x_m' + omega_m^2 x_m =
omega_m^2 r``. With target displacement, velocity and acceleration all known, the demand r is chosen so
that x_m is the target itself: the model adds no lag. The inner loop is three-variable control.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from baselines.servo.signals import (
    DISPLACEMENT,
    TARGET_ACCELERATION,
    TARGET_DISPLACEMENT,
    TARGET_VELOCITY,
    VELOCITY,
    Memory,
    SignalReader,
    as_action,
    recall,
)
from baselines.servo.tvc import TVCDesign, tvc_law
from shake_env.errors import ParameterError
from shake_env.model.parameters import FloatArray, is_number, require_non_negative, require_positive
from shake_env.scenario.scenario import Scenario

GAINS = 4  # of [displacement, velocity, demand, integral of the error]
NEEDS = ("table_displacement", "table_velocity", "table_acceleration")


@dataclass(frozen=True, kw_only=True)
class MCSDesign:
    """Reference model, adaptation and bounds.

    In units that make `alpha` and `beta` plain numbers: errors and regressors in parts of `displacement`
    (velocities over omega_m, integrals times it), gains in parts of ``omega_m / (2 zeta_m k_v)``, the
    displacement loop that has the model's slow pole.

    Raises
    ------
    ParameterError
        If a value is outside its range.
    """

    bandwidth: float = 4.0  # omega_m / (2 pi) [Hz]
    damping_ratio: float = 1.0  # zeta_m [-]
    alpha: float = 1.0  # [1/s] of the integral adaptation
    beta: float = 0.1  # [-] of the proportional one; a tenth of alpha, as is customary
    displacement: float = 0.02  # [m] unit of displacements
    leakage: float = 0.0  # sigma [1/s] of the integral gains to zero; 0: none
    bound: float = math.inf  # [-] of each integral gain; infinite: no projection
    error_integral: bool = False  # whether the regressor holds the integral of the error (MCSI)
    normalised: bool = False  # whether adaptation is divided by 1 + the regressor's square
    inner: TVCDesign = field(default_factory=TVCDesign)

    def __post_init__(self) -> None:
        require_positive(self, "bandwidth", "damping_ratio", "displacement")
        require_non_negative(self, "alpha", "beta", "leakage")
        if not (is_number(self.bound) and self.bound > 0.0):
            raise ParameterError("bound", self.bound, "must be above 0 (inf: no projection)")

    @classmethod
    def bounded(cls) -> MCSDesign:
        """Return MCSI with leakage over 5 s and gains within a quarter of the unit loop's.

        Normalised, so that a motion larger than the design's unit does not adapt with its square.
        """
        return cls(leakage=0.2, bound=0.25, error_integral=True, normalised=True)


class MCS:
    """Minimal control synthesis as a `Controller`; its memory is the gains.

    Parameters
    ----------
    scenario
        Whose observation it reads and whose nominal table the inner loop is designed on.
    design
        Its adaptation; None: plain MCS.
    """

    def __init__(self, scenario: Scenario, design: MCSDesign | None = None) -> None:
        self.design = values = design or MCSDesign()
        self.inner_row = tvc_law(scenario, values.inner).D  # (8,) [A per SI unit of a signal]
        self.reader = SignalReader(scenario, NEEDS)
        self.limit, self.period = scenario.current_limit, scenario.control_period  # [A], [s]
        self.omega = 2.0 * math.pi * values.bandwidth  # [rad/s]
        self.gain_unit = self.omega / (
            2.0 * values.damping_ratio * scenario.actuator.velocity_gain
        )  # [A/m]

    def gains(self, state: Memory) -> FloatArray:
        """Return the integral gains (..., 4) out of the memory, in the design's unit."""
        first = self.reader.memory_size
        adapted: FloatArray = state[0][..., first : first + GAINS]
        return adapted

    def predict(
        self,
        observation: NDArray[np.float32],
        state: Memory | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return the action (..., 1) for an observation (..., n), and the memory."""
        d, own = self.design, self.reader.memory_size
        memory = recall(state, episode_start, observation.shape[:-1], own + GAINS + 1)
        signals, read = self.reader.read(observation, memory[..., :own])
        change, integral = memory[..., own : own + GAINS], memory[..., -1]
        x, v = signals[..., DISPLACEMENT], signals[..., VELOCITY]
        target = signals[..., TARGET_DISPLACEMENT]
        target_velocity = signals[..., TARGET_VELOCITY]
        omega, zeta = self.omega, d.damping_ratio
        acceleration = signals[..., TARGET_ACCELERATION]
        demand = target + 2.0 * zeta / omega * target_velocity + acceleration / omega**2
        error, rate = target - x, target_velocity - v
        # The last row of the model's Lyapunov solution with Q = 2 I in units of omega_m.
        weighted = (error + rate / (omega * zeta)) / d.displacement
        last = omega * integral if d.error_integral else np.zeros_like(x)
        regressor = np.stack([x, v / omega, demand, last], axis=-1) / d.displacement
        drive = weighted[..., None] * regressor
        if d.normalised:
            drive = drive / (1.0 + np.sum(regressor**2, axis=-1, keepdims=True))
        total = change + d.beta * drive
        current = signals @ self.inner_row
        current = current + self.gain_unit * d.displacement * np.sum(total * regressor, axis=-1)
        # What the valve cannot give is no error of the gains: adaptation waits while it saturates.
        free = np.abs(current) <= self.limit
        step = d.alpha * drive * free[..., None] - d.leakage * change
        change = np.clip(change + self.period * step, -d.bound, d.bound)
        integral = integral + self.period * error * free
        next_memory = np.concatenate([read, change, integral[..., None]], axis=-1)
        return as_action(current, self.limit), (np.nan_to_num(next_memory),)
