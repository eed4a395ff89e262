"""Displacement PID with pressure feedback: the oldest servo-hydraulic controller.

``u = k_p (e + 1/T_i integral e + T_d e') + k_v v~ - k_dp (p_l - its mean)`` with e = x~ - x_a, e' from
the velocity transducer, and load pressure high-passed so that a steady force costs no position (Merritt,
Hydraulic Control Systems, 1967, ch. 6; Conte and Trombetti, Earthq. Eng. Struct. Dyn. 29, 2000). The
gains follow a written rule from the nominal model, see :class:`PIDRule`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from baselines.servo.output_feedback import LinearLaw, NominalTable, OutputFeedback, SampledClosedLoop
from baselines.servo.signals import (
    DISPLACEMENT,
    PRESSURE,
    SIGNALS,
    TARGET_DISPLACEMENT,
    TARGET_VELOCITY,
    VELOCITY,
)
from shake_env.errors import NumericalError, ParameterError
from shake_env.model.parameters import require_positive
from shake_env.scenario.scenario import Scenario

HIGHEST_GAIN = 1e4  # [1/s] of the velocity that an error commands; no sampled table bears as much


@dataclass(frozen=True, kw_only=True)
class PIDGains:
    """Gains of a displacement PID, from metres to amperes."""

    proportional: float  # k_p [A/m]
    integral_time: float  # T_i [s]; infinite: no integral
    derivative_time: float  # T_d [s]
    feed_forward: float = 0.0  # k_v [A s/m] of the target's velocity
    pressure: float = 0.0  # k_dp [A/Pa]; either sign, for the valve's lag turns the phase
    pressure_corner: float = 1.0  # [Hz] of the pressure's high-pass

    def __post_init__(self) -> None:
        require_positive(self, "proportional", "pressure_corner")
        if not self.integral_time > 0.0:
            raise ParameterError("integral_time", self.integral_time, "must be above 0 s (inf: none)")
        if not 0.0 <= self.derivative_time < math.inf:
            raise ParameterError("derivative_time", self.derivative_time, "must be at least 0 s")
        for name in ("feed_forward", "pressure"):
            if not math.isfinite(getattr(self, name)):
                raise ParameterError(name, getattr(self, name), "must be finite")


def pid_law(gains: PIDGains, period: float) -> LinearLaw:
    """Return the PID as a discrete law with memory ``[integral of e, mean pressure]``.

    The integral is by rectangles. While the valve saturates it is led back with time constant T_i
    (back-calculation; Astrom and Hagglund, PID Controllers, 1995, sec. 3.5).
    """
    k_p = gains.proportional
    D = np.zeros(SIGNALS)
    D[TARGET_DISPLACEMENT], D[DISPLACEMENT] = k_p, -k_p
    damping = k_p * gains.derivative_time
    D[TARGET_VELOCITY], D[VELOCITY] = damping + gains.feed_forward, -damping
    D[PRESSURE] = -gains.pressure
    pole = math.exp(-2.0 * math.pi * gains.pressure_corner * period)
    B = np.zeros((2, SIGNALS))
    B[0, TARGET_DISPLACEMENT], B[0, DISPLACEMENT] = period, -period
    B[1, PRESSURE] = 1.0 - pole
    integral = 0.0 if math.isinf(gains.integral_time) else k_p / gains.integral_time
    return LinearLaw(
        A=np.diag([1.0, pole]),
        B=B,
        C=np.array([integral, gains.pressure]),
        D=D,
        W=np.array([period / k_p, 0.0]),
    )


@dataclass(frozen=True)
class UltimatePoint:
    """Where a proportional displacement loop begins to oscillate."""

    gain: float  # K_u [A/m]
    period: float  # T_u [s]


def ultimate_point(scenario: Scenario, pressure: float = 0.0) -> UltimatePoint:
    """Return the ultimate gain of the nominal PID displacement loop, sampled and delayed as it is.

    Raises
    ------
    NumericalError
        If the loop is unstable at any gain, or stable up to `HIGHEST_GAIN`.
    """
    table, unit = NominalTable.from_scenario(scenario), scenario.actuator.velocity_gain

    def loop(gain: float) -> SampledClosedLoop:
        gains = PIDGains(
            proportional=gain / unit, integral_time=math.inf, derivative_time=0.0, pressure=pressure
        )
        # The integral is not connected; left in, it would be a pole at 1.
        law = pid_law(gains, table.period)
        reduced = LinearLaw(law.A[1:, 1:], law.B[1:], law.C[1:], law.D, law.W[1:])
        return SampledClosedLoop(table, reduced)

    rising = np.geomspace(0.1, HIGHEST_GAIN, 200)
    unstable = [gain for gain in rising if not loop(gain).radius < 1.0]
    if not unstable or unstable[0] == rising[0]:
        raise NumericalError("ultimate gain", unstable[:1], "no gain is the first unstable one")
    low, high = rising[rising < unstable[0]][-1], unstable[0]
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if loop(middle).radius < 1.0 else (low, middle)
    angle = abs(float(np.angle(loop(high).poles[0])))
    return UltimatePoint(float(low) / unit, 2.0 * math.pi * table.period / angle)


@dataclass(frozen=True, kw_only=True)
class PIDRule:
    """How a laboratory tunes the loop.

    `share` is the proportional gain over the ultimate gain, and the times follow Ziegler and Nichols
    (Trans. ASME 64, 1942): T_i = T_u / 2, T_d = T_u / 8; their share is 0.6. `bandwidth` instead sets
    k_p = 2 pi f_b / k_v and T_i = 5 / (2 pi f_b), and feeds the target's velocity forward by the table's
    steady gain. It has no derivative of the measured velocity: behind valve lag and delay that excites
    an oil column of 1 % damping, and the rule's loop is unstable with Table I's table.
    """

    share: float | None = None  # [-] of the ultimate gain
    bandwidth: float | None = None  # f_b [Hz]
    pressure: float = 0.0  # k_dp [A/Pa]

    def __post_init__(self) -> None:
        if (self.share is None) == (self.bandwidth is None):
            raise ParameterError("share, bandwidth", (self.share, self.bandwidth), "give one of them")
        require_positive(self, "bandwidth" if self.share is None else "share")

    def gains(self, scenario: Scenario) -> PIDGains:
        """Return the gains for a scenario's nominal model.

        Raises
        ------
        NumericalError
            If the nominal loop is not stable with them.
        """
        if self.bandwidth is not None:
            omega = 2.0 * math.pi * self.bandwidth
            k_p, T_i, T_d = omega / scenario.actuator.velocity_gain, 5.0 / omega, 0.0
            feed_forward = 1.0 / scenario.actuator.velocity_gain
        else:
            assert self.share is not None  # as checked
            point = ultimate_point(scenario, self.pressure)
            k_p, T_i, T_d = self.share * point.gain, point.period / 2.0, point.period / 8.0
            feed_forward = 0.0
        gains = PIDGains(
            proportional=k_p,
            integral_time=T_i,
            derivative_time=T_d,
            feed_forward=feed_forward,
            pressure=self.pressure,
        )
        radius = SampledClosedLoop(
            NominalTable.from_scenario(scenario), pid_law(gains, scenario.control_period)
        ).radius
        if not radius < 1.0:
            raise NumericalError(
                "spectral radius", radius, "the rule makes an unstable loop: lower share or bandwidth"
            )
        return gains


def pid(scenario: Scenario, gains: PIDGains | None = None) -> OutputFeedback:
    """Return a displacement PID; without `gains` by the 1 Hz bandwidth rule."""
    values = PIDRule(bandwidth=1.0).gains(scenario) if gains is None else gains
    needs: tuple[str, ...] = ("table_displacement",)
    if values.derivative_time > 0.0:
        needs += ("table_velocity",)
    if values.pressure:
        needs += ("load_pressure",)
    return OutputFeedback(scenario, pid_law(values, scenario.control_period), needs)
