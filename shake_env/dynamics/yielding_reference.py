"""The reference specimen when its storeys yield: no linear map, so stepped with the target."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from shake_env.dynamics.nonlinear import apply, slip_rates, specimen_with_slip
from shake_env.model.discretization import first_order_hold
from shake_env.model.nonlinearity import Yielding
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import CoupledPlant

Array = Any  # a numpy array or a torch tensor

ARRAYS = ("A", "ground", "ground_next", "level", "slope", "C")


@dataclass(frozen=True)
class YieldingReference:
    """One physics step of ``[x~_r, x~_r', s~]`` under a target that runs straight between samples.

    The same scheme as the table's (`shake_env.dynamics.nonlinear`). Matrices are common, or one a table.
    """

    yielding: Yielding
    A: Array  # (..., 3 stories, 3 stories)
    ground: Array  # (..., 3 stories, 1) target at the step's start
    ground_next: Array  # (..., 3 stories, 1) target at its end
    level: Array  # (..., 3 stories, stories) slip rates, held
    slope: Array  # (..., 3 stories, stories) their change over the step
    C: Array  # (..., 1, 3 stories) base shear
    stories: int

    @classmethod
    def from_plant(cls, plant: CoupledPlant, yielding: Yielding, dt: float) -> YieldingReference:
        """Discretise the yielding specimen of a plant."""
        continuous = specimen_with_slip(plant, yielding)
        scale = plant.state_scale[..., plant.layout.reference]
        n = plant.specimen.stories
        model, slope = first_order_hold(continuous, dt, np.concatenate([scale, scale[..., :n]], axis=-1))
        return cls(
            yielding=yielding,
            A=model.A,
            ground=model.B[..., :1],
            ground_next=slope[..., :1],
            level=model.B[..., 1:] + slope[..., 1:],
            slope=slope[..., 1:],
            C=continuous.C,
            stories=n,
        )

    def pick(self, lanes: Any) -> YieldingReference:
        """Return the reference of some lanes, where each has matrices of its own."""
        if self.A.ndim == 2:
            return self
        return replace(self, **{name: getattr(self, name)[lanes] for name in ARRAYS})

    def run(self, state: FloatArray, target: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Follow a target.

        Parameters
        ----------
        state
            (N, 3 stories) at the start.
        target
            (samples + 1, N) y~ [m/s^2] at the ends of the physics steps.

        Returns
        -------
        final, states, shear
            (N, 3 stories), (samples, N, 3 stories) and (samples, N) [N], after each step.
        """
        states, shear = [], []
        g = slip_rates(self.yielding, state, self.stories)
        for now, following in pairwise(target):
            pushed = apply(self.ground, now[:, None]) + apply(self.ground_next, following[:, None])
            predicted = apply(self.A, state) + pushed + apply(self.level, g)
            change = slip_rates(self.yielding, predicted, self.stories) - g
            state = predicted + apply(self.slope, change)
            g = slip_rates(self.yielding, state, self.stories)
            states.append(state)
            shear.append(apply(self.C, state)[:, 0])
        return state, np.stack(states), np.stack(shear)
