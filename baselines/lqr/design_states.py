"""The states that a design is made on: all of them, less a motion of the table that costs nothing.

A table that stands displaced leaves both errors at zero. Without a stiffness (k_a = 0) its displacement
feeds nothing at all. With one, the load pressure ``k_a x_a / A_p`` holds it, and with the valve shut it
creeps back as the oil leaks, at the rate ``epsilon = K_c k_a / A_p^2``: days with Table I's leakage.
In a Riccati equation this mode is a pole within rounding of the unit circle that hardly any cost sees,
and the equation has no solution that arithmetic can find.

Below `SLOWEST` the mode is therefore left out: a design works on the states less their part along it
(on the quotient space, where the plant's equations hold exactly), and its law does nothing about it.
What is neglected is the mode's own acceleration, ``epsilon^2 x_a``. The most that a target makes of x_a
is a random walk of 0.17 m^2/s, without a high-pass; that is ``0.01 epsilon^3`` of the target's mean
square, with epsilon in rad/s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shake_env.model.parameters import FloatArray
from shake_env.model.plant import (
    LOAD_PRESSURE,
    TABLE_DISPLACEMENT,
    TABLE_VELOCITY,
    CoupledPlant,
    actuator_plant,
)

IntArray = NDArray[np.intp]

SLOWEST = 1e-3  # [rad/s] rate of a displaced table's creep below which designs leave it out


def observable_states(plant: CoupledPlant) -> IntArray:
    """Return the indices of the states that feed anything, (n - 1,) when k_a = 0 and (n,) otherwise.

    With k_a = 0 the position x_a is a pure integrator that no output and no other state sees. A
    Riccati equation that contains it has no stabilising solution.
    """
    model, position = plant.coupled, plant.layout.table_displacement
    if np.any(model.A[:, position]) or np.any(model.C[:, position]):
        return np.arange(model.order)
    return np.delete(np.arange(model.order), position)


def displaced_table(plant: CoupledPlant) -> tuple[float, FloatArray]:
    """Return the mode of a table that stands displaced: its rate [rad/s] and its state (n,) at 1 m.

    Without table stiffness or leakage the rate is 0. The specimen's part, of the order of the rate
    squared, is left out.
    """
    A = actuator_plant(plant.actuator, plant.equations).A
    pressure, rate = 0.0, 0.0
    for _ in range(5):  # contracts by the rate over the oil's and the table's own
        damping = -A[TABLE_VELOCITY, TABLE_VELOCITY] * rate
        stiffness = -A[TABLE_VELOCITY, TABLE_DISPLACEMENT]
        pressure = (rate**2 + stiffness - damping) / A[TABLE_VELOCITY, LOAD_PRESSURE]
        flow = pressure - A[LOAD_PRESSURE, TABLE_VELOCITY]
        rate = -A[LOAD_PRESSURE, LOAD_PRESSURE] * pressure / flow
    state = np.zeros(plant.layout.order)
    state[plant.layout.actuator] = pressure, 1.0, -rate, 0.0
    return float(rate), state


@dataclass(frozen=True)
class DesignStates:
    """The m of n states that a design works on, in SI."""

    indices: IntArray  # (m,) their places in the full state
    left_out: FloatArray  # (n,) the state of 1 m along the mode that is left out; 0: none is
    position: int  # place of x_a, by which the mode is measured

    @classmethod
    def from_plant(cls, plant: CoupledPlant, *, whole: bool = False) -> DesignStates:
        """Return the states less a displaced table's mode; `whole`: all, with a displacement weight."""
        position, n = plant.layout.table_displacement, plant.layout.order
        if not whole:
            rate, state = displaced_table(plant)
            if rate < SLOWEST:
                return cls(np.delete(np.arange(n), position), state, position)
        return cls(np.arange(n), np.zeros(n), position)

    @classmethod
    def from_law(cls, plant: CoupledPlant, gain: FloatArray) -> DesignStates:
        """Return the states of a closed loop: less the mode, where ``u = -gain @ x`` ignores it."""
        reduced = cls.from_plant(plant)
        parts = gain * reduced.left_out
        used = abs(float(np.sum(parts))) > 1e-12 * float(np.sum(np.abs(parts)))
        return cls.from_plant(plant, whole=True) if used else reduced

    def rows(self, of_states: FloatArray) -> FloatArray:
        """Return (m, k) of the design's states from (n, k) of all: rates, inputs, noise."""
        along = np.outer(self.left_out[self.indices], of_states[self.position])
        part: FloatArray = of_states[self.indices] - along
        return part

    def completed(self, law: FloatArray, scale: FloatArray) -> FloatArray:
        """Return a row (n,) over states in units of `scale` (n,), with what it needs on x_a.

        A law that has nothing on x_a is made one that ignores the mode that is left out.
        """
        if not np.any(self.left_out):
            return law
        along = self.left_out / scale
        row = law.copy()
        row[self.position] = -float(law @ along) / along[self.position]
        return row
