"""What is not linear about a real table: friction, valve, stops, yielding storeys.

Each part is a frozen value that is off by default, and a function, written against the array API, of the
state alone. A part never replaces a linear term: it is the difference from it. Switched off, or at
its limit (no friction, infinite supply pressure, far stops), the step is the linear one to the last bit;
with an infinite yield drift to rounding, for the slips stay in the sums as zeros.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from typing import Any

import array_api_compat
import numpy as np

from shake_env.errors import ParameterError
from shake_env.model.ranges import check_ranges

Array = Any  # a numpy array or a torch tensor


@dataclass(frozen=True, kw_only=True)
class Friction:
    """Friction of the actuator's seals and the table's bearings.

    ``F(v) = (F_c + (F_s - F_c) exp(-(v / v_s)^2)) tanh(v / v_0) + c_v v``, against the motion: Coulomb
    and Stribeck friction smoothed over v_0 (Armstrong-Helouvry, Dupont and Canudas de Wit, Automatica
    30, 1994).

    Raises
    ------
    ParameterError
        If a value is negative, a velocity zero, or the static friction below the Coulomb friction.
    """

    coulomb: float = 0.0  # F_c [N]
    static: float | None = None  # F_s [N]; None: as Coulomb, so that there is no Stribeck effect
    stribeck_velocity: float = 0.02  # v_s [m/s]
    smoothing_velocity: float = 0.005  # v_0 [m/s]
    viscous: float = 0.0  # c_v [N s/m], on top of the table's linear damping

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.static is not None and self.static < self.coulomb:
            raise ParameterError(
                "static", self.static, f"must be at least the Coulomb force {self.coulomb} N"
            )

    @property
    def active(self) -> bool:
        """Whether there is any friction."""
        return self.coulomb > 0.0 or (self.static or 0.0) > 0.0 or self.viscous > 0.0

    def at(self, coulomb: float) -> Friction:
        """Return this friction at another Coulomb force [N]; what sticking adds to it stays."""
        static = None if self.static is None else coulomb + (self.static - self.coulomb)
        return replace(self, coulomb=coulomb, static=static)

    def force(self, velocity: Array, coulomb: Array | None = None) -> Array:
        """Return the force on the table [N], (...), for its velocity (...) [m/s].

        Parameters
        ----------
        velocity
            (...) [m/s].
        coulomb
            (...) [N] in place of `coulomb`, where it differs from table to table (the excess stays).
        """
        xp = array_api_compat.array_namespace(velocity)
        level: Array = self.coulomb if coulomb is None else coulomb
        if self.static is not None:
            excess = self.static - self.coulomb
            level = level + excess * xp.exp(-((velocity / self.stribeck_velocity) ** 2))
        return -(level * xp.tanh(velocity / self.smoothing_velocity) + self.viscous * velocity)


@dataclass(frozen=True, kw_only=True)
class ServoValve:
    """Orifice flow, saturation, rate limit, dead band and second-order dynamics of the servovalve.

    ``Q = K_q x_e sqrt(max(1e-6, (P_s - sag |x_e| - sgn(x_e) p_l) / P_r))``, x_e the spool position
    outside the dead band and P_r the supply pressure that the flow gain K_q is rated at (Merritt,
    Hydraulic Control Systems, 1967, ch. 5); at p_l = 0 and P_s = P_r, without sag and dead band, it is
    the linear valve's K_q x_v.

    Raises
    ------
    ParameterError
        If a limit is not above zero or the dead band negative.
    """

    supply_pressure: float = math.inf  # P_s [Pa]; infinite: the linear flow
    rated_pressure: float | None = None  # P_r [Pa] that the flow gain belongs to; None: the supply's
    supply_sag: float = 0.0  # [Pa/m] by which the supply falls for each metre of opening
    spool_limit: float = math.inf  # [m]
    spool_rate_limit: float = math.inf  # [m/s]
    dead_band: float = 0.0  # half width [m]
    natural_frequency: float | None = None  # [Hz]; None: first order with the actuator's T_v
    damping_ratio: float = 0.8  # [-] of the second-order valve

    def __post_init__(self) -> None:
        check_ranges(self)

    def with_pilot_stage(self, time_constant: float) -> ServoValve:
        """Return this valve at second order: poles at ``1/T_v`` and, its pilot stage's, ten times that.

        Parameters
        ----------
        time_constant
            T_v [s] of the actuator's first-order valve.
        """
        return replace(
            self,
            natural_frequency=math.sqrt(10.0) / (2.0 * math.pi * time_constant),
            damping_ratio=11.0 / (2.0 * math.sqrt(10.0)),
        )

    @property
    def rated(self) -> float:
        """Supply pressure [Pa] that the flow gain belongs to."""
        if self.rated_pressure is None or self._unlimited:
            return self.supply_pressure
        return self.rated_pressure

    @property
    def missing(self) -> float:
        """What the supply is short of its rated pressure [Pa]."""
        if self.rated_pressure is None or self._unlimited:
            return 0.0
        return self.rated_pressure - self.supply_pressure

    @property
    def _unlimited(self) -> bool:
        return bool(np.all(np.isinf(self.supply_pressure)))  # one, or one a plant

    @property
    def flow_active(self) -> bool:
        """Whether the flow differs from K_q x_v."""
        return (
            math.isfinite(self.supply_pressure)
            or math.isfinite(self.spool_limit)
            or self.dead_band > 0.0
        )

    @property
    def active(self) -> bool:
        """Whether the valve differs from the linear one."""
        rate = math.isfinite(self.spool_rate_limit)
        return self.flow_active or rate or self.natural_frequency is not None

    def opening(self, spool: Array, pressure: Array, missing: Array | None = None) -> Array:
        """Return the spool position (...) [m] that would let the same flow through a linear valve.

        Parameters
        ----------
        spool
            (...) [m].
        pressure
            (...) load pressure [Pa].
        missing
            (...) [Pa] in place of `missing`, where it differs from table to table.
        """
        xp = array_api_compat.array_namespace(spool)
        opening = self.limited(spool)
        if self.dead_band > 0.0:
            past = (xp.abs(opening) - self.dead_band).clip(0.0, None)
            opening = xp.sign(opening) * past
        if math.isfinite(self.supply_pressure):
            short = self.missing if missing is None else missing
            short = short + self.supply_sag * xp.abs(opening)
            available = 1.0 - (xp.sign(opening) * pressure + short) / self.rated
            # The root's slope is infinite where the flow stops; the floor bounds it (and its gradient)
            # at a flow of a thousandth of the valve's.
            opening = opening * xp.sqrt(available.clip(1e-6, None))
        return opening

    def limited(self, spool: Array) -> Array:
        """Return the spool position (...) [m] within its limit."""
        if not math.isfinite(self.spool_limit):
            return spool
        return spool.clip(-self.spool_limit, self.spool_limit)


@dataclass(frozen=True, kw_only=True)
class StrokeStops:
    """Hard stops at the ends of the stroke: a stiff spring and a damper that only push.

    Raises
    ------
    ParameterError
        If the gap or the stiffness is not above zero, or the damping negative.
    """

    gap: float = math.inf  # [m] from the middle; infinite: no stops
    stiffness: float = 2e7  # [N/m]
    damping: float = 5e4  # [N s/m]

    def __post_init__(self) -> None:
        check_ranges(self)

    @property
    def active(self) -> bool:
        """Whether there are stops."""
        return math.isfinite(self.gap)

    def force(self, displacement: Array, velocity: Array) -> Array:
        """Return the force on the table (...) [N] for its displacement [m] and velocity [m/s]."""
        xp = array_api_compat.array_namespace(displacement)
        depth = (xp.abs(displacement) - self.gap).clip(0.0, None)
        outward = xp.sign(displacement) * velocity
        # Damping grows with depth over a millimetre, so that the force has no step at contact, and the
        # sum is never negative: a stop does not pull.
        damper = self.damping * outward * (depth / 1e-3).clip(0.0, 1.0)
        return -xp.sign(displacement) * (self.stiffness * depth + damper).clip(0.0, None)


@dataclass(frozen=True, kw_only=True)
class Yielding:
    """Storeys that yield by Bouc and Wen's law (Wen, J. Eng. Mech. Div. ASCE 102, 1976).

    The storey force is ``k (d - (1 - alpha) s)`` with the slip s = d - z,
    ``s' = d' |z / z_y|^n (1/2 + 1/2 sgn(d' z))``: z is the hysteretic drift, z_y its yield value. The
    reference specimen yields by the same law under the target motion.

    Raises
    ------
    ParameterError
        If the yield drift or exponent is not above zero, or the stiffness ratio outside 0 to 1.
    """

    yield_drift: float = math.inf  # z_y [m] of every storey; infinite: no yielding
    stiffness_ratio: float = 0.1  # alpha [-], stiffness after over before yielding
    exponent: float = 4.0  # n [-], sharpness of the knee

    def __post_init__(self) -> None:
        check_ranges(self)

    @property
    def active(self) -> bool:
        """Whether storeys yield."""
        return math.isfinite(self.yield_drift)

    def slip_rate(self, drift: Array, drift_rate: Array, slip: Array) -> Array:
        """Return s' (..., stories) [m/s] from drift [m], its rate [m/s] and slip [m] of each storey."""
        xp = array_api_compat.array_namespace(drift)
        hysteretic = (drift - slip) / self.yield_drift
        loading = xp.where(drift_rate * hysteretic > 0.0, 1.0, 0.0)
        # At |z| = z_y the slip takes all of the drift, so that the exact z goes no further. A step
        # overshoots by its own error, which a sharp knee would raise to a high power: bounded.
        return drift_rate * loading * xp.abs(hysteretic).clip(0.0, 1.0) ** self.exponent


@dataclass(frozen=True, kw_only=True)
class Nonlinearity:
    """The nonlinear parts of a table; the default is none."""

    friction: Friction = field(default_factory=Friction)
    valve: ServoValve = field(default_factory=ServoValve)
    stops: StrokeStops = field(default_factory=StrokeStops)
    yielding: Yielding = field(default_factory=Yielding)

    def __post_init__(self) -> None:
        kinds = (Friction, ServoValve, StrokeStops, Yielding)
        for each, kind in zip(fields(self), kinds, strict=True):
            if not isinstance(getattr(self, each.name), kind):
                raise ParameterError(each.name, getattr(self, each.name), f"must be a {kind.__name__}")

    @property
    def active(self) -> bool:
        """Whether any part is on."""
        return any((self.friction.active, self.valve.active, self.stops.active, self.yielding.active))
