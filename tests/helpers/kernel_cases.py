"""Nonlinear tables for the tests of the compiled kernels and their adjoint."""

import math
from dataclasses import replace

import numpy as np
from hypothesis import strategies as st

from shake_env import make_scenario
from shake_env.dynamics.nonlinear import ARRAYS, NonlinearDynamics, controlled_scale
from shake_env.model.nonlinearity import Friction, Nonlinearity, ServoValve, StrokeStops, Yielding
from shake_env.model.plant import REFERENCE_CURRENT

PARTS = st.builds(
    Nonlinearity,
    friction=st.sampled_from(
        [
            Friction(),
            Friction(coulomb=150.0),
            Friction(coulomb=100.0, static=240.0, viscous=30.0),
            Friction(static=200.0, stribeck_velocity=0.05),
        ]
    ),
    valve=st.builds(
        ServoValve,
        supply_pressure=st.sampled_from([math.inf, 21e6, 2e6]),
        rated_pressure=st.sampled_from([None, 25e6]),
        supply_sag=st.sampled_from([0.0, 5e10]),
        spool_limit=st.sampled_from([math.inf, 1.25e-5, 3e-6]),
        spool_rate_limit=st.sampled_from([math.inf, 1e-3, 1e-4]),
        dead_band=st.sampled_from([0.0, 4e-7]),
        natural_frequency=st.sampled_from([None, 60.0]),
    ),
    stops=st.sampled_from([StrokeStops(), StrokeStops(gap=0.02), StrokeStops(gap=0.001, damping=0.0)]),
    yielding=st.sampled_from(
        [
            Yielding(),
            Yielding(yield_drift=0.004),
            Yielding(yield_drift=0.01, exponent=1.0, stiffness_ratio=0.3),
            Yielding(yield_drift=0.01, exponent=2.5),
        ]
    ),
)


def dynamics_of(parts, stories, substeps, delay, lanes=None):
    """Return the update common to a batch, or of lanes that differ in specimen, valve and friction."""
    rng = np.random.default_rng(stories)
    own = []
    for _ in range(lanes or 1):
        actuator = replace(make_scenario().actuator, valve_time_constant=rng.uniform(0.008, 0.012))
        scenario = make_scenario(
            "linear", {"stories": stories, "mass_ratio": rng.uniform(0.1, 1.0), "physics_step": 1e-3}
        )
        friction = replace(parts.friction, static=None, coulomb=rng.uniform(100.0, 300.0))
        drawn = replace(parts, friction=friction) if parts.friction.static is None else parts
        own.append(
            NonlinearDynamics.from_plant(
                replace(scenario, actuator=actuator).plant,
                drawn if lanes and parts.friction.active else parts,
                1e-3,
                substeps,
                delay=rng.uniform(0.0, delay) if lanes else delay,
                longest_delay=delay,
            )
        )
    if lanes is None:
        return own[0]
    stacks = {name: np.stack([getattr(one, name) for one in own]) for name in ARRAYS}
    return replace(own[0], parts=parts, **stacks)


def scale_of(dynamics, stories):
    plant = make_scenario("linear", {"stories": stories}).plant
    commands = dynamics.arrival.shape[-1] - 1
    return np.concatenate(
        [controlled_scale(plant, dynamics.parts), np.full(commands, REFERENCE_CURRENT)]
    )


EVERYTHING = Nonlinearity(
    friction=Friction(coulomb=150.0),
    valve=ServoValve(
        supply_pressure=3e6,
        spool_limit=1e-5,
        spool_rate_limit=3e-4,
        dead_band=2e-7,
        natural_frequency=60.0,
    ),
    stops=StrokeStops(gap=0.02),
    yielding=Yielding(yield_drift=0.003),
)
