"""Whether a physics step resolves a scenario's fastest motion; refused before anything is computed."""

from __future__ import annotations

import math

import numpy as np

from shake_env.errors import ScenarioError
from shake_env.model.nonlinearity import Nonlinearity
from shake_env.model.parameters import Actuator, GroundFilter, Specimen

# Per physics step. The covariance of a step's noise is taken through exp(-A dt), which loses two of
# sixteen digits for each 2.3 of rate times step; beyond 10 too few are left.
FASTEST = 10.0
# Stops and added viscous friction are stepped explicitly: a step of twice their time is unstable.
FASTEST_EXPLICIT = 2.0


def fastest_rates(actuator: Actuator, specimen: Specimen, ground: GroundFilter) -> dict[str, float]:
    """Return a bound of the rate [rad/s] of each part of the linear plant, by the field that decides it.

    Frequencies of the storeys are bounded by Gershgorin's circles; an oscillator of frequency omega and
    damping ratio zeta has no pole faster than ``omega (zeta + sqrt(max(0, zeta^2 - 1)) + 1)``.
    """
    a, m = actuator, specimen.masses
    stiffness, damping = (
        max(2.0 * (links[i] + (links[i + 1] if i + 1 < len(m) else 0.0)) / m[i] for i in range(len(m)))
        + links[0] / a.table_mass
        for links in (specimen.stiffnesses, specimen.dampings)
    )
    if specimen.coupled:
        M = specimen.mass_matrix
        stiffness, damping = (
            float(np.abs(np.linalg.eigvals(np.linalg.solve(M, matrix))).max())
            + float(matrix.sum()) / a.table_mass
            for matrix in (specimen.stiffness_matrix, specimen.damping_matrix)
        )
    highpass = (ground.highpass_frequency or 0.0, ground.highpass_damping_ratio)
    return {
        "actuator.valve_time_constant": 1.0 / a.valve_time_constant,
        "actuator.bulk_modulus": math.sqrt(a.oil_stiffness / a.table_mass)
        + 4.0 * a.bulk_modulus * a.leakage / a.oil_volume,
        "actuator.table_damping": a.table_damping / a.table_mass,
        "actuator.table_stiffness": math.sqrt(a.table_stiffness / a.table_mass),
        "specimen.stiffnesses": math.sqrt(stiffness),
        "specimen.dampings": damping,
        "ground.frequency": _pole(ground.frequency, ground.damping_ratio),
        "ground.highpass_frequency": _pole(*highpass),
    }


def check_resolution(
    actuator: Actuator,
    specimen: Specimen,
    ground: GroundFilter,
    nonlinearity: Nonlinearity,
    physics_step: float,
) -> None:
    """Raise ScenarioError unless `physics_step` [s] is short beside the fastest motion.

    The linear part is stepped exactly, but in double precision; stops and viscous friction explicitly.
    """
    rates = fastest_rates(actuator, specimen, ground)
    valve, stops, friction = nonlinearity.valve, nonlinearity.stops, nonlinearity.friction
    if valve.natural_frequency is not None:
        rates["nonlinearity.valve.natural_frequency"] = _pole(
            valve.natural_frequency, valve.damping_ratio
        )
    _check(rates, FASTEST, physics_step)
    mass = actuator.table_mass
    explicit = {"nonlinearity.friction.viscous": friction.viscous / mass}
    if stops.active:
        explicit["nonlinearity.stops.stiffness"] = math.sqrt(stops.stiffness / mass)
        explicit["nonlinearity.stops.damping"] = stops.damping / mass
    _check(explicit, FASTEST_EXPLICIT, physics_step)


def _check(rates: dict[str, float], most: float, physics_step: float) -> None:
    field = max(rates, key=lambda name: rates[name])
    if rates[field] * physics_step > most:
        raise ScenarioError(
            "physics_step",
            physics_step,
            f"is too long for {field}, whose motion has a rate of {rates[field]:.3g} rad/s: must be at "
            f"most {most / rates[field]:.3g} s, or the rate {most / physics_step:.3g} rad/s",
        )


def _pole(frequency: float, damping_ratio: float) -> float:
    omega = 2.0 * math.pi * frequency
    return omega * (damping_ratio + math.sqrt(max(0.0, damping_ratio**2 - 1.0)) + 1.0)
