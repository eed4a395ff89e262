"""Low-passes of sensors as states of the table: ``f' = omega (signal - f)``, stepped with the table.

A sensor's anti-alias filter is analogue: it works on the signal between the samples of the controller.
Every signal is linear in state and nonlinear inputs, so that the filter is one more linear state of the
continuous table, and whatever steps the table (either engine, a gradient, a Kalman filter, a plan) steps
the filter as exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shake_env.model.nonlinearity import Nonlinearity
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import (
    LOAD_PRESSURE,
    SPOOL_POSITION,
    TABLE_DISPLACEMENT,
    TABLE_VELOCITY,
    CoupledPlant,
    StateSpace,
)

STATE_SIGNALS = {
    "load_pressure": LOAD_PRESSURE,
    "table_displacement": TABLE_DISPLACEMENT,
    "table_velocity": TABLE_VELOCITY,
    "spool_position": SPOOL_POSITION,
}  # place of each in x_A
OUTPUTS = {"table_acceleration": 0, "base_shear": 1}  # row of each in the table's outputs


@dataclass(frozen=True)
class LowPass:
    """A first-order low-pass on a signal."""

    signal: str  # of `STATE_SIGNALS` or `OUTPUTS`, or floor_acceleration_1, ...
    frequency: float  # [Hz] at which the gain is 1 / sqrt(2)
    scale: float  # size of the signal, SI, for the arithmetic only


def first_low_pass(plant: CoupledPlant, parts: Nonlinearity) -> int:
    """Return where the low-passes' states begin: behind ``[x_A, x_S]`` and slips."""
    stories = plant.specimen.stories
    return 4 + 2 * stories + stories * parts.yielding.active


def with_low_passes(
    table: StateSpace,
    low_passes: Sequence[LowPass],
    place: int,
    floors: FloatArray | None = None,
) -> StateSpace:
    """Return a continuous table with the outputs of low-passes as states from `place` on.

    Parameters
    ----------
    table
        ``[x_A, x_S, ...]`` with outputs ``[y_A, f_s]``, one or a batch.
    low_passes
        f of them.
    place
        Where the f states are put in, the table's own states from there on behind them.
    floors
        (..., stories, 2 or 3 stories) map from ``[x_r, x_r', s]`` to the floors' accelerations; needed
        where one of these is measured through a low-pass.
    """
    A, B, f = table.A, table.B, len(low_passes)
    batch, order, inputs = A.shape[:-2], A.shape[-1], B.shape[-1]
    rows, through = np.zeros((*batch, f, order)), np.zeros((*batch, f, inputs))
    for i, low_pass in enumerate(low_passes):
        name = low_pass.signal
        if name in STATE_SIGNALS:
            rows[..., i, STATE_SIGNALS[name]] = 1.0
        elif name in OUTPUTS:
            rows[..., i, :] = table.C[..., OUTPUTS[name], :]
            through[..., i, :] = table.D[..., OUTPUTS[name], :]
        else:
            assert floors is not None  # the caller gives them where a sensor asks
            rows[..., i, 4 : 4 + floors.shape[-1]] = floors[..., int(name.rsplit("_", 1)[1]) - 1, :]
    omega = 2.0 * math.pi * np.array([each.frequency for each in low_passes])
    own = np.broadcast_to(-np.diag(omega), (*batch, f, f))
    above = np.concatenate([A, np.zeros((*batch, order, f))], axis=-1)
    below = np.concatenate([omega[:, None] * rows, own], axis=-1)
    places = np.r_[:place, order : order + f, place:order]
    whole = np.concatenate([above, below], axis=-2)[..., places, :][..., places]
    driven = np.concatenate([B, omega[:, None] * through], axis=-2)[..., places, :]
    none = np.zeros((*table.C.shape[:-1], f))
    return StateSpace(whole, driven, np.concatenate([table.C, none], axis=-1)[..., places], table.D)
