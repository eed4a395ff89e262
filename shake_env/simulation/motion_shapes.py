"""What a motion is to the ground under a table, a row a control period, prepared once and kept.

A recorded motion is its target and the ground filter's states that it comes from; filtered noise with an
envelope is its intensity. Past the last row the last row counts.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from shake_env.dynamics.ground import filter_state
from shake_env.model.discretization import DiscretePlant
from shake_env.model.parameters import FloatArray, GroundFilter
from shake_env.motion.targets import (
    EpisodeMotion,
    FilteredNoise,
    RecordedMotion,
    control_steps,
    target_history,
)


def motion_shape(motion: EpisodeMotion, discrete: DiscretePlant, ahead: int) -> FloatArray | None:
    """Return what shapes the ground under a motion, or None for noise without an envelope.

    Parameters
    ----------
    motion
        Of an episode.
    discrete
        Plant, physics step and control period.
    ahead
        Control periods that a preview reaches beyond the present one.

    Returns
    -------
    Of a record (periods, filter states + 2 stories + k + 1): filter states at the period's end, zeros in
    the place of the reference, and the target [m/s^2] at the ends of the physics steps, the first at the
    period's start. Of an envelope (periods, k): the intensity at the middle of each physics step.
    """
    k, dt = discrete.substeps, discrete.dt
    if isinstance(motion, RecordedMotion):
        return _history(motion, discrete.plant.ground, dt, k, 2 * discrete.layout.stories)
    if motion.envelope is None:
        return None
    return _intensity(motion, dt, k, ahead)


def initial_filter_state(motion: EpisodeMotion, ground: GroundFilter, dt: float) -> FloatArray:
    """Return the ground filter's state (2 or 4) at time 0."""
    if isinstance(motion, RecordedMotion):
        first: FloatArray = _filter_history(ground, motion, dt)[0]
        return first
    return np.zeros(2 if ground.highpass_frequency is None else 4)


def first_target(motion: EpisodeMotion, dt: float) -> float:
    """Return the target acceleration at time 0 [m/s^2]."""
    if isinstance(motion, RecordedMotion):
        return float(target_history(motion, dt).acceleration[0])
    return 0.0


@lru_cache(maxsize=64)
def _filter_history(ground: GroundFilter, motion: RecordedMotion, dt: float) -> FloatArray:
    return filter_state(ground, target_history(motion, dt), dt)


@lru_cache(maxsize=64)
def _history(motion: RecordedMotion, ground: GroundFilter, dt: float, k: int, room: int) -> FloatArray:
    target = target_history(motion, dt).acceleration
    states = _filter_history(ground, motion, dt)
    periods = -(-len(target) // k)
    samples, ends = np.zeros(periods * k + 1), states[k::k]
    samples[: len(target)] = target
    rows = np.zeros((periods + 1, states.shape[1] + room + k + 1))  # past the motion's end 0
    rows[: len(ends), : states.shape[1]] = ends
    for j in range(k + 1):
        rows[:periods, states.shape[1] + room + j] = samples[j : j + (periods - 1) * k + 1 : k]
    rows.flags.writeable = False
    return rows


@lru_cache(maxsize=64)
def _intensity(motion: FilteredNoise, dt: float, k: int, ahead: int) -> FloatArray:
    assert motion.envelope is not None  # `motion_shape` asked
    periods = control_steps(motion, k * dt, dt) + ahead + 1
    time = (np.arange(periods * k, dtype=np.float64) + 0.5) * dt
    rows = motion.envelope.at(time).reshape(periods, k)
    rows.flags.writeable = False
    return rows
